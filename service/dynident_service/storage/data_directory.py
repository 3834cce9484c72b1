"""The data directory: created private, locked, checked for disk space."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dynident.errors import DynidentError
from dynident_service.problems import ProblemError

FULL_ERROR_NUMBERS = frozenset({errno.ENOSPC, errno.EDQUOT})
FULL_MESSAGES = ("no space left on device", "disk is full", "disk quota exceeded", "disk full")
"""Phrases in errors of databases and stores that mean a full disk."""


def is_disk_full(error: BaseException | None) -> bool:
    """Return whether an error, or one that it came from, means that a disk is full."""
    visited: set[int] = set()
    # Causes of exceptions may form a circle.
    while error is not None and id(error) not in visited:
        visited.add(id(error))
        if isinstance(error, OSError) and error.errno in FULL_ERROR_NUMBERS:
            return True
        if any(words in str(error).lower() for words in FULL_MESSAGES):
            return True
        error = getattr(error, "orig", None) or error.__cause__ or error.__context__
    return False


def check_disk_space(folder: Path, size: int, reserved: int) -> None:
    """Raise a problem 507 if `size` bytes would leave fewer than `reserved` bytes free.

    The database needs some room even to delete something.
    """
    if shutil.disk_usage(folder).free < size + reserved:
        detail = "The disk of the service is nearly full (DYNIDENT_RESERVED_BYTES), so nothing was stored; free space."
        raise ProblemError(507, detail, title="Disk full")


PRIVATE = 0o027
"""Bits of the umask: files of the service are readable by owner and group, and writable by the owner only."""
OTHERS = 0o007
"""Permission bits of all other users."""
log = logging.getLogger("dynident.service")


def prepare_data_directory(folder: Path) -> None:
    """Create the data directory, private to its owner, or warn if others may enter an existing one.

    Refuse it if nothing can be written into it.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        check_writable(folder)
        mode = folder.stat().st_mode
    except OSError as error:
        raise _make_directory_error(folder, error) from error
    if mode & OTHERS:
        log.warning("every user of this machine can access the data directory; `chmod o= %s` keeps them out", folder)


def check_writable(folder: Path) -> None:
    """Raise DynidentError if nothing can be written into a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _make_directory_error(folder, error) from error


def _make_directory_error(folder: Path, error: OSError) -> DynidentError:
    detail = (
        f"the data directory {folder} is not writable ({error.strerror or error}); make it writable for this "
        "user, or choose another folder (--data-dir, DYNIDENT_DATA_DIR)"
    )
    return DynidentError(detail, title="Unusable data directory")


@contextmanager
def restrict_file_permissions() -> Iterator[None]:
    """Make files and folders that are created in this context unreadable for other users of the machine."""
    before = os.umask(PRIVATE)
    os.umask(before | PRIVATE)
    try:
        yield
    finally:
        os.umask(before)


@contextmanager
def mark_in_use(folder: Path) -> Iterator[bool]:
    """Mark a data directory as used by this service until the process ends. Yield whether no other service uses it."""
    # An exclusive lock can be had only while no other service holds its shared one. It is then changed to a shared
    # lock, so that further services may start with this directory.
    handle = os.open(folder, os.O_RDONLY)
    try:
        is_alone = False
        with suppress(OSError):  # another one has it, or the file system has no locks
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_alone = True
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_SH)
        yield is_alone
    finally:
        os.close(handle)
