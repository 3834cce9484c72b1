"""The object store: bytes under the SHA-256 of themselves, in a local folder or in S3."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from urllib.parse import unquote, urlsplit

import obstore
from obstore.exceptions import AlreadyExistsError
from obstore.store import LocalStore, from_url

CHUNK = 8 * 1024 * 1024
"""Bytes read or uploaded at once; S3 takes no parts below 5 MiB."""


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
        self._folder = Path(unquote(urlsplit(url).path)) if urlsplit(url).scheme == "file" else None
        self._store = LocalStore(self._folder, mkdir=True) if self._folder is not None else from_url(url)

    def put_file(self, file: BinaryIO) -> Stored:
        """Store what a file holds, from its start; a file that is there already is not written again."""
        key, size = digest(file)
        if self.exists(key):
            return Stored(key, size, created=False)
        file.seek(0)
        # The key is the hash of the content: a concurrent writer of the same key writes the same bytes.
        obstore.put(self._store, _path(key), file, chunk_size=CHUNK, max_concurrency=2)
        return Stored(key, size, created=True)

    def put_path(self, path: Path) -> Stored:
        """Store a local file."""
        with path.open("rb") as file:
            return self.put_file(file)

    def put_bytes(self, content: bytes) -> Stored:
        """Store bytes."""
        key = hashlib.sha256(content).hexdigest()
        try:
            obstore.put(self._store, _path(key), content, mode="create")
        except AlreadyExistsError:
            return Stored(key, len(content), created=False)
        return Stored(key, len(content), created=True)

    def exists(self, key: str) -> bool:
        """Tell whether an object is there."""
        try:
            obstore.head(self._store, _path(key))
        except FileNotFoundError:
            return False
        return True

    def get(self, key: str) -> bytes:
        """Read a whole object."""
        return bytes(obstore.get(self._store, _path(key)).bytes())

    def stream(self, key: str) -> Iterator[bytes]:
        """Read an object in pieces."""
        for chunk in obstore.get(self._store, _path(key)).stream(min_chunk_size=CHUNK):
            yield bytes(chunk)

    def path(self, key: str) -> Path:
        """Give a local file with the object: the object itself in a local store, else a copy in the cache."""
        if self._folder is not None:
            found = self._folder / _path(key)
            if not found.exists():
                raise FileNotFoundError(found)
            return found
        cached = self._cache_dir / key
        if not cached.exists():
            self._cache_dir.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self._cache_dir)
            with os.fdopen(handle, "wb") as file:
                for chunk in self.stream(key):
                    file.write(chunk)
            Path(name).replace(cached)
        return cached

    def delete(self, key: str) -> None:
        """Remove an object; one that is not there is no error."""
        try:
            obstore.delete(self._store, _path(key))
        except FileNotFoundError:
            return

    def ping(self) -> None:
        """Raise unless the store takes and gives an object."""
        stored = self.put_bytes(b"dynident")
        if self.get(stored.key) != b"dynident":
            raise OSError(f"the object store {self.url} does not give back what was put into it")


def digest(file: BinaryIO) -> tuple[str, int]:
    """Hash a file from its start: its SHA-256 and its size."""
    file.seek(0)
    sha256, size = hashlib.sha256(), 0
    while chunk := file.read(CHUNK):
        sha256.update(chunk)
        size += len(chunk)
    return sha256.hexdigest(), size


def _path(key: str) -> str:
    return f"{key[:2]}/{key}"
