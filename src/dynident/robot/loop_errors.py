"""Errors of closed loops, with their place in the description."""

from __future__ import annotations

from dynident.errors import DynidentError
from dynident.robot.cut_joints import Loop

LOOP_TITLE = "Unusable closed loop"


def make_loop_error(detail: str, loop: Loop) -> DynidentError:
    """Return an error that names a loop's place."""
    return DynidentError(f"line {loop.line}: {detail}" if loop.line else detail, pointer=loop.where, title=LOOP_TITLE)


def make_redundancy_error(loop: Loop, equations: int, unknowns: int, passive: str) -> DynidentError:
    """Return the error of a loop with more equations than passive joints."""
    return make_loop_error(
        f"Loop '{loop.name}' has redundant constraints: {equations} equations for {unknowns} passive joints "
        f"({passive}). A loop in a plane is of the kind planar (2 equations), one with ball joints of the kind point "
        "(3).",
        loop,
    )


def make_reach_error(loop: Loop, reached: int, sampled: int) -> DynidentError:
    """Return the error of loops that meet singular postures almost wherever their driven joints go."""
    return make_loop_error(
        "The loops can hardly move within the limits of the driven joints without passing a singular posture: "
        f"{reached} of {sampled} postures are reached. State limits of the driven joints, or another start.",
        loop,
    )


def make_approximation_error(loop: Loop) -> DynidentError:
    """Return the error of loops whose passive positions no polynomial approximates well enough."""
    return make_loop_error(
        "The loops come too near singular postures within the limits of the driven joints for the passive "
        "positions to be found everywhere. State narrower limits of the driven joints.",
        loop,
    )
