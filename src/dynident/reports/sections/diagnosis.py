"""Report section on a diagnosis: findings, their certainty, the worst places (12), what could not be seen; verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Diagnosis, evidence
from dynident.identification import Identification
from dynident.number_format import format_count
from dynident.presentation.diagnosis_tables import build_candidate_table, build_diagnosis_tables
from dynident.presentation.tables import ReportedTable
from dynident.recordings import Recording
from dynident.reports.figures.changes import draw_changes, draw_friction_differences
from dynident.reports.figures.diagnosis import draw_candidates, draw_detection_limits, draw_evidence
from dynident.reports.reported_data import Section
from dynident.reports.sections.summary import is_recommendation_added

_IN_EVIDENCE = ("error before", "after")
"""Columns of the ranking that the sentence of the evidence repeats; without them it has room."""
_MOST_BARS, _MOST_PANELS, _MOST_ROWS = 12, 8, 4


@dataclass(frozen=True)
class DiagnosisContent:
    """The content of the section."""

    figure: Markup | None
    evidence: Markup | None
    findings: ReportedTable | None
    others: ReportedTable | None
    tables: Mapping[str, ReportedTable]
    changes_figure: Markup | None
    friction_figure: Markup | None
    recommended_added: bool
    is_good: bool
    limits_figure: Markup | None
    next_experiment: NextExperiment | None


def build_diagnosis_section(
    identification: Identification, diagnosis: Diagnosis, recordings: Sequence[Recording] = ()
) -> Section:
    """Return the section on a diagnosis.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    diagnosis : Diagnosis
        The diagnosis.
    recordings : sequence of Recording
        Recordings in whose residual the effect of each finding is drawn; none: no such figure.

    Returns
    -------
    Section
        Candidates, changes, evidence, and the next experiment.
    """
    robot = identification.model.robot
    names, candidates = robot.joint_names, diagnosis.candidates
    units = [joint.effort_unit for joint in robot.joints]
    # All significant candidates are visible before the rest is unfolded, and at least a few.
    shown = max([_MOST_ROWS, *(k for k, item in enumerate(candidates, 1) if item.significant)])
    rest = candidates[shown:]
    rest_title = f"{format_count(len(rest), 'more effect')} that {'was' if len(rest) == 1 else 'were'} tried"
    content = DiagnosisContent(
        draw_candidates(diagnosis.candidates[:_MOST_BARS]) if diagnosis.candidates else None,
        _draw_evidence(identification, diagnosis, recordings),
        build_candidate_table(candidates[:shown], names).drop_columns(*_IN_EVIDENCE) if candidates else None,
        build_candidate_table(rest, names, rest_title).drop_columns(*_IN_EVIDENCE) if rest else None,
        {table.name: table for table in build_diagnosis_tables(diagnosis, names, units)},
        draw_changes(diagnosis.changes) if diagnosis.changes else None,
        draw_friction_differences(diagnosis.friction),
        is_recommendation_added(identification, diagnosis),
        diagnosis.verdict == "adequate",
        draw_detection_limits(diagnosis.detection_limits, robot) if diagnosis.detection_limits else None,
        diagnosis.next_experiment if isinstance(diagnosis, AdvisedDiagnosis) else None,
    )
    return Section("diagnosis", "Diagnosis", "diagnosis", content)


def _draw_evidence(
    identification: Identification, diagnosis: Diagnosis, recordings: Sequence[Recording]
) -> Markup | None:
    """Draw what the findings explain of the residual of the model that was diagnosed."""
    # A change is only in the later recordings, which this model may never have seen.
    changed = {(change.choice.effect, change.choice.runs) for change in diagnosis.changes or ()}
    findings = [
        item
        for item in diagnosis.candidates
        if item.significant and (item.choice.effect, item.choice.runs) not in changed
    ]
    if not findings or not recordings:
        return None
    recommended_effects = {choice.effect for choice in diagnosis.recommended}
    models = list(identification.ladder())
    # The model may already contain the recommended effects. The residual to draw is that of the last one without them.
    before = [m for m in models if not recommended_effects & {choice.effect for choice in m.choices.effects}]
    panels = evidence((before or models)[-1], findings, recordings)[:_MOST_PANELS]
    return draw_evidence(panels, identification.model.robot) if panels else None
