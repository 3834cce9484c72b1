"""Design of an experiment: from a robot and a request to a motion that keeps every limit."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.checkpoints import Checkpoints, NoCheckpoints
from dynident.excitation.checks import check_request
from dynident.excitation.criteria.deciding import with_rivals, yardstick_of
from dynident.excitation.experiments.earlier import earlier_rows
from dynident.excitation.experiments.periodic import periodic
from dynident.excitation.experiments.point_to_point import point_to_point
from dynident.excitation.experiments.strokes import joint_by_joint
from dynident.excitation.experiments.task import Made, Task
from dynident.excitation.observation.locked import locked_model, locked_note
from dynident.excitation.observation.model import design_model
from dynident.excitation.optimising.budget import Budget
from dynident.excitation.request import JOINT_BY_JOINT, DesignRequest
from dynident.excitation.result import Design
from dynident.excitation.sets.sequential import sequential
from dynident.motion.limits.bounds import bounds_of
from dynident.motion.limits.locked import locked_bounds, moving_joints
from dynident.motion.moves.home import check_home, home_candidates
from dynident.motion.surroundings.reach import reach_notes
from dynident.motion.trajectories.motion import in_sequence
from dynident.progress import Progress, ascending, silent
from dynident.recordings import Recording
from dynident.robot.model import Robot
from dynident.threads import single_threaded


@single_threaded
def design_experiment(
    robot: Robot,
    request: DesignRequest,
    progress: Progress = silent,
    earlier: Sequence[Recording] = (),
    checkpoints: Checkpoints | None = None,
) -> Design:
    """Design an experiment.

    Parameters
    ----------
    robot : Robot
    request : DesignRequest
    progress : Progress
        Receives the start, the iteration, the criterion and the tightest limit; may raise to cancel.
    earlier : sequence of Recording
        Recordings of earlier runs: their information about the parameters counts, so that the new experiment
        complements
        them.
    checkpoints : Checkpoints, optional
        Keeps the state of the search of a periodic trajectory. A search that was stopped continues from there, its time
        counted.

    Returns
    -------
    Design
        Verified on a grid ten times as fine as its sampling rate: no limit is broken.

    Raises
    ------
    DynidentError
        The request cannot be met; `ImpossibleLimitsError` names the limit in the way.
    """
    budget = Budget(request.wanted_starts, request.time_budget)
    progress = ascending(progress)
    check_request(request)
    limits = bounds_of(robot, request.limits, torque_margin=request.torque_margin, surroundings=request.surroundings)
    if request.home is not None:
        check_home(request.home, limits)
    model = design_model(robot, with_rivals(request.wanted_effects, request.criterion), other_runs=bool(earlier))
    # Designed for limits slightly inside the true ones, the verification does not fail by rounding.
    bounds, notes = limits.tightened(), list[str]()
    if request.trajectory.joints and request.kind not in JOINT_BY_JOINT:
        home = home_candidates(request.home, bounds, model)[0]
        moving = moving_joints(request.trajectory.joints, robot.joint_names)
        model, bounds = locked_model(model, home, moving), locked_bounds(bounds, home, moving)
        notes.append(locked_note(robot.joint_names, moving))
    yardstick = yardstick_of(
        model,
        request.criterion,
        request.noise,
        one_equation=request.model in ("energy", "power"),
        earlier=earlier_rows(model, earlier, request) if earlier else None,
    )
    task = Task(request, model, yardstick, limits, bounds, progress, checkpoints or NoCheckpoints())
    progress(0.0, f"{model.n_parameters} base parameters")
    experiment = joint_by_joint(task) if request.kind in JOINT_BY_JOINT else _moving_together(task, budget)
    motion = in_sequence(experiment.pieces, task.rate)
    floor_assumed = limits.space is not None and limits.space.assumed
    reach = reach_notes(robot, motion.t, motion.q, request.surroundings, floor_assumed=floor_assumed)
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
    )


def _moving_together(task: Task, budget: Budget) -> Made:
    """Design a motion of several joints at once."""
    if task.request.kind == "sequential":
        return sequential(task, budget)
    if task.request.trajectory.family == "point_to_point":
        return point_to_point(task, budget)
    return periodic(task, budget)
