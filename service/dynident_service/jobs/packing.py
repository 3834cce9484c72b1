"""Pickling of values for another worker; files of the object store are sent as their keys, as all share it."""

from __future__ import annotations

import io
import pickle
from pathlib import Path

from dynident_service.storage.objects import ObjectStore


def pack_value(value: object, objects: ObjectStore) -> bytes:
    """Pickle a value; raise whatever exception a value causes that cannot leave its process."""
    content = io.BytesIO()
    _Packer(content, objects).dump(value)
    return content.getvalue()


def unpack_value(content: bytes, objects: ObjectStore) -> object:
    """Unpickle a value and fetch its files from the object store; raise what `ObjectStore.path` raises."""
    value: object = _Unpacker(io.BytesIO(content), objects).load()
    return value


class _Packer(pickle.Pickler):
    def __init__(self, content: io.BytesIO, objects: ObjectStore) -> None:
        super().__init__(content, pickle.HIGHEST_PROTOCOL)
        self._objects = objects

    def persistent_id(self, value: object) -> str | None:
        """Return the key if a value is the path of a file in the object store."""
        return self._objects.find_key(value) if isinstance(value, Path) else None


class _Unpacker(pickle.Unpickler):
    def __init__(self, content: io.BytesIO, objects: ObjectStore) -> None:
        super().__init__(content)
        self._objects = objects

    def persistent_load(self, key: object) -> Path:
        """Return the local path of the file with a key."""
        return self._objects.fetch_file(str(key))
