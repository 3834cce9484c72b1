"""Base classes of collections: get, list in pages, delete, and labels (name, tags, archive)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Generic

from dynident_client.resource_objects import Page, Record, RecordT, get_identifier
from dynident_client.transport import ListPart, Param, Transport


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
            The resource as it is now.
        """
        return self._record(self._transport.get(f"{self.path}/{get_identifier(resource)}", dict))

    def page(self, limit: int | None = None, cursor: str | None = None, **narrow: Param) -> Page[RecordT]:
        """Read a part of the list, newest first.

        Parameters
        ----------
        limit : int, optional
            Most resources in the part.
        cursor : str, optional
            Cursor of the part before; None for the first part.
        **narrow : str, int, float or bool
            Filters of this kind of resource.

        Returns
        -------
        Page
            The resources of the part, and where the next one begins.
        """
        data = self._transport.get(self.path, ListPart, limit=limit, cursor=cursor, **narrow)
        return Page([self._record(record) for record in data["items"]], data["cursor"])

    def all(self, limit: int | None = None, **narrow: Param) -> Iterator[RecordT]:
        """Yield all resources, newest first.

        Parameters
        ----------
        limit : int, optional
            How many are read at a time.
        **narrow : str, int, float or bool
            Filters of this kind of resource.

        Yields
        ------
        Record
            One resource after the other; the next part is read when it is needed.
        """
        # Part by part: a list may be longer than what fits into one answer, and few callers read all of it.
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
            The resource or its identifier.

        Raises
        ------
        ProblemError
            With status 409 while other resources depend on it.
        """
        self._transport.delete(f"{self.path}/{get_identifier(resource)}")

    def _post(self, body: Mapping[str, object], below: str = "") -> RecordT:
        return self._record(self._transport.post(f"{self.path}{below}", dict, replace_resources(body)))

    def _record(self, data: dict[str, Any]) -> RecordT:
        return self.kind(self._transport, data)


def replace_resources(body: Mapping[str, object]) -> dict[str, object]:
    """Return a body of a request in which each resource is replaced by its identifier."""
    return {name: _replace_resource(value) for name, value in body.items()}


def _replace_resource(value: object) -> object:
    if isinstance(value, Record):
        return value.id
    if isinstance(value, Mapping):
        return replace_resources(value)
    # Resources may stand in lists and in objects inside a request.
    if isinstance(value, list | tuple):
        return [_replace_resource(element) for element in value]
    return value


class LabelledCollection(Collection[RecordT]):
    """Resources that can be renamed, tagged and archived; `page` and `all` take archived=True to list all of them."""

    def label(
        self,
        resource: Record | str,
        *,
        name: str | None = None,
        tags: Sequence[str] | None = None,
        archived: bool | None = None,
    ) -> RecordT:
        """Change name, tags (all of them) or archive; what is not given stays.

        Parameters
        ----------
        resource : Record or str
            The resource or its identifier.
        name : str, optional
            What it is called from now on.
        tags : sequence of str, optional
            All its tags from now on.
        archived : bool, optional
            Whether it is left out of lists.

        Returns
        -------
        Record
            The resource as it is now.
        """
        # None means as before: the transport leaves it out.
        body = {"name": name, "tags": None if tags is None else list(tags), "archived": archived}
        return self._record(self._transport.patch(f"{self.path}/{get_identifier(resource)}", dict, body))
