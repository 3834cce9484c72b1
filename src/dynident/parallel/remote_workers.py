"""Other machines that take parts of one computation, where the caller allows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar

from dynident.progress import Progress

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class RemoteWorkFailed(Exception):
    """Raised where a part that was sent away was not computed there, and that machine is not to be asked again."""


class RemoteWorkersBusy(RemoteWorkFailed):
    """Raised where a part was not computed there, but that machine may be asked again after a while."""


class RemoteWorkers(Protocol):
    """Other machines that take parts of a computation; the caller computes itself whatever they do not return."""

    def list_workers(
        self, work: Callable[[_Item, Progress], _Result], size: float
    ) -> Sequence[Callable[[_Item, Progress], _Result]]:
        """Return functions that compute an item on another machine, one for each item that may be under way at a time.

        The functions are called as `work` is, and wait for the result. They call the progress function all the time and
        stop with whatever it raises. Whatever goes wrong on the other machine they raise as `RemoteWorkFailed`: if the
        item itself is at fault, the same error shows when it is computed here.

        Parameters
        ----------
        work : function
            Computes an item here.
        size : float
            Of all items together, in samples.

        Returns
        -------
        sequence of functions
            Empty where sending is not worth it, or `work` cannot be sent.
        """
        ...


# A context variable, not a global: the service computes for several callers in threads of one process.
_others: ContextVar[RemoteWorkers | None] = ContextVar("others", default=None)


@contextmanager
def share_work_with(others: RemoteWorkers) -> Iterator[None]:
    """Let other machines take parts of what this thread computes within the with statement.

    Parameters
    ----------
    others : RemoteWorkers
        The machines, and how they are reached.
    """
    token = _others.set(others)
    try:
        yield
    # Also after an error: a thread of the service serves other callers next.
    finally:
        _others.reset(token)


def list_remote_workers(
    work: Callable[[_Item, Progress], _Result], size: float
) -> Sequence[Callable[[_Item, Progress], _Result]]:
    """Return the functions that compute an item on the machines that this thread shares with.

    Parameters
    ----------
    work : function
        Computes an item here.
    size : float
        Of all items together, in samples.

    Returns
    -------
    sequence of functions
        As `RemoteWorkers.list_workers` returns them; empty outside of `share_work_with`.
    """
    other_machines = _others.get()
    return () if other_machines is None else other_machines.list_workers(work, size)
