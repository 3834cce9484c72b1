"""Judge a model for each use (simulation, feed forward, collision detection, payload): findings and their words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.effects import LINKS
from dynident.errors import DynidentError, join_notes
from dynident.identification.estimators.feasible import find_nearest_feasible
from dynident.identification.estimators.feasible_problem import find_resisting_speeds
from dynident.identification.identified_models.fit_model import describe_slow_motion
from dynident.identification.identified_models.remove_and_solve_again import list_impossible
from dynident.identification.standard_parameters import compute_smallest_inertia_eigenvalue
from dynident.identification.thresholds import (
    LARGEST_DRIFT,
    LARGEST_ERROR,
    LARGEST_OF_JOINT,
    LARGEST_TO_WEIGH,
    NOTABLE_DRIFT,
    NOTABLE_OF_JOINT,
)
from dynident.number_format import format_percent
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.validation.contact_detection import (
    FEWEST_BLOCKS,
    HAND_CONTACT_FORCE_LIMIT,
    WRONG_IN_SOME_MOTIONS,
    CollisionValidation,
)
from dynident.validation.open_loop_drift import (
    Drift,
    compute_open_loop_drift,
    describe_unknown_torque,
    find_unknown_torque,
)
from dynident.verdict.held_out_evidence import HeldOutEvidence

UseName = Literal["simulation", "feed_forward", "collision_detection", "payload"]
USES: tuple[UseName, ...] = ("simulation", "feed_forward", "collision_detection", "payload")
State = Literal["yes", "limited", "no", "not_judged"]
MARKS: dict[State, str] = {"yes": "✓", "limited": "!", "no": "✕", "not_judged": "?"}
Action = Literal[
    "diagnose",
    "design",
    "identify_feasible",
    "check_gains",
    "identify_gains",
    "export_for_simulation",
    "export_for_feed_forward",
    "observe_momentum",
    "weigh_load",
]
"""What dynident can do next. Each front end knows its own command, call or button for it."""


@dataclass(frozen=True)
class NextStep:
    """One thing to do next.

    Parameters
    ----------
    sentence : str
        What to do, for people.
    action : str or None
        Which of the actions does it; None where it is done at the robot, or by what the sentence says.
    """

    sentence: str
    action: Action | None = None


DIAGNOSE = NextStep("Find the missing effects.", "diagnose")
FASTER = NextStep("Record a faster motion.", "design")
GIVE_RECORDINGS = NextStep("Give the held-out recordings of the model.")
"""Next steps that several uses have."""
FACE_CONTACT_FORCE_LIMIT = 65.0
"""Example of a force in N that a face may bear while it is clamped, from the sources of `HAND_CONTACT_FORCE_LIMIT`."""
_GRAVEST_FIRST: tuple[State, ...] = ("no", "not_judged", "limited", "yes")


@dataclass(frozen=True)
class Use:
    """Whether a model is fit for a use, with the reason and one thing to do next.

    Parameters
    ----------
    use : str
        The use: "simulation", "feed_forward", "collision_detection" or "payload".
    state : str
        "yes", "limited" (fit within a limit that the reason says), "no" or "not_judged" (nothing was there to tell by).
    reason : str
        The reason in a sentence or two.
    next : NextStep
        What to do next.
    """

    use: UseName
    state: State
    reason: str
    next: NextStep

    @property
    def next_step(self) -> str:
        """What to do next, as a sentence."""
        return self.next.sentence

    @property
    def next_action(self) -> Action | None:
        """Which action does it; None where no action of dynident does."""
        return self.next.action

    @property
    def fit(self) -> bool:
        """Whether the model may be used so, if only within a limit."""
        return self.state in ("yes", "limited")

    @property
    def mark(self) -> str:
        """One character for the state."""
        return MARKS[self.state]

    @property
    def words(self) -> str:
        """Name of the use for people."""
        return self.use.replace("_", " ")


@dataclass(frozen=True)
class UseFinding:
    """Result of one test of a use.

    Parameters
    ----------
    state : str
        "yes", "limited", "no" or "not_judged".
    sentence : str
        The result in a whole sentence.
    next : NextStep or None
        What to do about it where it is not good.
    """

    state: State
    sentence: str
    next: NextStep | None = None


def combine_findings(name: UseName, findings: Sequence[UseFinding], when_good: NextStep) -> Use:
    """Combine all findings about a use into one statement: the gravest decide.

    Parameters
    ----------
    name : UseName
        The use.
    findings : sequence of UseFinding
        Results of its tests, in the order in which they are to be cured.
    when_good : NextStep
        What to do next where nothing speaks against the use.

    Returns
    -------
    Use
        The gravest state, with the sentences of that state and the first next step among them.
    """
    # What was not judged is graver than a limit: it may hide a reason against the use.
    state = next(grade for grade in _GRAVEST_FIRST if any(finding.state == grade for finding in findings))
    # Where there is nothing to tell by, figures say nothing; a limit stands beside the figures that it limits.
    reported = (state, "yes") if state == "limited" else (state,)
    sentences = [finding.sentence for grade in reported for finding in findings if finding.state == grade]
    steps = [finding.next for finding in findings if finding.state == state and finding.next]
    return Use(name, state, join_notes(sentences), steps[0] if steps else when_good)


_FORCE_THAT_COUNTS = "The limit that counts is that of your risk assessment."
_LONGER = NextStep(
    f"Hold out at least {FEWEST_BLOCKS} s of motion of the joints that carry the tool, with their torque."
)


def judge_collision_detection(
    evidence: HeldOutEvidence, collision: CollisionValidation | None, obstacle: str = ""
) -> list[UseFinding]:
    """Judge the force at the tool that a momentum observer detects, how fast, and at which rate of false alarms.

    Parameters
    ----------
    evidence : HeldOutEvidence
        The model with its held-out recordings, residuals and validations.
    collision : CollisionValidation or None
        Which force a momentum observer detects, and how fast; None where no observer can use the model.
    obstacle : str
        Why it cannot.

    Returns
    -------
    list of UseFinding
        Findings for and against the use.
    """
    findings = [*judge_errors(evidence), *judge_scale(evidence)]
    if collision is None:
        return [*findings, UseFinding("not_judged", f"The observer's thresholds cannot be computed: {obstacle}.")]
    if not evidence.recordings:
        sentence = "The threshold can only be computed from the held-out recordings."
        return [*findings, UseFinding("not_judged", sentence, GIVE_RECORDINGS)]
    if collision.contact is None:
        return [*findings, UseFinding("not_judged", collision.judged.reason, _LONGER)]
    least, figures = collision.contact.force, collision.contact.describe()
    if collision.is_disproved:
        figures = collision.describe()
        findings.append(UseFinding("limited", WRONG_IN_SOME_MOTIONS, DIAGNOSE))
    if least > HAND_CONTACT_FORCE_LIMIT:
        against = (
            f"{figures} This is above {HAND_CONTACT_FORCE_LIMIT:g} N, an example of what a clamped hand can bear: it "
            f"protects the machine at best. {_FORCE_THAT_COUNTS}"
        )
        return [*findings, UseFinding("no", against, DIAGNOSE)]
    if least > FACE_CONTACT_FORCE_LIMIT:
        against = (
            f"This is above {FACE_CONTACT_FORCE_LIMIT:g} N, an example of what a face can bear. {_FORCE_THAT_COUNTS}"
        )
        findings.append(UseFinding("limited", against, DIAGNOSE))
    if not evidence.list_passed("payload"):
        findings.append(
            UseFinding(
                "limited",
                "The force in N is right only if the drive gains are right, and nothing has checked them.",
                GAINS,
            )
        )
    return [*findings, UseFinding("yes", figures)]


# Limits of nature that are named; of more their number is said.
_NAMED = 3
# Postures of the held-out motion that the mass matrix is computed in, spread evenly.
_POSTURES = 200
CURE = NextStep("Identify again with physically feasible bodies.", "identify_feasible")


def judge_simulation(evidence: HeldOutEvidence, drift: Drift | None) -> list[UseFinding]:
    """Judge the links, the mass matrix along the motion, and the drift of a simulation without a controller.

    Parameters
    ----------
    evidence : HeldOutEvidence
        The model with its held-out recordings, residuals and validations.
    drift : Drift or None
        Drift of a simulation without a controller; None where it could not be computed.

    Returns
    -------
    list of UseFinding
        Findings for and against the use.
    """
    slow = describe_slow_motion(evidence.identification.parameters)
    if slow is not None:
        return [UseFinding("no", slow, FASTER)]
    findings = [*_judge_bodies(evidence), *_judge_mass_matrix(evidence)]
    if drift is not None:
        return [*findings, _judge_drift(drift)]
    unknown = find_unknown_torque(evidence.identification, evidence.recordings)
    if unknown and evidence.recordings:
        record = NextStep(f"Record the torque of {', '.join(unknown)}, too.")
        return [*findings, UseFinding("not_judged", describe_unknown_torque(unknown), record)]
    if evidence.recordings:
        sentence = "A simulation with these parameters fails at the first step along the held-out motion."
        return [*findings, UseFinding("no", sentence, CURE)]
    sentence = "The drift of a simulation can only be computed from the held-out recordings."
    return [*findings, UseFinding("not_judged", sentence, GIVE_RECORDINGS)]


def compute_drift(evidence: HeldOutEvidence) -> Drift | None:
    """Return the drift along the held-out recordings; None where there are none, or no robot has these parameters."""
    try:
        return compute_open_loop_drift(evidence.identification, evidence.recordings) if evidence.recordings else None
    except DynidentError:
        return None


def _judge_bodies(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge whether bodies, rotors and friction that can exist have the parameters; if not, what they would cost."""
    identification = evidence.identification
    if not any(choice.effect == LINKS.effect for choice in identification.model.effects):
        return []
    is_feasible_fit = identification.estimate.standard is not None and not identification.estimate.not_essential
    if is_feasible_fit and not list_impossible(identification):
        return []  # These standard parameters were looked for among those of bodies that can exist.
    try:
        nearest = find_nearest_feasible(
            identification.model,
            identification.data.equations,
            identification.estimate.solution,
            identification.choices.trust,
            speeds=find_resisting_speeds(identification.model, identification.estimate.speeds),
        )
    except DynidentError as error:
        return [
            UseFinding("no", f"It is not known whether these parameters are physically feasible: {error.detail}.", CURE)
        ]
    if nearest.is_feasible:
        return []
    names = ", ".join(nearest.limits[:_NAMED])
    more = f" and {len(nearest.limits) - _NAMED} more" if len(nearest.limits) > _NAMED else ""
    cost = ""
    if identification.data.held_out is not None:
        after = compute_moving_errors(identification.data.held_out, nearest.values).relative_total
        before = evidence.error
        cost = (
            f" The nearest feasible parameters have a held-out error of {format_percent(after)} instead of "
            f"{format_percent(before)}."
        )
    return [UseFinding("no", f"These parameters are not physically feasible ({names}{more}).{cost}", CURE)]


def _judge_mass_matrix(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge whether the mass matrix is positive definite along the held-out motion, and in random postures."""
    identification = evidence.identification
    # Random postures are judged when the model is identified; the motion itself matters more, and is looked at first.
    along = np.inf
    if evidence.comparisons:
        q = np.concatenate([comparison.q for comparison in evidence.comparisons])
        along = compute_smallest_inertia_eigenvalue(
            identification.model, identification.values, postures=q[:: max(1, len(q) // _POSTURES)]
        )
    if along <= 0:
        return [UseFinding("no", "Along the held-out motion the mass matrix is not positive definite.", CURE)]
    if identification.worst_inertia_eigenvalue <= 0:
        return [UseFinding("no", "In some postures the mass matrix is not positive definite.", CURE)]
    return []


def _judge_drift(drift: Drift) -> UseFinding:
    figures = drift.describe()
    if not np.isfinite(drift.share[0]).all():
        return UseFinding(
            "no", f"Without a controller, the simulation under the measured torque diverges. {figures}", CURE
        )
    if drift.worst_share > LARGEST_DRIFT:
        sentence = (
            f"{figures} More than {format_percent(LARGEST_DRIFT, decimals=0)} of the travel within "
            f"{drift.judged_until:g} s is too much for a simulation of the robot."
        )
        return UseFinding("no", sentence, DIAGNOSE)
    if drift.worst_share > NOTABLE_DRIFT:
        sentence = (
            f"Simulate only with a controller, or for less than {drift.judged_until:g} s: "
            f"{figures[0].lower()}{figures[1:]}"
        )
        return UseFinding("limited", sentence, DIAGNOSE)
    return UseFinding("yes", f"For {drift.judged_until:g} s at a time, or longer with a controller. {figures}")


GAINS = NextStep("Record the motion of the identification with a load of known mass.", "check_gains")
_LEAST_DETERMINED = 0.5
"""Share of the links' parameters that the data have to determine before a load is weighed against them."""


def judge_scale(evidence: HeldOutEvidence) -> list[UseFinding]:
    """List the known loads that came out wrong: then all torques, forces and masses are off by the same factor."""
    step = NextStep("Find the drive gains from the recordings without and with the load.", "identify_gains")
    return [UseFinding("no", outcome.judged.reason, step) for outcome in evidence.list_failed("payload")]


def judge_units(evidence: HeldOutEvidence) -> list[UseFinding]:
    """List wrong known loads as limits, for uses in which torques are only compared with torques."""
    sentence = "Only in the unit of the recorded torque: a known load has a wrong mass, so all masses are wrong."
    return [UseFinding("limited", sentence, finding.next) for finding in judge_scale(evidence)]


def judge_payload(evidence: HeldOutEvidence, mass: float | None) -> list[UseFinding]:
    """Judge the scale of the torques by a known load, and the mass that shows.

    Parameters
    ----------
    evidence : HeldOutEvidence
        The model with its held-out recordings, residuals and validations.
    mass : float or None
        Mass in kg from which on a load shows; None where nothing tells.

    Returns
    -------
    list of UseFinding
        Findings for and against the use.
    """
    findings = [*judge_errors(evidence), *judge_scale(evidence)]
    error = evidence.error
    if error > LARGEST_TO_WEIGH:
        sentence = (
            f"The held-out error is {format_percent(error, decimals=1)}, above "
            f"{format_percent(LARGEST_TO_WEIGH, decimals=0)}: the residual would count as a load."
        )
        findings.append(UseFinding("no", sentence, DIAGNOSE))
    parameters = evidence.identification.parameters
    # Parameters that may be zero are left out: small ones are never determined, and do no harm.
    links = [
        parameter
        for parameter in parameters
        if parameter.effect == LINKS.effect and parameter.judgement not in ("zero_in_interval", "held")
    ]
    sure = sum(parameter.judgement == "determined" for parameter in links)
    if not links or sure < _LEAST_DETERMINED * len(links):
        sentence = (
            f"The data determine only {sure} of the {len(links)} nonzero parameters of the links: the estimate of a "
            "load would rest on uncertain parameters."
        )
        findings.append(UseFinding("no", sentence, NextStep("Record a longer, designed motion.", "design")))
    checked = evidence.list_passed("payload")
    # A wrong gain scales torque and parameters alike: residuals stay small, so that only a known load shows it.
    if not checked:
        sentence = (
            "Nothing has checked the drive gains: if they are wrong, all loads are wrong by the same factor, and no "
            "error shows it."
        )
        findings.append(UseFinding("not_judged", sentence, GAINS))
    if mass is None:
        sentence = "The smallest detectable mass can only be computed from a held-out motion that moves the tool."
        return [*findings, UseFinding("not_judged", sentence, GIVE_RECORDINGS)]
    figures = f"Along the held-out motion a load at the tool is detectable from {mass:.2g} kg on."
    return [*findings, *(UseFinding("yes", outcome.judged.reason) for outcome in checked), UseFinding("yes", figures)]


_PRESLIDING = NextStep("Find the missing effect, most often presliding friction.", "diagnose")


def judge_errors(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge the held-out error where joints move, in all and of each joint: every use rests on these."""
    error, each, joints = evidence.error, evidence.joint_errors, evidence.joints
    findings = []
    # Written so that nan counts as too large.
    if not error <= LARGEST_ERROR:
        most = format_percent(LARGEST_ERROR, decimals=0)
        sentence = f"The held-out error is {format_percent(error, decimals=1)}, above {most}."
        findings.append(UseFinding("no", sentence, DIAGNOSE))
    bad = [
        f"{joints[j]} ({format_percent(each[j], decimals=0)})"
        for j in range(len(joints))
        if not each[j] <= LARGEST_OF_JOINT
    ]
    if bad:
        sentence = (
            f"These joints have an error above {format_percent(LARGEST_OF_JOINT, decimals=0)} where they move: "
            f"{', '.join(bad)}."
        )
        step = NextStep(f"Find the missing effects on {bad[0].split(' (')[0]}.", "diagnose")
        findings.append(UseFinding("no", sentence, step))
    if evidence.never_moving:
        names = ", ".join(evidence.never_moving)
        sentence = f"The held-out data contain no information about {names}, which never moves in them."
        findings.append(
            UseFinding("limited", sentence, NextStep(f"Hold out a motion of all joints: {names} does not move."))
        )
    return findings


def judge_feed_forward(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge the error while joints move, reverse, and start: the worst joint counts."""
    error, each, joints = evidence.error, evidence.joint_errors, evidence.joints
    # One poor joint spoils the whole motion, whatever the others do.
    worst = int(np.argmax(each))
    figures = [f"where it moves {format_percent(each[worst], decimals=0)} ({joints[worst]})"]
    findings = judge_errors(evidence)
    slow = describe_slow_motion(evidence.identification.parameters)
    if slow is not None:
        findings.append(UseFinding("limited", f"Only at speeds as low as the recorded ones. {slow}", FASTER))
    notable = [
        f"{joints[j]} {format_percent(each[j], decimals=0)}"
        for j in range(len(joints))
        if NOTABLE_OF_JOINT < each[j] <= LARGEST_OF_JOINT
    ]
    if notable:
        sentence = f"The controller has to compensate much of the torque while joints move: {', '.join(notable)}."
        findings.append(UseFinding("limited", sentence, DIAGNOSE))
    remembers = bool(evidence.identification.model.observation.memory)
    # The first phase, moving, is judged by the joints' errors above, on all rows of the held-out data.
    for phase in evidence.phases[1:]:
        if np.isnan(phase.share).all():
            continue
        joint = int(np.nanargmax(phase.share))
        share = float(phase.share[joint])
        if share <= NOTABLE_OF_JOINT:
            figures.append(f"{phase.name} {format_percent(share, decimals=0)} ({joints[joint]})")
            continue
        state: State = "no" if share > LARGEST_OF_JOINT else "limited"
        sentence = (
            f"{phase.name.capitalize()}, the model of {joints[joint]} is off by {format_percent(share, decimals=0)} of "
            "its torque."
        )
        findings.append(UseFinding(state, sentence, DIAGNOSE if remembers else _PRESLIDING))
    if not evidence.phases:
        sentence = "The errors at reversals and starts can only be computed from the held-out recordings."
        findings.append(UseFinding("limited", sentence, GIVE_RECORDINGS))
    good = (
        f"The held-out error is {format_percent(error, decimals=1)}. The error of the worst joint: "
        f"{', '.join(figures)}."
    )
    return [*findings, UseFinding("yes", good)]
