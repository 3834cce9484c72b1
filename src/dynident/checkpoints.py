"""Checkpoints of a long computation, from which it goes on after it was stopped from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Checkpoints(Protocol):
    """Storage for the last checkpoint of one computation."""

    def load_last(self) -> bytes | None:
        """Return the checkpoint that was stored last; `None` where the computation begins."""

    def save(self, make: Callable[[], bytes]) -> None:
        """Store a checkpoint.

        Parameters ---------- make : function
            Makes the checkpoint's bytes. Computations call `keep` often; the storage calls `make` only from time to
            time.
        """


class NoCheckpoints:
    """Storage that keeps nothing: every computation begins anew."""

    def load_last(self) -> bytes | None:
        """Return None: there is never a checkpoint."""
        return None

    def save(self, make: Callable[[], bytes]) -> None:
        """Ignore the checkpoint."""
