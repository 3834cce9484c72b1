"""What has to be looked after from time to time, beside the requests and the jobs."""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections import Counter
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.doctor import CURABLE, examine
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.retention import KEPT, forget, forget_imports
from dynident_service.storage.tombstones import sweep

EVERY = 60.0
"""Seconds from one round to the next."""
ABANDONED = 24 * 3600.0
"""An upload that has not moved for so many seconds is over."""
EXAMINED_EVERY = 600.0
"""Seconds from one look through all that is stored to the next."""
log = logging.getLogger("dynident.housekeeping")


class Housekeeping:
    """Runs in a thread of its own from `start` to `close`; every process of a service may have one."""

    def __init__(
        self, settings: Settings, database: Database, objects: ObjectStore, abandoned_before: float = 0.0
    ) -> None:
        self._settings = settings
        self._database = database
        self._objects = objects
        self._stop = threading.Event()
        self._abandoned_before = abandoned_before
        """Files that were being written before this time were left behind: no other service used the directory then."""
        self._examined: float | None = None
        self.condition = "ok"
        """What was found when all that is stored was last looked through, in a few words."""
        self._thread = threading.Thread(target=self._run, name="dynident-housekeeping", daemon=True)

    def start(self) -> None:
        """Start in the background."""
        self._thread.start()

    def close(self, timeout: float = 10.0) -> None:
        """Stop, after the round that is under way."""
        self._stop.set()
        self._thread.join(timeout)

    def round(self) -> None:
        """Do once all that is due."""
        sweep_uploads(self._settings.uploads_dir, max(time.time() - ABANDONED, self._abandoned_before))
        if self._abandoned_before and self._examined is None:
            self._remove_what_was_being_written()
        forget_imports(self._database, timedelta(seconds=KEPT))
        swept = sweep(self._database, self._objects, timedelta(seconds=self._settings.deleted_kept_seconds))
        if swept:
            log.info("%d files that nobody owned were deleted", swept)
        forget(self._database, timedelta(days=self._settings.history_kept_days))
        if self._examined is None or time.monotonic() - self._examined >= EXAMINED_EVERY:
            self.examine()

    def examine(self) -> None:
        """Look through all that is stored, without reading what files hold."""
        found = Counter(one.trouble for one in examine(self._database, self._objects, by_hash=False))
        wrong = {trouble: number for trouble, number in found.items() if trouble not in CURABLE}
        told = ", ".join(f"{trouble}: {number}" for trouble, number in sorted(wrong.items()))
        self.condition = f"damaged ({told}); `dynident doctor` says more" if wrong else "ok"
        if wrong:
            log.error("what is stored is %s", self.condition)
        self._examined = time.monotonic()

    def _remove_what_was_being_written(self) -> None:
        """Remove what a service that was killed had begun to write into the object store and the cache."""
        for path in (*self._objects.leftovers(), *self._settings.cache_dir.glob("tmp*")):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < self._abandoned_before:
                    path.unlink()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.round()
            except Exception:
                # A database or a store that is away for a moment: the next round does what this one could not.
                log.exception("a round of housekeeping failed")
            self._stop.wait(EVERY)


def sweep_uploads(folder: Path, before: float) -> None:
    """Remove what has not changed since a time: uploads that were cut off by the end of the service."""
    for left in folder.glob("*"):
        with suppress(FileNotFoundError):
            if left.stat().st_mtime >= before:
                continue
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink()
