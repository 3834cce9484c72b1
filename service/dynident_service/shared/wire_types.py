"""Base classes and types that many bodies share: pages, labels, tables, effects; the longest lists (1,000)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime
from math import nan
from typing import Annotated, Any, Generic, Literal, Self, TypeVar, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from dynident.schema.fields import LARGEST, FieldDescription, describe_refusal
from dynident_service.problems import Problem
from dynident_service.storage.repository_values import Resource, State

T = TypeVar("T")
RequestT = TypeVar("RequestT", bound=BaseModel)
ResultT = TypeVar("ResultT", bound=BaseModel)

MOST_ITEMS = 1000
"""Of a list or an object in a request for which nothing else is stated: ten times as many as any robot or recording in
use has needed, and few enough that what is computed for each of them ends."""
LARGEST_BATCH = 10_000
"""Identifications that one request may ask for whatever the setting: all are stored in one transaction, for which all
who write wait."""
MOST_EFFECTS = 200
"""In a model: of each comes a column for each joint, and what is computed grows with their square."""
_HAS_RANGE = "dynident_range"
_SIZED = frozenset({"list", "set", "frozenset", "dict"})

LONGEST_NAME = 200
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Identifier = Annotated[str, Field(min_length=1, max_length=40)]


@dataclass(frozen=True)
class SourcePath:
    """Beside a field of an answer: where a result of the science has it, if it is called otherwise there.

    `path` is an attribute, or one of an attribute ("choice.joints"); `null` what null stands for in the science, of an
    interval at either end.
    """

    path: str = ""
    null: float | tuple[float, float] = nan


@dataclass(frozen=True)
class NumberRange:
    """Beside a number of a body: the range that the library gives it, and its sentence about a number out of it."""

    name: str
    description: FieldDescription

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check the number after its type."""
        schema = handler(source)
        return core_schema.no_info_after_validator_function(self._check, schema, metadata={_HAS_RANGE: True})

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Write the range into the contract."""
        return {**handler(schema), **self.description.range_schema}

    def _check(self, value: float) -> float:
        if not self.description.accepts(value):
            raise ValueError(describe_refusal(self.name, value, self.description))
        return value


def _limit_schema(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_limit_schema(part) for part in schema]
    # A number with a range of its own needs no further one.
    if not isinstance(schema, dict) or (schema.get("metadata") or {}).get(_HAS_RANGE):
        return schema
    limits: dict[str, object] = {"max_length": MOST_ITEMS} if schema.get("type") in _SIZED else {}
    if schema.get("type") == "float":
        ends = {"ge": -LARGEST, "le": LARGEST}
        limits = {end: value for end, value in ends.items() if end.replace("e", "t") not in schema}
    return limits | {name: _limit_schema(part) for name, part in schema.items()}


class RequestModel(BaseModel):
    """A request, or a part of one: a field that nobody knows is an error, not ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Limit every list, object and number for which no limit is stated."""
        return cast(CoreSchema, _limit_schema(handler(source)))


class NamedRequest(RequestModel):
    """A request for something that may be given a name."""

    name: Name | None = None


class QueryModel(BaseModel):
    """What the query of an address asks for."""

    model_config = ConfigDict(allow_inf_nan=False)


class ViewModel(BaseModel):
    """An answer, or a part of one; what is no finite number is shown as null."""

    model_config = ConfigDict(ser_json_inf_nan="null")


class Page(ViewModel, Generic[T]):
    """A page of a list, newest first."""

    items: list[T]
    cursor: str | None = Field(default=None, description="Give it as `cursor` to get the next page; null at the end.")


class Progress(ViewModel):
    """Progress of a job."""

    fraction: float = Field(description="0 to 1")
    message: str


class Computed(ViewModel, Generic[RequestT, ResultT]):
    """A resource that a job computes."""

    id: str
    name: str | None
    created_at: datetime
    job_id: str
    status: State
    progress: Progress
    request: RequestT
    result: ResultT | None = Field(default=None, description="Present if the status is succeeded.")
    error: Problem | None = Field(default=None, description="Present if the status is failed.")

    @classmethod
    def show(cls, resource: Resource, **more: object) -> Self:
        """Show a stored resource."""
        job = resource.job
        assert job is not None
        progress = Progress(fraction=job.fraction, message=job.message)
        job_fields = {"job_id": job.id, "status": job.state, "progress": progress, "error": job.error}
        return cls.model_validate({**vars(resource), **job_fields, **more})


class EffectChoice(RequestModel):
    """An effect of the catalogue, on some joints."""

    effect: str = Field(description="An id from GET /v1/effects")
    joints: list[str] = Field(
        default=[], description="Names of joints; by default, all joints that the effect can act on."
    )
    shape_parameters: dict[str, float] = Field(default={}, description="Shape constants; searched for if not given.")
    runs: list[str] = Field(
        default=[], description="Names of the measurements, or labels of their runs, in which the effect acts"
    )

    @model_validator(mode="before")
    @classmethod
    def _drop_question(cls, values: Any) -> Any:
        # What a diagnosis recommends is posted as it is, with the question that came with it.
        known = "question" in cls.model_fields or not isinstance(values, dict)
        return values if known else {name: value for name, value in values.items() if name != "question"}


Effects = Annotated[list[EffectChoice], Field(max_length=MOST_EFFECTS)]


def to_plain_json(model: BaseModel) -> dict[str, object]:
    """Give a model as it is stored: JSON values only, nothing that is not finite."""
    document: dict[str, Any] = json.loads(model.model_dump_json())
    return document


Tag = Annotated[str, Field(min_length=1, max_length=60)]


def _remove_duplicates(tags: list[str]) -> list[str]:
    return list(dict.fromkeys(tags))


class LabelsRequest(RequestModel):
    """Changes to a resource's labels; fields that are not given keep their values."""

    name: Name | None = None
    tags: Annotated[list[Tag], Field(max_length=50), AfterValidator(_remove_duplicates)] | None = Field(
        default=None, description="All tags: they replace the existing ones"
    )
    archived: bool | None = Field(
        default=None, description="Lists leave out archived resources; everything else works as before"
    )


class Labelled(ViewModel):
    """A resource with labels."""

    tags: list[str] = Field(default=[])
    archived: bool = Field(default=False, description="Whether lists leave it out")


class TableColumn(ViewModel):
    """A column of a table."""

    word: str
    figures: bool = Field(description="Whether it contains numbers")


class TableCell(ViewModel):
    """The content of one cell."""

    text: str
    value: float | None = Field(description="The exact value, if the cell is a number")
    mark: Literal["ok", "warning", "error", "plain"] | None = Field(description="Rating of the value")
    note: str = Field(description="Further explanation")


class Table(ViewModel):
    """A table for people: the same on the command line and in reports."""

    title: str
    columns: list[TableColumn]
    rows: list[list[TableCell]]
    groups: list[str] = Field(description="Heading above each row; [] if there are none")
    notes: list[str] = Field(default=[], description="Sentences that explain the table or say what follows from it")
    name: str = Field(default="", description="What programs know the table by")
    marked_rows: list[int] = Field(default=[], description="Indices of rows that stand out, such as findings")


class Tables(ViewModel):
    """Several tables."""

    items: list[Table]


class WithTables(ViewModel):
    """A resource that can be shown as tables."""

    tables: list[Table] = Field(
        default=[],
        description="The figures of the result as tables for people, as on the command line and in reports; only in "
        "the answer for one resource, not in lists",
    )


class EffectParameter(ViewModel):
    """One parameter of an effect."""

    name: str
    unit: str = Field(description="On a revolute joint")
    prismatic_unit: str
    description: str


class ShapeWord(ViewModel):
    """The meaning of a value of a constant that selects a kind."""

    value: float
    word: str


class ShapeParameter(ViewModel):
    """A constant inside an effect's columns; it is searched for, because the torque is not linear in it."""

    name: str
    unit: str
    description: str
    default: float
    words: list[ShapeWord] = Field(description="Empty if the constant is a number")


class EffectView(ViewModel):
    """A physical cause of joint torque."""

    id: str
    title: str
    formula: str = Field(description="LaTeX")
    parameters: list[EffectParameter]
    shape_parameters: list[ShapeParameter]
    signature: str = Field(description="What the effect leaves in the residual if a model lacks it")
    sources: list[str]
    confused_with: list[str]
    scope: Literal["joint", "robot"]
    hardware: str = Field(default="", description="The part that the effect is of, if only some robots have it")
    appearance: str = Field(default="", description="What the data show of such an effect, whatever its cause")


class Catalogue(ViewModel):
    """All effects."""

    items: list[EffectView]


class ErrorFigures(ViewModel):
    """Errors of a model on rows: rms in N m or N, relative as ||y − ŷ|| / ||y||; null if a joint has no such row."""

    rms: list[float | None] = Field(description="Per joint")
    relative: list[float | None] = Field(description="Per joint")
    relative_total: float | None


class ErrorsView(ErrorFigures):
    """Errors of a model on data: on all rows; at standstill, the distance to the range of static friction."""

    moving: ErrorFigures | None = Field(
        default=None, description="On the rows where each joint moves; null if not computed"
    )
    sigma: list[float | None] | None = Field(default=None, description="Standard deviation of the residual per joint")


class UsedPreprocessing(ViewModel):
    """The filters that were used, and why."""

    position_cutoff: float | None
    torque_cutoff: float | None
    decimation: int
    filter_order: int
    reasons: list[str]


class ContactDetectionView(ViewModel):
    """Thresholds of a momentum observer, and the force at the tool that they detect as it happens."""

    force: float = Field(
        description="N, in 95 % of the directions and postures of the held-out motion, while a joint moves"
    )
    force_at_rest: float | None = Field(
        default=None, description="N, where all joints are slow or have just been; null: that does not come up"
    )
    within: float = Field(description="Seconds within which it shows")
    false_alarms_an_hour: float = Field(description="The rate that the thresholds are made for")
    requested: float = Field(
        default=1.0, description="The rate that was asked for: smaller where the held-out motion is too short for it"
    )
    gain: float = Field(description="Bandwidth of the observer, 1/s")
    speeds: list[list[float | None]] = Field(description="rad/s or m/s between three classes of speed, per joint")
    thresholds: list[list[float | None]] = Field(
        description="N m or N, per joint: slow or just slow before, then by class of speed; null: too few data"
    )
    seconds: float = Field(description="Duration of the held-out motion that it was computed from")


class DriftView(ViewModel):
    """Drift of an open-loop simulation under the measured torque, root mean square over many starts.

    null if it diverged, or if no interval of the held-out data is that long.
    """

    joint_names: list[str]
    after: list[float] = Field(description="s")
    distance: list[list[float | None]] = Field(description="rad or m, after each time, per joint")
    speed: list[list[float | None]] = Field(default=[], description="The same of the velocity, rad/s or m/s")
    share: list[list[float | None]] = Field(description="Divided by the joint's travel in that time")
    starts: int
