"""A map over large items on several processors at once, by threads.

Threads suffice: what takes the time, machine code, filters and factorisations, does not hold Python's lock, and nothing
has to be copied between processes. Other machines take items as well where the caller allows it (`elsewhere`).
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
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _quick_to_switch() -> Iterator[None]:
    # With Python's usual interval of 5 ms a thread that returns from machine code would wait that long for the lock,
    # many times a second.
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
    """Apply `work` to every item in turn; takes and returns the same as `side_by_side`."""
    total_size, before = float(sum(sizes)) or 1.0, 0.0
    results = []
    for item, size in zip(items, sizes, strict=True):
        results.append(work(item, part(progress, before / total_size, min(1.0, (before + size) / total_size))))
        before += size
    return results


def side_by_side(
    work: Callable[[_Item, Progress], _Result],
    items: Sequence[_Item],
    sizes: Sequence[float],
    progress: Progress = silent,
) -> list[_Result]:
    """Apply `work` to every item, in threads where the items are large; return the results in the items' order.

    A thread that is done takes the next item. Other machines that this thread shares with (`elsewhere.shared_with`)
    take items, too, so `work` has to give the same result wherever it runs.

    Parameters
    ----------
    work : function
        Takes an item and a progress function, which stops it once its result is not needed any more.
    items : sequence
    sizes : sequence of float
        Size of each item in samples; progress is counted by them.
    progress : function
        Called by the calling thread alone.

    Returns
    -------
    list
        The result of each item.

    Raises
    ------
    Exception
        Whatever the work of an item raises; the other items are then stopped.
    """
    total_size = float(sum(sizes)) or 1.0
    if len(items) < 2 or total_size < WORTH:
        return one_by_one(work, items, sizes, progress)
    n_threads, other_machines = min(len(items), processors()), places(work, total_size)[: len(items)]
    if n_threads + len(other_machines) < 2:
        return one_by_one(work, items, sizes, progress)
    shared = _Shared(work, items, sizes)
    with _quick_to_switch(), ThreadPoolExecutor(n_threads + len(other_machines)) as pool:
        for _ in range(n_threads):
            pool.submit(shared.work_here)
        for place in other_machines:
            pool.submit(shared.have_done, place)
        try:
            # The calling thread only waits and reports: progress functions need not be thread-safe.
            ended = False
            while not ended:
                ended = shared.parts.wait(_LOOK)
                progress(shared.fraction, shared.name)
        except BaseException as error:
            # The progress function raised, that is, the computation is cancelled. All threads stop at their next
            # report.
            shared.parts.fail(error)
            raise
    return shared.parts.results()


class _Shared(Generic[_Item, _Result]):
    """One call's items, their progress, and the loops of the threads that work on them."""

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
        """Compute one item after the other in this thread until none is left."""
        _own.one_of_several = True
        while (number := self.parts.next_here()) is not None:
            began = time.monotonic()
            try:
                result = self._work(self._items[number], self._teller(number))
                self.parts.put(number, result, time.monotonic() - began)
            except BaseException as error:
                # Another machine may have delivered this item meanwhile; then an error here does not matter.
                if self.parts.wants(number):
                    self.parts.fail(error)

    def have_done(self, place: Callable[[_Item, Progress], _Result]) -> None:
        """Have another machine compute one item after the other.

        An item that fails there is given back and computed here, where its own error, if it has one, is raised.
        """
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
    """Yield items in their order while another thread already makes the next ones, where that is worth it.

    Parameters
    ----------
    items : iterator
    size : float
        Of all items together, in samples; below `WORTH` no thread is started.

    Yields
    ------
    item

    Raises
    ------
    Exception
        Whatever making an item raises, when it is that item's turn.
    """
    # A thread that is one of several already shares all processors with the others; one more would only compete.
    if processors() < 2 or size < WORTH or getattr(_own, "one_of_several", False):
        yield from items
        return
    ready: Queue[tuple[_Item | None, BaseException | None]] = Queue(_WAITING)
    over = Event()

    def put(item: _Item | None, error: BaseException | None = None) -> None:
        while not over.is_set():
            with suppress(Full):
                ready.put((item, error), timeout=_LOOK)
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
                item, error = ready.get()
                if error is not None:
                    raise error
                if item is None:
                    return
                yield item
        finally:
            over.set()
            # The maker may be waiting for room in the queue. Emptying it lets the thread see `over` and end.
            with suppress(Empty):
                while True:
                    ready.get_nowait()
            maker.join()
