"""What a model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from dynident.advice import AdvisedDiagnosis, NextExperiment, advise
from dynident.desk.figure import Figure, figure_of
from dynident.desk.frames import Columns, Framed, columns_of
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import Recordings, SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.diagnosis import (
    Evidence,
    Invisible,
    RankedEffect,
    UnknownPattern,
    evidence,
    examine,
)
from dynident.diagnosis.stated import DEFAULT_MOST_EFFECTS
from dynident.effects import EffectChoice
from dynident.effects.written import effect_text
from dynident.errors import DynidentError
from dynident.html import block, listed, paragraph, table
from dynident.identification import Identification
from dynident.progress import Progress, silent
from dynident.reports.candidate_rows import COLUMNS, candidate_rows
from dynident.reports.words import hidden_text, place_text, shape_text, title_of

_MOST_BARS, _MOST_PANELS = 12, 8


@dataclass(frozen=True, eq=False)
class DiagnosedModel(Framed):
    """What is missing in a model: `diagnosis` as the library knows it, with the model and the recordings looked at.

    `to_frame` has a row a family of effects, best first: rank, effect (its id), joints, constants (in words, with
    units), error_before, error_after and error_drop (relative, fractions, held out), t_value, p_value, significant,
    recommended, separability (0 to 1), equivalent (ids with commas), evidence, and choice, the text that `Model.extend`
    takes.
    """

    model: Model
    recordings: Recordings
    diagnosis: AdvisedDiagnosis

    @property
    def verdict(self) -> str:
        """adequate, missing_effect or unexplained."""
        return self.diagnosis.verdict

    @property
    def summary(self) -> str:
        """What was found, in a few sentences."""
        return self.diagnosis.summary

    @property
    def recommended(self) -> tuple[EffectChoice, ...]:
        """What should be added, in this order; `model.extend` takes them, one or all."""
        return self.diagnosis.recommended

    @property
    def candidates(self) -> tuple[RankedEffect, ...]:
        """All families of effects, best first."""
        return self.diagnosis.candidates

    @property
    def unknown(self) -> tuple[UnknownPattern, ...]:
        """What the residual still depends on, though no effect of the catalogue explains it."""
        return self.diagnosis.unknown

    @property
    def not_visible(self) -> tuple[Invisible, ...]:
        """Effects that these recordings could not have shown, each with the reason."""
        return self.diagnosis.not_visible

    @property
    def next_experiment(self) -> NextExperiment | None:
        """The motion that would tell more, for `design`; None where nothing is left to decide."""
        return self.diagnosis.next_experiment

    @cached_property
    def evidence(self) -> tuple[Evidence, ...]:
        """What each significant finding explains of the residual, joint by joint."""
        shown = [one for one in self.candidates if one.significant]
        return evidence(self.model.identification, shown, self.recordings.recordings)

    def _columns(self) -> Columns:
        return columns_of(_FRAME_COLUMNS, [self._frame_row(one) for one in self.candidates])

    def plot(self) -> Figure:
        """Draw the ranking, and what each significant finding explains of the residual."""
        from dynident.reports.figures.candidates import candidates_figure
        from dynident.reports.figures.evidence import evidence_figure

        parts = [candidates_figure(self.candidates[:_MOST_BARS])] if self.candidates else []
        if self.evidence:
            parts.append(evidence_figure(self.evidence[:_MOST_PANELS], self.model.robot))
        if not parts:
            raise DynidentError("the diagnosis ranked no effect: there is nothing to draw")
        return figure_of(parts, "what is missing, and the evidence")

    def _frame_row(self, one: RankedEffect) -> tuple[object, ...]:
        return (
            one.rank,
            one.effect,
            place_text(one.joints, self.model.robot.joint_names),
            shape_text(one.choice),
            one.error_before,
            one.error_after,
            one.error_drop,
            one.t_value,
            one.p_value,
            one.significant,
            one.choice in self.recommended,
            one.separability,
            ",".join(one.equivalent),
            one.evidence,
            effect_text(one.choice),
        )

    def __repr__(self) -> str:
        rows = candidate_rows((one for one in self.candidates if one.significant), self.model.robot)
        head = f"DiagnosedModel({self.verdict}): {self.summary}"
        return text_table(head, COLUMNS, rows, len(rows), right_from=3) if rows else head

    def _repr_html_(self) -> str:
        robot, found = self.model.robot, self.diagnosis
        recommended = [
            f"{title_of(one.effect)} on {place_text(one.joints, robot.joint_names)}" for one in found.recommended
        ]
        invisible = hidden_text(found, robot)
        return block(
            paragraph(found.summary, strong=True),
            paragraph("Recommended, in this order:") + listed(recommended) if recommended else "",
            paragraph("Evidence:") if recommended else "",
            listed(one.evidence for one in found.candidates if one.significant),
            table(COLUMNS, candidate_rows(found.candidates, robot), right_from=3),
            paragraph(f"These data could not have shown: {invisible}.") if invisible else "",
            _next(found.next_experiment),
        )


def diagnose(
    model: Model | Identification,
    recordings: SomeRecordings | None = None,
    *,
    candidates: Sequence[str] | None = None,
    most_effects: int = DEFAULT_MOST_EFFECTS,
    progress: Progress = silent,
) -> DiagnosedModel:
    """Name the physics that a model is missing.

    Parameters
    ----------
    model : Model
    recordings : recordings, optional
        The data to learn from; those that the model was identified from where nothing is said, so that the validation
        data remain a fair judge.
    candidates : effect ids, optional
        Only these; the whole catalogue otherwise.
    most_effects : int
        At most so many are recommended.

    Raises
    ------
    DynidentError
        Where there are no recordings, or no such effect.
    """
    known = as_model(model)
    if recordings is None:
        known.check_data("diagnose the model")
    learnt = known.recordings if recordings is None else as_recordings(recordings)
    check_some(learnt, "recordings")
    examined = examine(
        known.identification,
        learnt.recordings,
        candidates=candidates,
        most_effects=most_effects,
        progress=progress,
    )
    return DiagnosedModel(known, learnt, advise(examined))


def check_some(recordings: Recordings, name: str) -> None:
    """Raise `DynidentError` where there is no recording; `name` is the argument."""
    if not recordings:
        raise DynidentError("give at least one recording", pointer=name, title="Recordings needed")


_FRAME_COLUMNS = (
    "rank", "effect", "joints", "constants", "error_before", "error_after", "error_drop", "t_value", "p_value",
    "significant", "recommended", "separability", "equivalent", "evidence", "choice",
)  # fmt: skip


def _next(experiment: NextExperiment | None) -> str:
    if experiment is None:
        return ""
    return paragraph(f"Next experiment: {experiment.reason}") + listed(experiment.instructions)
