"""An archive of what is stored: rows of tables as lines of JSON and objects under their hashes, in a folder or a ZIP.

    manifest.json                 what it is, which version wrote it, and where its tables are
    tables-<number>/resources.jsonl one row a line, by names of columns
    objects/<sha256>              the bytes

The manifest is the one switch: it is written last and takes its name in one step. Tables have a new name each time, and
an object never changes, so that an archive which is written over an older one leaves that whole until then. It belongs
to no kind of database or store: what was written from SQLite is read into PostgreSQL, and the other way.
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
from dynident_service.storage.tables import UtcDateTime

FORMAT = 2
READABLE = (1, 2)
"""The first had its tables in the folder `tables`, always."""
CHUNK = 1 << 20
LONGEST_ROW = 64 * CHUNK
"""Bytes of a line; the largest body of a request makes less."""
DENSEST = 200
"""A ZIP whose files are so many times as large as itself holds nothing but a trap: recordings and tables pack to a
twentieth at best."""
LISTED = 200
"""More bytes than the list of a ZIP needs for each file of ours."""
LAST = 66_000
"""Bytes at the end of a ZIP, among which it says how long its list is."""
NO_SIZE = 2**32 - 1
"""Where a longer record says it."""
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, NotImplementedError, RuntimeError, OSError)
"""What comes of a ZIP that is cut, locked, packed in a way that nobody knows, or made by hand."""
TABLES = "tables"
"""The folder of the tables in a ZIP, which is written but once, and in archives of the first format."""
_TABLES = re.compile(r"tables(-[0-9a-f]{16})?")
_OBJECT = re.compile(r"([0-9a-f]{64})(\.part)?")
Row = dict[str, object]
Content = Literal["everything", "robot"]


class Folder:
    """Files in a folder, each there under its name once it is whole."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.tables = TABLES
        """The folder of the tables; the manifest says which."""

    def begin_tables(self) -> None:
        """Have the tables written into a folder that there is none of yet."""
        self.tables = f"{TABLES}-{secrets.token_hex(8)}"

    def clean(self, tables: str | None, keys: Collection[str] | None = None) -> None:
        """Remove what belongs to no archive here: tables but these, files that were cut, objects but these if given."""
        for path in self._path.glob(f"{TABLES}*"):
            if _TABLES.fullmatch(path.name) and path.name != tables:
                shutil.rmtree(path)
        for path in (self._path / "objects").glob("*"):
            matched = _OBJECT.fullmatch(path.name)
            if matched and (matched[2] or (keys is not None and matched[1] not in keys)):
                path.unlink()

    def write(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file to write it."""
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return _Whole(path)

    def read(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file to read it; FileNotFoundError where it is not there."""
        return (self._path / name).open("rb")

    def size(self, name: str) -> int | None:
        """Tell how large a file is; `None` where it is not there."""
        path = self._path / name
        return path.stat().st_size if path.is_file() else None

    def check(self) -> None:
        """Do nothing: what lies in a folder has its size already."""


class Zipped:
    """Files in a ZIP, which holds them as they are."""

    def __init__(self, zipped: zipfile.ZipFile) -> None:
        self._zipped = zipped
        self.tables = TABLES

    def write(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file to write it."""
        return self._zipped.open(name, "w", force_zip64=True)

    def read(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file to read it; KeyError where it is not there."""
        return self._zipped.open(name)

    def size(self, name: str) -> int | None:
        """Tell how large a file is."""
        try:
            return self._zipped.getinfo(name).file_size
        except KeyError:
            return None

    def check(self) -> None:
        """Raise DynidentError where the files are a trap."""
        file = self._zipped.fp
        whole = 0 if file is None else file.seek(0, os.SEEK_END)
        unpacked = sum(one.file_size for one in self._zipped.infolist())
        if unpacked > DENSEST * whole:
            raise unusable(f"it has {whole} bytes and would be unpacked to {unpacked}")


Files = Folder | Zipped
"""Named files, in a folder or in a ZIP."""


class _Whole:
    """A file that gets its name when all of it is on the disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._unfinished = path.with_name(path.name + ".part")

    def __enter__(self) -> IO[bytes]:
        self._file = self._unfinished.open("wb")
        return self._file

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._file:
            self._file.flush()
            os.fsync(self._file.fileno())
        if kind is None:
            self._unfinished.replace(self._path)
            _write_names(self._path.parent)
        else:
            self._unfinished.unlink()


def _write_names(folder: Path) -> None:
    """Have the names of the files in a folder on the disk, too: a manifest must not be there before what it names."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_listing(source: Path, most: int) -> None:
    """Raise DynidentError for a ZIP that lists far more files than these, before the list is in memory."""
    with source.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - LAST))
        end = file.read()
    for mark, place, form in ((b"PK\5\6", 12, "<L"), (b"PK\6\6", 40, "<Q")):
        at = end.rfind(mark)
        if at >= 0 and len(end) >= at + place + struct.calcsize(form):
            (size,) = struct.unpack_from(form, end, at + place)
            if size > most * LISTED and not (form == "<L" and size == NO_SIZE):
                raise unusable(f"its list of files has {size} bytes, and none of its kind has more than {most} files")


def write_rows(files: Files, table: str, rows: Iterable[Mapping[str, object]]) -> int:
    """Write the rows of a table; tells how many."""
    number = 0
    with files.write(f"{files.tables}/{table}.jsonl") as file:
        for row in rows:
            file.write(json.dumps(dict(row), default=_plain, ensure_ascii=False).encode() + b"\n")
            number += 1
    return number


def read_rows(files: Files, table: Table) -> Iterator[Row]:
    """Read the rows of a table, those of its columns that there are; none where the archive has no such table.

    Raises DynidentError for a line that is no row.
    """
    name = f"{files.tables}/{table.name}.jsonl"
    if files.size(name) is None:
        return
    times = {column.name: isinstance(column.type, UtcDateTime) for column in table.columns}
    number = 0
    try:
        with files.read(name) as file:
            while line := file.readline(LONGEST_ROW):
                number += 1
                yield _row(line, times)
    except (*_BROKEN, KeyError, ValueError, TypeError, RecursionError) as error:
        raise unusable(f"row {number} of {table.name} is none ({type(error).__name__})") from error


def _row(line: bytes, times: Mapping[str, bool]) -> Row:
    if len(line) >= LONGEST_ROW:
        raise ValueError("too long")
    said = json.loads(line)
    if not isinstance(said, dict):
        raise TypeError("no object")
    return {
        name: datetime.fromisoformat(value) if times[name] and value is not None else value
        for name, value in said.items()
        if name in times
    }


def write_object(files: Files, key: str, chunks: Iterable[bytes]) -> None:
    """Write an object; DynidentError where it is not what it should be."""
    with files.write(f"objects/{key}") as file:
        sha256 = hashlib.sha256()
        for chunk in chunks:
            sha256.update(chunk)
            file.write(chunk)
        if sha256.hexdigest() != key:
            raise DynidentError(f"the object {key} is damaged", title="Stored file damaged")


def read_object(files: Files, key: str, target: IO[bytes]) -> int:
    """Copy an object out of the archive, compared with its hash; tells its size."""
    sha256, size = hashlib.sha256(), 0
    for chunk in _pieces(files, key):
        sha256.update(chunk)
        size += target.write(chunk)
    if sha256.hexdigest() != key:
        raise unusable(f"the object {key} is damaged")
    return size


def _pieces(files: Files, key: str) -> Iterator[bytes]:
    try:
        with files.read(f"objects/{key}") as file:
            while chunk := file.read(CHUNK):
                yield chunk
    except (*_BROKEN, KeyError) as error:
        raise unusable(f"it lacks the object {key}, or that is damaged") from error


class Manifest(TypedDict):
    """What an archive is: its content, of what service, and how many rows of each table."""

    dynident_archive: int
    content: Content
    dynident: str
    revision: str
    tables: str
    subject: str | None
    counts: dict[str, int]


def write_manifest(
    files: Files, content: Content, revision: str, counts: Mapping[str, int], subject: str | None = None
) -> None:
    """Write what the archive is; last, as an archive without it is not whole."""
    said: Manifest = {
        "dynident_archive": FORMAT,
        "content": content,
        "dynident": __version__,
        "revision": revision,
        "tables": files.tables,
        "subject": subject,
        "counts": dict(counts),
    }
    with files.write("manifest.json") as file:
        file.write(json.dumps(said, indent=1).encode())


def tables_of(folder: Folder) -> str | None:
    """Tell where the tables of a whole archive in a folder are; None where there is no archive yet."""
    try:
        with folder.read("manifest.json") as file:
            said = json.loads(file.read(CHUNK))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise unusable("its manifest is damaged; write into another folder") from error
    return str(said.get("tables", TABLES)) if isinstance(said, dict) else None


def read_manifest(files: Files, content: Content, known: Iterable[str]) -> Manifest:
    """Read what the archive is, and where its tables are.

    DynidentError unless it is of that content and a version that is known here.
    """
    try:
        with files.read("manifest.json") as file:
            read = json.loads(file.read(CHUNK))
    except (*_BROKEN, KeyError, ValueError) as error:
        raise DynidentError(
            "this is no whole archive of dynident: it has no manifest", title="Unusable archive"
        ) from error
    said = read if isinstance(read, dict) else {}
    if said.get("dynident_archive") not in READABLE or str(said.get("revision")) not in known:
        written = said.get("dynident")
        detail = (
            f"the archive was written by dynident {written}, which is newer than this one ({__version__}); update first"
        )
        raise DynidentError(detail, title="Unusable archive")
    if said.get("content") != content:
        does = {"everything": "`dynident restore` reads it", "robot": "`dynident import-robot` reads it"}
        detail = (
            f"the archive holds {said.get('content')}; {does.get(str(said.get('content')), 'it is of no use here')}"
        )
        raise DynidentError(detail, title="Unusable archive")
    files.tables = str(said.get("tables", TABLES))
    if not _TABLES.fullmatch(files.tables):
        raise unusable(f"{files.tables[:80]!r} is no folder of tables")
    found: Manifest = read
    return found


def unusable(detail: str) -> DynidentError:
    """Say that an archive cannot be used, and why."""
    return DynidentError(f"the archive cannot be used: {detail}", title="Unusable archive")


def _plain(value: Any) -> str:
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} has no form in an archive")
