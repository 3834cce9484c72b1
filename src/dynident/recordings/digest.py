"""Digest of a file: what it is known by, whatever it is called."""

from __future__ import annotations

import hashlib
from pathlib import Path

from dynident.recordings.names import split_path


def compute_digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits; of a recording in several files, that of their digests.

    Parameters
    ----------
    path : path

    Returns
    -------
    str

    Raises
    ------
    OSError
        For a file that cannot be read.
    """
    parts = split_path(path)
    if len(parts) > 1:
        return hashlib.sha256("".join(compute_digest(part) for part in parts).encode()).hexdigest()
    with parts[0].open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
