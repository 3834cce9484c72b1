"""What was made for a request or a job and never changes, so that the next one has it at once."""

from __future__ import annotations

from collections import OrderedDict
from typing import Generic, TypeVar

T = TypeVar("T")


class Remembered(Generic[T]):
    """Values by the ids of what they are of; those not asked for longest are forgotten. A restart forgets all."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, T] = OrderedDict()

    def get(self, identifier: str) -> T | None:
        """Give a value, if it is remembered."""
        if identifier in self._kept:
            self._kept.move_to_end(identifier)
        return self._kept.get(identifier)

    def keep(self, identifier: str, value: T) -> None:
        """Remember a value."""
        self._kept[identifier] = value
        self._kept.move_to_end(identifier)
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
