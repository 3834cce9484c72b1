"""The cache on disk of compiled code and passed checks: its folder (`DYNIDENT_CACHE_DIR`), its largest size (256 MB).

The cache is a folder of the user's own: the operating system's folder for caches, or `DYNIDENT_CACHE_DIR` (empty:
nothing is cached). What cannot be cached or read is computed; this is no error.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import platformdirs

from dynident.version import __version__

SETTING = "DYNIDENT_CACHE_DIR"
_MOST_BYTES = 256 * 2**20
"""Bytes that are kept; a regressor of six joints takes some 50 kB."""
_DIGEST = sha256().digest_size


def load_or_compute(text: str, compute: Callable[[], bytes]) -> bytes:
    """Return what follows from a text: the cached bytes, or what `compute` makes, which is cached from then on.

    Parameters
    ----------
    text : str
        All that the bytes follow from, of machine code the names of compiler and processor included; its hash names
        the file.
    compute : function
        Makes the bytes; called only if none are cached. Nothing (no bytes) is not cached.

    Returns
    -------
    bytes
        Such as an object file.
    """
    folder = code_folder()
    if folder is None:
        return compute()
    path = folder / sha256(text.encode()).hexdigest()
    code = _read(path)
    if code:
        return code
    code = compute()
    if code:
        with suppress(OSError):
            _write(path, code)
            _remove_old_files(folder)
    return code


def read_pairs(cached: bytes) -> list[tuple[str, str]]:
    """Return pairs of texts from JSON; none where the bytes are of anything else."""
    with suppress(ValueError, TypeError):
        pairs = json.loads(cached)
        if pairs == [[str(first), str(second)] for first, second in pairs]:
            return [(first, second) for first, second in pairs]
    return []


def pickle_with_library(value: object) -> bytes | None:
    """Return bytes that differ for other values and by another state of this library; None where there are none."""
    try:
        return pickle.dumps((describe_library(), value))
    except (pickle.PicklingError, TypeError, AttributeError):  # such as views of mappings, and functions in functions
        return None


@cache
def describe_library() -> str:
    """Return sizes and times of this library's files, and versions: with others it may compute something else."""
    root, versions = Path(__file__).parents[1], [sys.version, __version__]
    files = [(path.stat().st_size, path.stat().st_mtime_ns) for path in sorted(root.rglob("*.py"))]
    for package in ("numpy", "scipy", "casadi", "pin"):
        with suppress(PackageNotFoundError):  # not all installers say what they installed
            versions.append(f"{package} {version(package)}")
    return f"{versions} {files}"


def code_folder() -> Path | None:
    """Return the folder in which machine code is cached; None if none is."""
    return _find_folder(os.environ.get(SETTING))


def _read(path: Path) -> bytes | None:
    """Return the code in a file; None if the file does not exist or is damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    with suppress(OSError):  # a folder that may only be read
        os.utime(path)
    # Damaged machine code would end the process without a word, so that every file starts with its hash.
    digest, code = data[:_DIGEST], data[_DIGEST:]
    return code if sha256(code).digest() == digest else None


def _write(path: Path, code: bytes) -> None:
    """Write a file in one step (a temporary file that is renamed), so that nobody reads half of it."""
    handle, unfinished = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(sha256(code).digest() + code)
        os.replace(unfinished, path)
    except OSError:
        Path(unfinished).unlink(missing_ok=True)
        raise


@cache
def _find_folder(setting: str | None) -> Path | None:
    """Return the cache folder, made if need be; None if it must not be used or others may write to it."""
    if setting == "":
        return None
    folder = Path(setting).absolute() if setting else platformdirs.user_cache_path("dynident", appauthor=False)
    folder /= "code"
    if not folder.is_absolute():
        return None  # a user without a home
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # What lies here is executed: a folder that somebody else owns or may write to is not used.
        status = folder.stat()
        if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & 0o022):
            return None
    except OSError:
        return None
    return folder


@cache
def _remove_old_files(folder: Path) -> None:
    """Remove the files that were not used for longest until half of the limit is left; once in a process."""
    files = []
    for path in folder.iterdir():
        with suppress(OSError):  # another process may tidy, too
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in files)
    if total <= _MOST_BYTES:
        return
    for _, size, path in sorted(files, key=lambda file: file[:2]):
        if total <= _MOST_BYTES // 2:
            return
        path.unlink(missing_ok=True)
        total -= size
