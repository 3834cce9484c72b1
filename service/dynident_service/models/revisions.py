"""Revisions of measurements on the wire: what is said of a file from now on."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from dynident.recordings.metadata import Revision
from dynident_service.models.common import Name, RequestModel, ViewModel
from dynident_service.models.request_bodies import derive_body


@derive_body(Revision, or_null=("columns", "units", "permutation", "signs", "scale"))
class RevisionRequest(RequestModel):
    """What is to be said of a measurement's file; the file stays as it is. What is not given stays as it was said.

    `columns`, `units`, `permutation`, `signs` and `scale` are merged with what was said, key by key. All fields but
    `role` and `name` are also fields of an upload's metadata.
    """

    name: Name | None = None

    @model_serializer(mode="wrap")
    def _drop_unset_fields(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}


class SeenMeasurement(ViewModel):
    """A measurement as a model saw it."""

    id: str
    name: str | None
    role: Literal["identification", "validation"]
    sha256: str = Field(description="Of the file as it was uploaded")
    revision: int = Field(description="0: as it was uploaded")
    parent_id: str | None = None
    edits: list[RevisionRequest] = Field(default=[], description="What was said of the file since, in order")
