"""Limits for child processes: memory, processor time, file sizes, and the folders that they may read and write.

The kernel enforces all of them. A library that a malicious file misleads can then neither read other files nor reach
the network, and if it uses too many resources only its own process ends.
"""

from __future__ import annotations

import itertools
import os
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident_service.environment_secrets import forget_secrets
from dynident_service.jobs.landlock import restrict_files_and_network

PAGE = os.sysconf("SC_PAGE_SIZE")
REQUEST_MEMORY = 1_500_000_000
"""Bytes that a process for requests may allocate. Files are read block by block, which takes 0.1 GB; a row group of a
Parquet file is read whole, which takes 0.3 GB if pandas wrote 40 columns.
"""
LONGEST_REQUEST = 120.0
"""Seconds that a computation for a request may take, apart from reading files."""
SPARE_SECONDS = 20.0
"""Seconds of processor time for any file, whatever its size. A file of six joints takes one, and compiling the
regressors of a robot of 29 joints less than ten.
"""
SLOWEST_READING = 1_000_000
"""Bytes of a file that are read and checked per second of processor time, at the very least. Six joints at 5 kHz are
read at 7 MB/s from Parquet, which has the fewest bytes per row.
"""
SMALLEST_FILE_LIMIT = 64_000_000
"""Bytes that may be written in any case, however small the uploaded file."""
LARGEST_GROWTH = 8
"""Largest ratio of the recording that is written to the file that was sent, which may be compressed."""
SLOWEST_SHARE = 4.0
"""Ratio of elapsed time to processor time that a computation is allowed, as it shares the processors with others."""


@dataclass(frozen=True)
class AllowedFolders:
    """Folders that a process may read or write. `private` contains them, and much that the process may not read."""

    private: Path
    read: Sequence[Path]
    written: Sequence[Path]


@dataclass(frozen=True)
class Confinement:
    """Limits of a child process for all of its life.

    Parameters
    ----------
    memory : int
        Bytes of address space beyond what is loaded when it begins.
    scratch : Path or None
        Folder of its own for temporary files; without it the system's folder is used.
    folders : Folders or None
        Folders that it may read and write besides those of its program, without a network; None means no restriction.
    """

    memory: int | None = None
    scratch: Path | None = None
    folders: AllowedFolders | None = None

    def apply(self, connections: Sequence[int]) -> None:
        """Confine this process, which must have a single thread.

        Parameters
        ----------
        connections : sequence of int
            File descriptors that stay open besides the standard ones.
        """
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a core file would hold all that the process knows
        if self.scratch is not None:
            os.environ["TMPDIR"] = os.environ["SQLITE_TMPDIR"] = str(self.scratch)
            tempfile.tempdir = str(self.scratch)
        if self.memory is not None and (used := _get_address_space()) is not None:
            _set_limit(resource.RLIMIT_AS, used + self.memory)
        if self.folders is not None:
            # A process that reads strangers' files gets neither credentials nor any inherited descriptor.
            forget_secrets()
            _close_descriptors(connections)
            own = () if self.scratch is None else (self.scratch,)
            restrict_files_and_network(self.folders.read, [*self.folders.written, *own], self.folders.private)


@dataclass(frozen=True)
class ComputationLimits:
    """Limits of one computation that a request waits for.

    Parameters
    ----------
    longest : float
        Elapsed time in seconds.
    processor_seconds : float or None
        Processor time in seconds; None for as much as `longest` allows.
    file_bytes : int or None
        Bytes of the largest file that it may write; None for any size.
    """

    longest: float = LONGEST_REQUEST
    processor_seconds: float | None = None
    file_bytes: int | None = SMALLEST_FILE_LIMIT

    @classmethod
    def from_file_sizes(cls, *sizes: int) -> ComputationLimits:
        """Return the limits for reading files of these sizes in bytes."""
        size = sum(sizes)
        seconds = SPARE_SECONDS + size / SLOWEST_READING
        return cls(LONGEST_REQUEST + SLOWEST_SHARE * seconds, seconds, max(SMALLEST_FILE_LIMIT, LARGEST_GROWTH * size))

    def apply(self) -> None:
        """Set the limits of this process; the next computation may have others."""
        usage = resource.getrusage(resource.RUSAGE_SELF)
        seconds = resource.RLIM_INFINITY
        if self.processor_seconds is not None:
            # RLIMIT_CPU counts from the start of the process, so the time used up by earlier computations is added.
            seconds = int(usage.ru_utime + usage.ru_stime + self.processor_seconds) + 1
        # Only soft limits are set: a process may raise them again for the next computation, but not hard ones.
        _set_limit(resource.RLIMIT_CPU, seconds, hard=False)
        _set_limit(
            resource.RLIMIT_FSIZE, resource.RLIM_INFINITY if self.file_bytes is None else self.file_bytes, hard=False
        )


UNLIMITED = ComputationLimits(float("inf"), None, None)


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error means that memory ran out; CasADi and others pass on the message of C++."""
    return isinstance(error, MemoryError) or "bad_alloc" in str(error)


def _set_limit(kind: int, most: int, *, hard: bool = True) -> None:
    """Set a resource limit, at most as high as the one that the process was started with."""
    ceiling = resource.getrlimit(kind)[1]
    if ceiling != resource.RLIM_INFINITY:
        most = ceiling if most == resource.RLIM_INFINITY else min(most, ceiling)
    resource.setrlimit(kind, (most, most if hard else ceiling))


def _get_address_space() -> int | None:
    """Return the bytes of address space that this process has; None if the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * PAGE
    except OSError:
        return None


def _close_descriptors(spared: Sequence[int]) -> None:
    """Close all file descriptors except the standard ones and `spared`."""
    bounds = [2, *sorted(spared), os.sysconf("SC_OPEN_MAX")]
    for below, above in itertools.pairwise(bounds):
        os.closerange(below + 1, above)
