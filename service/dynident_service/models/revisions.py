"""Revisions of measurements on the wire: what is said of a file from now on."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from dynident_service.models.common import Asked, Name, Shown

Axis = Literal["q", "tau"]
ORDER = (
    'Of "q" (with velocities and commands) or "tau" (or currents): at place k the number, from 1, of joint k\'s column'
)
SIGNS = '1 or -1 by which a joint\'s positions or torques are taken: {"tau2": -1}; "tau" means all joints'
SCALE = 'Positive factors of a joint\'s positions or torques: {"tau2": 0.1}'
EXCLUDE = "Seconds of t to leave out, [from, to]"


class RevisionRequest(Asked):
    """What is to be said of a measurement's file; the file stays as it is. What is not given stays as it was said.

    `columns`, `units`, `permutation`, `signs` and `scale` are merged with what was said, key by key. All fields but
    `role` and `name` are also fields of an upload's metadata.
    """

    windows: list[tuple[float, float]] | None = Field(default=None, description="Seconds of t to use; [] for all")
    columns: dict[str, str] | None = None
    units: dict[str, str] | None = None
    permutation: dict[Axis, list[int]] | None = Field(default=None, description=ORDER)
    signs: dict[str, float] | None = Field(default=None, description=SIGNS)
    scale: dict[str, float] | None = Field(default=None, description=SCALE)
    exclude: list[tuple[float, float]] | None = Field(default=None, description=f"{EXCLUDE}; [] for nothing")
    torque_delay: float | None = Field(default=None, description="Seconds by which the file's torque is late")
    role: Literal["identification", "validation", "friction", "payload"] | None = None
    name: Name | None = None

    @model_serializer(mode="wrap")
    def _only_what_is_said(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}


class SeenMeasurement(Shown):
    """A measurement as a model saw it."""

    id: str
    name: str | None
    role: Literal["identification", "validation"]
    sha256: str = Field(description="Of the file as it was uploaded")
    revision: int = Field(description="0: as it was uploaded")
    parent_id: str | None = None
    edits: list[RevisionRequest] = Field(default=[], description="What was said of the file since, in order")
