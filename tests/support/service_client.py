"""A client of a service in another process."""

from __future__ import annotations

from typing import Any


class Client:
    """Stands for a request whose client may leave."""

    def __init__(self) -> None:
        self.has_left = False
        self.scope: dict[str, Any] = {}

    async def is_disconnected(self) -> bool:
        return self.has_left
