"""The section on the diagnosis: what is missing, how sure that is, and what the data could not have shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Change, Diagnosis, FailureSpot, RankedEffect, UnknownPattern, evidence
from dynident.effects import EffectChoice, effect_by_id
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.reports.change_rows import FRICTION_COLUMNS, ChangeCells, FrictionCells, change_rows, friction_row
from dynident.reports.figures.candidates import candidates_figure
from dynident.reports.figures.changes import changes_figure
from dynident.reports.figures.evidence import evidence_figure
from dynident.reports.figures.friction_since import friction_figure
from dynident.reports.numbers import number, p_value, percent, span
from dynident.reports.section import Section
from dynident.reports.sections.summary import recommended_is_added
from dynident.reports.words import place_text, shape_text, title_of
from dynident.robot import Robot

VERDICTS = {
    "adequate": "Nothing is missing that this data could show",
    "missing_effect": "Something is missing, and it has a name",
    "unexplained": "Something is missing that no effect of the catalogue explains",
}
_MOST_SPOTS, _MOST_BARS, _MOST_PANELS, _MOST_ROWS = 12, 12, 8, 6


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
    unknown: tuple[tuple[UnknownPattern, str], ...]
    invisible: tuple[InvisibleRow, ...]
    spots: tuple[SpotRow, ...]
    next_experiment: NextExperiment | None

    @property
    def shown(self) -> int:
        """Number of candidates visible before the rest is unfolded: all significant ones, and at least a few."""
        return max([_MOST_ROWS, *(k for k, row in enumerate(self.candidates, 1) if row.candidate.significant)])


def diagnosis_section(
    identification: Identification, diagnosis: Diagnosis, recordings: Sequence[Recording] = ()
) -> Section:
    """Return the section on a diagnosis.

    Parameters
    ----------
    identification : Identification
    diagnosis : Diagnosis
    recordings : sequence of Recording
        Those in whose residual the effect of each finding is drawn; none: no such figure.

    Returns
    -------
    Section
    """
    robot = identification.model.robot
    content = DiagnosisContent(
        diagnosis.verdict,
        VERDICTS[diagnosis.verdict],
        diagnosis.summary,
        candidates_figure(diagnosis.candidates[:_MOST_BARS]) if diagnosis.candidates else None,
        _evidence(identification, diagnosis, recordings),
        tuple(_candidate(item, robot) for item in diagnosis.candidates),
        None if diagnosis.changes is None else tuple(_changed(diagnosis.changes, robot)),
        changes_figure(diagnosis.changes) if diagnosis.changes else None,
        FRICTION_COLUMNS,
        tuple(friction_row(difference) for difference in diagnosis.friction),
        friction_figure(diagnosis.friction),
        tuple(_choice(choice, robot) for choice in diagnosis.recommended),
        recommended_is_added(identification, diagnosis),
        tuple((pattern, percent(pattern.share, 2)) for pattern in diagnosis.unknown),
        tuple(_invisible(diagnosis, robot)),
        tuple(_spot(spot, robot) for spot in diagnosis.failure_map[:_MOST_SPOTS]),
        diagnosis.next_experiment if isinstance(diagnosis, AdvisedDiagnosis) else None,
    )
    return Section("diagnosis", "Diagnosis", "diagnosis", content)


def _evidence(identification: Identification, diagnosis: Diagnosis, recordings: Sequence[Recording]) -> Markup | None:
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
    return evidence_figure(panels, identification.model.robot) if panels else None


def _candidate(item: RankedEffect, robot: Robot) -> CandidateRow:
    return CandidateRow(
        item,
        effect_by_id(item.effect).title,
        place_text(item.joints, robot.joint_names),
        percent(item.error_before),
        percent(item.error_after),
        percent(item.error_drop, 2),
        p_value(item.p_value),
        percent(item.separability, 2),
        shape_text(item.choice),
        ", ".join(title_of(name) for name in item.equivalent),
    )


def _changed(changes: Sequence[Change], robot: Robot) -> Iterator[ChangeRow]:
    for change in changes:
        equivalent = ", ".join(title_of(name) for name in change.equivalent)
        for place, cells in enumerate(change_rows(change, robot)):
            yield ChangeRow(change, cells, equivalent, place == 0)


def _choice(choice: EffectChoice, robot: Robot) -> ChoiceText:
    effect = effect_by_id(choice.effect)
    return ChoiceText(effect.title, effect.id, place_text(choice.joints, robot.joint_names), shape_text(choice))


def _invisible(diagnosis: Diagnosis, robot: Robot) -> Iterator[InvisibleRow]:
    for effect in dict.fromkeys(item.effect for item in diagnosis.not_visible):
        items = [item for item in diagnosis.not_visible if item.effect == effect]
        joints = tuple(dict.fromkeys(name for item in items for name in item.joints))
        yield InvisibleRow(
            effect_by_id(effect).title,
            place_text(joints, robot.joint_names),
            tuple(dict.fromkeys(item.brief or item.reason for item in items)),
        )


def _spot(spot: FailureSpot, robot: Robot) -> SpotRow:
    unit = robot.joints[robot.joint_names.index(spot.joint)].effort_unit
    return SpotRow(spot, span(spot.low, spot.high, spot.unit), f"{number(spot.rms)} {unit}", number(spot.ratio, 2))
