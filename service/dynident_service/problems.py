"""Errors as RFC 9457 `application/problem+json`: what is wrong, where, and what would be right."""

from __future__ import annotations

import re
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any, TypedDict, Unpack

from pydantic import BaseModel, Field
from pydantic_core import ErrorDetails

from dynident.errors import DynidentError

MEDIA_TYPE = "application/problem+json"
MOST_FIELDS = 100
"""As many wrong fields are told one by one; all of them would be larger than the request."""
_NOWHERE = object()


class ProblemField(BaseModel):
    """One field, column or parameter that is wrong."""

    pointer: str = Field(description="A JSON pointer into the body, a column of a file, or the name of a parameter.")
    detail: str
    row: int | None = Field(default=None, description="Data row of a file, from 1")
    time: float | None = Field(default=None, description="Seconds of t")


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
    dependents: list[Dependent] | None = Field(default=None, description="On 409: what has to be deleted first.")
    dependents_count: int | None = Field(default=None, description="On 409: how many there are; not all are listed.")
    checks: list[dict[str, Any]] | None = Field(default=None, description="All that was found in a file.")
    request_id: str | None = Field(default=None, description="Under which the service's log tells of the request.")


class Further(TypedDict, total=False):
    """What else a problem may say."""

    errors: list[ProblemField] | None
    dependents: list[Dependent] | None
    dependents_count: int | None
    checks: list[dict[str, Any]] | None
    request_id: str | None


class ProblemError(Exception):
    """Ends a request with a problem."""

    retry_after = "1"
    """Seconds after which the same request may be right, where the status says that it may."""

    def __init__(self, status: int, detail: str, *, title: str = "", **more: Unpack[Further]) -> None:
        super().__init__(detail)
        self.problem = make_problem(status, detail, title=title, **more)

    @classmethod
    def of(cls, problem: Problem) -> ProblemError:
        """End a request with a problem that is there already."""
        error = cls(problem.status, problem.detail)
        error.problem = problem
        return error


def make_problem(status: int, detail: str, *, title: str = "", **more: Unpack[Further]) -> Problem:
    """Make a problem whose type follows from its title, so that programs can tell kinds apart."""
    title = title or HTTPStatus(status).phrase
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    return Problem(type=f"urn:dynident:problem:{slug}", title=title, status=status, detail=detail, **more)


def not_found(kind: str, identifier: str) -> ProblemError:
    """Say that there is no such resource."""
    return ProblemError(404, f"There is no {kind} {identifier!r}.", title="Not found")


def unusable(detail: str, pointer: str, *, title: str = "Unusable input") -> ProblemError:
    """Say that one field of the request is wrong."""
    return ProblemError(422, detail, title=title, errors=[ProblemField(pointer=pointer, detail=detail)])


def problem_of(error: DynidentError | ProblemError) -> Problem:
    """Turn an error that the user can mend into a problem, if it is none yet."""
    if isinstance(error, ProblemError):
        return error.problem
    fields = [ProblemField(pointer=error.pointer, detail=error.detail)]
    return make_problem(422, error.detail, title=error.title, errors=fields)


def pointer_of(location: Sequence[int | str], error_type: str, body: object) -> str:
    """Turn pydantic's location of an error into a JSON pointer; the query and the path give the parameter's name.

    Pydantic puts the name of a union's member into the location; what is not in the body is therefore passed over,
    but for the field that is missing there.
    """
    first, *rest = location or ("body",)
    if first != "body":
        return ".".join(str(part) for part in rest)
    kept = []
    for index, part in enumerate(rest):
        inside = _inside(body, part)
        is_missing = error_type == "missing" and index == len(rest) - 1
        if inside is not _NOWHERE or is_missing:
            kept.append(str(part).replace("~", "~0").replace("/", "~1"))
        body = body if inside is _NOWHERE else inside
    return "".join(f"/{part}" for part in kept)


def _inside(body: object, part: int | str) -> object:
    if isinstance(body, dict):
        return body.get(part, _NOWHERE)
    if isinstance(body, list) and isinstance(part, int) and part < len(body):
        return body[part]
    return _NOWHERE


def fields_of(errors: Sequence[ErrorDetails], body: object, prefix: str = "") -> list[ProblemField]:
    """Turn pydantic's errors into the fields of a problem; several for one pointer are joined."""
    joined: dict[str, list[str]] = {}
    for error in errors:
        location: Sequence[int | str] = error["loc"]
        if error["type"] == "json_invalid":
            location = ("body",)
            detail = f"the body is not JSON: {error.get('ctx', {}).get('error', 'it cannot be parsed')}"
        elif error["type"] == "model_attributes_type" and location in (("body",), ["body"]):
            detail = "the body is no JSON object, or is not said to be one: send content-type: application/json"
        elif error["type"] == "extra_forbidden":
            detail = f"there is no field {location[-1]!r}"
        else:
            detail = str(error["msg"]).removeprefix("Value error, ")
        pointer = prefix + pointer_of(location, error["type"], body)
        details = joined.setdefault(pointer, [])
        if detail not in details:
            details.append(detail)
    return [ProblemField(pointer=pointer, detail="; or ".join(details)) for pointer, details in joined.items()]


def validation_problem(fields: list[ProblemField]) -> Problem:
    """Make the problem of a request that does not have the form that the contract asks for."""
    summary = "; ".join(f"{field.pointer or 'body'}: {field.detail}" for field in fields[:5])
    more = f"; and {len(fields) - 5} more" if len(fields) > 5 else ""
    told = fields[:MOST_FIELDS]
    return make_problem(422, summary + more, title="Request does not fit the contract", errors=told)
