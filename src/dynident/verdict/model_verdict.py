"""The verdict of a model and its data: fit for what, why not, whether to stop, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.blas_threads import single_threaded
from dynident.diagnosis.comparing.data_leakage import DataOverlap, find_overlaps
from dynident.estimation import Errors, find_outlying_spans
from dynident.identification import Identification
from dynident.identification.recording_faults import CAUSES, VETOES, check_recording_faults
from dynident.identification.thresholds import LARGEST_ERROR, OVERFIT, STOP, USUAL, USUAL_IN_FULL
from dynident.recordings import Check, Recording, Revision
from dynident.robot import Robot
from dynident.text_and_html_tables import join_html, render_list, render_paragraph
from dynident.validation.simulation import Drift
from dynident.verdict.detectable_loads import DetectableForce, compute_detectable_force, compute_detectable_mass
from dynident.verdict.evidence import HeldOutEvidence, Outcome
from dynident.verdict.use_findings import (
    DIAGNOSE,
    USES,
    State,
    Use,
    UseFinding,
    UseName,
    combine_findings,
    compute_drift,
    judge_collision_detection,
    judge_errors,
    judge_feed_forward,
    judge_payload,
    judge_simulation,
    judge_units,
)

SCALED = 5.0
"""Times the measured torque by which a prediction is off from which on it is a unit or a gain."""


@dataclass(frozen=True)
class Stop:
    """The most probable cause of a gross mistake.

    Parameters
    ----------
    cause : str
        The cause, in a sentence or two.
    recording : str or None
        Name of the recording that shows it; None where it is no single one.
    apply : Revision or None
        Change of the metadata that cures that recording, where it is known.
    records_more : bool
        Whether nothing is wrong but that the data determine too little.
    """

    cause: str
    recording: str | None = None
    apply: Revision | None = None
    records_more: bool = False


def is_hopeless(errors: Errors | None) -> bool:
    """Tell whether an error is so large that the model is not to be used.

    Parameters
    ----------
    errors : Errors or None
        Errors of the fit or on held-out data.

    Returns
    -------
    bool
        False where there are no errors to judge by.
    """
    # Written with `not`, so that an error that is no number counts as too large.
    return errors is not None and bool(errors.counts.any()) and not errors.relative_total <= STOP


def find_stop_cause(
    identification: Identification,
    fitted: Sequence[Recording],
    held_out: Sequence[Recording],
    common: Sequence[DataOverlap],
) -> Stop | None:
    """Find the most probable cause for which a model is not to be used; None where it may be used.

    Causes are looked for in the order of what they usually cost: content, columns, then what only a person can see.

    Parameters
    ----------
    identification : Identification
        The identified model.
    fitted : sequence of Recording
        Data of the fit.
    held_out : sequence of Recording
        Held-out data.
    common : sequence of DataOverlap
        What the two share.

    Returns
    -------
    Stop or None
        The cause; None where the model may be used.
    """
    copied = next((overlap for overlap in common if overlap.kind == "copied"), None)
    if copied is not None:
        return Stop(str(copied), copied.held_out)
    if not is_hopeless(identification.held_out) and not is_hopeless(identification.fit):
        return None
    error, data_name = _select_worst_errors(identification)
    robot = identification.model.robot
    # Where only held-out data fail, the fault is most probably in one of them.
    for recording in (*held_out, *fitted) if data_name == "held out" else fitted:
        cause = _find_failed_check(robot, recording)
        if cause is not None:
            return cause
    # If the joints are explained while they move, columns and units are right, and the rows at rest are to blame.
    moving = identification.held_out_moving if data_name == "held out" else identification.fit_moving
    if moving is not None and moving.counts.any() and moving.relative_total <= STOP:
        return Stop(
            f"The model does not explain {error.relative_total:.0%} of the torque on all rows, but only "
            f"{moving.relative_total:.0%} where the joints move: the fault is in the rows at standstill. Engaged "
            "brakes or drives that are off make the torque there meaningless: leave these seconds out."
        )
    if (
        data_name == "held out"
        and identification.fit.relative_total * OVERFIT < error.relative_total
        and _are_most_joints_bad(error)
    ):
        return Stop(
            f"The model leaves {identification.fit.relative_total:.0%} of the torque unexplained in the fit, but "
            f"{error.relative_total:.0%} on the held-out data. Columns and units are right, because the fit is good: "
            "either its motion does not determine the parameters that the held-out data need, or the held-out data "
            "have another load. Record a designed motion.",
            records_more=True,
        )
    return Stop(_word_by_joints(robot, moving if moving is not None and moving.counts.any() else error, data_name))


def _are_most_joints_bad(error: Errors) -> bool:
    """Return whether most joints are bad: a single bad joint would point at its own column."""
    relative = error.relative[error.counts > 0]
    return bool((relative > STOP).mean() > 0.5)


def _select_worst_errors(identification: Identification) -> tuple[Errors, str]:
    fit, held_out = identification.fit, identification.held_out
    if held_out is not None and is_hopeless(held_out) and not is_hopeless(fit):
        return held_out, "held out"
    return fit if is_hopeless(fit) or held_out is None else held_out, "fit"


def _find_failed_check(robot: Robot, recording: Recording) -> Stop | None:
    """Return the gravest finding of the checks that hold a recording against the robot's dynamics."""
    n = recording.n
    # The names of the columns do not matter here, they only appear in the words of the checks.
    checks = check_recording_faults(
        robot, recording, [f"q{k + 1}" for k in range(n)], [f"tau{k + 1}" for k in range(n)]
    ).checks
    failed_checks = sorted(
        (check for check in checks if check.name in CAUSES and check.status != "ok"), key=_get_severity
    )
    if not failed_checks:
        return None
    return Stop(f"In {recording.name}: {failed_checks[0].detail}", recording.name, failed_checks[0].apply)


def _get_severity(check: Check) -> bool:
    # Errors sort before warnings; among equals the order of the checks stays.
    return check.status != "error"


def _word_by_joints(robot: Robot, error: Errors, data_name: str) -> str:
    names = robot.joint_names
    relative = np.where(error.counts > 0, error.relative, 0.0)
    worst = int(np.argmax(relative))
    bad = [j for j in range(len(names)) if relative[j] > STOP]
    data_words = "the data of the fit" if data_name == "fit" else "held-out data"
    if len(bad) < len(names) and relative[worst] > STOP:
        return (
            f"On {data_words} the model does not explain "
            f"{', '.join(f'{names[j]} ({relative[j]:.0%})' for j in bad)}, but it explains the other joints: check "
            "the unit, the drive gain and the zero position of these joints, and their axes in the description."
        )
    both = (
        "The model does not explain the data of the fit"
        if data_name == "fit"
        else "The model explains the data of the fit but not the held-out data"
    )
    return (
        f"{both}, on nearly all joints: the cause may be another robot, another load, a wrong unit of all columns, "
        "or a wrong direction of gravity."
    )


@dataclass(frozen=True, eq=False)
class ModelVerdict:
    """What a model is fit for.

    Parameters
    ----------
    uses : tuple of Use
        Each use with its state, the reason and a next step.
    held_out : Errors or None
        Errors on held-out data that the model was judged by; None where there are none.
    held_out_moving : Errors or None
        The same where each joint moves.
    stop : Stop or None
        Why the model is not to be used at all; None where it may.
    common : tuple of DataOverlap
        What held-out data share with those of the fit.
    next_steps : tuple of str
        What to do about the error, in the order of what it usually costs.
    drift : Drift or None
        How far a simulation without a controller drifts; None where nothing tells.
    force : DetectableForce or None
        Which force at the tool shows; None where nothing tells.
    mass : float or None
        Mass in kg from which on a load shows; None where nothing tells.
    """

    uses: tuple[Use, ...]
    held_out: Errors | None
    held_out_moving: Errors | None
    stop: Stop | None
    common: tuple[DataOverlap, ...]
    next_steps: tuple[str, ...]
    drift: Drift | None = None
    force: DetectableForce | None = None
    mass: float | None = None

    @property
    def summary(self) -> str:
        """The verdict in a sentence."""
        if self.stop is not None:
            return f"Stop: {self.stop.cause}"
        parts = {words: [use.words for use in self.uses if use.state == state] for state, words in _STATES.items()}
        text = "; ".join(f"{words} {', '.join(names)}" for words, names in parts.items() if names)
        return f"{text[:1].upper()}{text[1:]}."

    def __repr__(self) -> str:
        return "\n".join([f"ModelVerdict: {self.summary}", *(f"  {line}" for line in self._lines())])

    def _repr_html_(self) -> str:
        return join_html(render_paragraph(self.summary, strong=True), render_list(self._lines()))

    def _lines(self) -> list[str]:
        """List the uses with their reasons, unless the model is not to be used at all, and the next steps."""
        uses = () if self.stop is not None else self.uses
        lines = [f"{use.mark} {use.words}: {use.reason} → {use.next_step}" for use in uses]
        return [*lines, *(f"→ {step}" for step in self.next_steps)]


_STATES: Mapping[State, str] = {
    "yes": "fit for",
    "limited": "fit within limits for",
    "no": "not fit for",
    "not_judged": "not judged for",
}


@single_threaded
def verdict(
    identification: Identification,
    recordings: Sequence[Recording] = (),
    validation: Sequence[Recording] = (),
    checks: Mapping[str, Sequence[Check]] | None = None,
    outcomes: Sequence[Outcome] = (),
) -> ModelVerdict:
    """Judge what a model is fit for.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        What the model was identified from. Without them and the held-out data neither overlaps between the two nor the
        cause of a gross mistake are looked for, and uses that need the residual in time are not judged.
    validation : sequence of Recording
        The held-out data.
    checks : mapping of a recording's name to its checks, optional
        What the checks found when the recordings were read. Where they say that size, sign or gravity are wrong, the
        model is fit for nothing, however small its errors are: a wrong scale is fitted as well as the right one.
    outcomes : sequence of Outcome
        How validations of this model ended: they revise the verdict of their use.

    Returns
    -------
    ModelVerdict
        The state of each use, with reasons and next steps.
    """
    common = find_overlaps(recordings, validation)
    # What is looked for in the columns of a stopped model shows in motion alone.
    at_rest = identification.model.is_at_rest
    stop = None if at_rest else find_stop_cause(identification, recordings, validation, common)
    reservations = [UseFinding("limited", str(overlap), _ANOTHER) for overlap in common if overlap.kind == "repeated"]
    if identification.model.robot.joints_without_torque:
        silent = ", ".join(identification.model.robot.joints_without_torque)
        sentence = f"Not for {silent}, whose torque was not recorded."
        reservations.append(UseFinding("limited", sentence, f"Record the torque of {silent}, too."))
    against = _find_universal_objection(identification, stop, common, checks or {})
    held_out = identification.held_out
    drift, force, mass = None, None, None
    if against is not None or held_out is None:
        finding = against or UseFinding(
            "not_judged",
            "There are no held-out data to judge the model by: give a recording that the fit does not use.",
            "Record another motion, and hold it out.",
        )
        uses = tuple(combine_findings(name, [finding], "") for name in USES)
    else:
        # Each use has its own findings. Failed validations and reservations count for all of them, and come first,
        # since the first of the gravest findings gives the next step.
        evidence = HeldOutEvidence.from_identification(identification, held_out, validation, outcomes)
        robot = identification.model.robot
        drift = compute_drift(evidence)
        force, mass = (
            compute_detectable_force(robot, evidence.comparisons),
            compute_detectable_mass(robot, evidence.comparisons),
        )
        findings_by_use: dict[UseName, list[UseFinding]] = {
            "simulation": [*judge_errors(evidence), *judge_simulation(evidence, drift), *judge_units(evidence)],
            "feed_forward": [*judge_feed_forward(evidence), *judge_units(evidence)],
            "collision_detection": judge_collision_detection(evidence, force),
            "payload": judge_payload(evidence, mass),
        }
        uses = tuple(
            combine_findings(name, [*_list_failed_validations(evidence, name), *reservations, *own], _WHEN_GOOD[name])
            for name, own in findings_by_use.items()
        )
    return ModelVerdict(
        uses,
        held_out,
        identification.held_out_moving,
        stop,
        common,
        tuple(_list_next_steps(identification, stop, common)),
        drift,
        force,
        mass,
    )


_ANOTHER = "Hold out another motion: this one is the motion of the fit."
_WHEN_GOOD: Mapping[UseName, str] = {
    "simulation": "Export it: dynident export MODEL -f urdf, or -f mjcf.",
    "feed_forward": "Export it: dynident export MODEL -f c, or -f casadi.",
    "collision_detection": "Export it, and watch the residual after the same filters: dynident export MODEL -f c.",
    "payload": "Weigh a load: hold out recordings with it, and run dynident validate MODEL payload.",
}
_REVISES: Mapping[UseName, tuple[str, ...]] = {
    "simulation": ("simulation", "inertia_matrix", "cross", "direct"),
    "feed_forward": ("cross", "direct"),
    "collision_detection": ("cross", "direct"),
    "payload": ("bootstrap", "methods", "cross", "direct"),
}
"""Which validations speak of a use. The known load is in the findings of those that it speaks of."""


def _list_failed_validations(evidence: HeldOutEvidence, name: UseName) -> list[UseFinding]:
    """List a finding for each failed validation that speaks of this use."""
    return [
        UseFinding(
            "no",
            f"The validation {outcome.kind.replace('_', ' ')} failed: {outcome.judged.reason}",
            DIAGNOSE,
        )
        for outcome in evidence.list_failed(*_REVISES[name])
    ]


def _find_universal_objection(
    identification: Identification,
    stop: Stop | None,
    common: Sequence[DataOverlap],
    checks: Mapping[str, Sequence[Check]],
) -> UseFinding | None:
    """Return what speaks against every use, or leaves nothing to judge by; None where nothing does."""
    if identification.model.is_at_rest:
        sentence = "Poses at rest contain no information about motion."
        return UseFinding("no", sentence, "Record a designed motion: dynident design ROBOT.")
    # Before the size of the error: on copied data it is as small as in the fit, and says nothing.
    copied = [overlap for overlap in common if overlap.kind == "copied"]
    if copied:
        return UseFinding("not_judged", " ".join(map(str, copied)), "Hold out a recording of another motion.")
    if stop is not None:
        worst = max(
            errors.relative_total for errors in (identification.fit, identification.held_out) if errors is not None
        )
        sentence = f"The error is {worst:.0%}, above {STOP:.0%}: the cause is not a missing effect."
        return UseFinding("no", sentence, "Remove the cause above first.")
    # Last, since a gross error has a cause of its own that helps more.
    veto = _find_veto(checks)
    return UseFinding("no", veto, "Correct the recording as its check says, and identify again.") if veto else None


def _find_veto(checks: Mapping[str, Sequence[Check]]) -> str:
    """Say which check speaks against every use; nothing where the user has accepted what it finds, or none does."""
    against = [
        f"In {name}: {check.detail}"
        for name, own in checks.items()
        for check in own
        if check.name in VETOES and check.status != "ok" and not check.is_accepted
    ]
    return against[0] if against else ""


def _judge_poses(identification: Identification) -> str:
    """Word what a model of poses at rest is good for."""
    errors = identification.fit if identification.held_out is None else identification.held_out
    error, poses = errors.relative_total, "poses of the fit" if identification.held_out is None else "held-out poses"
    able = "Fit for gravity compensation" if error <= LARGEST_ERROR else "Not even fit for gravity compensation"
    return f"{able}: {error:.1%} of the torque of {poses} is not explained."


def is_stopped(identification: Identification) -> bool:
    """Tell whether a model is not to be used, since its errors are too large or its held-out data those of the fit.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    bool
        True where it is not to be used at all.
    """
    return bool(identification.data.copied) or is_hopeless(identification.held_out) or is_hopeless(identification.fit)


def explain_stop(identification: Identification) -> str:
    """Return why a model is not to be used (`is_stopped`).

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    str
        A sentence without its full stop; "" where the model may be used.
    """
    if not is_stopped(identification):
        return ""
    if identification.data.copied:
        copied = ", ".join(identification.data.copied)
        return (
            f"the held-out data of this model ({copied}) contain samples of the fit, so they do not test the model. "
            "Hold out a recording of another motion"
        )
    return f"the error of this model is above {STOP:.0%}, too large for a missing effect; its verdict names the cause"


def _list_next_steps(identification: Identification, stop: Stop | None, common: Sequence[DataOverlap]) -> list[str]:
    if stop is not None and stop.apply is not None:
        return [f"Read {stop.recording} again with: {stop.apply}.", "Identify again, and look at the verdict again."]
    if stop is not None and any(overlap.kind == "copied" for overlap in common):
        return ["Hold out a recording of another motion."]
    if stop is not None and stop.records_more:
        return ["Record a longer, designed motion, and identify again.", "Hold out a motion with the same load."]
    if stop is not None:
        return [
            "Read the checks of each recording.",
            "Compare the description with the robot: axes, gravity.",
        ]
    # Disturbances come first: they shift all parameters, and cost a window of time to leave out.
    steps = [
        f"Leave out {span.start:.1f} to {span.end:.1f} s of the data of the fit, where an external disturbance acted."
        for span in find_outlying_spans(identification.data.training).spans
    ]
    if identification.model.is_at_rest:
        return [_judge_poses(identification), "Record a designed motion to identify the dynamics."]
    if identification.held_out_judged is None:
        return [*steps, "Record another motion, and hold it out."]
    error, own = identification.held_out_judged.relative_total, identification.fit_judged.relative_total
    if any(overlap.kind == "repeated" for overlap in common):
        steps.append(_ANOTHER)
    if error > OVERFIT * own:
        steps.append(
            f"The held-out error is {error / max(own, 1e-12):.1f} times that of the fit: record a designed motion."
        )
    return [*steps, *_advise_diagnosis(error, was_extended=identification.step.parent is not None)]


def _advise_diagnosis(error: float, *, was_extended: bool) -> list[str]:
    """Advise to look for effects: in a model that was extended already only where its error is still unusual."""
    alone, full = (f"{low:.0%} to {high:.0%}" for low, high in (USUAL, USUAL_IN_FULL))
    # A model with all usual effects is not sent to the diagnosis for ever: only an unusual error is worth another try.
    if was_extended:
        still = f"Diagnose this model, too: it was extended already, and errors of {full} are usual with all effects."
        return [still] if error > USUAL_IN_FULL[1] else []
    if error <= USUAL_IN_FULL[0]:
        return []
    return [
        f"Diagnose which effects are missing and add them: errors of {alone} are usual with friction alone, {full} "
        "with all effects."
    ]
