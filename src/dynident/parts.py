"""The parts of one computation on which several work: what nobody is at, what is elsewhere, what has been found."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from threading import Condition
from typing import Generic, TypeVar

_LATE = 2.0
"""A part is late that has been elsewhere for so many times as long as one of its size took here."""
_LOOK = 0.1
"""Seconds between two looks at what is late."""

_Result = TypeVar("_Result")


class Parts(Generic[_Result]):
    """Shared by the threads of those who work here, and of those who wait for what others do elsewhere.

    What is late elsewhere is done here as well, and whoever is first counts: so it ends even if nothing ever comes
    back.

    Parameters
    ----------
    sizes : one a part
        In samples.
    """

    def __init__(self, sizes: Sequence[float]) -> None:
        self._sizes = sizes
        self._free = deque(range(len(sizes)))
        self._away: dict[int, float] = {}
        """When parts were sent away that nobody here is at."""
        self._found: dict[int, _Result] = {}
        self._error: BaseException | None = None
        self._pace = 0.0
        """Most seconds a sample that a part took here."""
        self._changed = Condition()

    def next_here(self) -> int | None:
        """Give the next part to somebody here, who waits while one may still come back; None: there is none left."""
        with self._changed:
            while not self._ended():
                if self._free:
                    return self._free.popleft()
                late = self._late()
                if late is not None:
                    del self._away[late]
                    return late
                if not self._away:
                    return None
                self._changed.wait(_LOOK)
            return None

    def next_away(self) -> int | None:
        """Give the next part that nobody is at to somebody elsewhere; None: there is none now."""
        with self._changed:
            if self._ended() or not self._free:
                return None
            number = self._free.popleft()
            self._away[number] = time.monotonic()
            return number

    def give_back(self, number: int) -> None:
        """A part that was sent away is not worked on there."""
        with self._changed:
            if self._away.pop(number, None) is not None and number not in self._found:
                self._free.appendleft(number)
            self._changed.notify_all()

    def put(self, number: int, result: _Result, took_here: float = 0.0) -> None:
        """Keep what came of a part, if nothing has yet, and how many seconds it took if it was worked on here."""
        with self._changed:
            self._found.setdefault(number, result)
            self._away.pop(number, None)
            self._pace = max(self._pace, took_here / max(1.0, self._sizes[number]))
            self._changed.notify_all()

    def fail(self, error: BaseException) -> None:
        """End it all: the first error counts."""
        with self._changed:
            self._error = self._error or error
            self._changed.notify_all()

    def wants(self, number: int) -> bool:
        """Tell whether somebody still waits for a part."""
        return self._error is None and number not in self._found

    def wait(self, seconds: float) -> bool:
        """Wait for the end, at most so long; tells whether it has come."""
        with self._changed:
            return self._changed.wait_for(self._ended, seconds)

    def results(self) -> list[_Result]:
        """What came of all parts, in their order; raises what ended them."""
        if self._error is not None:
            raise self._error
        return [self._found[number] for number in range(len(self._sizes))]

    def _ended(self) -> bool:
        return self._error is not None or len(self._found) == len(self._sizes)

    def _late(self) -> int | None:
        now = time.monotonic()
        for number, since in self._away.items():
            if now - since >= _LATE * self._pace * self._sizes[number]:
                return number
        return None
