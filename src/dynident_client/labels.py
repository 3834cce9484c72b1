"""Collections of resources that have labels: a name, tags, an archive flag."""

from __future__ import annotations

from collections.abc import Sequence

from dynident_client.collection import Collection
from dynident_client.records import Record, RecordT, get_identifier


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
        """Change name, tags (all of them) or archive; what is not given stays."""
        body = {"name": name, "tags": None if tags is None else list(tags), "archived": archived}
        return self._record(self._transport.patch(f"{self.path}/{get_identifier(resource)}", dict, body))
