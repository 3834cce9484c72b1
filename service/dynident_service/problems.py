"""Type of problems (RFC 9457) and their making from errors; the most wrong fields that one lists (100)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, TypedDict, Unpack

from pydantic import BaseModel, Field
from pydantic_core import ErrorDetails

from dynident.errors import DynidentError, Remedy

MEDIA_TYPE = "application/problem+json"
MOST_FIELDS = 100
"""Upper limit for the wrong fields in a problem; all of them might be larger than the request."""
_NOWHERE = object()


class RemedyView(BaseModel):
    """A field of the metadata, or of the robot, with the value that puts a finding right."""

    field: str
    value: object = Field(description="null, or null in it, where only the user can know it")
    text: str = Field(default="", description="How the sentence writes it")


class ProblemField(BaseModel):
    """One field, column or parameter that is wrong."""

    pointer: str = Field(description="A JSON pointer into the body, a column of a file, or the name of a parameter.")
    detail: str
    row: int | None = Field(default=None, description="Data row of a file, from 1")
    time: float | None = Field(default=None, description="Seconds of t")
    remedies: list[RemedyView] | None = Field(default=None, description="Those that the sentence names")


class Dependent(BaseModel):
    """A resource that rests on another one."""

    id: str
    kind: str


class Problem(BaseModel):
    """The body of every error (RFC 9457)."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[ProblemField] | None = None
    dependents: list[Dependent] | None = Field(
        default=None, description="On 409: the resources that must be deleted first."
    )
    dependents_count: int | None = Field(default=None, description="On 409: their number; not all are listed.")
    checks: list[dict[str, Any]] | None = Field(default=None, description="Everything that was found in a file.")
    request_id: str | None = Field(default=None, description="Id of the request in the log of the service.")


class Further(TypedDict, total=False):
    """Optional members of a problem."""

    errors: list[ProblemField] | None
    dependents: list[Dependent] | None
    dependents_count: int | None
    checks: list[dict[str, Any]] | None
    request_id: str | None


class ProblemError(Exception):
    """Exception that ends a request with a problem."""

    retry_after = "1"
    """Seconds after which the same request may succeed, for status codes that say so."""

    def __init__(self, status: int, detail: str, *, title: str = "", **more: Unpack[Further]) -> None:
        super().__init__(detail)
        self.problem = make_problem(status, detail, title=title, **more)

    @classmethod
    def from_problem(cls, problem: Problem) -> ProblemError:
        """Create the exception for an existing problem."""
        error = cls(problem.status, problem.detail)
        error.problem = problem
        return error


def make_problem(status: int, detail: str, *, title: str = "", **more: Unpack[Further]) -> Problem:
    """Create a problem whose type follows from its title, so that programs can tell kinds apart.

    `detail` says what is wrong and what to do; the title is the phrase of the status by default.
    """
    title = title or HTTPStatus(status).phrase
    # The type is made from the title alone: it stays the same whatever the detail says.
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    return Problem(type=f"urn:dynident:problem:{slug}", title=title, status=status, detail=detail, **more)


def make_not_found(kind: str, identifier: str) -> ProblemError:
    """Return the error for a resource that does not exist."""
    return ProblemError(404, f"There is no {kind} {identifier!r}.", title="Not found")


def make_unusable(detail: str, pointer: str, *, title: str = "Unusable input") -> ProblemError:
    """Return the error for a wrong field of the request."""
    return ProblemError(422, detail, title=title, errors=[ProblemField(pointer=pointer, detail=detail)])


# Fields of requests that name stored resources, by the parameter of the library that takes what they hold.
_FIELDS = {"recordings": "measurement_ids", "validation": "validation_ids"}


def to_problem(error: DynidentError | ProblemError, fields_by_parameter: Mapping[str, str] = _FIELDS) -> Problem:
    """Convert an error that the user can correct into a problem.

    The library points to its own parameters: `fields_by_parameter` names the fields of the request that are called
    otherwise.
    """
    if isinstance(error, ProblemError):
        return error.problem
    root, *inside = error.pointer.split("/")[1:] if error.pointer.startswith("/") else [""]
    pointer = "/".join(["", fields_by_parameter[root], *inside]) if root in fields_by_parameter else error.pointer
    fields = [ProblemField(pointer=pointer, detail=error.detail, remedies=show_remedies(error.remedies) or None)]
    return make_problem(422, error.detail, title=error.title, errors=fields)


def show_remedies(remedies: Sequence[Remedy]) -> list[RemedyView]:
    """Build the views of remedies."""
    return [RemedyView(field=remedy.field, value=_show_value(remedy.value), text=str(remedy)) for remedy in remedies]


def _show_value(value: object) -> object:
    if isinstance(value, Mapping):
        return {name: _show_value(inner) for name, inner in value.items()}
    return None if value is ... else value


def to_pointer(location: Sequence[int | str], error_type: str, body: object) -> str:
    """Convert pydantic's location of an error into a JSON pointer, or into the name of a parameter of query or path.

    Pydantic includes names of union members in the location. Parts that the body does not have are therefore skipped,
    except for the last part of a missing field.
    """
    first, *rest = location or ("body",)
    if first != "body":
        return ".".join(str(part) for part in rest)
    tokens = []
    for index, part in enumerate(rest):
        inside = _get_item(body, part)
        is_missing = error_type == "missing" and index == len(rest) - 1
        if inside is not _NOWHERE or is_missing:
            # RFC 6901 escapes "~" before "/".
            tokens.append(str(part).replace("~", "~0").replace("/", "~1"))
        body = body if inside is _NOWHERE else inside
    return "".join(f"/{part}" for part in tokens)


def _get_item(body: object, part: int | str) -> object:
    if isinstance(body, dict):
        return body.get(part, _NOWHERE)
    if isinstance(body, list) and isinstance(part, int) and part < len(body):
        return body[part]
    return _NOWHERE


def to_problem_fields(errors: Sequence[ErrorDetails], body: object, prefix: str = "") -> list[ProblemField]:
    """Convert pydantic's errors into fields of a problem; several errors for one pointer are joined."""
    joined: dict[str, list[str]] = {}
    for error in errors:
        location: Sequence[int | str] = error["loc"]
        if error["type"] == "json_invalid":
            location = ("body",)
            detail = f"the body is not JSON: {error.get('ctx', {}).get('error', 'it cannot be parsed')}"
        elif error["type"] == "model_attributes_type" and location in (("body",), ["body"]):
            detail = "the body is not a JSON object, or is not marked as one: send content-type: application/json"
        elif error["type"] == "extra_forbidden":
            detail = f"there is no field {location[-1]!r}"
        else:
            # Pydantic puts these words in front of what our own validators say.
            detail = str(error["msg"]).removeprefix("Value error, ")
        pointer = prefix + to_pointer(location, error["type"], body)
        # Each member of a union reports an error of its own for the same place.
        details = joined.setdefault(pointer, [])
        if detail not in details:
            details.append(detail)
    return [ProblemField(pointer=pointer, detail="; or ".join(details)) for pointer, details in joined.items()]


def make_validation_problem(fields: list[ProblemField]) -> Problem:
    """Return the problem of a request that does not conform to the contract."""
    # The sentence is for people and names a few; programs read the list.
    summary = "; ".join(f"{field.pointer or 'body'}: {field.detail}" for field in fields[:5])
    more = f"; and {len(fields) - 5} more" if len(fields) > 5 else ""
    listed = fields[:MOST_FIELDS]
    return make_problem(422, summary + more, title="Request does not fit the contract", errors=listed)
