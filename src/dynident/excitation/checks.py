"""What can be asked of a design, and what cannot."""

from __future__ import annotations

import numpy as np

from dynident.errors import DynidentError
from dynident.excitation.criteria.choice import check_criterion, check_wishes
from dynident.excitation.observation.row_models import ROW_MODELS
from dynident.excitation.request import FAMILIES, JOINT_BY_JOINT, KINDS, DesignRequest, TrajectoryRequest
from dynident.excitation.sets.planned import SETS
from dynident.motion.surroundings.obstacles import check_surroundings
from dynident.motion.trajectories.motion import MOST_SAMPLES

_MOST_TIMES = 1_000_000
_SAMPLES_PER_WAVE = 4
_MOST_HARMONICS = 100
_MOST_POINTS = 200
_LONGEST_DWELL = 60.0


def check_request(request: DesignRequest) -> None:
    """Raise `DynidentError` for what cannot be asked; joints, effects and limits are checked where they are used."""
    _one_of(request.kind, KINDS, "kind of design", "/kind")
    _one_of(request.model, ROW_MODELS, "identification model to design for", "/model")
    check_criterion(request.criterion)
    check_wishes(request.criterion)
    trajectory = request.trajectory
    _one_of(trajectory.family, FAMILIES, "trajectory family", "/trajectory/family")
    _positive(trajectory.duration, "duration", "/trajectory/duration")
    _positive(trajectory.sampling_rate, "sampling_rate", "/trajectory/sampling_rate")
    _at_least(trajectory.periods, 1, "periods", "/trajectory/periods")
    _at_least(request.random_trajectories, 1, "random_trajectories", "/random_trajectories")
    _at_least(request.seed, 0, "seed", "/seed")
    if request.starts is not None:
        _at_least(request.starts, 1, "starts", "/starts")
    if request.time_budget is not None:
        _positive(request.time_budget, "time_budget", "/time_budget")
    if not (np.isfinite(request.torque_margin) and request.torque_margin >= 0):
        raise DynidentError(
            f"torque_margin is {request.torque_margin}; it must be a share from 0 on, such as 0.2",
            pointer="/torque_margin",
        )
    check_surroundings(request.surroundings)
    for value, name, at in (
        (trajectory.periods, "periods", "/trajectory/periods"),
        (request.random_trajectories, "random_trajectories", "/random_trajectories"),
        (request.starts or 1, "starts", "/starts"),
    ):
        if value > _MOST_TIMES:
            raise DynidentError(f"{name} is too large; at most {_MOST_TIMES} can be designed", pointer=at)
    _check_shares(request.wanted_speeds, "speeds", "the velocity limit")
    _check_shares(trajectory.paces, "paces", "the speed of the path")
    _check_dwell(request)
    for amplitude in request.wanted_amplitudes:
        _positive(amplitude, "an amplitude", "/trajectory/amplitudes")
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
    _one_of(request.trajectory.sets, SETS, "set of test motions", "/trajectory/sets")
    if request.trajectory.joints:
        raise DynidentError(
            "a set of test motions says itself which joints move in each of them; leave joints out",
            pointer="/trajectory/joints",
        )


def _check_dwell(request: DesignRequest) -> None:
    least, most = request.trajectory.dwell
    if not 0 <= least <= most <= _LONGEST_DWELL:
        raise DynidentError(
            f"dwell is {list(request.trajectory.dwell)}; it must be the shortest and the longest rest in a point, "
            f"between 0 and {_LONGEST_DWELL:g} s",
            pointer="/trajectory/dwell",
        )
    together = request.kind in ("optimized", "random")
    if most > 0 and not (together and request.trajectory.family == "point_to_point"):
        raise DynidentError(
            "only a motion from point to point rests in its points; leave dwell out", pointer="/trajectory/dwell"
        )


def _check_points(request: DesignRequest) -> None:
    trajectory = request.trajectory
    _at_least(trajectory.points, 2, "points", "/trajectory/points")
    if trajectory.points > _MOST_POINTS:
        raise DynidentError(
            f"points is {trajectory.points}; at most {_MOST_POINTS} can be designed", pointer="/trajectory/points"
        )
    if request.model != "dynamic":
        raise DynidentError(
            f"only a periodic trajectory of all joints can be designed for the {request.model} model; leave model out",
            pointer="/model",
        )
    if trajectory.paces != (1.0,):
        raise DynidentError(
            "sequences of moves and sets of test motions choose their speeds themselves; leave paces out",
            pointer="/trajectory/paces",
        )


def _check_fineness(trajectory: TrajectoryRequest) -> None:
    """Raise where a periodic trajectory has too few or too many shapes, or where they are too fast for the sampling."""
    what = "intervals" if trajectory.family == "b_spline" else "harmonics"
    count, most = (
        (trajectory.intervals, 2 * _MOST_HARMONICS) if what == "intervals" else (trajectory.harmonics, _MOST_HARMONICS)
    )
    _at_least(count, 2, what, f"/trajectory/{what}")
    if count > most:
        raise DynidentError(f"{what} is {count}; at most {most} can be designed", pointer=f"/trajectory/{what}")
    fastest = count / trajectory.duration / (2 if what == "intervals" else 1)
    least = _SAMPLES_PER_WAVE * fastest
    if trajectory.sampling_rate < least:
        raise DynidentError(
            f"a sampling rate of {trajectory.sampling_rate:g} Hz is too low for {what} that make {fastest:g} Hz; use "
            f"at least {least:g} Hz, fewer {what} or a longer period",
            pointer="/trajectory/sampling_rate",
        )


def _one_of(value: str, known: tuple[str, ...], what: str, pointer: str) -> None:
    if value not in known:
        raise DynidentError(f"there is no {what} {value!r}; there are: {', '.join(known)}", pointer=pointer)


def _positive(value: float, what: str, pointer: str) -> None:
    if not (np.isfinite(value) and value > 0):
        raise DynidentError(f"{what} is {value}; it must be a positive number", pointer=pointer)


def _at_least(value: int, least: int, what: str, pointer: str) -> None:
    if value < least:
        raise DynidentError(f"{what} is {value}; it must be at least {least}", pointer=pointer)


def _check_shares(shares: tuple[float, ...], what: str, of: str) -> None:
    if not shares or not all(np.isfinite(share) and 0 < share <= 1 for share in shares):
        raise DynidentError(
            f"{what} are {list(shares)}; they must be shares of {of} between 0 and 1", pointer=f"/trajectory/{what}"
        )
