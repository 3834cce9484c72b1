"""Checkpoints of one attempt at a job, limited in number so that they do not slow the job down."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from dynident_service.storage.checkpoints import Checkpointing
from dynident_service.storage.patience import INFRASTRUCTURE, reason_of
from dynident_service.storage.turns import Claim

EVERY = 3.0
"""Seconds between checkpoints: at most about as much work is lost when a worker is killed."""
SHARE = 0.05
"""Upper limit for the share of time that checkpoints take; one that takes long is written less often."""
log = logging.getLogger("dynident.job")


class KeptCheckpoints:
    """Checkpoints of one attempt at a job; the attempt continues from the last checkpoint of any earlier one."""

    def __init__(self, storage: Checkpointing, claim: Claim) -> None:
        self._storage = storage
        self._claim = claim
        self._next = time.monotonic() + EVERY

    def last(self) -> bytes | None:
        """Return the last checkpoint of earlier attempts, or None."""
        return self._storage.find(self._claim.job_id) if self._claim.attempt > 1 else None

    def keep(self, make: Callable[[], bytes]) -> None:
        """Write a checkpoint if it is time; a database that is away costs only the checkpoint."""
        began = time.monotonic()
        if began < self._next:
            return
        try:
            self._storage.keep(self._claim, make())
        except INFRASTRUCTURE as error:
            log.warning("job %s: a checkpoint could not be kept: %s", self._claim.job_id, reason_of(error))
        ended = time.monotonic()
        self._next = ended + max(EVERY, (ended - began) / SHARE)
