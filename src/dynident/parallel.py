"""Map a function over large items on threads; run BLAS on one thread (`single_threaded`), or later (`defer`).

Holds from which size on several threads are used.

Threads suffice: what takes the time, machine code, filters and factorisations, does not hold Python's lock, and nothing
has to be copied between processes.

On matrices of 100 x 60 a multi-threaded BLAS spends its time waking threads: the same identification takes up to ten
times as long, and the time varies from run to run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import lru_cache, wraps
from operator import mul
from queue import Empty, Full, Queue
from threading import Event, Lock, Thread, local
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, Self, TypeVar, cast

from threadpoolctl import ThreadpoolController

from dynident.errors import Cancelled
from dynident.progress import Progress, ignore_progress, scale_progress

_Arguments = ParamSpec("_Arguments")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


MIN_PARALLEL_SIZE = 200_000
"""Size of all parts together from which on several at a time are worth their threads: half a second of work."""

_SWITCH_INTERVAL = 5e-4
"""Seconds for which a thread may keep Python's lock from another that comes back from what needs none."""
# The interval is one for the process: what it was before, and an entry for each computation that has shortened it.
_shortening, _intervals = Lock(), list[float]()
_PROGRESS_INTERVAL = 0.1
"""Seconds between two looks at how far all are."""

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
    most: int | None = None,
) -> list[_Result]:
    """Apply `work` to every item, in threads where the items are large; return the results in the items' order.

    A thread that is done takes the next item.

    Parameters
    ----------
    work : function
        Takes an item and a progress function, which stops it once its result is not needed any more.
    items : sequence of _Item
        What `work` is applied to.
    sizes : sequence of float
        Size of each item in samples; progress is counted by them.
    progress : function
        Called by the calling thread alone; may raise to cancel.
    most : int, optional
        Largest number of items at a time, where each needs much memory; by default the number of processors.

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
    n_threads = min(len(items), count_processors(), most or len(items))
    if n_threads < 2 or total_size < MIN_PARALLEL_SIZE:
        return map_sequentially(work, items, sizes, progress)
    done, message, errors = [0.0] * len(items), "", list[BaseException]()

    def run(number: int) -> _Result:
        def report_progress(fraction: float, own_message: str) -> None:
            nonlocal message
            if errors:
                raise Cancelled
            done[number], message = fraction, own_message or message

        _thread_state.one_of_several = True
        try:
            result = work(items[number], report_progress)
        except BaseException as error:
            errors.append(error)
            raise
        done[number] = 1.0
        return result

    with _shorten_switch_interval(), ThreadPoolExecutor(n_threads) as pool:
        pending = futures = [pool.submit(run, number) for number in range(len(items))]
        # The calling thread only waits and reports: progress functions need not be thread-safe.
        while pending and not errors:
            pending = list(wait(pending, _PROGRESS_INTERVAL, FIRST_EXCEPTION).not_done)
            try:
                progress(min(1.0, sum(map(mul, sizes, done)) / total_size), message)
            except BaseException as error:
                # The computation is cancelled: all threads stop at their next report.
                errors.append(error)
        pool.shutdown(cancel_futures=True)
    # The first error is the cause: the others only stopped after it.
    if errors:
        raise errors[0]
    return [future.result() for future in futures]


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


def single_threaded(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorate a function so that BLAS uses one thread while it runs.

    Parameters
    ----------
    function : callable
        A function whose matrices are small.

    Returns
    -------
    callable
        The function with the same signature.
    """

    @wraps(function)
    def limited(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with _find_libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@lru_cache(maxsize=1)
def _find_libraries(n_modules: int) -> ThreadpoolController:  # noqa: ARG001 - the key of the cache
    """Return what limits the threads of all BLAS libraries of this process.

    Looking for them reads the list of all loaded files, which takes milliseconds. A library comes with a module, so
    that they are looked for again only when modules were imported since.

    Parameters
    ----------
    n_modules : int
        Number of modules that are imported now.
    """
    return ThreadpoolController()


class _Deferred(Generic[_Result]):
    """A value that is computed once, when it is first asked for."""

    def __init__(self, compute: Callable[[], _Result]) -> None:
        self._compute: Callable[[], _Result] | None = compute
        self._lock = Lock()

    @property
    def value(self) -> _Result:
        with self._lock:
            if self._compute is not None:
                self._value = single_threaded(self._compute)()
                # What the function holds may be large, and is not needed any more.
                self._compute = None
        return self._value


def defer(compute: Callable[[], _Result]) -> _Result:
    """Return the value of a field of a `Deferring` dataclass that is computed when it is first asked for.

    Parameters
    ----------
    compute : callable
        Computes the value; BLAS uses one thread meanwhile.
    """
    return cast("_Result", _Deferred(compute))


class Deferring:
    """A frozen dataclass of which some fields may be deferred: often nobody asks for what takes longest.

    Such a field has no default but a factory: the class would have the default as an attribute.
    """

    def __post_init__(self) -> None:
        """Take the deferred fields out of the instance, so that `__getattr__` hears of them."""
        waiting = {name: value for name, value in self.__dict__.items() if isinstance(value, _Deferred)}
        for name in waiting:
            del self.__dict__[name]
        self.__dict__["_waiting"] = waiting

    if not TYPE_CHECKING:  # or every attribute would seem to exist

        def __getattr__(self, name: str) -> Any:
            """Compute a deferred field."""
            waiting = self.__dict__.get("_waiting", {}).get(name)
            if waiting is None:
                raise AttributeError(f"{type(self).__name__} has no attribute {name}")
            self.__dict__[name] = waiting.value
            return waiting.value

    def __getstate__(self) -> dict[str, Any]:
        """Return all fields, as a copy in another process cannot compute what this one has deferred."""
        for name in self.__dict__["_waiting"]:
            getattr(self, name)
        return self.__dict__ | {"_waiting": {}}

    def with_changes(self, **changes: object) -> Self:
        """Return a copy with other values of some fields, as `dataclasses.replace`, which would compute the others."""
        known = self.__dict__["_waiting"] | self.__dict__
        values: dict[str, Any] = {field.name: known[field.name] for field in fields(cast("Any", self))} | changes
        return type(self)(**values)
