"""Checks of a design request."""

from __future__ import annotations

from dynident.errors import DynidentError
from dynident.excitation.criteria.criterion_choice import check_criterion, check_criterion_targets
from dynident.excitation.observation.row_models import ROW_MODELS
from dynident.excitation.request import FAMILIES, JOINT_BY_JOINT, KINDS, DesignRequest, TrajectoryRequest
from dynident.excitation.sets.named_sets import SETS
from dynident.motion.collision.obstacles import check_surroundings
from dynident.motion.trajectories.motion import MOST_SAMPLES
from dynident.schema.fields import check_ranges

_SAMPLES_PER_WAVE = 4


def check_request(request: DesignRequest) -> None:
    """Raise `DynidentError` for an impossible request; joints, effects and limits are checked where they are used.

    Parameters
    ----------
    request : DesignRequest
        The request.
    """
    check_ranges(request)
    _check_choice(request.kind, KINDS, "kind of design", "/kind")
    _check_choice(request.model, ROW_MODELS, "identification model to design for", "/model")
    check_criterion(request.criterion)
    check_criterion_targets(request.criterion)
    trajectory = request.trajectory
    _check_choice(trajectory.family, FAMILIES, "trajectory family", "/trajectory/family")
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
    _check_choice(request.trajectory.sets, SETS, "set of test motions", "/trajectory/sets")
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


def _check_choice(value: str, known: tuple[str, ...], subject: str, pointer: str) -> None:
    if value not in known:
        raise DynidentError(f"there is no {subject} {value!r}; there are: {', '.join(known)}", pointer=pointer)
