"""Parts of a job that another worker of a cluster does: the message, and its execution in a child process."""

from __future__ import annotations

import logging
import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

from dynident.progress import Progress, ignore_progress
from dynident_service.jobs.packing import unpack_value
from dynident_service.jobs.work import JobEnvironment
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.turns import Claim

log = logging.getLogger("dynident.job")


class PartFailed(Exception):
    """A part was not done: its process died, its computation failed, or nobody waits for it any more."""


@dataclass(frozen=True)
class JobPart:
    """Part of a job: a function and its argument, pickled by `packing`."""

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
