"""Restriction of this process to some folders, without a network, by Linux's Landlock.

Uses system calls directly, as the packages that wrap them are not maintained. See `man 7 landlock`.
"""

from __future__ import annotations

import ctypes
import errno
import os
import stat
import struct
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

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

    Parameters
    ----------
    readable, writable : iterable of Path
        Folders besides those of Python and its packages; writable ones may be read too.
    private : Path
        No folder that contains it is allowed because Python's path has it: the data of a service often lies in its
        working directory.

    Returns
    -------
    bool
        Whether the kernel restricts it. Linux does from 5.13 on, unless Landlock is switched off.
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
