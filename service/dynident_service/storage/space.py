"""Whether something failed because there is no room left."""

from __future__ import annotations

import errno

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
