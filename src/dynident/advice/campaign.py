"""Campaigns: run after run until enough is known, with a promise before and a decision after each.

`plan_run` designs the motion that tells most about the goal (torque, parameters, effects, a load); `add_run` takes its
recording, identifies and diagnoses the model from all runs, and decides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dynident.advice.campaign_request import (
    FEWEST_RUNS,
    NOTHING_DECIDED,
    CampaignRequest,
    Decision,
    check_time,
    check_time_with_moves,
    describe_broken_promise,
    describe_first_run,
    estimate_rest,
    limit_search,
    list_designs,
    list_targets,
    select_longest,
    word_larger_error,
    word_share,
)
from dynident.advice.payload_goal import (
    PayloadErrors,
    add_load,
    choose_load,
    has_load,
    name_as_loaded,
    name_load_parameters,
)
from dynident.advice.prediction_error import (
    ErrorMeasure,
    RegionRows,
    build_measure,
    check_targets,
    compare_with_run,
    compute_lacking,
    compute_target_errors,
    is_of_motion,
    predict_errors,
)
from dynident.array_types import FloatArray
from dynident.diagnosis import diagnose
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.prediction_region import Region, count_harmonics, draw_region
from dynident.excitation.design_request import compute_planned_seconds
from dynident.excitation.design_result import follows_design
from dynident.identification import Identification, extend, identify
from dynident.motion.limits.bounds import slow_down_limits
from dynident.number_format import format_count, format_percent
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.recordings.raw_signals import SampleHashes
from dynident.robot import Robot

# A run that leaves more than this multiple of the promised error is said to have brought less; and a goal is out of
# reach only where repetitions of the last motion leave more than this multiple of it, since new motions bring more.
_BROKEN_PROMISE = 1.3
_LEAST_NOISE = 1e-6
_MINUTE = 60.0


@dataclass(frozen=True, eq=False)
class CampaignRun:
    """One run of a campaign, as it stood after its recording was taken in.

    Parameters
    ----------
    name : str
        Name of the recording.
    seconds : float
        Length of the recording, s.
    promised : (k,) or None
        Relative errors of each target that its motion promised; None for a motion that the campaign did not plan, and
        for effects.
    predicted : (n,) or None
        Relative errors of the torque of this run as the model before it predicted it; None for the first run.
    parameters : (k,)
        Relative errors of the targets (joints, parameters) from uncertain parameters, with 95 % probability; of effects
        the smallest size that would have shown, as a share of the usual one, and 0 of those that were found; of a load
        the uncertainty as a share of that asked for, infinite before it is mounted.
    lacking : (k,)
        Relative errors of the torque over the region from what the model lacks; 0 for other goals.
    added : tuple of EffectChoice
        Effects that the diagnosis of all runs so far added to those asked for.
    is_changed : bool
        Whether these are others than after the run before.
    """

    name: str
    seconds: float
    promised: FloatArray | None
    predicted: FloatArray | None
    parameters: FloatArray
    lacking: FloatArray
    added: tuple[EffectChoice, ...] = ()
    is_changed: bool = False

    @property
    def errors(self) -> FloatArray:
        """Relative errors (k,) of the targets, from both causes."""
        return np.hypot(self.parameters, self.lacking)


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """The next motion.

    Parameters
    ----------
    design : Design
        Its design.
    promised : (k,) or None
        Relative errors of the targets once it is made, with what the model lacks; None before the first run, and for
        effects.
    """

    design: Design
    promised: FloatArray | None


@dataclass(frozen=True, eq=False)
class CampaignState:
    """A campaign between two runs.

    Parameters
    ----------
    robot : Robot
        The robot.
    request : CampaignRequest
        What is to be reached.
    region : Region
        States whose torque shall be predicted.
    recordings : tuple of Recording
        Recordings of all runs, in order.
    runs : tuple of CampaignRun
        What each of them brought.
    identification : Identification or None
        The model from all of them; None before the first.
    decision : Decision
        What to do next.
    """

    robot: Robot
    request: CampaignRequest
    region: Region
    recordings: tuple[Recording, ...] = ()
    runs: tuple[CampaignRun, ...] = ()
    identification: Identification | None = None
    decision: Decision = NOTHING_DECIDED

    @property
    def targets(self) -> tuple[str, ...]:
        """What the errors are of: joints, parameters, effects or quantities of a load, by name."""
        return list_targets(self.request, self.robot.joint_names)

    @property
    def is_load_due(self) -> bool:
        """Whether the next run is made with the load."""
        return self.request.goal == "payload" and len(self.runs) >= self.request.unloaded_runs

    @property
    def seconds(self) -> float:
        """Robot time so far, s."""
        return sum(run.seconds for run in self.runs)

    @property
    def seconds_left(self) -> float:
        """Robot time that is left, s."""
        return _MINUTE * self.request.minutes - self.seconds


def start_campaign(robot: Robot, request: CampaignRequest, region: Region | None = None) -> CampaignState:
    """Return a campaign before its first run.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : CampaignRequest
        What is to be reached, and what it may cost.
    region : Region, optional
        States whose torque shall be predicted; by default drawn within the robot's limits.

    Raises
    ------
    DynidentError
        For a design of another kind than motions of all joints, or limits that are not known.
    """
    design = request.design
    if region is not None and region.q.shape[1] != robot.n:
        raise DynidentError(f"the region has {region.q.shape[1]} joints; the robot has {robot.n}", pointer="/region")
    check_targets(robot, request)
    check_time(request)
    design = limit_search(design)
    region, trajectory = region or draw_region(robot, design.limits, request.speed), design.trajectory
    if trajectory.family == "fourier" and trajectory.harmonics == TrajectoryRequest.harmonics:
        harmonics = count_harmonics(region, robot, design.limits, trajectory.duration)
        trajectory = replace(trajectory, harmonics=max(trajectory.harmonics, harmonics))
    request = replace(request, design=replace(design, trajectory=trajectory))
    return CampaignState(robot, request, region, decision=Decision("next_run", describe_first_run(request.goal)))


def plan_run(state: CampaignState, progress: Progress = ignore_progress) -> PlannedRun:
    """Design the next motion of a campaign, and tell what it promises.

    The first motion is slow, since nothing is known of the torque but the description, and so is the first one with a
    load. Each later one lowers the variance of what is to be known, beside the recordings so far, within limits of
    torque that the model keeps with its uncertainty. Moves from and to home count as time.

    Parameters
    ----------
    state : CampaignState
        The campaign.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Raises
    ------
    DynidentError
        Where there is no such motion; it names the limit in the way.
    """
    request, identification = state.request, state.identification
    designs, speed = list_designs(request.design), 1.0
    if len(state.runs) in (0, request.unloaded_runs if request.goal == "payload" else 0):
        # It tells what torque to expect, and no more than that: half the length is enough.
        designs, speed = designs[:-1] or designs, request.first_speed
    select = partial(select_longest, designs, state.seconds_left, request.fewest_runs - len(state.runs) - 1)
    measure = None if identification is None else build_measure(request, state.region, identification)
    if identification is None or measure is None:
        chosen = select()
        design = _design_motion(state, chosen, scale_progress(progress, 0.0, 0.5), speed)
        if (fitting := select(design.moves)) is not chosen:
            design = _design_motion(state, fitting, scale_progress(progress, 0.5, 1.0), speed)
        if not state.runs:
            check_time_with_moves(request, design.duration, design.moves)
        return PlannedRun(design, None)
    now, goal, runs = float(state.runs[-1].errors.max()), request.largest_error, request.runs - len(state.runs)

    def plan(chosen: DesignRequest, first: float, last: float) -> PlannedRun:
        design = _design_motion(state, chosen, scale_progress(progress, first, last))
        uncertain = predict_errors(identification, measure, design, state.recordings[-1])
        return PlannedRun(design, np.hypot(uncertain, state.runs[-1].lacking))

    def estimate(planned: PlannedRun) -> tuple[float, float]:
        assert planned.promised is not None
        return estimate_rest(now, float(planned.promised.max()), goal, planned.design.duration, runs)

    try:
        shortest = plan(designs[0], 0.0, 0.5)
    except DynidentError:
        # In more time a motion may keep limits of velocity and acceleration that none keeps in less.
        if select() is designs[0]:
            raise
        return plan(select(), 0.5, 1.0)
    longest = select(shortest.design.moves)
    if longest is designs[0] or estimate(shortest) <= (0.0, shortest.design.duration):
        return shortest
    return min((shortest, plan(longest, 0.5, 1.0)), key=estimate)


def _design_motion(
    state: CampaignState, design_request: DesignRequest, progress: Progress, speed: float = 1.0
) -> Design:
    """Design a motion for the next run, at a share of the velocity limits."""
    # Another seed for each run: a motion that is made again finds nothing that it could not show the first time.
    request = replace(design_request, seed=design_request.seed + len(state.runs))
    if speed < 1.0:
        request = replace(request, limits=slow_down_limits(state.robot, request.limits, speed))
    identification = state.identification
    if identification is None:
        request = replace(request, effects=state.request.choices.effects)
        return design_experiment(state.robot, request, progress, counts_moves=True)
    # A recording without noise has residuals that are rounding.
    smallest = _LEAST_NOISE * max(float(identification.noise.max()), 1.0)
    effects = identification.model.effects
    if state.is_load_due and not has_load(effects):
        effects = (*effects, choose_load(()))
    noise = dict(zip(state.robot.joint_names, map(float, np.maximum(identification.noise, smallest)), strict=True))
    return design_experiment(
        state.robot,
        replace(request, effects=effects, noise=noise, criterion=_choose_criterion(state)),
        progress,
        earlier=state.recordings,
        identified=identification.estimate,
        region=state.region,
        counts_moves=True,
    )


def _choose_criterion(state: CampaignState) -> CriterionChoice:
    if state.request.goal == "parameters":
        return CriterionChoice("parameters", parameters=state.request.parameters)
    if state.is_load_due:
        return CriterionChoice("parameters", parameters=name_load_parameters(state.robot, state.request))
    if state.request.goal == "effects":
        # One after the other: they need not be told from each other.
        worst = state.targets[int(np.argmax(state.runs[-1].errors))]
        return CriterionChoice("separation", effects=(EffectChoice(worst),))
    return CriterionChoice("prediction")


def add_run(
    state: CampaignState,
    recording: Recording,
    planned: PlannedRun | None = None,
    progress: Progress = ignore_progress,
) -> CampaignState:
    """Take in the recording of a run: predict it, identify and diagnose from all runs, and decide.

    Parameters
    ----------
    state : CampaignState
        The campaign before the run.
    recording : Recording
        The recording, of a planned motion or of any other.
    planned : PlannedRun, optional
        The motion that was planned for it; a recording of another motion keeps no promise.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    CampaignState
        The campaign with the run.

    Raises
    ------
    DynidentError
        For a recording with the samples of one that was added before, or that the model cannot be identified from.
    """
    before = state.identification
    if before is not None and SampleHashes.from_recording(recording).digest in before.data.digests:
        raise DynidentError(
            f"{recording.name} has the samples of an earlier run of this campaign; each run needs its own recording",
            pointer="recording",
        )
    if any(earlier.name == recording.name for earlier in state.recordings):
        recording = replace(recording, name=f"{recording.name} {len(state.runs) + 1}")
    # A promise is that of its motion: another motion, told by mistake or at will, is a run without a promise.
    if planned is not None and not follows_design(recording, planned.design):
        planned = None
    # Before anything is fitted to it, the run tests the model: a prediction that nothing was chosen on.
    tested = name_as_loaded(recording, state.recordings) if state.is_load_due else recording
    predicted = None if before is None else compare_with_run(before, tested).predicted
    recordings = (*state.recordings, recording)
    # From the effects asked for each time: what one run alone suggested has to show in all of them.
    choices = add_load(state.request, recordings).choices
    identification = identify(state.robot, recordings, (), choices, scale_progress(progress, 0.0, 0.3))
    diagnosed, has_limits = scale_progress(progress, 0.3, 0.9), state.request.goal == "effects"
    diagnosis = diagnose(identification, recordings, with_limits=has_limits, progress=diagnosed)
    added = tuple(choice for choice in diagnosis.recommended if is_of_motion(choice))
    if added:
        identification = extend(identification, added, recordings, (), scale_progress(progress, 0.9, 1.0))
    measure = build_measure(state.request, state.region, identification)
    lacking = np.zeros(len(state.targets))
    if isinstance(measure, RegionRows):
        # Of a torque that was not recorded the model lacks all, and not nothing.
        lacking = np.ones(len(state.targets))
        # The first run is slow: beside it, what a model lacks at speed would seem less than it is.
        absent = compute_lacking([compare_with_run(identification, run) for run in recordings[1:] or recordings])
        np.divide(absent, measure.torque, out=lacking, where=identification.model.robot.has_torque)
    # Shape constants are refined with every run.
    known = state.runs[-1].added if state.runs else ()
    places = [{(choice.effect, choice.joints) for choice in choices} for choices in (added, known)]
    run = CampaignRun(
        name=recording.name,
        seconds=sum(segment.length * recording.period for segment in recording.segments),
        promised=None if planned is None else planned.promised,
        predicted=predicted,
        parameters=compute_target_errors(state.request, identification, diagnosis, measure, recording.sampling_rate),
        lacking=lacking,
        added=added,
        is_changed=places[0] != places[1],
    )
    extended = replace(state, recordings=recordings, runs=(*state.runs, run), identification=identification)
    return replace(extended, decision=decide(extended, measure, planned))


def decide(state: CampaignState, measure: ErrorMeasure | None, planned: PlannedRun | None = None) -> Decision:
    """Decide whether a campaign goes on.

    Parameters
    ----------
    state : CampaignState
        The campaign with its last run.
    measure : ErrorMeasure or None
        What the covariance of its model means for the targets.
    planned : PlannedRun, optional
        The motion of the last run; its repetition bounds what the time that is left can bring.

    Returns
    -------
    Decision
        What to do, and why.
    """
    assert state.identification is not None
    run, goal, names = state.runs[-1], state.request.largest_error, state.targets
    silent = state.identification.model.robot.joints_without_torque
    if silent and state.request.goal == "torque":
        return Decision(
            "not_reachable",
            f"The torque of {', '.join(silent)} was not recorded, and the model predicts nothing of it. Record it, or "
            "lock what moves without a drive (locked_joints).",
        )
    worst = int(np.argmax(run.errors))
    reached = _word_error(state, measure, names[worst], float(run.errors[worst]))
    # Of effects there is no error to be stated: each is found, or ruled out at its usual size. A load is in kg and m.
    has_error = state.request.goal in ("torque", "parameters")
    aim = f"The goal of {format_percent(goal)}" if has_error else "The goal"
    stand = f"Error: {reached}" if has_error else reached
    remarks = ""
    if run.promised is not None and not run.is_changed and run.errors.max() > _BROKEN_PROMISE * run.promised.max():
        remarks = describe_broken_promise(float(run.promised.max()), float(run.errors[worst]), names[worst])
    moves = 0.0 if planned is None else planned.design.moves
    shortest = compute_planned_seconds(list_designs(state.request.design)[0]) + moves
    has_time = state.seconds_left >= shortest and len(state.runs) < state.request.runs
    if state.request.goal == "payload" and measure is None and has_time:
        mount = "Mount the load now: the next run and all after it are made with it."
        return Decision("next_run", mount if state.is_load_due else "Leave the load off for the next run, too.")
    if run.is_changed and has_time:
        count = format_count(len(run.added), "effect") if run.added else "no effect"
        words = f"The diagnosis of all runs now adds {count}, unlike before; the next run tests the model."
        return Decision("next_run", f"{words} {stand}.{remarks}")
    if (run.errors <= goal).all() and len(state.runs) >= FEWEST_RUNS:
        return Decision("reached", f"{aim} is reached: {reached}.{remarks}")
    if (run.errors <= goal).all() and has_time:
        return Decision("next_run", f"The goal seems reached ({reached}); another run has to confirm it.{remarks}")
    lacking = int(np.argmax(run.lacking))
    if run.lacking[lacking] > goal and len(state.runs) >= FEWEST_RUNS:
        return Decision(
            "not_reachable",
            f"The model lacks {format_percent(float(run.lacking[lacking]))} of the torque of {names[lacking]}, which "
            f"no effect of the catalogue explains; more runs do not reach {format_percent(goal)}.{remarks}",
        )
    if not has_time:
        spent = (
            f"All {format_count(len(state.runs), 'run')} are made"
            if len(state.runs) >= state.request.runs
            else f"Less than one run is left of {state.request.minutes:g} min"
        )
        return Decision("out_of_time", f"{spent}. {stand}. Give more{word_larger_error(state.request.goal)}.{remarks}")
    # The first motion (with a load, too) is slow, and one search may end poorly: the second at full speed says more.
    n_before = state.request.unloaded_runs if state.request.goal == "payload" else 0
    if planned is not None and measure is not None and len(state.runs) > n_before + FEWEST_RUNS:
        at_end = _predict_end(state, measure, planned)
        if (at_end > _BROKEN_PROMISE * goal).any():
            joint = int(np.argmax(at_end))
            share = word_share(state.request.goal, float(at_end[joint]))
            unloaded = ", also without the load" if state.request.goal == "payload" else ""
            return Decision(
                "not_reachable",
                f"In the remaining time and runs, {names[joint]} comes to {share}, "
                f"not to {format_percent(goal)}; now it is {reached}. Give more minutes or runs{unloaded}, "
                f"wider limits{word_larger_error(state.request.goal)}.{remarks}",
            )
    wanted = {
        "effects": "its usual size has to show",
        "payload": f"{names[worst]} is at {word_share(state.request.goal, float(run.errors[worst]))}",
    }.get(state.request.goal, f"the goal is {format_percent(goal)}")
    return Decision("next_run", f"{stand}; {wanted}.{remarks}")


def _word_error(state: CampaignState, measure: ErrorMeasure | None, name: str, error: float) -> str:
    """Return the error of the worst target in words; of a load all that is known."""
    goal = state.request.goal
    if goal == "payload":
        if not isinstance(measure, PayloadErrors) or state.identification is None:
            return "The load was not mounted yet"
        return measure.describe(state.identification.statistics.covariance)
    if goal == "effects":
        if not np.isfinite(error):
            return f"{name} would not have shown at any size on at least one joint"
        if error == 0.0:
            return f"{name} is found"
        return f"{name} would have shown from {format_percent(error)} of its usual size on every joint"
    target = "joint" if goal == "torque" else "parameter"
    return f"{format_percent(error)} on {name}, the worst {target}"


def _predict_end(state: CampaignState, measure: ErrorMeasure, planned: PlannedRun) -> FloatArray:
    """Return the errors (k,) once the last motion, or all so far, were repeated in the time and runs that are left."""
    assert state.identification is not None
    # Any of the runs that are left may be as long as was requested.
    longest = compute_planned_seconds(state.request.design) + planned.design.moves
    seconds = min(state.seconds_left, (state.request.runs - len(state.runs)) * longest)
    count = seconds / planned.design.duration
    again = predict_errors(state.identification, measure, planned.design, state.recordings[-1], count)
    all_again = state.runs[-1].parameters * np.sqrt(state.seconds / (state.seconds + seconds))
    return np.asarray(np.hypot(np.minimum(again, all_again), state.runs[-1].lacking))
