"""What goes to another worker, as bytes: a file of the object store as its key, since all read the same store."""

from __future__ import annotations

import io
import pickle
from pathlib import Path

from dynident_service.storage.objects import ObjectStore


def packed(value: object, objects: ObjectStore) -> bytes:
    """Pack a value; raises whatever it meets in one that cannot leave its process."""
    content = io.BytesIO()
    _Packer(content, objects).dump(value)
    return content.getvalue()


def unpacked(content: bytes, objects: ObjectStore) -> object:
    """Unpack a value; files of the object store are at hand then. Raises what `ObjectStore.path` does."""
    found: object = _Unpacker(io.BytesIO(content), objects).load()
    return found


class _Packer(pickle.Pickler):
    def __init__(self, content: io.BytesIO, objects: ObjectStore) -> None:
        super().__init__(content, pickle.HIGHEST_PROTOCOL)
        self._objects = objects

    def persistent_id(self, value: object) -> str | None:
        """The key of a file of the store, for what names one."""
        return self._objects.key_of(value) if isinstance(value, Path) else None


class _Unpacker(pickle.Unpickler):
    def __init__(self, content: io.BytesIO, objects: ObjectStore) -> None:
        super().__init__(content)
        self._objects = objects

    def persistent_load(self, key: object) -> Path:
        """Where the file of a key is here."""
        return self._objects.path(str(key))
