"""What all collections of resources have in common."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Generic

from dynident_client.records import Page, Record, RecordT, id_of
from dynident_client.transport import Param, Part, Transport


class Collection(Generic[RecordT]):
    """The resources of one kind."""

    kind: type[RecordT]

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    @property
    def path(self) -> str:
        """Where they are."""
        return self.kind.path

    def get(self, resource: Record | str) -> RecordT:
        """Read one."""
        return self._record(self._transport.get(f"{self.path}/{id_of(resource)}", dict))

    def page(self, limit: int | None = None, cursor: str | None = None, **narrow: Param) -> Page[RecordT]:
        """Read a part of the list, newest first."""
        data = self._transport.get(self.path, Part, limit=limit, cursor=cursor, **narrow)
        return Page([self._record(one) for one in data["items"]], data["cursor"])

    def all(self, limit: int | None = None, **narrow: Param) -> Iterator[RecordT]:
        """Go through the whole list, newest first; `limit` says how many are read at a time."""
        cursor = None
        while True:
            part = self.page(limit, cursor, **narrow)
            yield from part
            if (cursor := part.cursor) is None:
                return

    def delete(self, resource: Record | str) -> None:
        """Delete one; a ProblemError 409 while others rest on it."""
        self._transport.delete(f"{self.path}/{id_of(resource)}")

    def _post(self, body: Mapping[str, object], below: str = "") -> RecordT:
        return self._record(self._transport.post(f"{self.path}{below}", dict, with_identifiers(body)))

    def _record(self, data: dict[str, Any]) -> RecordT:
        return self.kind(self._transport, data)


def with_identifiers(body: Mapping[str, object]) -> dict[str, object]:
    """Give the same with the identifier of each resource in its place."""
    return {name: _identified(one) for name, one in body.items()}


def _identified(value: object) -> object:
    if isinstance(value, Record):
        return value.id
    if isinstance(value, Mapping):
        return with_identifiers(value)
    if isinstance(value, list | tuple):
        return [_identified(one) for one in value]
    return value
