"""The object store: bytes under the SHA-256 of themselves, in a local folder or in S3."""

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
"""Bytes read or uploaded at once; S3 takes no parts below 5 MiB."""
STREAMED = 256 * 1024
"""Bytes that are read at once of an object which somebody fetches, who may be slow: so many wait for each of them."""
PROBE = b"dynident"
"""What is put and read again to see whether the store works."""
PROBE_KEY = hashlib.sha256(PROBE).hexdigest()
_KEY = re.compile("[0-9a-f]{64}")
_UNFINISHED = re.compile("[0-9a-f]{64}#[0-9]+")
"""The names under which a local store writes an object before it has its own."""


@dataclass(frozen=True)
class Stored:
    """An object that is in the store."""

    key: str
    size: int
    created: bool


class ObjectStore:
    """Puts and gets objects by the SHA-256 of their bytes; what is there never changes."""

    def __init__(self, url: str, cache_dir: Path) -> None:
        self.url = url
        self._cache_dir = cache_dir
        self._verified: dict[Path, tuple[int, int, int]] = {}
        self._folder = Path(unquote(urlsplit(url).path)) if urlsplit(url).scheme == "file" else None
        self._store = LocalStore(self._folder, mkdir=True) if self._folder is not None else from_url(url)

    def put_file(self, file: BinaryIO) -> Stored:
        """Store what a file holds, from its start; a file that is there already is not written again."""
        return self.put_hashed(file, *digest(file))

    def put_hashed(self, file: BinaryIO, key: str, size: int) -> Stored:
        """Store what a file holds, whose hash and size are known; what is there but damaged is written anew."""
        if self._is_whole(file, key, size):
            return Stored(key, size, created=False)
        file.seek(0)
        # The key is the hash of the content: a concurrent writer of the same key writes the same bytes.
        obstore.put(self._store, _path(key), file, chunk_size=CHUNK, max_concurrency=2)
        return Stored(key, size, created=True)

    def put_bytes(self, content: bytes) -> Stored:
        """Store bytes."""
        return self.put_file(io.BytesIO(content))

    def size(self, key: str) -> int | None:
        """Tell how large an object is; `None` where it is not there."""
        try:
            return int(obstore.head(self._store, _path(key))["size"])
        except FileNotFoundError:
            return None

    def get(self, key: str) -> bytes:
        """Read a whole object; a problem if it is missing or not what was put in."""
        try:
            content = bytes(obstore.get(self._store, _path(key)).bytes())
        except FileNotFoundError as error:
            raise missing(key) from error
        if hashlib.sha256(content).hexdigest() != key:
            raise damaged(key)
        return content

    def stream(self, key: str) -> Iterator[bytes]:
        """Read an object in pieces.

        A missing or damaged one is a problem at once in a local store; from a remote one the last piece of a damaged
        object is withheld, so that nobody takes it for whole.
        """
        if self._folder is not None:
            self._verify(self._folder / _path(key), key)
        try:
            found = obstore.get(self._store, _path(key))
        except FileNotFoundError as error:
            raise missing(key) from error
        return _checked(found.stream(min_chunk_size=STREAMED), key)

    def path(self, key: str) -> Path:
        """Give a local file with the object: the object itself in a local store, else a copy in the cache.

        A problem if it is missing or not what was put in.
        """
        if self._folder is not None:
            found = self._folder / _path(key)
            self._verify(found, key)
            return found
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
        """The folder below which `path` gives files."""
        return (self._cache_dir if self._folder is None else self._folder).resolve()

    def key_of(self, path: Path) -> str | None:
        """Tell which object a local file is that `path` gave; None for any other file."""
        key = path.name
        place = self._cache_dir / key if self._folder is None else self._folder / _path(key)
        return key if path == place and _KEY.fullmatch(key) else None

    def is_damaged(self, key: str) -> bool:
        """Read an object again from its store and compare it with its hash; one that is missing is damaged too."""
        sha256 = hashlib.sha256()
        try:
            for chunk in obstore.get(self._store, _path(key)).stream(min_chunk_size=CHUNK):
                sha256.update(chunk)
        except FileNotFoundError:
            return True
        return sha256.hexdigest() != key

    def listed(self) -> Iterator[tuple[str, int]]:
        """Go through all objects that are there: their keys and sizes."""
        for batch in obstore.list(self._store):
            for one in batch:
                key = str(one["path"]).rpartition("/")[2]
                if _KEY.fullmatch(key):
                    yield key, int(one["size"])

    def leftovers(self) -> Iterator[Path]:
        """Go through what writers are writing, or left behind when they were cut off (in a local store)."""
        if self._folder is not None:
            yield from (one for one in self._folder.rglob("*") if _UNFINISHED.fullmatch(one.name))

    def delete(self, key: str) -> None:
        """Remove an object; one that is not there is no error."""
        try:
            obstore.delete(self._store, _path(key))
        except FileNotFoundError:
            return

    def ping(self) -> None:
        """Raise unless the store takes and gives an object."""
        self.get(self.put_bytes(PROBE).key)

    def _is_whole(self, file: BinaryIO, key: str, size: int) -> bool:
        """Tell whether an object is there already as a file is.

        A remote one is held against the file by what its store says of the bytes that it was sent: nothing is read.
        A store that says it in another way than S3 does is sent the file once more, which costs as much as reading.
        """
        if self._folder is None:
            try:
                found = obstore.head(self._store, _path(key))
            except FileNotFoundError:
                return False
            told = (found["e_tag"] or "").removeprefix("W/").strip('"')
            return int(found["size"]) == size and told == _etag(file)
        if self.size(key) != size:
            return False
        self._verified.pop(self._folder / _path(key), None)  # what a disk has lost since leaves no mark on a file
        try:
            self._verify(self._folder / _path(key), key)
        except ProblemError:
            return False
        return True

    def _verify(self, path: Path, key: str) -> None:
        """Compare a local file with its hash, once as long as it does not change."""
        try:
            with path.open("rb") as file:
                state = os.fstat(file.fileno())
                mark = (state.st_ino, state.st_mtime_ns, state.st_size)
                if self._verified.get(path) == mark:
                    return
                found, _ = digest(file)
        except FileNotFoundError as error:
            raise missing(key) from error
        if found != key:
            raise damaged(key)
        self._verified[path] = mark

    def _fetch(self, key: str, cached: Path) -> None:
        self._cache_dir.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=self._cache_dir)
        try:
            with os.fdopen(handle, "wb") as file:
                for chunk in self.stream(key):
                    file.write(chunk)
            Path(name).replace(cached)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def missing(key: str) -> ProblemError:
    """Say that an object is not there that should be."""
    detail = f"A stored file is missing (object {key}); `dynident doctor` lists all that are, and what rests on them."
    return ProblemError(500, detail, title="Stored file missing")


def damaged(key: str) -> ProblemError:
    """Say that an object is not what was stored."""
    detail = (
        f"A stored file is not what it was (object {key}); uploading the same file again mends it, and "
        "`dynident doctor` lists all that are damaged."
    )
    return ProblemError(500, detail, title="Stored file damaged")


def digest(file: BinaryIO) -> tuple[str, int]:
    """Hash a file from its start: its SHA-256 and its size."""
    file.seek(0)
    sha256, size = hashlib.sha256(), 0
    while chunk := file.read(CHUNK):
        sha256.update(chunk)
        size += len(chunk)
    return sha256.hexdigest(), size


def _etag(file: BinaryIO) -> str:
    """What S3 says of a file that was sent to it as `put_hashed` does: its MD5, or that of those of its parts."""
    file.seek(0)
    parts = []
    while chunk := file.read(CHUNK):
        parts.append(hashlib.md5(chunk, usedforsecurity=False))
    if len(parts) > 1:
        together = b"".join(part.digest() for part in parts)
        return f"{hashlib.md5(together, usedforsecurity=False).hexdigest()}-{len(parts)}"
    return (parts[0] if parts else hashlib.md5(usedforsecurity=False)).hexdigest()


def _checked(chunks: Iterable[Any], key: str) -> Iterator[bytes]:
    """Pass on the pieces of an object, the last one only if the whole has the hash that it should have."""
    sha256, last = hashlib.sha256(), b""
    for chunk in chunks:
        if last:
            yield last
        last = bytes(chunk)
        sha256.update(last)
    if sha256.hexdigest() != key:
        raise damaged(key)
    yield last


def _path(key: str) -> str:
    return f"{key[:2]}/{key}"
