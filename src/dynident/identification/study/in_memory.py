"""Filtered rows that an identification keeps in memory, so that an extension costs one pass less."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.regressors.rows import CachedRows


@dataclass(frozen=True, eq=False)
class RowsInMemory:
    """Filtered rows of W that are still in memory: a model that extends theirs evaluates its new columns alone.

    None of data that are too long to be kept, of a model out of a file, and of one that effects were taken out of: all
    that is computed without them is the same, one pass over the samples later.
    """

    training: CachedRows | None = None
    held_out: CachedRows | None = None

    def __repr__(self) -> str:
        return f"RowsInMemory({self.training}, held out {self.held_out})"


NONE_IN_MEMORY = RowsInMemory()
