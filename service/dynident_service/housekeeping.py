"""Periodic maintenance: expired and abandoned data, unfinished uploads (24 h), checks of stored data.

Holds the intervals.
"""

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
from dynident_service.storage.deletion_and_expiry import (
    IMPORT_LIFETIME,
    delete_expired,
    delete_unused_imports,
    sweep_objects,
)
from dynident_service.storage.integrity_check import REPAIRABLE, check_storage
from dynident_service.storage.object_store import ObjectStore

EVERY = 60.0
"""Seconds between rounds."""
ABANDONED = 24 * 3600.0
"""Seconds without a change after which an upload counts as abandoned."""
EXAMINED_EVERY = 600.0
"""Seconds between checks of all stored data."""
log = logging.getLogger("dynident.housekeeping")


class Housekeeping:
    """Maintenance thread, from `start` to `close`; every process of a service may have one."""

    def __init__(
        self, settings: Settings, database: Database, objects: ObjectStore, abandoned_before: float = 0.0
    ) -> None:
        self._settings = settings
        self._database = database
        self._objects = objects
        self._stop = threading.Event()
        self._abandoned_before = abandoned_before
        """Unfinished files that are older than this time are abandoned: no other service used the directory then."""
        self._examined: float | None = None
        self.condition = "ok"
        """Result of the last check of all stored data, in a few words."""
        self._thread = threading.Thread(target=self._run, name="dynident-housekeeping", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, timeout: float = 10.0) -> None:
        """Stop after the current round."""
        self._stop.set()
        self._thread.join(timeout)

    def run_round(self) -> None:
        """Do one round of all that is due."""
        sweep_folder(self._settings.uploads_dir, max(time.time() - ABANDONED, self._abandoned_before))
        # Temporary files of running processes may be of any age, so only those from before this service are removed.
        sweep_folder(self._settings.processes_dir, self._abandoned_before)
        # Once, in the first round: later unfinished files are those of this service.
        if self._abandoned_before and self._examined is None:
            self._remove_what_was_being_written()
        delete_unused_imports(self._database, timedelta(seconds=IMPORT_LIFETIME))
        # Swept only after a grace period, since an upload may be about to own a file that looks abandoned.
        swept = sweep_objects(self._database, self._objects, timedelta(seconds=self._settings.deleted_kept_seconds))
        if swept:
            log.info("%d files without an owner were deleted", swept)
        delete_expired(self._database, timedelta(days=self._settings.history_kept_days))
        if self._examined is None or time.monotonic() - self._examined >= EXAMINED_EVERY:
            self.check_stored_data()

    def check_stored_data(self) -> None:
        """Check all stored data, without reading the contents of files."""
        counts = Counter(defect.trouble for defect in check_storage(self._database, self._objects, by_hash=False))
        wrong = {trouble: number for trouble, number in counts.items() if trouble not in REPAIRABLE}
        listed = ", ".join(f"{trouble}: {number}" for trouble, number in sorted(wrong.items()))
        self.condition = f"damaged ({listed}); `dynident doctor` shows details" if wrong else "ok"
        if wrong:
            log.error("the stored data are %s", self.condition)
        self._examined = time.monotonic()

    def _remove_what_was_being_written(self) -> None:
        """Remove unfinished files of a killed service from the object store and the cache."""
        for path in (*self._objects.list_leftovers(), *self._settings.cache_dir.glob("tmp*")):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < self._abandoned_before:
                    path.unlink()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.run_round()
            except Exception:
                # A database or a store that is away for a moment: the next round does what this one could not.
                log.exception("housekeeping failed")
            self._stop.wait(EVERY)


def sweep_folder(folder: Path, before: float) -> None:
    """Remove everything from a folder that has not changed since `before`."""
    for path in folder.glob("*"):
        with suppress(FileNotFoundError):
            if path.stat().st_mtime >= before:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
