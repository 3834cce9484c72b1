"""Who else may work on the parts of one computation: other machines, where somebody says so."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar

from dynident.progress import Progress

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class NotElsewhere(Exception):
    """A part that was sent away was not worked on there, and nobody there is to be asked again."""


class Busy(NotElsewhere):
    """The same, but whoever is there may be asked again in a while."""


class Elsewhere(Protocol):
    """Others who take parts of a computation; whoever asks them computes himself what they do not give back."""

    def places(
        self, work: Callable[[_Item, Progress], _Result], size: float
    ) -> Sequence[Callable[[_Item, Progress], _Result]]:
        """Functions that have `work` of an item done elsewhere and wait for it, one for each item at the same time.

        None where it is not worth it, or what is to be done cannot be sent. They call what tells how far it is all the
        time, as `work` does, and stop with what that raises; they raise `NotElsewhere` whatever goes wrong there: what
        is wrong with the item itself shows here.

        Parameters
        ----------
        work : function
            Does the same here.
        size : float
            Of all items together, in samples.
        """
        ...


_others: ContextVar[Elsewhere | None] = ContextVar("others", default=None)


@contextmanager
def shared_with(others: Elsewhere) -> Iterator[None]:
    """Let others take parts of what this thread computes meanwhile."""
    before = _others.set(others)
    try:
        yield
    finally:
        _others.reset(before)


def places(work: Callable[[_Item, Progress], _Result], size: float) -> Sequence[Callable[[_Item, Progress], _Result]]:
    """Those of the others that this thread shares with; see `Elsewhere.places`."""
    others = _others.get()
    return () if others is None else others.places(work, size)
