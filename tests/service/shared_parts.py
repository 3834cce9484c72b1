"""Who reduces which recording on a cluster: noted by those who do, who take as long as with large recordings."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from dynident import parallel
from dynident.estimation import Reduction
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.regressors import row_cache
from dynident.regressors.qr_accumulation import EquationAccumulator
from dynident_service.jobs import distributed_map

WORKER, NOTES = "NAME_OF_THE_WORKER", "NOTES_OF_THE_WORKERS"
"""Variables of a worker: what it is called, and the folder of the notes."""
TAKES = 1.0
"""Seconds by which a recording takes longer than it would."""
LOOK = 0.05


@dataclass(frozen=True)
class Note:
    """That a process of a worker has begun a recording: for a job of its own, or a part of another's."""

    worker: str
    kind: str
    recording: str
    pid: int


def share_what_is_small() -> None:
    """Let this process and its children share whatever the size."""
    parallel.MIN_PARALLEL_SIZE, distributed_map.WORTH, row_cache.MOST_VALUES = 1_000, 1_000, 0
    parallel.count_processors = lambda: 1
    fold, worker, folder = EquationAccumulator.__call__, os.environ[WORKER], Path(os.environ[NOTES])

    def noted(self: EquationAccumulator, recording: Recording, told: Progress) -> Reduction:
        # What does a part for another worker tells nobody how far it is.
        kind = "part" if told is ignore_progress else "own"
        name = f"{time.time_ns()} {worker} {kind} {recording.name} {os.getpid()}"
        (folder / name).touch()
        until = time.monotonic() + TAKES
        while time.monotonic() < until:
            told(0.0, recording.name)
            time.sleep(LOOK)
        return fold(self, recording, told)

    EquationAccumulator.__call__ = noted  # type: ignore[method-assign]


def notes_in(folder: Path) -> list[Note]:
    """All notes, in the order in which they were made."""
    found = [path.name.split() for path in sorted(folder.iterdir())]
    return [Note(worker, kind, recording, int(pid)) for _, worker, kind, recording, pid in found]
