"""Room on the disk, and recognition of failures that a full disk caused."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

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
        detail = "The disk of the service is nearly full (DYNIDENT_RESERVED_BYTES), so nothing was stored; make room."
        raise ProblemError(507, detail, title="Disk full")
