"""`dynident.diagnose`: the diagnosis of a model, as a table that prints, plots and gives the next step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from dynident.advice import AdvisedDiagnosis, NextExperiment, advise
from dynident.api.argument_checks import check_arguments
from dynident.api.figure import Figure, join_figures
from dynident.api.model import Model
from dynident.api.model_identification import as_model
from dynident.api.named_tables import Framed, PlainText, Table, build_columns, describe_missing
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.diagnosis import (
    Conclusion,
    DetectionLimit,
    Diagnosis,
    Evidence,
    Examination,
    Invisible,
    RankedEffect,
    UnknownPattern,
    evidence,
    examine,
)
from dynident.diagnosis.diagnosis_request import DEFAULT_MOST_EFFECTS, DEFAULT_SIGNIFICANCE, DiagnosisChoices
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason
from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import format_effect
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.presentation.diagnosis_tables import EVIDENCE, build_candidate_table
from dynident.presentation.labels import format_hidden_effects, format_joints, format_shape_constants
from dynident.presentation.tables import ReportedTable
from dynident.progress import Progress, ignore_progress
from dynident.robot.limits_and_drives import split_hardware
from dynident.text_and_html_tables import join_html, render_list, render_paragraph

_MOST_BARS, _MOST_PANELS = 12, 8


@dataclass(frozen=True, eq=False)
class DiagnosedModel(Framed):
    """A model with its diagnosis.

    `to_frame` has a row for each candidate, best first: rank, effect (its id), joints, constants (in words, with
    units), error_before and error_after (relative errors, fractions, of the joints that the effect acts on, on blocks
    of time left out of the fit, beside the findings taken before; rows of different joints do not continue each other),
    error_drop (the share of the error that it removes), t_value, p_value (the probability that the best of all
    candidates would gain as evenly over the blocks of time by chance; it counts all of them, so that a larger t need
    not have a smaller p), significant, recommended, separability (0 to 1), equivalent (ids with commas), evidence,
    choice (the text that `Model.extend` takes), and reason (why it is a finding or not).

    Parameters
    ----------
    model : Model
        The model that was diagnosed.
    recordings : Recordings
        Those that the diagnosis was made from.
    examination : Examination
        The diagnosis as the library gives it, with what it leaves open and the data behind it.
    """

    model: Model
    recordings: Recordings
    examination: Examination

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis as the library gives it."""
        return self.examination.diagnosis

    @property
    def verdict(self) -> str:
        """adequate, missing_effect, unexplained or cannot_tell."""
        return self.diagnosis.verdict

    @property
    def summary(self) -> PlainText:
        """The findings, in a few sentences: `found.summary` or, as for a model, `found.summary()`."""
        return PlainText(self.diagnosis.summary)

    @property
    def recommended(self) -> tuple[EffectChoice, ...]:
        """The effects to add, in this order; `model.extend` takes one or all of them."""
        return self.diagnosis.recommended

    @property
    def candidates(self) -> tuple[RankedEffect, ...]:
        """All candidates, best first."""
        return self.diagnosis.candidates

    @property
    def unknown(self) -> tuple[UnknownPattern, ...]:
        """Dependences of the residual that no effect of the catalogue explains."""
        return self.diagnosis.unknown

    @property
    def not_visible(self) -> tuple[Invisible, ...]:
        """Effects that these recordings could not have shown, each with the reason."""
        return self.diagnosis.not_visible

    @cached_property
    def advised_diagnosis(self) -> AdvisedDiagnosis:
        """The diagnosis with the next experiment, which is computed when it is first asked for."""
        return advise(self.examination)

    @property
    def outcomes(self) -> tuple[CandidateOutcome, ...]:
        """What became of every effect on every joint, and why; findings first."""
        return self.diagnosis.outcomes

    @property
    def detection_limits(self) -> tuple[DetectionLimit, ...]:
        """The smallest size of each effect on each joint that these recordings would have shown with 95 %."""
        return self.diagnosis.detection_limits

    @property
    def questions(self) -> tuple[str, ...]:
        """Parts that recommended effects are of, asked for once: `hardware` of `load_robot` answers."""
        return self.diagnosis.questions

    @property
    def conclusion(self) -> Conclusion | None:
        """Whether something is missing, nothing above the limits is, or these data cannot tell; and what to do next."""
        return self.diagnosis.conclusion

    def plot_detection_limits(self) -> Figure:
        """Draw the detection limits as a map of effects and joints, in shares of the usual size.

        Returns
        -------
        Figure
            The map.

        Raises
        ------
        DynidentError
            Where the diagnosis has no limits.
        """
        from dynident.reports.figures.diagnosis import draw_detection_limits

        if not self.detection_limits:
            raise DynidentError("nothing to draw: the diagnosis has no detection limits")
        return join_figures([draw_detection_limits(self.detection_limits, self.model.robot)], "detection limits")

    def why_not(self, effect: str, joint: str = "") -> Reason:
        """Return why an effect on a joint is a finding or not.

        Parameters
        ----------
        effect : str
            Id of the effect, or with its joint: "backlash@elbow".
        joint : str
            Name of the joint; without it, the reason is that of the place where the effect explains most.

        Returns
        -------
        Reason
            Code, values, and the sentence (`str(reason)`).

        Raises
        ------
        DynidentError
            Where there is no such effect or joint.

        Examples
        --------
        >>> print(dy.diagnose(model).why_not("backlash", "elbow"))  # doctest: +SKIP
        Not significant: p = 0.34, and the level is 0.01.
        """
        joints = self.model.robot.joint_names
        if joint and joint not in joints:
            raise DynidentError(
                describe_missing("joint", str(joint), joints, {}), pointer="joint", title="Unknown joint"
            )
        return self.diagnosis.why_not(effect, joint)

    @property
    def next_experiment(self) -> NextExperiment | None:
        """The motion that would tell more, for `design`; None where no motion decides anything."""
        return self.advised_diagnosis.next_experiment

    @cached_property
    def evidence(self) -> tuple[Evidence, ...]:
        """What each significant candidate explains of the residual, joint by joint."""
        significant = [candidate for candidate in self.candidates if candidate.significant]
        return evidence(self.model.identification, significant, self.recordings.recordings)

    def _columns(self) -> Table:
        return build_columns(_FRAME_COLUMNS, [self._build_frame_row(candidate) for candidate in self.candidates])

    def plot(self) -> Figure:
        """Draw the ranking, and what each significant candidate explains of the residual.

        Returns
        -------
        Figure
            The ranking, and below it a panel for each joint and significant candidate.

        Raises
        ------
        DynidentError
            Where no effect was ranked.
        """
        from dynident.reports.figures.diagnosis import draw_candidates, draw_evidence

        # More bars or panels than these are too small to read.
        parts = [draw_candidates(self.candidates[:_MOST_BARS])] if self.candidates else []
        if self.evidence:
            parts.append(draw_evidence(self.evidence[:_MOST_PANELS], self.model.robot))
        if not parts:
            raise DynidentError("nothing to draw: the diagnosis ranked no effect")
        return join_figures(parts, "missing effects and their evidence")

    def _build_frame_row(self, candidate: RankedEffect) -> tuple[object, ...]:
        return (
            candidate.rank,
            candidate.effect,
            format_joints(candidate.joints, self.model.robot.joint_names),
            format_shape_constants(candidate.choice),
            candidate.error_before,
            candidate.error_after,
            candidate.error_drop,
            candidate.t_value,
            candidate.p_value,
            candidate.significant,
            candidate.choice in self.recommended,
            candidate.separability,
            ",".join(candidate.equivalent),
            candidate.evidence,
            format_effect(candidate.choice),
            candidate.reason.text if candidate.reason is not None else "",
        )

    def __repr__(self) -> str:
        # A terminal shows the significant candidates alone; the notebook's table and `to_frame` have all.
        findings = [candidate for candidate in self.candidates if candidate.significant]
        head = f"DiagnosedModel({self.verdict}): {self.summary}"
        text = self._table(findings).to_text(head) if findings else head
        return "\n".join((text, *self._list_open_questions()))

    def _repr_html_(self) -> str:
        robot, diagnosis = self.model.robot, self.diagnosis
        recommended = [
            f"{diagnosis.get_title(choice)} on {format_joints(choice.joints, robot.joint_names)}"
            for choice in diagnosis.recommended
        ]
        invisible = format_hidden_effects(diagnosis, robot)
        return join_html(
            render_paragraph(diagnosis.summary, strong=True),
            render_paragraph("Recommended, in this order:") + render_list(recommended) if recommended else "",
            render_paragraph("Evidence:") if recommended else "",
            render_list(candidate.evidence for candidate in diagnosis.candidates if candidate.significant),
            self._table(diagnosis.candidates).to_html(),
            render_paragraph(f"These data cannot show: {invisible}.") if invisible else "",
            *(render_paragraph(sentence) for sentence in self._list_open_questions()),
        )

    def _table(self, candidates: Sequence[RankedEffect]) -> ReportedTable:
        # The evidence stands above the table.
        return build_candidate_table(candidates, self.model.robot.joint_names).drop_columns(*EVIDENCE)

    def _list_open_questions(self) -> list[str]:
        count = len(self.examination.doubts)
        if not count:
            return []
        are_open = "1 question is open" if count == 1 else f"{count} questions are open"
        return [f"{are_open}: .next_experiment looks for a motion that decides."]


@check_arguments
def diagnose(
    model: Model | Identification,
    recordings: SomeRecordings | None = None,
    *,
    validation: SomeRecordings | None = None,
    candidates: str | Sequence[str] | None = None,
    max_effects: int = DEFAULT_MOST_EFFECTS,
    significance: float = DEFAULT_SIGNIFICANCE,
    hardware: Mapping[str, bool] | None = None,
    progress: Progress = ignore_progress,
) -> DiagnosedModel:
    """Name the physics that a model is missing.

    Parameters
    ----------
    model : Model
        The identified model, with or without its recordings.
    recordings : recordings, optional
        By default those from which the model was identified.
    validation : recordings, optional
        Held-out recordings. They propose nothing; what they do not confirm is not named. By default the model's own,
        or none where `recordings` are given.
    candidates : effect ids, optional
        Only these are tried, at least one; the whole catalogue where left out.
    max_effects : int
        Largest number of recommended effects; contacts do not count.
    significance : float
        Largest p-value of a finding: the probability that an effect is named although nothing is missing.
    hardware : mapping of part to bool
        Whether the robot has a part, as in `load_robot`. Effects of parts that the robot does not have are not
        proposed; `questions` asks about parts that are not stated.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    DiagnosedModel
        The ranked candidates, and the recommended effects.

    Raises
    ------
    DynidentError
        If there are no recordings, or if there is no such effect.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> diagnosis = dy.diagnose(model)
    >>> diagnosis.verdict
    'missing_effect'
    >>> [(choice.effect, choice.joints) for choice in diagnosis.recommended]
    [('stribeck', ('elbow',))]
    >>> better = model.extend(diagnosis)
    >>> better.held_out.relative_total < model.held_out.relative_total
    True
    """
    has, has_not = split_hardware(hardware or {})
    choices = DiagnosisChoices(list_candidates(candidates), max_effects, significance, has=has, has_not=has_not)
    desk_model = as_model(model)
    if recordings is None:
        desk_model.check_data("diagnose the model")
    checked_recordings = desk_model.recordings if recordings is None else as_recordings(recordings)
    check_not_empty(checked_recordings, "recordings")
    own = desk_model.validation if recordings is None else ()
    held_out = as_recordings(own if validation is None else validation)
    examination = examine(
        desk_model.identification,
        checked_recordings.recordings,
        choices,
        validation=held_out.recordings,
        checks={item.name: item.checks for item in checked_recordings},
        progress=progress,
    )
    return DiagnosedModel(desk_model, checked_recordings, examination)


def check_not_empty(recordings: Recordings, name: str) -> None:
    """Check that there is at least one recording.

    Parameters
    ----------
    recordings : Recordings
        The recordings to check.
    name : str
        The argument that they were given as, for the message.

    Raises
    ------
    DynidentError
        Where there is none.
    """
    if not recordings:
        raise DynidentError("give at least one recording", pointer=name, title="Recordings needed")


def list_candidates(candidates: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the effects to try as a request has them; a single one may be given by its name alone."""
    return (candidates,) if isinstance(candidates, str) else None if candidates is None else tuple(candidates)


_FRAME_COLUMNS = (
    "rank", "effect", "joints", "constants", "error_before", "error_after", "error_drop", "t_value", "p_value",
    "significant", "recommended", "separability", "equivalent", "evidence", "choice",
    "reason",
)  # fmt: skip
