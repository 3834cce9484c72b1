"""Limits of child processes by the kernel: memory, time, file sizes, folders, network (Landlock).

Holds the numbers.

The kernel enforces all of them, the folders by Landlock. A library that a malicious file misleads can then neither
read other files nor reach the network, and if it uses too many resources only its own process ends.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import resource
import stat
import struct
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident_service.environment_secrets import forget_secrets

# Numbers of system calls; newer calls such as these have the same number on all architectures.
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
ASK_VERSION = 1
RULE_OF_PATH = 1
NO_NEW_PRIVILEGES = 38
NEW_NETWORK = 0x40000000

EXECUTE, WRITE_FILE, READ_FILE, READ_FOLDER, TRUNCATE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 14
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
READ = EXECUTE | READ_FILE | READ_FOLDER
ALL_RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 5: (1 << 16) - 1}
"""All rights on files, by the first version of Landlock that knows them."""
CONNECT_AND_LISTEN = 0b11
"""Restriction of TCP, from version 4 on."""
SIGNALS_AND_SOCKETS = 0b11
"""Restriction of signals to other processes and of abstract sockets, from version 6 on."""
PROGRAM_FILES = (
    "/usr",
    "/lib",
    "/lib64",
    "/etc/ld.so.cache",
    "/etc/localtime",
    "/etc/mime.types",
    "/dev/null",
    "/dev/zero",
    "/dev/urandom",
    "/proc/cpuinfo",
    "/proc/meminfo",
    "/sys/devices/system/cpu",
)
"""Files and folders that libraries read while they are loaded or used."""


def restrict_files_and_network(readable: Iterable[Path], writable: Iterable[Path], private: Path) -> bool:
    """Restrict this thread, and those that it starts later, to some folders and cut it off from the network.

    Writable folders may be read too. No folder that contains `private` is allowed because Python's path has it: the
    data of a service often lies in its working directory. Return whether the kernel restricts it: Linux does from 5.13
    on, unless Landlock is switched off.
    """
    if not sys.platform.startswith("linux"):
        return False
    system = ctypes.CDLL(None, use_errno=True)
    _leave_network(system)
    version = system.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ASK_VERSION)
    if version < 1:
        return False
    rights = ALL_RIGHTS[max(known for known in ALL_RIGHTS if known <= version)]
    attributes = struct.pack(
        "=QQQ", rights, CONNECT_AND_LISTEN if version >= 4 else 0, SIGNALS_AND_SOCKETS if version >= 6 else 0
    )
    # Older versions know fewer fields of this structure.
    length = 8 if version < 4 else 16 if version < 6 else 24
    ruleset = _check_result(system.syscall(CREATE_RULESET, attributes, ctypes.c_size_t(length), 0))
    try:
        read, write = [*list_program_folders(private), *readable], list(writable)
        for path in read:
            _allow_path(system, ruleset, path, READ & rights)
        for path in write:
            _allow_path(system, ruleset, path, rights)
        # Libraries read /proc/self to limit their threads. The folder stays open, because a rule for it holds only
        # while the kernel keeps it in memory.
        own = os.open("/proc/self/", os.O_PATH | os.O_CLOEXEC)
        _add_rule(system, ruleset, own, READ & rights)
        # Landlock is allowed without privileges only if programs cannot gain any by set-user-id.
        _check_result(system.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))
        _check_result(system.syscall(RESTRICT_SELF, ruleset, 0))
    finally:
        os.close(ruleset)
    return True


def list_program_folders(private: Path) -> list[Path]:
    """Return the folders of Python, its packages and compiled code; none of Python's path that contains `private`."""
    # Imported here, since the process that answers requests does not need it.
    from dynident.expressions.code_cache import code_folder

    searched = [Path(name) for name in sys.path if name]
    import_folders = [path for path in searched if not private.resolve().is_relative_to(path.resolve())]
    installed = (*PROGRAM_FILES, sys.prefix, sys.base_prefix, sys.exec_prefix, *sysconfig.get_paths().values())
    code = code_folder()
    return [*(Path(name) for name in dict.fromkeys(installed)), *import_folders, *([code] if code else [])]


def _leave_network(system: ctypes.CDLL) -> None:
    """Move to an empty network namespace if the kernel allows it: Landlock restricts TCP only."""
    if system.unshare(NEW_NETWORK) != 0 and ctypes.get_errno() not in (errno.EPERM, errno.EINVAL, errno.ENOSYS):
        _check_result(-1)


def _allow_path(system: ctypes.CDLL, ruleset: int, path: Path, rights: int) -> None:
    """Allow rights on everything below a path; do nothing if the path does not exist."""
    try:
        opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not stat.S_ISDIR(os.fstat(opened).st_mode):
            rights &= OF_FILES
        _add_rule(system, ruleset, opened, rights)
    finally:
        os.close(opened)


def _add_rule(system: ctypes.CDLL, ruleset: int, opened: int, rights: int) -> None:
    _check_result(system.syscall(ADD_RULE, ruleset, RULE_OF_PATH, struct.pack("=Qi", rights, opened), 0))


def _check_result(result: int) -> int:
    """Raise OSError if a system call failed."""
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


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

    `memory` is in bytes beyond what is loaded when it begins. Without `folders` no files are restricted; with them it
    has no network.
    """

    memory: int | None = None
    scratch: Path | None = None
    folders: AllowedFolders | None = None

    def apply(self, connections: Sequence[int]) -> None:
        """Confine this process, which must have a single thread.

        The file descriptors `connections` stay open besides the standard ones.
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

    In seconds that pass, seconds of the processor (None for as many), and bytes of a file that it may write (None for
    any).
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
