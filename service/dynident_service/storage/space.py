"""Whether there is room on the disk, and whether something failed because there is none left."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

from dynident_service.problems import ProblemError

FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
SAID = ("no space left on device", "disk is full", "disk quota exceeded", "disk full")


def is_full(error: BaseException | None) -> bool:
    """Tell whether an error, or what it came from, is a disk that is full; stores and databases say so in words."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, OSError) and error.errno in FULL:
            return True
        if any(words in str(error).lower() for words in SAID):
            return True
        error = getattr(error, "orig", None) or error.__cause__ or error.__context__
    return False


def require_room(folder: Path, size: int, reserved: int) -> None:
    """Refuse what would fill the disk to the brim: the database needs room too, even to delete something."""
    if shutil.disk_usage(folder).free < size + reserved:
        detail = "The disk of the service is nearly full (DYNIDENT_RESERVED_BYTES), so nothing was stored; make room."
        raise ProblemError(507, detail, title="Disk full")
