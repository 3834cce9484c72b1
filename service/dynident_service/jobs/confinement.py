"""What a child process may take and touch: memory, processor time, files and, where it reads strangers' files, folders.

The kernel enforces all of it. A library that is led astray by a file can then neither read another file nor reach the
network, and what it takes too much of ends its own process alone.
"""

from __future__ import annotations

import itertools
import os
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident_service.environment import forget_secrets
from dynident_service.jobs.landlock import restrict_files_and_network

PAGE = os.sysconf("SC_PAGE_SIZE")
REQUEST_MEMORY = 1_500_000_000
"""Bytes that a process may take which computes for requests. Files are read block by block, which takes 0.1 GB; a row
group of a Parquet file is read whole, and has 0.3 GB where pandas writes 40 columns."""
LONGEST_REQUEST = 120.0
SPARE_SECONDS = 20.0
"""Seconds of processor time that reading any file may take: one of six joints takes one, and the regressors of a robot
of 29 joints are compiled within ten."""
SLOWEST_READING = 1_000_000
"""Bytes of a file that are read and checked in a second of processor time, at the very least: six joints at 5 kHz are
read at 7 MB a second as Parquet, whose rows are the smallest."""
SMALLEST_FILE_LIMIT = 64_000_000
"""Bytes that may be written whatever was sent."""
LARGEST_GROWTH = 8
"""The recording that is written of a file is at most so many times as large: the file may be compressed."""
SLOWEST_SHARE = 4.0
"""A computation may wait for a processor, beside others, for so many times as long as it may use one."""


@dataclass(frozen=True)
class Folders:
    """Folders that a process may read or write; `private` holds them and much that it may not."""

    private: Path
    read: Sequence[Path]
    written: Sequence[Path]


@dataclass(frozen=True)
class Confinement:
    """What a child process may take and touch for all of its life.

    Parameters
    ----------
    memory : int
        Bytes of address space beyond what is loaded when it begins.
    scratch : Path or None
        Folder of its own for temporary files; that of the system where there is none.
    folders : Folders or None
        All that it may read (beside its own program) and write, without a network. None: it is not restricted so.
    """

    memory: int | None = None
    scratch: Path | None = None
    folders: Folders | None = None

    def apply(self, connections: Sequence[int]) -> None:
        """Confine this process, which must have one thread.

        Of its descriptors the standard ones and `connections` stay.
        """
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a core file would hold all that the process knows
        if self.scratch is not None:
            os.environ["TMPDIR"] = os.environ["SQLITE_TMPDIR"] = str(self.scratch)
            tempfile.tempdir = str(self.scratch)
        if self.memory is not None and (used := _address_space()) is not None:
            _limit(resource.RLIMIT_AS, used + self.memory)
        if self.folders is not None:
            forget_secrets()
            _close_descriptors(connections)
            own = () if self.scratch is None else (self.scratch,)
            restrict_files_and_network(self.folders.read, [*self.folders.written, *own], self.folders.private)


@dataclass(frozen=True)
class Limits:
    """What one computation that a request waits for may take.

    Parameters
    ----------
    longest : float
        Seconds.
    processor_seconds : float or None
        Of processor time; None: as many as `longest` leaves.
    file_bytes : int or None
        Bytes of the largest file that it may write; None: any.
    """

    longest: float = LONGEST_REQUEST
    processor_seconds: float | None = None
    file_bytes: int | None = SMALLEST_FILE_LIMIT

    @classmethod
    def for_files(cls, *sizes: int) -> Limits:
        """Give the limits of reading files of some sizes in bytes."""
        size = sum(sizes)
        seconds = SPARE_SECONDS + size / SLOWEST_READING
        return cls(LONGEST_REQUEST + SLOWEST_SHARE * seconds, seconds, max(SMALLEST_FILE_LIMIT, LARGEST_GROWTH * size))

    def apply(self) -> None:
        """Limit what this process takes from now on; the next computation may have other limits."""
        usage = resource.getrusage(resource.RUSAGE_SELF)
        seconds = resource.RLIM_INFINITY
        if self.processor_seconds is not None:
            seconds = int(usage.ru_utime + usage.ru_stime + self.processor_seconds) + 1
        # Only the soft limits: they are set anew for the next computation.
        _limit(resource.RLIMIT_CPU, seconds, hard=False)
        _limit(
            resource.RLIMIT_FSIZE, resource.RLIM_INFINITY if self.file_bytes is None else self.file_bytes, hard=False
        )


UNLIMITED = Limits(float("inf"), None, None)


def is_out_of_memory(error: BaseException) -> bool:
    """Tell whether an error is that memory could not be had; CasADi and others pass on the words of C++."""
    return isinstance(error, MemoryError) or "bad_alloc" in str(error)


def _limit(kind: int, most: int, *, hard: bool = True) -> None:
    """Set a limit, which never exceeds the one that the process was started with."""
    ceiling = resource.getrlimit(kind)[1]
    if ceiling != resource.RLIM_INFINITY:
        most = ceiling if most == resource.RLIM_INFINITY else min(most, ceiling)
    resource.setrlimit(kind, (most, most if hard else ceiling))


def _address_space() -> int | None:
    """Bytes of address space that this process has; None where the system does not say so."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * PAGE
    except OSError:
        return None


def _close_descriptors(kept: Sequence[int]) -> None:
    """Close all descriptors but the standard ones and `kept`."""
    bounds = [2, *sorted(kept), os.sysconf("SC_OPEN_MAX")]
    for below, above in itertools.pairwise(bounds):
        os.closerange(below + 1, above)
