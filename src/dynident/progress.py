"""Progress callbacks (which also cancel) and checkpoints of long computations.

A progress report also stops a computation that nobody waits for any more; from a checkpoint a computation goes on after
it was stopped from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Checkpoints(Protocol):
    """Storage for the last checkpoint of one computation."""

    def load_last(self) -> bytes | None:
        """Return the checkpoint that was stored last; `None` where the computation begins."""

    def save(self, make: Callable[[], bytes]) -> None:
        """Store a checkpoint.

        Parameters
        ----------
        make : function
            Makes the checkpoint's bytes. Computations call `save` often; the storage calls `make` only from time to
            time.
        """


class NoCheckpoints:
    """Storage that keeps nothing: every computation begins anew."""

    def load_last(self) -> bytes | None:
        """Return None: there is never a checkpoint."""
        return None

    def save(self, make: Callable[[], bytes]) -> None:
        """Ignore the checkpoint."""


Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a short message; raises `errors.Cancelled` to stop the computation."""


def ignore_progress(fraction: float, message: str) -> None:
    """Ignore the report: the default progress function.

    Parameters
    ----------
    fraction : float
        Share of the work that is done, 0 to 1.
    message : str
        What is being done.
    """


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
        Called with the largest fraction so far.

    Returns
    -------
    Progress
        Takes any fractions.
    """
    reached = 0.0

    def inner(fraction: float, message: str) -> None:
        nonlocal reached
        # A repeated step begins at zero again; the report stays where it was.
        reached = max(reached, fraction)
        progress(reached, message)

    return inner
