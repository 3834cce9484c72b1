"""What all collections of resources have in common."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Generic

from dynident_client.records import Page, Record, RecordT, id_of
from dynident_client.transport import Transport


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
        return self._record(self._transport.get(f"{self.path}/{id_of(resource)}"))

    def page(self, limit: int | None = None, cursor: str | None = None, **narrow: Any) -> Page[RecordT]:
        """Read a part of the list, newest first."""
        data = self._transport.get(self.path, limit=limit, cursor=cursor, **narrow)
        return Page([self._record(one) for one in data["items"]], data["cursor"])

    def all(self, **narrow: Any) -> Iterator[RecordT]:
        """Go through the whole list, newest first."""
        cursor = None
        while True:
            part = self.page(cursor=cursor, **narrow)
            yield from part
            if (cursor := part.cursor) is None:
                return

    def delete(self, resource: Record | str) -> None:
        """Delete one; a ProblemError 409 while others rest on it."""
        self._transport.delete(f"{self.path}/{id_of(resource)}")

    def _post(self, body: Mapping[str, Any], below: str = "") -> RecordT:
        return self._record(self._transport.post(f"{self.path}{below}", with_identifiers(body)))

    def _record(self, data: dict[str, Any]) -> RecordT:
        return self.kind(self._transport, data)


def with_identifiers(value: Any) -> Any:
    """Give the same with the identifier of each resource in its place."""
    if isinstance(value, Record):
        return value.id
    if isinstance(value, Mapping):
        return {name: with_identifiers(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [with_identifiers(one) for one in value]
    return value
