"""The science, which a service loads beside its first requests: one thread at a time imports it, requests first.

Modules of SciPy import each other in a circle. Where two threads are in it at once, each waits for what the other one
imports, and Python ends that by an error in one of them.
"""

from __future__ import annotations

import gc
import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager

PIECES = (
    "dynident_service.adapters.robots",
    "dynident_service.adapters.identifications",
    "dynident_service.adapters.measurements",
    "dynident_service.adapters.designs",
    "dynident_service.work",
)
"""What requests will need, that first for which a page asks first; between two of them requests have their turn."""


class Turns:
    """Who imports: one at a time, and not who is patient while another one waits."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_taken = False
        self._waiting = 0

    @contextmanager
    def taken(self, *, patiently: bool = False) -> Iterator[None]:
        """Have the turn."""
        with self._changed:
            self._waiting += not patiently
            self._changed.wait_for(lambda: not self._is_taken and not (patiently and self._waiting))
            self._waiting -= not patiently
            self._is_taken = True
        try:
            yield
        finally:
            with self._changed:
                self._is_taken = False
                self._changed.notify_all()


_turns = Turns()


@contextmanager
def importing() -> Iterator[None]:
    """Import science in here while requests are answered: no other thread does meanwhile."""
    with _turns.taken():
        yield


def load_science() -> None:
    """Load what requests will need, so that the first one does not wait for it."""
    for name in PIECES:
        with _turns.taken(patiently=True):
            importlib.import_module(name)
    # It stays: a full collection of garbage would go through all of it again, and every request wait for 0.1 s.
    gc.freeze()
