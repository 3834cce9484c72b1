"""Files on their way in: whether there is room for them, their bytes, and what they are."""

from __future__ import annotations

import shutil
from pathlib import Path

from fastapi import UploadFile

from dynident_service.problems import ProblemError
from dynident_service.services import Services
from dynident_service.storage.objects import digest

MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def require_room(services: Services, folder: Path, size: int) -> None:
    """Refuse what would fill the disk to the brim: the database needs room too, even to delete something."""
    needed = 2 * size + services.settings.reserved_bytes  # the file and what is made of it
    if shutil.disk_usage(folder).free < needed:
        detail = "The disk of the service is nearly full (DYNIDENT_RESERVED_BYTES), so nothing was stored; make room."
        raise ProblemError(507, detail, title="Disk full")


def receive(services: Services, file: UploadFile, target: Path) -> None:
    """Write what is uploaded into a file."""
    require_room(services, target.parent, file.size or 0)
    with target.open("wb") as opened:
        shutil.copyfileobj(file.file, opened, 1 << 20)


def sha256_of(path: Path) -> str:
    """The hash of a file, in hex."""
    with path.open("rb") as opened:
        return digest(opened)[0]


def media_type_of(source: Path) -> str:
    """What a file is, for whoever fetches it."""
    with source.open("rb") as opened:
        start = opened.read(16)
    if start.startswith(b"PAR1"):
        return MEDIA_TYPES["parquet"]
    foreign = (b"\x93NUMPY", b"PK\x03\x04", b"MATLAB", b"\x89HDF", b"#ROSBAG", b"SQLite", b"\x89MCAP")
    return "application/octet-stream" if start.startswith(foreign) else MEDIA_TYPES["csv"]
