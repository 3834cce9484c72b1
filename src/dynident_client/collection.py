"""The base of all collections of resources."""

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
        """The path of the collection."""
        return self.kind.path

    def get(self, resource: Record | str) -> RecordT:
        """Read one resource.

        Parameters
        ----------
        resource : Record or str
            The resource or its identifier.

        Returns
        -------
        Record
        """
        return self._record(self._transport.get(f"{self.path}/{id_of(resource)}", dict))

    def page(self, limit: int | None = None, cursor: str | None = None, **narrow: Param) -> Page[RecordT]:
        """Read a part of the list, newest first.

        Parameters
        ----------
        limit : int, optional
            Most resources in the part.
        cursor : str, optional
            Of the part before; None for the first part.
        narrow
            Filters of this kind of resource.

        Returns
        -------
        Page
        """
        data = self._transport.get(self.path, Part, limit=limit, cursor=cursor, **narrow)
        return Page([self._record(record) for record in data["items"]], data["cursor"])

    def all(self, limit: int | None = None, **narrow: Param) -> Iterator[RecordT]:
        """Yield all resources, newest first.

        Parameters
        ----------
        limit : int, optional
            How many are read at a time.
        narrow
            Filters of this kind of resource.

        Yields
        ------
        Record
        """
        cursor = None
        while True:
            part = self.page(limit, cursor, **narrow)
            yield from part
            if (cursor := part.cursor) is None:
                return

    def delete(self, resource: Record | str) -> None:
        """Delete one resource.

        Parameters
        ----------
        resource : Record or str

        Raises
        ------
        ProblemError
            With status 409 while other resources depend on it.
        """
        self._transport.delete(f"{self.path}/{id_of(resource)}")

    def _post(self, body: Mapping[str, object], below: str = "") -> RecordT:
        return self._record(self._transport.post(f"{self.path}{below}", dict, with_identifiers(body)))

    def _record(self, data: dict[str, Any]) -> RecordT:
        return self.kind(self._transport, data)


def with_identifiers(body: Mapping[str, object]) -> dict[str, object]:
    """Return a body of a request in which each resource is replaced by its identifier."""
    return {name: _identified(value) for name, value in body.items()}


def _identified(value: object) -> object:
    if isinstance(value, Record):
        return value.id
    if isinstance(value, Mapping):
        return with_identifiers(value)
    if isinstance(value, list | tuple):
        return [_identified(element) for element in value]
    return value
