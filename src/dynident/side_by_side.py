"""Large parts of one computation on several processors at once.

By threads: what takes the time, machine code, filters and factors, holds no lock of Python's, and nothing has to be
copied from one process to another. Where others elsewhere take parts (`elsewhere`), they are done there as well.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import Empty, Full, Queue
from threading import Event, Thread, local
from typing import Generic, TypeVar

from dynident.elsewhere import Busy, places
from dynident.errors import Cancelled
from dynident.parts import Parts
from dynident.progress import Progress, part, silent

WORTH = 200_000
"""Size of all parts together from which on several at a time are worth their threads: half a second of work."""

_SWITCH = 5e-4
"""Seconds for which a thread may keep Python's lock from another that comes back from what needs none."""
_LOOK = 0.1
"""Seconds between two looks at how far all are."""
_ASK_AGAIN = 1.0
"""Seconds after which somebody elsewhere is asked again who was busy."""

_WAITING = 2
"""Items that are made ahead of whoever takes them."""

_own = local()
"""Of a thread: whether it is one of several that have all processors between them."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _quick_to_switch() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _SWITCH))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def one_by_one(
    work: Callable[[_Item, Progress], _Result],
    items: Sequence[_Item],
    sizes: Sequence[float],
    progress: Progress = silent,
) -> list[_Result]:
    """`work` of every item in turn, as `side_by_side`."""
    whole, before = float(sum(sizes)) or 1.0, 0.0
    found = []
    for item, size in zip(items, sizes, strict=True):
        found.append(work(item, part(progress, before / whole, min(1.0, (before + size) / whole))))
        before += size
    return found


def side_by_side(
    work: Callable[[_Item, Progress], _Result],
    items: Sequence[_Item],
    sizes: Sequence[float],
    progress: Progress = silent,
) -> list[_Result]:
    """`work` of every item, in their order; as many at a time as there are processors where they are large.

    Whoever is done takes the next one, and those elsewhere that this thread shares with (`elsewhere.shared_with`) do,
    too: `work` has to give the same wherever it is done.

    Parameters
    ----------
    work : function
        Takes an item, and what it tells how far it is; that stops it once nobody waits for the result.
    sizes : one an item
        In samples: by them progress is counted.
    progress : function
        Called by the calling thread alone.

    Raises
    ------
    Whatever the work of an item raises, the others being stopped.
    """
    whole = float(sum(sizes)) or 1.0
    if len(items) < 2 or whole < WORTH:
        return one_by_one(work, items, sizes, progress)
    at_once, others = min(len(items), processors()), places(work, whole)[: len(items)]
    if at_once + len(others) < 2:
        return one_by_one(work, items, sizes, progress)
    shared = _Shared(work, items, sizes)
    with _quick_to_switch(), ThreadPoolExecutor(at_once + len(others)) as pool:
        for _ in range(at_once):
            pool.submit(shared.work_here)
        for place in others:
            pool.submit(shared.have_done, place)
        try:
            ended = False
            while not ended:
                ended = shared.parts.wait(_LOOK)
                progress(shared.fraction, shared.name)
        except BaseException as error:
            shared.parts.fail(error)
            raise
    return shared.parts.results()


class _Shared(Generic[_Item, _Result]):
    """The work on several items, among those who do it here and those who wait for others."""

    def __init__(
        self, work: Callable[[_Item, Progress], _Result], items: Sequence[_Item], sizes: Sequence[float]
    ) -> None:
        self._work = work
        self._items = items
        self._sizes = sizes
        self._done = [0.0] * len(items)
        self.parts = Parts[_Result](sizes)
        self.name = ""
        """Of what somebody was heard of last."""

    @property
    def fraction(self) -> float:
        """How much of the whole is done."""
        done = sum(size * done for size, done in zip(self._sizes, self._done, strict=True))
        return min(1.0, done / (float(sum(self._sizes)) or 1.0))

    def work_here(self) -> None:
        """Do one item after the other until none is left."""
        _own.one_of_several = True
        while (number := self.parts.next_here()) is not None:
            began = time.monotonic()
            try:
                result = self._work(self._items[number], self._teller(number))
                self.parts.put(number, result, time.monotonic() - began)
            except BaseException as error:
                # Of one that somebody else has done meanwhile nothing is wanted.
                if self.parts.wants(number):
                    self.parts.fail(error)

    def have_done(self, place: Callable[[_Item, Progress], _Result]) -> None:
        """Have others do one item after the other; what they do not is done here, which says what is wrong with it."""
        while (number := self.parts.next_away()) is not None:
            try:
                self.parts.put(number, place(self._items[number], self._teller(number)))
                self._done[number] = 1.0
            except Busy:
                self.parts.give_back(number)
                self.parts.wait(_ASK_AGAIN)
            except Cancelled:
                self.parts.give_back(number)
            except Exception:
                self.parts.give_back(number)
                return

    def _teller(self, number: int) -> Progress:
        def told(fraction: float, message: str) -> None:
            if not self.parts.wants(number):
                raise Cancelled
            self._done[number] = max(self._done[number], fraction)
            self.name = message or self.name

        return told


def ahead(items: Iterator[_Item], size: float) -> Generator[_Item, None, None]:
    """The items in their order, made by another thread while those before them are worked on, where that is worth it.

    Parameters
    ----------
    size : float
        Of all items together, in the samples of `WORTH`.

    Raises
    ------
    Whatever making an item raises, when it is its turn.
    """
    if processors() < 2 or size < WORTH or getattr(_own, "one_of_several", False):
        yield from items
        return
    made: Queue[tuple[_Item | None, BaseException | None]] = Queue(_WAITING)
    over = Event()

    def put(item: _Item | None, error: BaseException | None = None) -> None:
        while not over.is_set():
            with suppress(Full):
                made.put((item, error), timeout=_LOOK)
                return
        raise Cancelled

    def make() -> None:
        _own.one_of_several = True
        with suppress(Cancelled):
            try:
                for item in items:
                    put(item)
            except BaseException as error:
                put(None, error)
            else:
                put(None)

    maker = Thread(target=make, name="ahead", daemon=True)
    with _quick_to_switch():
        maker.start()
        try:
            while True:
                item, error = made.get()
                if error is not None:
                    raise error
                if item is None:
                    return
                yield item
        finally:
            over.set()
            with suppress(Empty):
                while True:
                    made.get_nowait()
            maker.join()
