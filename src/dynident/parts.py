"""A queue of the parts of one computation, which threads here and machines elsewhere take and give back."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from threading import Condition
from typing import Generic, TypeVar

_LATE_FACTOR = 2.0
"""A part is late that has been elsewhere for so many times as long as one of its size took here."""
_LATE_CHECK_INTERVAL = 0.1
"""Seconds between two looks at what is late."""

_PartResult = TypeVar("_PartResult")


class WorkQueue(Generic[_PartResult]):
    """The parts of one computation: which are free, which are on other machines, and the results so far.

    The threads that compute here and those that wait for other machines share it. A part that is late elsewhere is
    computed here as well, and the first result counts. So the computation ends even if no other machine ever answers.

    Parameters
    ----------
    sizes : sequence of float
        Size of each part, in samples.
    """

    def __init__(self, sizes: Sequence[float]) -> None:
        self._sizes = sizes
        self._free = deque(range(len(sizes)))
        self._away: dict[int, float] = {}
        """When parts were sent away that nobody here is at."""
        self._found: dict[int, _PartResult] = {}
        self._error: BaseException | None = None
        self._pace = 0.0
        """Most seconds a sample that a part took here."""
        self._changed = Condition()

    def take_local(self) -> int | None:
        """Return the number of the next part to compute here; None where none is left.

        Waits while a part may still come back from another machine.
        """
        with self._changed:
            while not self._has_ended():
                if self._free:
                    return self._free.popleft()
                late = self._find_late()
                if late is not None:
                    del self._away[late]
                    return late
                if not self._away:
                    return None
                # Lateness comes with time alone, without a notification, so the wait has to end by itself.
                self._changed.wait(_LATE_CHECK_INTERVAL)
            return None

    def take_remote(self) -> int | None:
        """Return the number of a free part for another machine; None where no part is free now."""
        with self._changed:
            if self._has_ended() or not self._free:
                return None
            number = self._free.popleft()
            self._away[number] = time.monotonic()
            return number

    def give_back(self, number: int) -> None:
        """Make a part available again that another machine did not compute."""
        with self._changed:
            # A part that was late has already been taken over here and must not become free a second time.
            if self._away.pop(number, None) is not None and number not in self._found:
                self._free.appendleft(number)
            self._changed.notify_all()

    def put_result(self, number: int, result: _PartResult, took_here: float = 0.0) -> None:
        """Store the result of a part unless it has one, and learn from the time that it took.

        Parameters
        ----------
        number : int
            Of the part.
        result : object
        took_here : float
            Seconds, if it was computed here; 0 otherwise.
        """
        with self._changed:
            self._found.setdefault(number, result)
            self._away.pop(number, None)
            # The slowest pace decides what is late, so that a part elsewhere is seldom computed twice for nothing.
            self._pace = max(self._pace, took_here / max(1.0, self._sizes[number]))
            self._changed.notify_all()

    def fail(self, error: BaseException) -> None:
        """End the computation with an error; the first error counts."""
        with self._changed:
            self._error = self._error or error
            self._changed.notify_all()

    def is_needed(self, number: int) -> bool:
        """Return whether the result of a part is still needed."""
        return self._error is None and number not in self._found

    def wait_for_end(self, seconds: float) -> bool:
        """Wait for the end of the computation.

        Parameters
        ----------
        seconds : float
            Longest wait.

        Returns
        -------
        bool
            Whether it has ended.
        """
        with self._changed:
            return self._changed.wait_for(self._has_ended, seconds)

    def collect_results(self) -> list[_PartResult]:
        """Return the results of all parts in their order, or raise the error that ended the computation."""
        if self._error is not None:
            raise self._error
        return [self._found[number] for number in range(len(self._sizes))]

    def _has_ended(self) -> bool:
        return self._error is not None or len(self._found) == len(self._sizes)

    def _find_late(self) -> int | None:
        now = time.monotonic()
        for number, since in self._away.items():
            if now - since >= _LATE_FACTOR * self._pace * self._sizes[number]:
                return number
        return None
