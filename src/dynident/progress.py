"""How a long computation tells how far it is, and learns that nobody waits for it any more."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a short message; raises `errors.Cancelled` to stop the computation."""


def silent(fraction: float, message: str) -> None:
    """Report to nobody."""


def part(progress: Progress, first: float, last: float) -> Progress:
    """Give the range from `first` to `last` of `progress` to a sub-task that counts from 0 to 1."""

    def inner(fraction: float, message: str) -> None:
        progress(first + (last - first) * fraction, message)

    return inner


def ascending(progress: Progress) -> Progress:
    """The same, but what is begun again (another look, a second check) does not go back behind what was reached."""
    reached = 0.0

    def inner(fraction: float, message: str) -> None:
        nonlocal reached
        reached = max(reached, fraction)
        progress(reached, message)

    return inner
