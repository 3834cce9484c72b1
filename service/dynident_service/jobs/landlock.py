"""Restrict this process to some folders and take the network from it, by Linux's Landlock.

Called by its system calls: the packages that wrap them are not kept up. See `man 7 landlock`.
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

# The same on all architectures.
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
ASK_VERSION = 1
RULE_OF_PATH = 1
NO_NEW_PRIVILEGES = 38
NEW_NETWORK = 0x40000000

EXECUTE, WRITE_FILE, READ_FILE, READ_FOLDER, TRUNCATE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 14
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
READ = EXECUTE | READ_FILE | READ_FOLDER
ALL_RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 5: (1 << 16) - 1}
"""Rights on files that a version of Landlock, or a later one, knows."""
CONNECT_AND_LISTEN = 0b11
"""TCP, from version 4 on."""
SIGNALS_AND_SOCKETS = 0b11
"""Signals to other processes and abstract sockets, from version 6 on."""
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
"""What libraries read while they are loaded or used."""


def restrict_files_and_network(readable: Iterable[Path], writable: Iterable[Path], private: Path) -> bool:
    """Leave this thread, and those that it starts, its program, some folders and no network.

    Parameters
    ----------
    readable, writable : folders
        Beside those of Python and its packages. What is writable may be read.
    private : folder
        No folder above it is allowed for being in Python's path: a service's data is often in its working directory.

    Returns
    -------
    bool
        Whether the kernel restricts it; it does from Linux 5.13 on, where Landlock is not switched off.
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
    length = 8 if version < 4 else 16 if version < 6 else 24
    ruleset = _checked(system.syscall(CREATE_RULESET, attributes, ctypes.c_size_t(length), 0))
    try:
        read, write = [*program_folders(private), *readable], list(writable)
        for path in read:
            _allow(system, ruleset, path, READ & rights)
        for path in write:
            _allow(system, ruleset, path, rights)
        # Of itself: the limits of threads are set by what is loaded. The folder stays open, since a rule holds for it
        # only as long as the system remembers it.
        own = os.open("/proc/self/", os.O_PATH | os.O_CLOEXEC)
        _add_rule(system, ruleset, own, READ & rights)
        _checked(system.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))
        _checked(system.syscall(RESTRICT_SELF, ruleset, 0))
    finally:
        os.close(ruleset)
    return True


def program_folders(private: Path) -> list[Path]:
    """Give what Python, its packages and machine code are read from; nothing in its path that holds `private`."""
    # Here, since the process that answers requests does without it.
    from dynident.expressions.kept_code import code_folder

    searched = [Path(name) for name in sys.path if name]
    beside = [path for path in searched if not private.resolve().is_relative_to(path.resolve())]
    installed = (*PROGRAM_FILES, sys.prefix, sys.base_prefix, sys.exec_prefix, *sysconfig.get_paths().values())
    code = code_folder()
    return [*(Path(name) for name in dict.fromkeys(installed)), *beside, *([code] if code else [])]


def _leave_network(system: ctypes.CDLL) -> None:
    """Have a network of its own without any interface, where this process may: Landlock knows TCP alone."""
    if system.unshare(NEW_NETWORK) != 0 and ctypes.get_errno() not in (errno.EPERM, errno.EINVAL, errno.ENOSYS):
        _checked(-1)


def _allow(system: ctypes.CDLL, ruleset: int, path: Path, rights: int) -> None:
    """Allow rights on all that is below a path; nothing where there is no such path."""
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
    _checked(system.syscall(ADD_RULE, ruleset, RULE_OF_PATH, struct.pack("=Qi", rights, opened), 0))


def _checked(result: int) -> int:
    """Raise the OSError of a system call that failed."""
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
