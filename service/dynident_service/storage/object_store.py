"""Store files by their SHA-256 in a folder or S3."""

from __future__ import annotations

import hashlib
import io
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote, urlsplit

import obstore
from obstore.store import LocalStore, from_url

from dynident_service.problems import ProblemError

CHUNK = 8 * 1024 * 1024
"""Bytes that are read or uploaded at a time; S3 takes no parts below 5 MiB."""
STREAMED = 256 * 1024
"""Bytes that are read at a time of an object that a client downloads; every slow client keeps so many in memory."""
PROBE = b"dynident"
"""Content that is written and read to see whether the store works."""
PROBE_KEY = hashlib.sha256(PROBE).hexdigest()
_KEY = re.compile("[0-9a-f]{64}")
_UNFINISHED = re.compile("[0-9a-f]{64}#[0-9]+")
"""Names under which a local store writes an object before it has its own."""


@dataclass(frozen=True)
class StoredObject:
    """Result of putting an object: its key, its size in bytes, and whether it was written."""

    key: str
    size: int
    created: bool


class ObjectGone(Exception):
    """An object was swept away before anybody owned it; put it again and retry."""


class ObjectStore:
    """Store of immutable objects, each under the SHA-256 of its bytes.

    It is a folder (`file://…`) or a bucket (`s3://…`); copies of a bucket's objects lie in `cache_dir`.
    """

    def __init__(self, url: str, cache_dir: Path) -> None:
        self.url = url
        self._cache_dir = cache_dir
        # Identity of each file that was verified: inode, time of change, and size.
        self._verified: dict[Path, tuple[int, int, int]] = {}
        self._folder = Path(unquote(urlsplit(url).path)) if urlsplit(url).scheme == "file" else None
        self._store = LocalStore(self._folder, mkdir=True) if self._folder is not None else from_url(url)

    def put_file(self, file: BinaryIO) -> StoredObject:
        """Store the content of a file from its start, unless it is stored already."""
        return self.put_hashed(file, *compute_digest(file))

    def put_hashed(self, file: BinaryIO, key: str, size: int) -> StoredObject:
        """Store the content of a file whose hash and size are known; a damaged object is written again."""
        # Equal contents have equal keys, so an object that is whole need not be written again.
        if self._is_whole(file, key, size):
            return StoredObject(key, size, created=False)
        file.seek(0)
        # The key is the hash of the content: a concurrent writer of the same key writes the same bytes.
        obstore.put(self._store, _get_object_path(key), file, chunk_size=CHUNK, max_concurrency=2)
        return StoredObject(key, size, created=True)

    def put_bytes(self, content: bytes) -> StoredObject:
        """Store bytes."""
        return self.put_file(io.BytesIO(content))

    def get_size(self, key: str) -> int | None:
        """Return the size of an object in bytes, or None if there is none."""
        try:
            return int(obstore.head(self._store, _get_object_path(key))["size"])
        except FileNotFoundError:
            return None

    def get(self, key: str) -> bytes:
        """Read a whole object; raise a problem 500 if it is missing or damaged."""
        try:
            content = bytes(obstore.get(self._store, _get_object_path(key)).bytes())
        except FileNotFoundError as error:
            raise make_missing_problem(key) from error
        if hashlib.sha256(content).hexdigest() != key:
            raise make_damaged_problem(key)
        return content

    def stream(self, key: str) -> Iterator[bytes]:
        """Read an object in pieces.

        A missing or damaged object is a problem at once in a local store. Of a damaged remote object the last piece is
        held back, so that nobody takes it for complete.
        """
        if self._folder is not None:
            self._verify(self._folder / _get_object_path(key), key)
        try:
            answer = obstore.get(self._store, _get_object_path(key))
        except FileNotFoundError as error:
            raise make_missing_problem(key) from error
        return _verify_chunks(answer.stream(min_chunk_size=STREAMED), key)

    def fetch_file(self, key: str) -> Path:
        """Return a local file with the object: the object itself in a local store, else a copy in the cache.

        Raise a problem (500) if the object is missing or damaged.
        """
        if self._folder is not None:
            path = self._folder / _get_object_path(key)
            self._verify(path, key)
            return path
        cached = self._cache_dir / key
        if not cached.exists():
            self._fetch(key, cached)
        try:
            self._verify(cached, key)
        except ProblemError:  # the copy, not the object
            self._fetch(key, cached)
        return cached

    @property
    def local_folder(self) -> Path:
        """Folder that holds all files that `fetch_file` returns."""
        return (self._cache_dir if self._folder is None else self._folder).resolve()

    def is_damaged(self, key: str) -> bool:
        """Return whether an object, read again from the store, is missing or does not have its hash."""
        sha256 = hashlib.sha256()
        try:
            for chunk in obstore.get(self._store, _get_object_path(key)).stream(min_chunk_size=CHUNK):
                sha256.update(chunk)
        except FileNotFoundError:
            return True
        return sha256.hexdigest() != key

    def list_objects(self) -> Iterator[tuple[str, int]]:
        """Yield key and size in bytes of all objects."""
        for batch in obstore.list(self._store):
            for entry in batch:
                key = str(entry["path"]).rpartition("/")[2]
                # A folder may hold other files, which are none of ours.
                if _KEY.fullmatch(key):
                    yield key, int(entry["size"])

    def list_leftovers(self) -> Iterator[Path]:
        """Yield unfinished files of a local store, being written or abandoned."""
        if self._folder is not None:
            yield from (path for path in self._folder.rglob("*") if _UNFINISHED.fullmatch(path.name))

    def delete(self, key: str) -> None:
        """Delete an object, if there is one."""
        try:
            obstore.delete(self._store, _get_object_path(key))
        except FileNotFoundError:
            return

    def ping(self) -> None:
        """Raise an exception unless an object can be written and read."""
        self.get(self.put_bytes(PROBE).key)

    def _is_whole(self, file: BinaryIO, key: str, size: int) -> bool:
        """Return whether the content of a file is already stored and undamaged.

        A remote object is compared by the ETag that the store computed when it was sent: nothing is downloaded. A store
        with other ETags than S3 gets the file once more, which costs as much as reading it.
        """
        if self._folder is None:
            try:
                head = obstore.head(self._store, _get_object_path(key))
            except FileNotFoundError:
                return False
            etag = (head["e_tag"] or "").removeprefix("W/").strip('"')
            return int(head["size"]) == size and etag == _compute_etag(file)
        if self.get_size(key) != size:
            return False
        self._verified.pop(self._folder / _get_object_path(key), None)  # a disk error does not change the file's time
        try:
            self._verify(self._folder / _get_object_path(key), key)
        except ProblemError:
            return False
        return True

    def _verify(self, path: Path, key: str) -> None:
        """Compare a local file with its hash, once as long as inode, time and size stay the same."""
        try:
            with path.open("rb") as file:
                # Of the open file, as another one may get the name meanwhile.
                state = os.fstat(file.fileno())
                mark = (state.st_ino, state.st_mtime_ns, state.st_size)
                if self._verified.get(path) == mark:
                    return
                actual_key, _ = compute_digest(file)
        except FileNotFoundError as error:
            raise make_missing_problem(key) from error
        if actual_key != key:
            raise make_damaged_problem(key)
        self._verified[path] = mark

    def _fetch(self, key: str, cached: Path) -> None:
        self._cache_dir.mkdir(parents=True, exist_ok=True)
        # Renamed once it is complete: another process may ask for the same object at the same time.
        handle, name = tempfile.mkstemp(dir=self._cache_dir)
        try:
            with os.fdopen(handle, "wb") as file:
                for chunk in self.stream(key):
                    file.write(chunk)
            Path(name).replace(cached)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def make_missing_problem(key: str) -> ProblemError:
    """Return the problem for an object that should be in the store and is not."""
    detail = f"A stored file is missing (object {key}); `dynident doctor` lists all missing files and what needs them."
    return ProblemError(500, detail, title="Stored file missing")


def make_damaged_problem(key: str) -> ProblemError:
    """Return the problem for an object whose bytes have changed."""
    detail = (
        f"A stored file is damaged (object {key}); upload the same file again to repair it. `dynident doctor` "
        "lists all damaged files."
    )
    return ProblemError(500, detail, title="Stored file damaged")


def compute_digest(file: BinaryIO) -> tuple[str, int]:
    """Return the SHA-256 and the size in bytes of a file, read from its start."""
    file.seek(0)
    sha256, size = hashlib.sha256(), 0
    while chunk := file.read(CHUNK):
        sha256.update(chunk)
        size += len(chunk)
    return sha256.hexdigest(), size


def _compute_etag(file: BinaryIO) -> str:
    """Return the ETag that S3 gives to a file sent by `put_hashed`: its MD5, or the MD5 of the MD5s of its parts."""
    file.seek(0)
    parts = []
    while chunk := file.read(CHUNK):
        parts.append(hashlib.md5(chunk, usedforsecurity=False))
    if len(parts) > 1:
        together = b"".join(part.digest() for part in parts)
        return f"{hashlib.md5(together, usedforsecurity=False).hexdigest()}-{len(parts)}"
    return (parts[0] if parts else hashlib.md5(usedforsecurity=False)).hexdigest()


def _verify_chunks(chunks: Iterable[Any], key: str) -> Iterator[bytes]:
    """Pass on the pieces of an object, the last one only if the whole has the right hash."""
    sha256, last = hashlib.sha256(), b""
    for chunk in chunks:
        if last:
            yield last
        last = bytes(chunk)
        sha256.update(last)
    if sha256.hexdigest() != key:
        raise make_damaged_problem(key)
    yield last


def _get_object_path(key: str) -> str:
    """Return the path of an object in the store."""
    # Spread over 256 folders: one with very many files is slow to work with.
    return f"{key[:2]}/{key}"
