"""Report section on a diagnosis: findings, their certainty, the worst places (12), what could not be seen; verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Change, Diagnosis, FailureSpot, RankedEffect, evidence
from dynident.diagnosis.diagnosis_summary import group_patterns
from dynident.effects import EffectChoice, get_effect
from dynident.identification import Identification
from dynident.number_format import format_number, format_p_value, format_percent, format_range
from dynident.recordings import Recording
from dynident.reports.figures.changes import draw_changes, draw_friction_differences
from dynident.reports.figures.diagnosis import draw_candidates, draw_detection_limits, draw_evidence
from dynident.reports.labels import format_joints, format_shape_constants, get_effect_title
from dynident.reports.reported_data import Section
from dynident.reports.result_tables import (
    FRICTION_COLUMNS,
    LIMIT_COLUMNS,
    ChangeCells,
    FrictionCells,
    format_change,
    format_friction_difference,
    format_limits,
    format_reason,
)
from dynident.reports.sections.summary import is_recommendation_added
from dynident.robot import Robot

VERDICTS = {
    "adequate": "These data show no missing effect",
    "missing_effect": "Effects are missing, and the diagnosis names them",
    "unexplained": "Something is missing that no effect of the catalogue explains",
}
_MOST_SPOTS, _MOST_BARS, _MOST_PANELS, _MOST_ROWS = 12, 12, 8, 4


@dataclass(frozen=True)
class CandidateRow:
    """One ranked candidate, in words."""

    candidate: RankedEffect
    title: str
    place: str
    before: str
    after: str
    drop: str
    p: str
    separability: str
    shape: str
    equivalent: str
    reason: str


@dataclass(frozen=True)
class ChangeRow:
    """One number that differs from the baseline, in words; the `first` row of a change also shows its evidence."""

    change: Change
    cells: ChangeCells
    equivalent: str
    first: bool


@dataclass(frozen=True)
class ChoiceText:
    """A recommended effect, in words."""

    title: str
    identifier: str
    place: str
    shape: str


@dataclass(frozen=True)
class InvisibleRow:
    """An effect that the data could not have shown, with all joints for which that holds."""

    title: str
    place: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class SpotRow:
    """A range of a variable in which the residual is large."""

    spot: FailureSpot
    place: str
    rms: str
    ratio: str


@dataclass(frozen=True)
class DiagnosisContent:
    """The content of the section."""

    verdict: str
    headline: str
    summary: str
    figure: Markup | None
    evidence: Markup | None
    candidates: tuple[CandidateRow, ...]
    changes: tuple[ChangeRow, ...] | None
    changes_figure: Markup | None
    friction_columns: tuple[str, ...]
    friction: tuple[FrictionCells, ...]
    friction_figure: Markup | None
    recommended: tuple[ChoiceText, ...]
    recommended_added: bool
    unknown: tuple[tuple[str, str, str], ...]
    invisible: tuple[InvisibleRow, ...]
    spots: tuple[SpotRow, ...]
    next_step: str
    is_good: bool
    limit_columns: tuple[str, ...]
    limits: tuple[tuple[str, ...], ...]
    limits_figure: Markup | None
    next_experiment: NextExperiment | None

    @property
    def shown(self) -> int:
        """Number of candidates visible before the rest is unfolded: all significant ones, and at least a few."""
        # Every significant candidate is shown, however many there are.
        return max([_MOST_ROWS, *(k for k, row in enumerate(self.candidates, 1) if row.candidate.significant)])


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
    content = DiagnosisContent(
        diagnosis.verdict,
        _word_headline(diagnosis),
        diagnosis.summary,
        draw_candidates(diagnosis.candidates[:_MOST_BARS]) if diagnosis.candidates else None,
        _draw_evidence(identification, diagnosis, recordings),
        tuple(_build_candidate_row(item, robot) for item in diagnosis.candidates),
        None if diagnosis.changes is None else tuple(_build_change_rows(diagnosis.changes, robot)),
        draw_changes(diagnosis.changes) if diagnosis.changes else None,
        FRICTION_COLUMNS,
        tuple(format_friction_difference(difference) for difference in diagnosis.friction),
        draw_friction_differences(diagnosis.friction),
        tuple(_build_choice_text(choice, diagnosis, robot) for choice in diagnosis.recommended),
        is_recommendation_added(identification, diagnosis),
        tuple(group_patterns(diagnosis.unknown, robot.joint_names)),
        tuple(_build_invisible_rows(diagnosis, robot)),
        tuple(_build_spot_row(spot, robot) for spot in diagnosis.failure_map[:_MOST_SPOTS]),
        diagnosis.conclusion.next_step if diagnosis.conclusion is not None else "",
        diagnosis.verdict == "adequate" and not is_undecided(diagnosis),
        LIMIT_COLUMNS,
        tuple(format_limits(diagnosis.detection_limits, robot)),
        draw_detection_limits(diagnosis.detection_limits, robot) if diagnosis.detection_limits else None,
        diagnosis.next_experiment if isinstance(diagnosis, AdvisedDiagnosis) else None,
    )
    return Section("diagnosis", "Diagnosis", "diagnosis", content)


def is_undecided(diagnosis: Diagnosis) -> bool:
    """Return whether a diagnosis concludes that its data cannot tell."""
    return diagnosis.conclusion is not None and diagnosis.conclusion.code == "cannot_tell"


def _word_headline(diagnosis: Diagnosis) -> str:
    """Return the headline: of a model in which nothing was found, what that is worth."""
    if diagnosis.conclusion is not None and (diagnosis.verdict == "adequate" or is_undecided(diagnosis)):
        return diagnosis.conclusion.headline.rstrip(".")
    return VERDICTS[diagnosis.verdict]


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


def _build_candidate_row(item: RankedEffect, robot: Robot) -> CandidateRow:
    return CandidateRow(
        item,
        item.title,
        format_joints(item.joints, robot.joint_names),
        format_percent(item.error_before),
        format_percent(item.error_after),
        format_percent(item.error_drop, 2),
        format_p_value(item.p_value),
        format_percent(item.separability, 2),
        format_shape_constants(item.choice),
        ", ".join(get_effect_title(name) for name in item.equivalent),
        format_reason(item),
    )


def _build_change_rows(changes: Sequence[Change], robot: Robot) -> Iterator[ChangeRow]:
    for change in changes:
        equivalent = ", ".join(get_effect_title(name) for name in change.equivalent)
        for place, cells in enumerate(format_change(change, robot)):
            yield ChangeRow(change, cells, equivalent, place == 0)


def _build_choice_text(choice: EffectChoice, diagnosis: Diagnosis, robot: Robot) -> ChoiceText:
    return ChoiceText(
        diagnosis.get_title(choice),
        choice.effect,
        format_joints(choice.joints, robot.joint_names),
        format_shape_constants(choice),
    )


def _build_invisible_rows(diagnosis: Diagnosis, robot: Robot) -> Iterator[InvisibleRow]:
    # One row for each effect, with the joints and the different reasons collected.
    for effect in dict.fromkeys(item.effect for item in diagnosis.not_visible):
        items = [item for item in diagnosis.not_visible if item.effect == effect]
        joints = tuple(dict.fromkeys(name for item in items for name in item.joints))
        yield InvisibleRow(
            get_effect(effect).title,
            format_joints(joints, robot.joint_names),
            _shorten_reasons(list(dict.fromkeys(item.brief or item.reason for item in items))),
        )


def _shorten_reasons(reasons: Sequence[str]) -> tuple[str, ...]:
    """Return a few reasons; a robot with many joints has one for each, and a table with all limits."""
    if len(reasons) <= _MOST_ROWS:
        return tuple(reasons)
    return (*reasons[: _MOST_ROWS - 1], f"and {len(reasons) - _MOST_ROWS + 1} more, as in the table of limits")


def _build_spot_row(spot: FailureSpot, robot: Robot) -> SpotRow:
    unit = robot.joints[robot.joint_names.index(spot.joint)].effort_unit
    return SpotRow(
        spot,
        format_range(spot.low, spot.high, spot.unit),
        f"{format_number(spot.rms)} {unit}",
        format_number(spot.ratio, 2),
    )
