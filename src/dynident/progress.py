"""Progress reports of long computations, which also stop a computation that nobody waits for any more."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a short message; raises `errors.Cancelled` to stop the computation."""


def ignore_progress(fraction: float, message: str) -> None:
    """Ignore the report: the default progress function."""


def scale_progress(progress: Progress, first: float, last: float) -> Progress:
    """Return a progress function for a sub-task.

    Parameters
    ----------
    progress : Progress
        Of the whole task.
    first, last : float
        The fractions of the whole task at which the sub-task begins and ends.

    Returns
    -------
    Progress
        Takes fractions of the sub-task, from 0 to 1.
    """

    def inner(fraction: float, message: str) -> None:
        progress(first + (last - first) * fraction, message)

    return inner


def make_monotonic(progress: Progress) -> Progress:
    """Return a progress function that never goes back, for tasks that repeat steps, such as a second check.

    Parameters
    ----------
    progress : Progress

    Returns
    -------
    Progress
    """
    reached = 0.0

    def inner(fraction: float, message: str) -> None:
        nonlocal reached
        reached = max(reached, fraction)
        progress(reached, message)

    return inner
