"""A cache of the most recently used values."""

from __future__ import annotations

from collections import OrderedDict
from typing import Generic, TypeVar

T = TypeVar("T")


class LruCache(Generic[T]):
    """Values by id, of which the least recently used are dropped. For values that never change; a restart drops all."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, T] = OrderedDict()

    def get(self, identifier: str) -> T | None:
        """Return a cached value, or None."""
        if identifier in self._kept:
            self._kept.move_to_end(identifier)
        return self._kept.get(identifier)

    def put(self, identifier: str, value: T) -> None:
        """Cache a value."""
        self._kept[identifier] = value
        self._kept.move_to_end(identifier)
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
