"""Binary streams whose bytes are produced while they are read."""

from __future__ import annotations

import io
from abc import abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer


class ProducedStream(io.RawIOBase):
    """A readable stream; a subclass produces the next bytes."""

    @abstractmethod
    def read_part(self, size: int) -> bytes:
        """Return the next bytes, at most `size`; none at the end."""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """Put the next bytes into a buffer; return how many."""
        view = memoryview(buffer)
        part = self.read_part(len(view))
        view[: len(part)] = part
        return len(part)
