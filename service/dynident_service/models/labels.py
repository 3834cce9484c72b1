"""What a resource is called and filed under, on the wire."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from dynident_service.models.common import Asked, Name, Shown

Tag = Annotated[str, Field(min_length=1, max_length=60)]


def _each_once(tags: list[str]) -> list[str]:
    return list(dict.fromkeys(tags))


class LabelsRequest(Asked):
    """What is to change of a resource's labels; what is not given stays."""

    name: Name | None = None
    tags: Annotated[list[Tag], Field(max_length=50), AfterValidator(_each_once)] | None = Field(
        default=None, description="All of them: they replace those that there are"
    )
    archived: bool | None = Field(
        default=None, description="Lists leave out what is archived; all else works as before"
    )


class Labelled(Shown):
    """A resource with labels."""

    tags: list[str] = Field(default=[])
    archived: bool = Field(default=False, description="Whether lists leave it out")
