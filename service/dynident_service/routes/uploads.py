"""Uploaded files: room for them, their content, their hash and their media type."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePath

from fastapi import UploadFile

from dynident.recordings.packing import MOST_FILES, pack_files
from dynident_service.problems import make_unusable
from dynident_service.services import Services
from dynident_service.storage.objects import compute_digest
from dynident_service.storage.space import check_disk_space

__all__ = [
    "FURTHER",
    "MEDIA_TYPES",
    "MOST_FILES",
    "detect_media_type",
    "hash_file",
    "receive_files",
    "require_room_for",
]

FURTHER = "Further files of the same recording: signals in files of their own, joined by time or row by row"
MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def require_room_for(services: Services, size: int) -> None:
    """Refuse a file of so many bytes for which there is no room, with what is made of it."""
    check_disk_space(services.settings.data_dir, 2 * size, services.settings.reserved_bytes)


def receive_files(services: Services, files: Sequence[UploadFile], target: Path) -> None:
    """Move what was uploaded to where it is wanted; several files that are one recording become an archive."""
    require_room_for(services, sum(file.size or 0 for file in files))
    sent = [Path(file.file.name) for file in files]
    if len(sent) == 1:
        sent[0].replace(target)
        return
    names = [PurePath(file.filename or f"file{number}").name for number, file in enumerate(files, start=1)]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        detail = f"two files are called {repeated!r}; their names tell the signals of one from those of another"
        raise make_unusable(detail, "/further", title="Unusable file")
    pack_files(list(zip(names, sent, strict=True)), target)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, in hex."""
    with path.open("rb") as opened:
        return compute_digest(opened)[0]


def detect_media_type(source: Path) -> str:
    """Return the media type of a file, by its first bytes."""
    with source.open("rb") as opened:
        start = opened.read(16)
    if start.startswith(b"PAR1"):
        return MEDIA_TYPES["parquet"]
    foreign = (b"\x93NUMPY", b"PK\x03\x04", b"MATLAB", b"\x89HDF", b"#ROSBAG", b"SQLite", b"\x89MCAP")
    return "application/octet-stream" if start.startswith(foreign) else MEDIA_TYPES["csv"]
