"""Files on their way in: whether there is room for them, their bytes, and what they are."""

from __future__ import annotations

from pathlib import Path

from fastapi import UploadFile

from dynident_service.services import Services
from dynident_service.storage.objects import digest
from dynident_service.storage.space import require_room

MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def require_room_for(services: Services, size: int) -> None:
    """Refuse a file of so many bytes for which there is no room, with what is made of it."""
    require_room(services.settings.data_dir, 2 * size, services.settings.reserved_bytes)


def receive(services: Services, file: UploadFile, target: Path) -> None:
    """Move what was uploaded to where it is wanted."""
    require_room_for(services, file.size or 0)
    Path(file.file.name).replace(target)


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
