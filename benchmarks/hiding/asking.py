"""What scripts that look into cases one by one have in common: their options, and the cases over several processes."""

from __future__ import annotations

import argparse
import secrets
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from hiding.case import Case

T = TypeVar("T")


@dataclass(frozen=True)
class Asked:
    """`cache`: the folder where simulated runs are kept."""

    seed: int
    cases: int
    processes: int
    cache: Path


def asked(about: str, cases: int) -> Asked:
    """The options of a script, whose documentation begins with what it asks; `cases` of them by default."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--cache", type=Path, default=kept())
    given = parser.parse_args()
    seed = secrets.randbelow(10**6) if given.seed == "new" else int(given.seed)
    return Asked(seed, given.cases, given.processes, given.cache)


def kept() -> Path:
    """Where simulated runs are kept, if nobody says otherwise."""
    return Path(tempfile.gettempdir()) / "hidden-effects"


def each(of: Callable[[Case], T], cases: Sequence[Case], processes: int) -> Iterator[T]:
    """What a function finds in every case, as it comes."""
    if processes == 1:
        yield from map(of, cases)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for job in as_completed([pool.submit(of, case) for case in cases]):
            yield job.result()
