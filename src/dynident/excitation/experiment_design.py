"""`design_experiment`: from a checked request to a motion that keeps all limits; quick rehearsals of a design.

A rehearsal is the motion of a design without verification, which predicts what the design is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError, Note
from dynident.excitation.criteria.criterion_choice import check_criterion, check_criterion_targets
from dynident.excitation.criteria.design_criterion import add_rivals, build_design_criterion
from dynident.excitation.criteria.prediction_region import Region, draw_region
from dynident.excitation.design_observation_matrix import (
    DesignModel,
    build_design_model,
    lock_model,
    note_locked_joints,
)
from dynident.excitation.design_request import (
    JOINT_BY_JOINT,
    SAMPLES_PER_WAVE,
    DesignRequest,
    TrajectoryRequest,
    compute_least_sampling_rate,
)
from dynident.excitation.design_result import Design
from dynident.excitation.expected_torque import ExpectedTorque, IdentifiedModel
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask, build_earlier_rows
from dynident.excitation.experiments.periodic_trajectories import build_family, design_periodic, search_trajectory
from dynident.excitation.experiments.point_to_point import design_point_to_point
from dynident.excitation.experiments.sequential_design import design_sequential
from dynident.excitation.experiments.single_joint_motions import (
    Stroke,
    design_joint_by_joint,
    plan_stroke_moves,
    plan_strokes,
)
from dynident.excitation.optimisation.design_problem import Budget, count_period_samples
from dynident.excitation.standing_feet import stand_on_feet
from dynident.excitation.swaying_trunk import Sway, build_swaying_model
from dynident.motion.collision.obstacle_geometry import ASSUMED_HEIGHT, check_surroundings, note_reach
from dynident.motion.collision_free_paths import check_home, list_home_candidates, note_home
from dynident.motion.joint_trajectories import MOST_SAMPLES, Motion, PeriodicMotion, concatenate_motions, sample_pieces
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, build_bounds, lock_bounds, select_moving_joints
from dynident.motion.limits.postures_within_limits import compute_static_torque
from dynident.parallel import single_threaded
from dynident.progress import Checkpoints, NoCheckpoints, Progress, ignore_progress, make_monotonic
from dynident.recordings import Recording
from dynident.robot.robot_model import Robot


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
    if request.standing.feet:
        raise DynidentError(
            "a set of test motions moves all joints, but legs that stand do not move; choose another kind",
            pointer="/kind",
        )
    if request.trajectory.joints:
        raise DynidentError(
            "a set of test motions determines which joints move in each motion; leave joints out",
            pointer="/trajectory/joints",
        )


def _check_sway(request: DesignRequest, *, is_simple: bool) -> None:
    """Raise where a trunk that sways is asked for what only legs that are held can do.

    `is_simple` says that there are no earlier recordings, no identified model, and no region.
    """
    periodic = request.kind not in (*JOINT_BY_JOINT, "sequential") and request.trajectory.family != "point_to_point"
    if not periodic or request.model != "dynamic" or len(request.trajectory.paces) > 1:
        raise DynidentError(
            "the trunk sways only in periodic motions of all joints at one pace, for the dynamic model; choose these, "
            "or leave sway out",
            pointer="/standing/sway",
        )
    if not is_simple or request.criterion.name == "prediction":
        raise DynidentError(
            "a design in which the trunk sways takes neither earlier recordings nor an identified model into account, "
            "and its criterion cannot be the prediction of torque; leave these out, or leave sway out",
            pointer="/standing/sway",
        )


def _convert_request(request: DesignRequest, sway: Sway) -> DesignRequest:
    """Return a request for the driven joints of a robot that sways from one for its joints."""
    tree, stated = sway.linkage.tree, request.trajectory.joints
    legs = {tree.joint_names[j] for j in sway.linkage.passive}
    joints = (*sway.robot.joint_names[: tree.n_base], *stated) if stated else ()
    return replace(
        request,
        home=tuple(sway.home.tolist()),
        trajectory=replace(request.trajectory, joints=joints),
        # The equations of the legs are mixed with those of the base, and so is their noise.
        noise={name: value for name, value in request.noise.items() if name not in legs},
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
    least = compute_least_sampling_rate(trajectory)
    if trajectory.sampling_rate < least:
        raise DynidentError(
            f"a sampling rate of {trajectory.sampling_rate:g} Hz is too low for {pieces} that reach "
            f"{least / SAMPLES_PER_WAVE:g} Hz; use at least {least:g} Hz, fewer {pieces} or a longer period",
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
    region: Region | None = None,
    counts_moves: bool = False,
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
    region : Region, optional
        States whose torque is to be predicted, for the criterion "prediction"; by default all that the limits allow.
    counts_moves : bool
        Whether a periodic motion is worth less the longer the moves from and to home take.

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
    robot, stated, balance = stand_on_feet(robot, request)
    sway, machine, request = None if balance is None else balance.sway, robot, stated
    if sway is not None:
        _check_sway(stated, is_simple=not earlier and identified is None and region is None)
        # What moves are the trunk and the joints that are in no leg.
        machine, request = sway.robot, _convert_request(stated, sway)
    has_loads = any(choice.runs for choice in request.effects_or_default)
    expected = None if identified is None else ExpectedTorque(robot, identified, has_loads)
    limits = build_bounds(
        machine,
        request.limits,
        torque_margin=request.torque_margin,
        surroundings=request.surroundings,
        torque_note=None if expected is None else expected.complete_note,
        balance=balance,
    )
    if request.home is not None:
        check_home(request.home, limits)
    effects = add_rivals(request.effects_or_default, request.criterion)
    if sway is None:
        model = build_design_model(robot, effects, other_runs=bool(earlier), expected=expected)
    else:
        model = build_swaying_model(sway, effects, limits)
    # Designed for limits slightly inside the true ones, the verification does not fail by rounding.
    bounds, notes = limits.tighten(), list[str]()
    if (request.trajectory.joints and request.kind not in JOINT_BY_JOINT) or sway is not None:
        # Locked joints stay at home, so home has to be known before the model of the moving joints.
        home = list_home_candidates(request.home, bounds, model)[0]
        moving = select_moving_joints(request.trajectory.joints, machine.joint_names)
        model = lock_model(model, home, moving)
        bounds = lock_bounds(bounds, home, moving if sway is None else moving & sway.moves)
        notes += [] if moving.all() else [note_locked_joints(machine.joint_names, moving)]
    design_criterion = build_design_criterion(
        model,
        request.criterion,
        request.noise,
        one_equation=request.model in ("energy", "power"),
        earlier=build_earlier_rows(model, earlier, request) if earlier else None,
        region=region or (draw_region(robot, request.limits) if request.criterion.name == "prediction" else None),
    )
    task = DesignTask(
        request, model, design_criterion, limits, bounds, progress, checkpoints or NoCheckpoints(), counts_moves
    )
    progress(0.0, f"{model.n_parameters} base parameters")
    experiment = design_joint_by_joint(task) if request.kind in JOINT_BY_JOINT else _design_joint_motion(task, budget)
    motion = sample_pieces(experiment.pieces, task.rate)
    # A floor that was only assumed is not a floor that the user stated: the note on what was checked says so.
    floor_assumed = limits.space is not None and limits.space.assumed
    reach = note_reach(machine, motion.t, motion.q, request.surroundings, floor_assumed=floor_assumed)
    if sway is not None:
        # The user's home has the joints of the legs, and no trunk.
        own = {note_home(sway.home): note_home(np.array(stated.home))}
        experiment = replace(experiment, notes=tuple(own.get(note, note) for note in experiment.notes))
    all_notes = (*experiment.notes, *notes, *model.notes, *limits.notes, *reach)
    progress(1.0, "done")
    joints = (motion.q, motion.dq, motion.ddq)
    q, dq, ddq = joints if sway is None else sway.list_joint_motion(*joints)
    return Design(
        joint_names=robot.joint_names,
        request=stated,
        t=motion.t,
        q=q,
        dq=dq,
        ddq=ddq,
        exciting=experiment.exciting,
        period=experiment.period,
        parameter_names=model.parameter_names,
        criterion_values=experiment.valued.values,
        baseline=experiment.baseline,
        margins=experiment.margins,
        notes=all_notes,
        warnings=tuple(note for note in all_notes if isinstance(note, Note) and note.code),
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


# Random motions of a quick rehearsal, and postures of a joint's strokes whose static torque is checked.
_CANDIDATES = 6
_POSTURES = 30


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A motion that stands for an experiment.

    Parameters
    ----------
    motion : Motion
        The motion, sampled sparsely.
    n_samples : float
        Number of samples that the experiment would have.
    """

    motion: Motion
    n_samples: float


def rehearse_quickly(request: DesignRequest, model: DesignModel, bounds: Bounds, rate: float) -> Rehearsal:
    """Return a motion of the requested kind, fast enough to tell whether that kind is worth while.

    Of a periodic trajectory it is one period of the best of a few random ones, at every pace: an optimised one is
    better, or at least different. The moves from and to rest are not included.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    model : DesignModel
        Model with the effects in question.
    bounds : Bounds
        Limits of the motion.
    rate : float
        Rate of the samples of strokes, Hz.

    Returns
    -------
    Rehearsal
        The motion, and the number of samples that it stands for.

    Raises
    ------
    ImpossibleLimitsError
        No such motion keeps the limits.
    """
    hasty = replace(request, kind="random", random_trajectories=_CANDIDATES)
    return rehearse_motion(request if request.kind in JOINT_BY_JOINT else hasty, model, bounds, rate)


def rehearse_motion(
    request: DesignRequest, model: DesignModel, bounds: Bounds, rate: float, earlier: FloatArray | None = None
) -> Rehearsal:
    """Return the motion that a design of this request will have, except for what its verification removes.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    model : DesignModel
        Model with the effects in question.
    bounds : Bounds
        Limits of the motion.
    rate : float
        Rate of the samples of strokes, Hz: the design's own where the model has a memory, fewer otherwise.
    earlier : (r, b), optional
        Rows besides W / √N that stand for earlier runs, see `build_earlier_rows`.

    Returns
    -------
    Rehearsal
        The motion, and the number of samples that it stands for.

    Raises
    ------
    ImpossibleLimitsError
        No such motion keeps the limits.
    """
    if request.kind in JOINT_BY_JOINT:
        home = list_home_candidates(request.home, bounds, model)[0]
        strokes = plan_strokes(request, bounds, home)
        _check_holding(strokes, home, bounds, model)
        # One look at all strokes is enough here; every single move is checked when it is designed.
        unloaded = replace(bounds, torque=np.full_like(bounds.torque, np.inf))
        course = plan_stroke_moves(unloaded, model, home, strokes, repeats=request.trajectory.periods, rate=rate)
        motion = sample_pieces(course.pieces, rate)
        return Rehearsal(motion, float(len(motion.t)))
    trajectory = request.trajectory
    # The period need not be a whole number of samples: nothing is recorded.
    family = build_family(trajectory, trajectory.duration)
    design_criterion = build_design_criterion(model, request.criterion, request.noise, earlier=earlier)
    budget = Budget(request.starts_or_default, request.time_budget)
    # The same search with the same seed as the design makes, so that its result foretells the design's.
    task = DesignTask(request, model, design_criterion, bounds, bounds, ignore_progress)
    best = search_trajectory(task, family, budget).best
    parts, elapsed = [], 0.0
    for pace in trajectory.paces:
        slow = family.with_period(trajectory.duration / pace)
        # The same number of samples at every pace would count the slow ones too little.
        t = np.arange(0.0, slow.period, trajectory.duration / count_period_samples(model, family))
        part = PeriodicMotion(slow, best.x).evaluate(t)
        parts.append(Motion(elapsed + part.t, part.q, part.dq, part.ddq, part.dddq))
        # Paces are recorded one after the other.
        elapsed += slow.period
    return Rehearsal(concatenate_motions(parts), elapsed * trajectory.periods * rate)


def _check_holding(strokes: Sequence[Stroke], home: FloatArray, bounds: Bounds, model: DesignModel) -> None:
    """Raise `ImpossibleLimitsError` where the arm cannot be held along the strokes."""
    if not bounds.has_torque_limits:
        return
    postures = []
    for joint in sorted({stroke.joint for stroke in strokes}):
        own = [stroke for stroke in strokes if stroke.joint == joint]
        along = np.tile(home, (_POSTURES, 1))
        # Static torque depends on the position alone, and so on the range of a joint's strokes, not on their number.
        along[:, joint] = np.linspace(
            min(own_stroke.low for own_stroke in own), max(own_stroke.high for own_stroke in own), _POSTURES
        )
        postures.append(along)
    if (np.abs(compute_static_torque(model, np.concatenate(postures))) > bounds.torque).any():
        raise ImpossibleLimitsError(
            "the torque limits do not allow the arm to be held everywhere along the strokes; choose another home "
            "posture",
            pointer="/home",
        )
