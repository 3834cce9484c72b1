"""Format of backups and bundles: rows as JSON lines, objects by hash, in a folder or ZIP; its version and limits.

    manifest.json                   content, version of the writer, and folder of the tables
    tables-<number>/resources.jsonl one row per line, by column name
    objects/<sha256>                the bytes

The manifest is written last and replaced atomically, so it alone decides what the archive contains. Each backup writes
its tables into a new folder, and an object never changes; writing over an older archive therefore leaves the older one
intact until the new manifest is in place. The format is independent of the database and of the object store: an archive
written from SQLite can be restored into PostgreSQL, and the other way round.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import os
import re
import secrets
import shutil
import struct
import zipfile
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from typing import IO, Any, Literal, TypedDict

from sqlalchemy import Table

from dynident.errors import DynidentError
from dynident.version import __version__
from dynident_service.storage.database_tables import UtcDateTime

FORMAT = 2
"""Version of the format that this code writes."""
READABLE_FORMATS = (1, 2)
"""Versions that can be read. Version 1 always had its tables in the folder `tables`."""
CHUNK = 1 << 20
"""Bytes that are read at a time."""
MAX_ROW_BYTES = 64 * CHUNK
"""Upper limit in bytes for one line; the largest request body that the service accepts gives a shorter one."""
MAX_COMPRESSION_RATIO = 200
"""Largest ratio of unpacked to packed size. A ZIP beyond it is taken for a decompression bomb: recordings and tables
compress to a twentieth at best.
"""
DIRECTORY_BYTES_PER_FILE = 200
"""Bytes of the ZIP directory per file; entries of our own archives need less."""
END_RECORD_BYTES = 66_000
"""Bytes at the end of a ZIP that are searched for the record with the size of its directory."""
ZIP64_MARKER = 2**32 - 1
"""Marker in the short end record of a ZIP: the actual size stands in the ZIP64 record."""
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, NotImplementedError, RuntimeError, OSError)
"""Exceptions raised while reading a ZIP that is truncated, encrypted, packed by an unknown method or forged."""
TABLES = "tables"
"""Folder of the tables in a ZIP, which is written only once, and in archives of version 1."""
_TABLES = re.compile(r"tables(-[0-9a-f]{16})?")
_OBJECT = re.compile(r"([0-9a-f]{64})(\.part)?")
Row = dict[str, object]
Content = Literal["everything", "robot"]


class ArchiveFolder:
    """Archive in a folder; a file appears under its name only when it is complete."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.tables = TABLES
        """Folder of the tables, as the manifest names it."""

    def choose_tables_folder(self) -> None:
        """Choose a new, unused folder for the tables."""
        self.tables = f"{TABLES}-{secrets.token_hex(8)}"

    def remove_unused(self, tables: str | None, keys: Collection[str] | None = None) -> None:
        """Remove what belongs to no archive in this folder.

        All folders of tables but `tables` go, and all objects but `keys`; without keys, only unfinished files.
        """
        for path in self._path.glob(f"{TABLES}*"):
            if _TABLES.fullmatch(path.name) and path.name != tables:
                shutil.rmtree(path)
        for path in (self._path / "objects").glob("*"):
            # Files of other names are not ours, and stay.
            matched = _OBJECT.fullmatch(path.name)
            if matched and (matched[2] or (keys is not None and matched[1] not in keys)):
                path.unlink()

    def write(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file for writing."""
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return _AtomicFile(path)

    def read(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file for reading; raise FileNotFoundError if there is none."""
        return (self._path / name).open("rb")

    def get_size(self, name: str) -> int | None:
        """Return the size of a file in bytes, or None if there is none."""
        path = self._path / name
        return path.stat().st_size if path.is_file() else None

    def check_compression(self) -> None:
        """Do nothing: files in a folder are not compressed."""


class ArchiveZip:
    """Archive in a ZIP file, without compression."""

    def __init__(self, zipped: zipfile.ZipFile) -> None:
        self._zipped = zipped
        self.tables = TABLES

    def write(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file for writing."""
        # The size is not known before: the header has to have room for more than 4 GB.
        return self._zipped.open(name, "w", force_zip64=True)

    def read(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file for reading; raise KeyError if there is none."""
        return self._zipped.open(name)

    def get_size(self, name: str) -> int | None:
        """Return the size of a file in bytes, or None if there is none."""
        try:
            return self._zipped.getinfo(name).file_size
        except KeyError:
            return None

    def check_compression(self) -> None:
        """Raise DynidentError if the ZIP is a decompression bomb."""
        file = self._zipped.fp
        whole = 0 if file is None else file.seek(0, os.SEEK_END)
        # The ZIP states the unpacked sizes itself, so nothing has to be unpacked to find a bomb.
        unpacked = sum(member.file_size for member in self._zipped.infolist())
        if unpacked > MAX_COMPRESSION_RATIO * whole:
            raise make_archive_error(f"it has {whole} bytes and would unpack to {unpacked} bytes")


ArchiveFiles = ArchiveFolder | ArchiveZip
"""Named files of an archive, in a folder or in a ZIP."""


class _AtomicFile:
    """Context manager for a file that gets its name only once all its bytes are on the disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._unfinished = path.with_name(path.name + ".part")

    def __enter__(self) -> IO[bytes]:
        self._file = self._unfinished.open("wb")
        return self._file

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # The bytes must be on the disk before the name is: after a power cut a name without content would look valid.
        with self._file:
            self._file.flush()
            os.fsync(self._file.fileno())
        if kind is None:
            # Renaming is atomic: the file has its name with all its content, or not at all.
            self._unfinished.replace(self._path)
            _flush_folder(self._path.parent)
        else:
            self._unfinished.unlink()


def _flush_folder(folder: Path) -> None:
    """Flush the entries of a folder, so that a manifest never reaches the disk before the files that it names."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_listing(source: Path, most: int) -> None:
    """Raise DynidentError for a ZIP that lists far more than `most` files, before its directory is read into memory."""
    with source.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - END_RECORD_BYTES))
        end = file.read()
    # The end record of a ZIP and its ZIP64 counterpart: signature, offset of the directory's size, and its format.
    for mark, place, form in ((b"PK\5\6", 12, "<L"), (b"PK\6\6", 40, "<Q")):
        at = end.rfind(mark)
        if at >= 0 and len(end) >= at + place + struct.calcsize(form):
            (size,) = struct.unpack_from(form, end, at + place)
            if size > most * DIRECTORY_BYTES_PER_FILE and not (form == "<L" and size == ZIP64_MARKER):
                raise make_archive_error(
                    f"its list of files has {size} bytes, but such an archive has at most {most} files"
                )


def write_rows(files: ArchiveFiles, table: str, rows: Iterable[Mapping[str, object]]) -> int:
    """Write the rows of a table as JSON lines. Return their number."""
    number = 0
    with files.write(f"{files.tables}/{table}.jsonl") as file:
        for row in rows:
            file.write(json.dumps(dict(row), default=_encode_value, ensure_ascii=False).encode() + b"\n")
            number += 1
    return number


def read_rows(files: ArchiveFiles, table: Table) -> Iterator[Row]:
    """Read the rows of a table from an archive.

    Columns that `table` does not have are left out; nothing is yielded if the archive lacks the table.
    """
    name = f"{files.tables}/{table.name}.jsonl"
    if files.get_size(name) is None:
        return
    # JSON has no type for times, so they are restored by the type of the column.
    times = {column.name: isinstance(column.type, UtcDateTime) for column in table.columns}
    number = 0
    try:
        with files.read(name) as file:
            # The limit keeps a hostile file with one endless line from filling the memory.
            while line := file.readline(MAX_ROW_BYTES):
                number += 1
                yield _parse_row(line, times)
    except (*_BROKEN, KeyError, ValueError, TypeError, RecursionError) as error:
        raise make_archive_error(f"row {number} of {table.name} is not valid ({type(error).__name__})") from error


def _parse_row(line: bytes, times: Mapping[str, bool]) -> Row:
    if len(line) >= MAX_ROW_BYTES:
        raise ValueError("too long")
    values = json.loads(line)
    if not isinstance(values, dict):
        raise TypeError("not an object")
    return {
        name: datetime.fromisoformat(value) if times[name] and value is not None else value
        for name, value in values.items()
        if name in times
    }


def write_object(files: ArchiveFiles, key: str, chunks: Iterable[bytes]) -> None:
    """Write an object, and raise DynidentError if its bytes do not have the hash that is its key."""
    with files.write(f"objects/{key}") as file:
        sha256 = hashlib.sha256()
        for chunk in chunks:
            sha256.update(chunk)
            file.write(chunk)
        if sha256.hexdigest() != key:
            raise DynidentError(f"the object {key} is damaged", title="Stored file damaged")


def read_object(files: ArchiveFiles, key: str, target: IO[bytes]) -> int:
    """Copy an object from the archive to `target` and compare it with its hash. Return its size in bytes."""
    sha256, size = hashlib.sha256(), 0
    for chunk in _read_chunks(files, key):
        sha256.update(chunk)
        size += target.write(chunk)
    if sha256.hexdigest() != key:
        raise make_archive_error(f"the object {key} is damaged")
    return size


def _read_chunks(files: ArchiveFiles, key: str) -> Iterator[bytes]:
    try:
        with files.read(f"objects/{key}") as file:
            # In pieces: a recording may be larger than the memory.
            while chunk := file.read(CHUNK):
                yield chunk
    except (*_BROKEN, KeyError) as error:
        raise make_archive_error(f"the object {key} is missing or damaged") from error


class Manifest(TypedDict):
    """Manifest of an archive: content, version of the writer, database revision, and number of rows of each table."""

    dynident_archive: int
    content: Content
    dynident: str
    revision: str
    tables: str
    subject: str | None
    counts: dict[str, int]


def write_manifest(
    files: ArchiveFiles, content: Content, revision: str, counts: Mapping[str, int], subject: str | None = None
) -> None:
    """Write the manifest. This is the last step: an archive without a manifest is incomplete.

    `revision` is the migration of the database that the rows are from; `subject` the robot of a bundle.
    """
    manifest: Manifest = {
        "dynident_archive": FORMAT,
        "content": content,
        "dynident": __version__,
        "revision": revision,
        "tables": files.tables,
        "subject": subject,
        "counts": dict(counts),
    }
    with files.write("manifest.json") as file:
        file.write(json.dumps(manifest, indent=1).encode())


def find_tables_folder(folder: ArchiveFolder) -> str | None:
    """Return the folder of the tables of a complete archive in a folder, or None if there is no archive yet."""
    try:
        with folder.read("manifest.json") as file:
            manifest = json.loads(file.read(CHUNK))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise make_archive_error("its manifest is damaged; write into another folder") from error
    return str(manifest.get("tables", TABLES)) if isinstance(manifest, dict) else None


def read_manifest(files: ArchiveFiles, content: Content, known: Iterable[str]) -> Manifest:
    """Read the manifest, and set `files.tables` by it.

    Refuse an archive that is incomplete, of another kind, or from a migration that is not `known` here.
    """
    try:
        with files.read("manifest.json") as file:
            read = json.loads(file.read(CHUNK))
    except (*_BROKEN, KeyError, ValueError) as error:
        raise DynidentError(
            "this is not a complete archive of dynident: it has no manifest", title="Unusable archive"
        ) from error
    fields = read if isinstance(read, dict) else {}
    if fields.get("dynident_archive") not in READABLE_FORMATS or str(fields.get("revision")) not in known:
        written = fields.get("dynident")
        detail = (
            f"the archive was written by dynident {written}, which is newer than this one ({__version__}); update first"
        )
        raise DynidentError(detail, title="Unusable archive")
    if fields.get("content") != content:
        does = {"everything": "`dynident restore` reads it", "robot": "`dynident import-robot` reads it"}
        remedy = does.get(str(fields.get("content")), "no command reads it")
        detail = f"the archive contains {fields.get('content')}; {remedy}"
        raise DynidentError(detail, title="Unusable archive")
    files.tables = str(fields.get("tables", TABLES))
    # The name comes from outside: a path in it must not lead out of the archive.
    if not _TABLES.fullmatch(files.tables):
        raise make_archive_error(f"{files.tables[:80]!r} is not a folder of tables")
    manifest: Manifest = read
    return manifest


def make_archive_error(detail: str) -> DynidentError:
    """Return the error for an archive that cannot be used."""
    return DynidentError(f"the archive cannot be used: {detail}", title="Unusable archive")


def _encode_value(value: Any) -> str:
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} cannot be written to an archive")
