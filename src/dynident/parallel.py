"""Map a function over large items on threads, and on other machines, by a shared work queue.

Holds from which size on several threads or machines are used, and when a remote item counts as late.

Threads suffice: what takes the time, machine code, filters and factorisations, does not hold Python's lock, and nothing
has to be copied between processes. Other machines take items as well where the caller allows it (`share_work_with`).
"""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from queue import Empty, Full, Queue
from threading import Condition, Event, Lock, Thread, local
from typing import Generic, Protocol, TypeVar

from dynident.errors import Cancelled
from dynident.progress import Progress, ignore_progress, scale_progress

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_PartResult = TypeVar("_PartResult")


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


_LATE_FACTOR = 2.0
"""A part is late that has been elsewhere for so many times as long as one of its size took here."""
_LATE_CHECK_INTERVAL = 0.1
"""Seconds between two looks at what is late."""


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
            What `collect_results` returns for it.
        took_here : float
            Seconds, if it was computed here; 0 otherwise.
        """
        with self._changed:
            # A late part may be computed twice; all threads have to see the same result of it.
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
        # Parts that were sent first come first: dictionaries keep the order of insertion.
        for number, since in self._away.items():
            if now - since >= _LATE_FACTOR * self._pace * self._sizes[number]:
                return number
        return None


MIN_PARALLEL_SIZE = 200_000
"""Size of all parts together from which on several at a time are worth their threads: half a second of work."""

_SWITCH_INTERVAL = 5e-4
"""Seconds for which a thread may keep Python's lock from another that comes back from what needs none."""
# The interval is one for the process: what it was before, and an entry for each computation that has shortened it.
_shortening, _intervals = Lock(), list[float]()
_PROGRESS_INTERVAL = 0.1
"""Seconds between two looks at how far all are."""
_RETRY_INTERVAL = 1.0
"""Seconds after which somebody elsewhere is asked again who was busy."""

_PREFETCHED_ITEMS = 2
"""Items that are made ahead of whoever takes them."""

_thread_state = local()
"""Of a thread: whether it is one of several that have all processors between them."""


def count_processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _shorten_switch_interval() -> Iterator[None]:
    # With Python's usual interval of 5 ms a thread that returns from machine code would wait that long for the lock,
    # many times a second.
    with _shortening:
        if not _intervals:
            _intervals.append(sys.getswitchinterval())
            sys.setswitchinterval(min(_intervals[0], _SWITCH_INTERVAL))
        _intervals.append(_SWITCH_INTERVAL)
    try:
        yield
    finally:
        with _shortening:
            _intervals.pop()
            if len(_intervals) == 1:
                sys.setswitchinterval(_intervals.pop())


def map_sequentially(
    work: Callable[[_Item, Progress], _Result],
    items: Sequence[_Item],
    sizes: Sequence[float],
    progress: Progress = ignore_progress,
) -> list[_Result]:
    """Apply `work` to every item in turn; takes and returns the same as `map_in_threads`.

    Parameters
    ----------
    work : function
        Takes an item and a progress function.
    items : sequence of _Item
        What `work` is applied to.
    sizes : sequence of float
        Size of each item in samples; progress is counted by them.
    progress : Progress
        Called with the share of the whole and a message; may raise to cancel.
    """
    total_size, before = float(sum(sizes)) or 1.0, 0.0
    results = []
    for item, size in zip(items, sizes, strict=True):
        results.append(
            work(item, scale_progress(progress, before / total_size, min(1.0, (before + size) / total_size)))
        )
        before += size
    return results


def map_in_threads(
    work: Callable[[_Item, Progress], _Result],
    items: Sequence[_Item],
    sizes: Sequence[float],
    progress: Progress = ignore_progress,
) -> list[_Result]:
    """Apply `work` to every item, in threads where the items are large; return the results in the items' order.

    A thread that is done takes the next item. Other machines that this thread shares with
    (`share_work_with`) take items, too, so `work` has to give the same result wherever it runs.

    Parameters
    ----------
    work : function
        Takes an item and a progress function, which stops it once its result is not needed any more.
    items : sequence
        What `work` is applied to.
    sizes : sequence of float
        Size of each item in samples; progress is counted by them.
    progress : function
        Called by the calling thread alone; may raise to cancel.

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
    if len(items) < 2 or total_size < MIN_PARALLEL_SIZE:
        return map_sequentially(work, items, sizes, progress)
    n_threads, other_machines = min(len(items), count_processors()), list_remote_workers(work, total_size)[: len(items)]
    if n_threads + len(other_machines) < 2:
        return map_sequentially(work, items, sizes, progress)
    shared = _SharedWork(work, items, sizes)
    with _shorten_switch_interval(), ThreadPoolExecutor(n_threads + len(other_machines)) as pool:
        for _ in range(n_threads):
            pool.submit(shared.run_locally)
        for place in other_machines:
            pool.submit(shared.run_remotely, place)
        try:
            # The calling thread only waits and reports: progress functions need not be thread-safe.
            ended = False
            while not ended:
                ended = shared.parts.wait_for_end(_PROGRESS_INTERVAL)
                progress(shared.fraction, shared.name)
        except BaseException as error:
            # The progress function raised, that is, the computation is cancelled. All threads stop at their next
            # report.
            shared.parts.fail(error)
            raise
    return shared.parts.collect_results()


class _SharedWork(Generic[_Item, _Result]):
    """One call's items, their progress, and the loops of the threads that work on them."""

    def __init__(
        self, work: Callable[[_Item, Progress], _Result], items: Sequence[_Item], sizes: Sequence[float]
    ) -> None:
        self._work = work
        self._items = items
        self._sizes = sizes
        self._done = [0.0] * len(items)
        self.parts = WorkQueue[_Result](sizes)
        self.name = ""
        """Of what somebody was heard of last."""

    @property
    def fraction(self) -> float:
        """How much of the whole is done."""
        done = sum(size * done for size, done in zip(self._sizes, self._done, strict=True))
        return min(1.0, done / (float(sum(self._sizes)) or 1.0))

    def run_locally(self) -> None:
        """Compute one item after the other in this thread until none is left."""
        _thread_state.one_of_several = True
        while (number := self.parts.take_local()) is not None:
            began = time.monotonic()
            try:
                result = self._work(self._items[number], self._make_progress(number))
                self.parts.put_result(number, result, time.monotonic() - began)
            except BaseException as error:
                # Another machine may have delivered this item meanwhile; then an error here does not matter.
                if self.parts.is_needed(number):
                    self.parts.fail(error)

    def run_remotely(self, place: Callable[[_Item, Progress], _Result]) -> None:
        """Have another machine compute one item after the other.

        An item that fails there is given back and computed here, where its own error, if it has one, is raised.
        """
        while (number := self.parts.take_remote()) is not None:
            try:
                self.parts.put_result(number, place(self._items[number], self._make_progress(number)))
                self._done[number] = 1.0
            except RemoteWorkersBusy:
                self.parts.give_back(number)
                self.parts.wait_for_end(_RETRY_INTERVAL)
            # The part is not needed any more, or the whole computation has ended; the next look at the queue tells
            # which.
            except Cancelled:
                self.parts.give_back(number)
            # The machine failed, whatever the reason: this thread asks it no more, and the part is computed here.
            except Exception:
                self.parts.give_back(number)
                return

    def _make_progress(self, number: int) -> Progress:
        def report_progress(fraction: float, message: str) -> None:
            if not self.parts.is_needed(number):
                raise Cancelled
            # A part that is computed here and elsewhere at once must not make the progress go back.
            self._done[number] = max(self._done[number], fraction)
            self.name = message or self.name

        return report_progress


def prefetch(items: Iterator[_Item], size: float) -> Generator[_Item, None, None]:
    """Yield items in their order while another thread already makes the next ones, where that is worth it.

    Parameters
    ----------
    items : iterator
        The next one is made while the caller works on the last.
    size : float
        Of all items together, in samples; below `MIN_PARALLEL_SIZE` no thread is started.

    Yields
    ------
    item

    Raises
    ------
    Exception
        Whatever making an item raises, when it is that item's turn.
    """
    # A thread that is one of several already shares all processors with the others; one more would only compete.
    if count_processors() < 2 or size < MIN_PARALLEL_SIZE or getattr(_thread_state, "one_of_several", False):
        yield from items
        return
    ready: Queue[tuple[_Item | None, BaseException | None]] = Queue(_PREFETCHED_ITEMS)
    over = Event()

    def put(item: _Item | None, error: BaseException | None = None) -> None:
        while not over.is_set():
            with suppress(Full):
                ready.put((item, error), timeout=_PROGRESS_INTERVAL)
                return
        raise Cancelled

    def make() -> None:
        _thread_state.one_of_several = True
        with suppress(Cancelled):
            try:
                for item in items:
                    put(item)
            except BaseException as error:
                # The error takes its place in the queue, behind the items that were made before it.
                put(None, error)
            else:
                put(None)

    maker = Thread(target=make, name="ahead", daemon=True)
    with _shorten_switch_interval():
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
