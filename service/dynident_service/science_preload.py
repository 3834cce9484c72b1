"""Import the numerical packages in the background at the start, one thread at a time.

Modules of SciPy import each other in a circle. If two threads import them at once, each waits for the other, and Python
ends the deadlock with an error in one of them.
"""

from __future__ import annotations

import gc
import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager

PIECES = tuple(
    f"dynident_service.{resource}.adapters"
    for resource in (
        "robots",
        "identifications",
        "measurements",
        "designs",
        "comparisons",
        "diagnoses",
        "validations",
    )
)
"""Modules that requests will need, in the order in which a page needs them; requests may import between two of them."""


class ImportLock:
    """Lock for imports, with a lower priority for those who are patient."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_taken = False
        self._waiting = 0

    @contextmanager
    def hold(self, *, patiently: bool = False) -> Iterator[None]:
        """Hold the lock; `patiently` lets all others go first."""
        with self._changed:
            self._waiting += not patiently
            # Who is patient waits while anybody else does: a request never stands behind the preload for longer than
            # one module.
            self._changed.wait_for(lambda: not self._is_taken and not (patiently and self._waiting))
            self._waiting -= not patiently
            self._is_taken = True
        try:
            yield
        finally:
            with self._changed:
                self._is_taken = False
                self._changed.notify_all()


_import_lock = ImportLock()


@contextmanager
def hold_import_lock() -> Iterator[None]:
    """Hold the import lock while a request imports science."""
    with _import_lock.hold():
        yield


def load_science() -> None:
    """Import what requests will need, so that the first one does not wait."""
    for name in PIECES:
        with _import_lock.hold(patiently=True):
            importlib.import_module(name)
    # The modules stay for good. Unfrozen, a full garbage collection would visit all their objects and stop every
    # request for 0.1 s.
    gc.freeze()
