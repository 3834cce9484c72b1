"""What is wrong with a closed loop, and where."""

from __future__ import annotations

from dynident.errors import DynidentError
from dynident.robot.cut_joints import Loop

TITLE = "Unusable closed loop"


def loop_error(detail: str, loop: Loop) -> DynidentError:
    """Error that names a loop's place."""
    return DynidentError(f"line {loop.line}: {detail}" if loop.line else detail, pointer=loop.where, title=TITLE)


def redundant(loop: Loop, equations: int, unknowns: int, passive: str) -> DynidentError:
    """Error of a loop that states more than its passive joints leave open."""
    return loop_error(
        f"Loop '{loop.name}' has redundant constraints: {equations} equations for {unknowns} passive joints "
        f"({passive}). A loop in a plane is of the kind planar (2 equations), one with ball joints of the kind point "
        "(3).",
        loop,
    )


def hardly_reached(loop: Loop, reached: int, tried: int) -> DynidentError:
    """Error of loops that pass singular postures almost wherever their driven joints go."""
    return loop_error(
        "The loops can hardly move within the limits of the driven joints without passing a singular posture: "
        f"{reached} of {tried} postures are reached. State limits of the driven joints, or another start.",
        loop,
    )


def nowhere_near(loop: Loop) -> DynidentError:
    """Error of loops whose passive positions no polynomial comes near enough to."""
    return loop_error(
        "The loops come too near singular postures within the limits of the driven joints for the passive "
        "positions to be found everywhere. State narrower limits of the driven joints.",
        loop,
    )
