"""Checkpoints of one attempt at a job, limited in number so that they do not slow the job down."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from dynident_service.storage.checkpoints import CheckpointStore
from dynident_service.storage.patience import INFRASTRUCTURE_ERRORS, describe_error
from dynident_service.storage.turns import Claim

CHECKPOINT_INTERVAL = 3.0
"""Seconds between checkpoints: at most about as much work is lost when a worker is killed."""
MAX_CHECKPOINT_SHARE = 0.05
"""Upper limit for the share of time that checkpoints take; one that takes long is written less often."""
log = logging.getLogger("dynident.job")


class JobCheckpoints:
    """Checkpoints of one attempt at a job; the attempt continues from the last checkpoint of any earlier one."""

    def __init__(self, storage: CheckpointStore, claim: Claim) -> None:
        self._storage = storage
        self._claim = claim
        self._next = time.monotonic() + CHECKPOINT_INTERVAL

    def load_last(self) -> bytes | None:
        """Return the last checkpoint of earlier attempts, or None."""
        return self._storage.find(self._claim.job_id) if self._claim.attempt > 1 else None

    def save(self, make: Callable[[], bytes]) -> None:
        """Write a checkpoint if it is time; a database that is away costs only the checkpoint."""
        began = time.monotonic()
        if began < self._next:
            return
        try:
            self._storage.save(self._claim, make())
        except INFRASTRUCTURE_ERRORS as error:
            log.warning("job %s: a checkpoint could not be kept: %s", self._claim.job_id, describe_error(error))
        ended = time.monotonic()
        self._next = ended + max(CHECKPOINT_INTERVAL, (ended - began) / MAX_CHECKPOINT_SHARE)
