"""`verdict`: join the judgements of all uses, decide whether to stop, and name the next step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.data_leakage import DataOverlap, find_overlaps
from dynident.diagnosis.conclusion import point_to_check
from dynident.errors import DynidentError, Note, join_notes, word_notes, write_argument
from dynident.estimation import Errors, OutlyingSpan, find_outlying_spans
from dynident.identification import Identification
from dynident.identification.identified_models.fit_model import OF_COMMANDS
from dynident.identification.recording_faults import VETOES
from dynident.identification.thresholds import LARGEST_ERROR, OVERFIT, STOP, USUAL, USUAL_IN_FULL
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.recordings import Check, Recording
from dynident.text_and_html_tables import join_html, render_list, render_paragraph
from dynident.validation.contact_detection import CollisionValidation, ContactDetection, validate_collision
from dynident.validation.open_loop_drift import Drift
from dynident.verdict.fitness_by_use import (
    DIAGNOSE,
    GAINS,
    USES,
    Action,
    NextStep,
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
from dynident.verdict.held_out_evidence import (
    DetectableForce,
    HeldOutEvidence,
    Outcome,
    compute_detectable_force,
    compute_detectable_mass,
)
from dynident.verdict.stop_cause import Stop, find_stop_cause, is_hopeless

TESTS: Mapping[UseName, str] = {
    "simulation": "Can bodies have these parameters, and how far does a simulated robot drift from held-out motions "
    "under the measured torque, without a controller?",
    "feed_forward": "How large is the held-out residual while joints move, at reversals, and at starts and stops?",
    "collision_detection": "Which force at the tool does a momentum observer detect, and how fast, with how many "
    "false alarms an hour?",
    "payload": "Was a known load weighed rightly, and which mass at the tool shows along the held-out motion?",
}
"""What each use is judged by."""


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
    calls_for_diagnosis : bool
        Whether missing effects are to be looked for next; not while anything else is to be corrected first.
    drift : Drift or None
        How far a simulation without a controller drifts; None where nothing tells.
    force : DetectableForce or None
        Which force at the tool shows; None where nothing tells.
    mass : float or None
        Mass in kg from which on a load shows; None where nothing tells.
    contact : ContactDetection or None
        Thresholds of a momentum observer, and the force that they detect; None where nothing tells.
    """

    uses: tuple[Use, ...]
    held_out: Errors | None
    held_out_moving: Errors | None
    stop: Stop | None
    common: tuple[DataOverlap, ...]
    next_steps: tuple[str, ...]
    calls_for_diagnosis: bool
    drift: Drift | None = None
    force: DetectableForce | None = None
    mass: float | None = None
    contact: ContactDetection | None = None

    @property
    def summary(self) -> str:
        """The verdict in a sentence."""
        if self.stop is not None:
            return Note(f"Stop: {self.stop.cause}", self.stop.remedies)
        parts = {words: [use.words for use in self.uses if use.state == state] for state, words in _STATES.items()}
        text = "; ".join(f"{words} {', '.join(names)}" for words, names in parts.items() if names)
        return f"{text[:1].upper()}{text[1:]}."

    def get_values(self, use: UseName) -> dict[str, float]:
        """Return the numbers that the test of a use gave.

        Parameters
        ----------
        use : UseName
            The use.

        Returns
        -------
        dict of str to float
            Values in SI units by name; without those that nothing told.
        """
        values: dict[str, float | None] = {}
        if self.held_out_moving is not None:
            values["error"] = self.held_out_moving.relative_total
        if use == "simulation" and self.drift is not None:
            values |= {"drift_share": self.drift.worst_share, "drift_until": self.drift.judged_until}
        if use == "feed_forward" and self.held_out_moving is not None:
            values["error_of_worst_joint"] = float(np.max(self.held_out_moving.relative))
        if use == "collision_detection" and self.contact is not None:
            values |= {"force": self.contact.force, "within": self.contact.within}
            values["false_alarms_per_hour"] = self.contact.false_alarms_an_hour
            if self.contact.force_at_rest is not None:
                values["force_at_rest"] = self.contact.force_at_rest
        if use == "payload":
            values["smallest_mass"] = self.mass
        return {name: value for name, value in values.items() if value is not None and np.isfinite(value)}

    def __repr__(self) -> str:
        return "ModelVerdict: " + "\n  ".join(self._lines())

    def _repr_html_(self) -> str:
        summary, *lines = self._lines()
        return join_html(render_paragraph(summary, strong=True), render_list(lines))

    def _lines(self) -> list[str]:
        """List the summary, the uses with their reasons unless the model is not to be used, and the next steps."""
        uses = () if self.stop is not None else self.uses
        lines = [join_notes((f"{use.mark} {use.words}:", use.reason, f"→ {_word_next_step(use.next)}")) for use in uses]
        return word_notes([self.summary, *lines, *(f"→ {step}" for step in self.next_steps)], write_argument)


_CALLS: Mapping[Action, str] = {
    "diagnose": "dynident.diagnose(model, recordings)",
    "design": "dynident.design(robot)",
    "identify_feasible": 'dynident.identify(robot, recordings, effects=model.effects, estimator="feasible")',
    "check_gains": "dynident.validation.validate_payload",
    "identify_gains": "dynident.identification.identify_gains",
    "export_for_simulation": 'model.export("arm.urdf")',
    "export_for_feed_forward": 'model.export("arm.c")',
    "observe_momentum": "dynident.validation.validate_collision",
    "weigh_load": "dynident.validation.validate_payload",
}
"""How each next step is done in Python."""


def _word_next_step(step: NextStep) -> str:
    return step.sentence if step.action is None else f"{step.sentence} In Python: {_CALLS[step.action]}"


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
        cause of a gross fault are looked for, and uses that need the residual in time are not judged.
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
    if silent := identification.model.robot.names_without_torque:
        sentence = f"Not for {silent}, whose torque was not recorded."
        reservations.append(UseFinding("limited", sentence, NextStep(f"Record the torque of {silent}, too.")))
    spans = () if at_rest else find_outlying_spans(identification.data.training).spans
    reservations += _list_disturbances(spans)
    from_commands = identification.data.from_commands or any(
        recording.torque_from_commands for recording in (*recordings, *validation)
    )
    # A load that came out right shows that the gains are.
    is_weighed = any(outcome.kind == "payload" and outcome.judged.verdict == "pass" for outcome in outcomes)
    if from_commands and not is_weighed:
        reservations.append(UseFinding("limited", OF_COMMANDS, GAINS))
    pointed = point_to_check(checks or {})
    instead = _CURRENTS if from_commands else NextStep(pointed) if pointed else _LEAVE_OUT if spans else None
    against = _find_universal_objection(identification, stop, common, checks or {})
    held_out = identification.held_out
    drift, force, mass, contact = None, None, None, None
    if against is not None or held_out is None:
        finding = against or UseFinding(
            "not_judged",
            "There are no held-out data to judge the model by: give a recording that the fit does not use.",
            NextStep("Record another motion, and hold it out."),
        )
        uses = tuple(combine_findings(name, [finding], finding.next or _ANOTHER) for name in USES)
    else:
        # Each use has its own findings. Failed validations and reservations count for all of them, and come first,
        # since the first of the gravest findings gives the next step.
        evidence = HeldOutEvidence.from_identification(identification, held_out, validation, outcomes)
        robot = identification.model.robot
        drift = compute_drift(evidence)
        force = compute_detectable_force(robot, evidence.comparisons)
        mass = compute_detectable_mass(robot, evidence.comparisons)
        collision, obstacle = _validate_contacts(evidence)
        contact = None if collision is None else collision.contact
        findings_by_use: dict[UseName, list[UseFinding]] = {
            "simulation": [*judge_errors(evidence), *judge_simulation(evidence, drift), *judge_units(evidence)],
            "feed_forward": [*judge_feed_forward(evidence), *judge_units(evidence)],
            "collision_detection": judge_collision_detection(evidence, collision, obstacle),
            "payload": judge_payload(evidence, mass),
        }
        if instead is not None:
            findings_by_use = {name: _replace_diagnosis(own, instead) for name, own in findings_by_use.items()}
        uses = tuple(
            combine_findings(name, [*_list_failed_validations(evidence, name), *reservations, *own], _WHEN_GOOD[name])
            for name, own in findings_by_use.items()
        )
    may_diagnose = against is None and (instead is None or instead is _LEAVE_OUT)
    asks = any(use.next.action == "diagnose" for use in uses) or bool(_advise_diagnosis(identification))
    return ModelVerdict(
        uses,
        held_out,
        identification.held_out_moving,
        stop,
        common,
        tuple(_list_next_steps(identification, recordings, stop, common, spans, instead)),
        may_diagnose and (asks or held_out is None),
        drift,
        force,
        mass,
        contact,
    )


def _validate_contacts(evidence: HeldOutEvidence) -> tuple[CollisionValidation | None, str]:
    """Return the thresholds of a momentum observer, or what speaks against one of this model."""
    try:
        return validate_collision(evidence.identification, evidence.recordings), ""
    except DynidentError as error:
        return None, error.detail


def _list_disturbances(spans: Sequence[OutlyingSpan]) -> list[UseFinding]:
    """List the seconds of the fit in which something else than the robot acted, as limits of every use."""
    return [
        UseFinding(
            "limited",
            f"From {span.start:.1f} to {span.end:.1f} s of the fit something else acted on the robot, which shifts all "
            "parameters.",
            _LEAVE_OUT,
        )
        for span in spans
    ]


_LEAVE_OUT = NextStep("Leave these seconds out of the fit, or find what acted there.", "diagnose")
_ANOTHER = NextStep("Hold out another motion: this one is the motion of the fit.")
_WHEN_GOOD: Mapping[UseName, NextStep] = {
    "simulation": NextStep("Export it for a simulator.", "export_for_simulation"),
    "feed_forward": NextStep("Export it for the controller.", "export_for_feed_forward"),
    "collision_detection": NextStep("Watch the residual of a momentum observer.", "observe_momentum"),
    "payload": NextStep("Weigh a load: hold out recordings with it, and validate the model by them.", "weigh_load"),
}
_REVISES: Mapping[UseName, tuple[str, ...]] = {
    "simulation": ("simulation", "inertia_matrix", "cross", "direct"),
    "feed_forward": ("cross", "direct"),
    "collision_detection": ("collision", "cross", "direct"),
    "payload": ("bootstrap", "methods", "cross", "direct"),
}
"""Which validations speak of a use. The known load is in the findings of those that it speaks of."""


def _list_failed_validations(evidence: HeldOutEvidence, name: UseName) -> list[UseFinding]:
    """List a finding for each failed validation that speaks of this use."""
    return [
        UseFinding("no", f"The validation {outcome.kind.replace('_', ' ')} failed: {outcome.judged.reason}", DIAGNOSE)
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
        return UseFinding("no", sentence, NextStep("Record a designed motion.", "design"))
    # Before the size of the error: on copied data it is as small as in the fit, and says nothing.
    copied = [overlap for overlap in common if overlap.kind == "copied"]
    if copied:
        return UseFinding("not_judged", " ".join(map(str, copied)), NextStep("Hold out a recording of another motion."))
    if stop is not None:
        judged = (identification.fit, identification.held_out)
        worst = max(errors.relative_total for errors in judged if errors is not None)
        sentence = (
            f"The error is {format_percent(worst, decimals=0)}, above {format_percent(STOP, decimals=0)}: the cause is "
            "not a missing effect."
        )
        return UseFinding("no", sentence, NextStep("Remove the cause above first."))
    # Last, since a gross error has a cause of its own that helps more.
    veto = _find_veto(checks)
    correct = NextStep("Correct the recording as its check says, and identify again.")
    return UseFinding("no", veto, correct) if veto else None


def _find_veto(checks: Mapping[str, Sequence[Check]]) -> str:
    """Say which check speaks against every use; nothing where the user has accepted what it finds, or none does."""
    against = [
        Note(f"In {name}: {check.detail}", check.remedies)
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
    return f"{able}: {format_percent(error, decimals=1)} of the torque of {poses} is not explained."


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
    return (
        f"the error of this model is above {format_percent(STOP, decimals=0)}, too large for a missing effect; its "
        "verdict names the cause"
    )


_CURRENTS = NextStep("Record the currents of the servos, too: without a torque no missing effect can be named.")


def _replace_diagnosis(findings: Sequence[UseFinding], instead: NextStep) -> list[UseFinding]:
    """Return findings whose next step is another one than a diagnosis."""
    return [
        replace(finding, next=instead) if finding.next is not None and finding.next.action == "diagnose" else finding
        for finding in findings
    ]


def _advise_windows(blocks: FloatArray, recordings: Sequence[Recording], spans: Sequence[OutlyingSpan]) -> list[str]:
    """Write the windows of the fit's only recording without some seconds; nothing where the option cannot say them."""
    if len(recordings) != 1 or not spans or "," in recordings[0].name:
        return []
    windows = list(recordings[0].windows or [(float(blocks[0, 0]), float(blocks[-1, 1]))])
    for span in spans:
        sides = [side for a, b in windows for side in ((a, min(b, span.start)), (max(a, span.end), b))]
        windows = [(start, end) for start, end in sides if end > start]
    # Rounded away from the disturbance: what is left out too much costs little.
    rounded = [(np.ceil(10.0 * start) / 10.0, np.floor(10.0 * end) / 10.0) for start, end in windows]
    texts = ",".join(f"{start:.1f}:{end:.1f}" for start, end in rounded if end > start)
    return [f"For that identify with the windows {recordings[0].name}={texts}."] if texts else []


def _list_next_steps(
    identification: Identification,
    recordings: Sequence[Recording],
    stop: Stop | None,
    common: Sequence[DataOverlap],
    spans: Sequence[OutlyingSpan],
    instead: NextStep | None,
) -> list[str]:
    if stop is not None and stop.apply is not None:
        return [f"Read {stop.recording} again with: {stop.apply}.", "Identify again, and look at the verdict again."]
    if stop is not None and any(overlap.kind == "copied" for overlap in common):
        return ["Hold out a recording of another motion."]
    if stop is not None and stop.records_more:
        return ["Record a longer, designed motion, and identify again.", "Hold out a motion with the same load."]
    if stop is not None:
        return ["Read the checks of each recording.", "Compare the description with the robot: axes, gravity."]
    # Disturbances come first: they shift all parameters, and cost a window of time to leave out.
    steps = [
        f"Leave out {span.start:.1f} to {span.end:.1f} s of the data of the fit, where an external disturbance acted."
        for span in spans
    ]
    steps += _advise_windows(identification.data.training.spans, recordings, spans)
    if identification.model.is_at_rest:
        return [_judge_poses(identification), "Record a designed motion to identify the dynamics."]
    # The seconds to leave out are among the steps already.
    named = [] if instead is None or instead is _LEAVE_OUT else [instead.sentence]
    if identification.held_out_judged is None:
        return [*steps, *named, "Record another motion, and hold it out."]
    error, own = identification.held_out_judged.relative_total, identification.fit_judged.relative_total
    if any(overlap.kind == "repeated" for overlap in common):
        steps.append(_ANOTHER.sentence)
    if error > OVERFIT * own and (instead is None or instead is _CURRENTS):
        steps.append(
            f"The held-out error is {error / max(own, 1e-12):.1f} times that of the fit: record a designed motion."
        )
    if instead is not None:
        return [*steps, *named]
    return [*steps, *_advise_diagnosis(identification)]


def _advise_diagnosis(identification: Identification) -> list[str]:
    """Advise to look for effects: in a model that was extended already only where its error is still unusual."""
    judged = identification.held_out_judged
    error = 0.0 if judged is None else judged.relative_total
    alone, full = (
        f"{format_percent(low, decimals=0)} to {format_percent(high, decimals=0)}"
        for low, high in (USUAL, USUAL_IN_FULL)
    )
    # A model with all usual effects is not sent to the diagnosis for ever: only an unusual error is worth another try.
    if identification.step.parent is not None:
        still = f"Diagnose this model, too: it was extended already, and errors of {full} are usual with all effects."
        return [still] if error > USUAL_IN_FULL[1] else []
    if error <= USUAL_IN_FULL[0]:
        return []
    return [
        f"Diagnose which effects are missing and add them: errors of {alone} are usual with friction alone, {full} "
        "with all effects."
    ]
