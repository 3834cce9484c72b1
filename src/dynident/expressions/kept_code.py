"""Machine code kept on disk, so that the regressors of a robot are compiled once on a machine and not by every process.

A folder of the user's own holds it: that of the operating system for such things, or `DYNIDENT_CACHE_DIR` (empty: none
is kept). What cannot be kept or read is compiled, and no error.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path

import platformdirs

SETTING = "DYNIDENT_CACHE_DIR"
_ROOM = 256 * 2**20
"""Bytes that are kept; a regressor of six joints takes some 50 kB."""
_DIGEST = sha256().digest_size


def kept(text: str, compiled: Callable[[], bytes]) -> bytes:
    """Give the code of a text: that which is kept, or `compiled` now and kept from now on."""
    folder = code_folder()
    if folder is None:
        return compiled()
    path = folder / sha256(text.encode()).hexdigest()
    code = _read(path)
    if code is None:
        code = compiled()
        with suppress(OSError):
            _write(path, code)
            _tidied(folder)
    return code


def code_folder() -> Path | None:
    """Give the folder in which machine code is kept; None where none is."""
    return _folder(os.environ.get(SETTING))


def _read(path: Path) -> bytes | None:
    """What a file holds; None where there is none, or one that was damaged, which would end the process."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    with suppress(OSError):  # a folder that may only be read
        os.utime(path)
    digest, code = data[:_DIGEST], data[_DIGEST:]
    return code if sha256(code).digest() == digest else None


def _write(path: Path, code: bytes) -> None:
    """Write a file at once, so that nobody reads half of it."""
    handle, unfinished = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(sha256(code).digest() + code)
        os.replace(unfinished, path)
    except OSError:
        Path(unfinished).unlink(missing_ok=True)
        raise


@cache
def _folder(setting: str | None) -> Path | None:
    """Where code is kept, with room for more; None where it must not be, or where others might write into it."""
    if setting == "":
        return None
    folder = Path(setting).absolute() if setting else platformdirs.user_cache_path("dynident", appauthor=False)
    folder /= "code"
    if not folder.is_absolute():
        return None  # a user without a home
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & 0o022):
            return None
    except OSError:
        return None
    return folder


@cache
def _tidied(folder: Path) -> None:
    """Remove what was not used for longest, down to half the room, where there is too much; once in a process."""
    found = []
    for path in folder.iterdir():
        with suppress(OSError):  # another process may tidy, too
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in found)
    if total <= _ROOM:
        return
    for _, size, path in sorted(found, key=lambda one: one[:2]):
        if total <= _ROOM // 2:
            return
        path.unlink(missing_ok=True)
        total -= size
