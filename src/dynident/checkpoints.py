"""How a long computation keeps what it has reached, so that it goes on from there if it is stopped from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Checkpoints(Protocol):
    """Keeps the last checkpoint of one computation."""

    def last(self) -> bytes | None:
        """Give what was kept last; `None` where the computation begins."""

    def keep(self, make: Callable[[], bytes]) -> None:
        """Keep what `make` gives; called often, it asks for one from time to time."""


class NoCheckpoints:
    """Keeps nothing."""

    def last(self) -> bytes | None:
        """Give nothing."""
        return None

    def keep(self, make: Callable[[], bytes]) -> None:
        """Keep nothing."""
