"""The data directory: for its owner alone, writable, and cleared of what a killed service left behind."""

from __future__ import annotations

import fcntl
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dynident.errors import DynidentError

PRIVATE = 0o027
"""Bits that files made by the service lack: nobody but owner and group reads them, and nobody but the owner writes."""
OTHERS = 0o007
log = logging.getLogger("dynident.service")


def prepare_data_directory(folder: Path) -> None:
    """Make the data directory, where there is none, for its owner alone; warn where others may enter it.

    Raises
    ------
    DynidentError
        Where nothing can be written into it.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        check_writable(folder)
        mode = folder.stat().st_mode
    except OSError as error:
        raise _unusable(folder, error) from error
    if mode & OTHERS:
        log.warning("every user of this machine may enter the data directory; `chmod o= %s` keeps them out", folder)


def check_writable(folder: Path) -> None:
    """Raise DynidentError where nothing can be written into a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _unusable(folder, error) from error


def _unusable(folder: Path, error: OSError) -> DynidentError:
    detail = (
        f"nothing can be written into the data directory {folder} ({error.strerror or error}); make it writable for "
        "this user, or say where else data is to be kept (--data-dir, DYNIDENT_DATA_DIR)"
    )
    return DynidentError(detail, title="Unusable data directory")


@contextmanager
def private_files() -> Iterator[None]:
    """Have all files and folders that are made meanwhile unreadable for other users of the machine."""
    before = os.umask(PRIVATE)
    os.umask(before | PRIVATE)
    try:
        yield
    finally:
        os.umask(before)


@contextmanager
def mark_in_use(folder: Path) -> Iterator[bool]:
    """Mark a data directory as used by a service, until the process ends; gives whether no other one uses it."""
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
