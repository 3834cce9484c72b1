"""Large parts of one computation on several processors at once.

By threads: what takes the time, machine code, filters and factors, holds no lock of Python's, and nothing has to be
copied from one process to another.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from queue import Empty, Full, Queue
from threading import Event, Thread, local
from typing import TypeVar

from dynident.errors import Cancelled
from dynident.progress import Progress, part, silent

WORTH = 200_000
"""Size of all parts together from which on several at a time are worth their threads: half a second of work."""

_SWITCH = 5e-4
"""Seconds for which a thread may keep Python's lock from another that comes back from what needs none."""
_LOOK = 0.1
"""Seconds between two looks at how far all are."""

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
    at_once = min(len(items), processors())
    if at_once < 2 or whole < WORTH:
        return one_by_one(work, items, sizes, progress)
    over, done, name = Event(), [0.0] * len(items), [""]

    def one(number: int) -> _Result:
        def told(fraction: float, message: str) -> None:
            if over.is_set():
                raise Cancelled
            done[number], name[0] = fraction, message

        _own.one_of_several = True
        return work(items[number], told)

    with _quick_to_switch(), ThreadPoolExecutor(at_once) as pool:
        futures = [pool.submit(one, number) for number in range(len(items))]
        try:
            waiting = set(futures)
            while waiting:
                ended, waiting = wait(waiting, _LOOK, FIRST_EXCEPTION)
                for future in ended:
                    future.result()
                progress(min(1.0, sum(map(float.__mul__, done, map(float, sizes))) / whole), name[0])
        except BaseException:
            over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [future.result() for future in futures]


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
