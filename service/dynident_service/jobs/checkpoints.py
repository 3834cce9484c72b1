"""The checkpoints of a job: not more often than is worth it, and never in the way of the work."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from dynident_service.storage.checkpoints import Checkpointing
from dynident_service.storage.patience import INFRASTRUCTURE, reason_of
from dynident_service.storage.turns import Claim

EVERY = 3.0
"""Seconds from one checkpoint to the next: about as much work is lost where a worker is killed."""
SHARE = 0.05
"""Of the time, what checkpoints may take at most: one that takes long is kept less often."""
log = logging.getLogger("dynident.job")


class KeptCheckpoints:
    """Those of one attempt at a job; it goes on from the last one of any attempt before."""

    def __init__(self, storage: Checkpointing, claim: Claim) -> None:
        self._storage = storage
        self._claim = claim
        self._next = time.monotonic() + EVERY

    def last(self) -> bytes | None:
        """Give what an earlier attempt kept last."""
        return self._storage.find(self._claim.job_id) if self._claim.attempt > 1 else None

    def keep(self, make: Callable[[], bytes]) -> None:
        """Keep one if it is time; a database that is away only costs the checkpoint."""
        began = time.monotonic()
        if began < self._next:
            return
        try:
            self._storage.keep(self._claim, make())
        except INFRASTRUCTURE as error:
            log.warning("job %s: a checkpoint could not be kept: %s", self._claim.job_id, reason_of(error))
        ended = time.monotonic()
        self._next = ended + max(EVERY, (ended - began) / SHARE)
