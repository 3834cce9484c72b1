"""Parts of a job that another worker computes: pickling, message, and execution in a child process."""

from __future__ import annotations

import io
import logging
import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

from dynident.progress import Progress, ignore_progress
from dynident_service.jobs.task import JobEnvironment
from dynident_service.storage.job_transitions import Claim
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


log = logging.getLogger("dynident.job")


class PartFailed(Exception):
    """A part was not done: its process died, its computation failed, or nobody waits for it any more."""


@dataclass(frozen=True)
class JobPart:
    """Part of a job: a function and its argument, pickled by `_Packer`."""

    claim: Claim
    place: JobEnvironment
    work: bytes
    item: bytes


def compute_part(job_id: str, url: str, cache_dir: Path, work: bytes, item: bytes) -> bytes:
    """Compute a part; the function is cached for the next part, with the machine code that it contains."""
    began = time.monotonic()
    function, objects = _get_function(work, url, cache_dir), _get_store(url, cache_dir)
    result = pickle.dumps(function(unpack_value(item, objects), ignore_progress), pickle.HIGHEST_PROTOCOL)
    log.info("did a part of job %s in %.1f s", job_id, time.monotonic() - began)
    return result


@lru_cache(maxsize=1)
def _get_store(url: str, cache_dir: Path) -> ObjectStore:
    return ObjectStore(url, cache_dir)


@lru_cache(maxsize=2)
def _get_function(content: bytes, url: str, cache_dir: Path) -> Callable[[object, Progress], object]:
    return cast(Callable[[object, Progress], object], unpack_value(content, _get_store(url, cache_dir)))
