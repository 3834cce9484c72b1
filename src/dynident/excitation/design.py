"""Design of an experiment: from a checked request for a robot to a motion that keeps every limit."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.blas_threads import single_threaded
from dynident.errors import DynidentError
from dynident.excitation.criteria.criterion_choice import check_criterion, check_criterion_targets
from dynident.excitation.criteria.design_criterion import add_rivals, build_design_criterion
from dynident.excitation.design_model import build_design_model, lock_model, note_locked_joints
from dynident.excitation.expected_torque import ExpectedTorque, IdentifiedModel
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask, build_earlier_rows
from dynident.excitation.experiments.periodic import design_periodic
from dynident.excitation.experiments.point_to_point import design_point_to_point
from dynident.excitation.experiments.single_joint import design_joint_by_joint
from dynident.excitation.optimising.design_problem import Budget
from dynident.excitation.request import JOINT_BY_JOINT, DesignRequest, TrajectoryRequest
from dynident.excitation.result import Design
from dynident.excitation.sets.sequential_design import design_sequential
from dynident.motion.collision.obstacles import ASSUMED_HEIGHT, check_surroundings, note_reach
from dynident.motion.joint_trajectories import MOST_SAMPLES, sample_pieces
from dynident.motion.limits.bounds import build_bounds, lock_bounds, select_moving_joints
from dynident.motion.move_paths import check_home, list_home_candidates
from dynident.progress import Checkpoints, NoCheckpoints, Progress, ignore_progress, make_monotonic
from dynident.recordings import Recording
from dynident.robot.model import Robot

_SAMPLES_PER_WAVE = 4


def check_request(request: DesignRequest) -> None:
    """Raise `DynidentError` for an impossible request; joints, effects and limits are checked where they are used.

    Parameters
    ----------
    request : DesignRequest
        The request.
    """
    check_criterion(request.criterion)
    check_criterion_targets(request.criterion)
    trajectory = request.trajectory
    check_surroundings(request.surroundings)
    _check_dwell(request)
    # Filters and integrals over whole periods need a periodic motion of one pace.
    alone = request.kind in JOINT_BY_JOINT or len(trajectory.paces) > 1
    if alone and request.model != "dynamic":
        raise DynidentError(
            f"only a periodic trajectory at one pace can be designed for the {request.model} model; leave model out",
            pointer="/model",
        )
    if request.kind in JOINT_BY_JOINT:
        return
    if request.kind == "sequential":
        _check_set(request)
    if trajectory.family == "point_to_point" or request.kind == "sequential":
        _check_points(request)
    if trajectory.family == "point_to_point":
        return
    _check_fineness(trajectory)
    samples = trajectory.sampling_rate * trajectory.duration * trajectory.periods * sum(1 / p for p in trajectory.paces)
    if samples > MOST_SAMPLES:
        raise DynidentError(
            f"the trajectory would have {samples:.0f} samples; at most {MOST_SAMPLES} can be designed",
            pointer="/trajectory",
        )


def _check_set(request: DesignRequest) -> None:
    if request.trajectory.joints:
        raise DynidentError(
            "a set of test motions determines which joints move in each motion; leave joints out",
            pointer="/trajectory/joints",
        )


def _check_dwell(request: DesignRequest) -> None:
    least, most = request.trajectory.dwell
    if least > most:
        raise DynidentError(
            f"dwell is {list(request.trajectory.dwell)}; it must be the shortest and the longest rest in a point",
            pointer="/trajectory/dwell",
        )
    together = request.kind in ("optimized", "random")
    if most > 0 and not (together and request.trajectory.family == "point_to_point"):
        raise DynidentError(
            "only a point-to-point motion rests in points; leave dwell out", pointer="/trajectory/dwell"
        )


def _check_points(request: DesignRequest) -> None:
    if request.model != "dynamic":
        raise DynidentError(
            f"only a periodic trajectory of all joints can be designed for the {request.model} model; leave model out",
            pointer="/model",
        )
    if request.trajectory.paces != (1.0,):
        raise DynidentError(
            "paces apply neither to sequences of moves nor to sets of test motions; leave paces out",
            pointer="/trajectory/paces",
        )


def _check_fineness(trajectory: TrajectoryRequest) -> None:
    """Raise where the shapes of a periodic trajectory are too fast for the sampling."""
    pieces = "intervals" if trajectory.family == "b_spline" else "harmonics"
    count = trajectory.intervals if pieces == "intervals" else trajectory.harmonics
    # A wave takes two intervals of a spline, or one period of the highest harmonic.
    fastest = count / trajectory.duration / (2 if pieces == "intervals" else 1)
    least = _SAMPLES_PER_WAVE * fastest
    if trajectory.sampling_rate < least:
        raise DynidentError(
            f"a sampling rate of {trajectory.sampling_rate:g} Hz is too low for {pieces} that reach {fastest:g} Hz; "
            f"use at least {least:g} Hz, fewer {pieces} or a longer period",
            pointer="/trajectory/sampling_rate",
        )


@single_threaded
def design_experiment(
    robot: Robot,
    request: DesignRequest,
    progress: Progress = ignore_progress,
    earlier: Sequence[Recording] = (),
    checkpoints: Checkpoints | None = None,
    identified: IdentifiedModel | None = None,
) -> Design:
    """Design an experiment.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : DesignRequest
        What the motion is to show, and the limits that it has to keep.
    progress : Progress
        Called with the start, the iteration, the criterion and the tightest limit; may raise to cancel.
    earlier : sequence of Recording
        Recordings of earlier runs: their information about the parameters counts, so that the new experiment
        complements them.
    checkpoints : Checkpoints, optional
        Keeps the state of the search of a periodic trajectory. A search that was stopped continues from there, its time
        counted.
    identified : IdentifiedModel, optional
        The estimate of an identified model of the robot, by which the torque is predicted for its limits: friction and
        rotors count, and a margin from its uncertainty. Without it the torque is that of the description's inertias.

    Returns
    -------
    Design
        Verified on a grid ten times as fine as its sampling rate: no limit is broken.

    Raises
    ------
    DynidentError
        The request cannot be met; `ImpossibleLimitsError` names the limit in the way.
    """
    # The time of the budget runs from here on: the model is part of what the user waits for.
    budget = Budget(request.starts_or_default, request.time_budget)
    progress = make_monotonic(progress)
    check_request(request)
    expected = None if identified is None else ExpectedTorque(robot, identified)
    limits = build_bounds(
        robot,
        request.limits,
        torque_margin=request.torque_margin,
        surroundings=request.surroundings,
        torque_note=None if expected is None else expected.complete_note,
    )
    if request.home is not None:
        check_home(request.home, limits)
    model = build_design_model(
        robot,
        add_rivals(request.effects_or_default, request.criterion),
        other_runs=bool(earlier),
        expected=expected,
    )
    # Designed for limits slightly inside the true ones, the verification does not fail by rounding.
    bounds, notes = limits.tighten(), list[str]()
    if request.trajectory.joints and request.kind not in JOINT_BY_JOINT:
        # Locked joints stay at home, so home has to be known before the model of the moving joints.
        home = list_home_candidates(request.home, bounds, model)[0]
        moving = select_moving_joints(request.trajectory.joints, robot.joint_names)
        model, bounds = lock_model(model, home, moving), lock_bounds(bounds, home, moving)
        notes.append(note_locked_joints(robot.joint_names, moving))
    design_criterion = build_design_criterion(
        model,
        request.criterion,
        request.noise,
        one_equation=request.model in ("energy", "power"),
        earlier=build_earlier_rows(model, earlier, request) if earlier else None,
    )
    task = DesignTask(request, model, design_criterion, limits, bounds, progress, checkpoints or NoCheckpoints())
    progress(0.0, f"{model.n_parameters} base parameters")
    experiment = design_joint_by_joint(task) if request.kind in JOINT_BY_JOINT else _design_joint_motion(task, budget)
    motion = sample_pieces(experiment.pieces, task.rate)
    # A floor that was only assumed is not a floor that the user stated: the note on what was checked says so.
    floor_assumed = limits.space is not None and limits.space.assumed
    reach = note_reach(robot, motion.t, motion.q, request.surroundings, floor_assumed=floor_assumed)
    progress(1.0, "done")
    return Design(
        joint_names=robot.joint_names,
        request=request,
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        exciting=experiment.exciting,
        period=experiment.period,
        parameter_names=model.parameter_names,
        criterion_values=experiment.valued.values,
        baseline=experiment.baseline,
        margins=experiment.margins,
        notes=(*experiment.notes, *notes, *model.notes, *limits.notes, *reach),
        expected=experiment.valued.expected,
        runs=experiment.runs,
        floor=ASSUMED_HEIGHT if floor_assumed else request.surroundings.floor,
    )


def _design_joint_motion(task: DesignTask, budget: Budget) -> DesignedExperiment:
    """Design a motion of several joints at once."""
    if task.request.kind == "sequential":
        return design_sequential(task, budget)
    if task.request.trajectory.family == "point_to_point":
        return design_point_to_point(task, budget)
    return design_periodic(task, budget)
