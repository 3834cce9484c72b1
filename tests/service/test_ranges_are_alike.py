"""A number is refused alike, and in the same words, by the library, over HTTP and on the command line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, fields
from math import inf, nextafter
from typing import Any, get_type_hints

import pytest
import typer
from fastapi.testclient import TestClient
from test_absurd_numbers_over_http import CONTRACT, NONE, _bodies, state_kind

from dynident.errors import DynidentError
from dynident.excitation import DesignRequest
from dynident.identification import IdentificationChoices
from dynident.schema.fields import get_description
from dynident_cli.program_and_exit_codes import app
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_service.measurements.wire_types import MeasurementMetadata
from dynident_service.problems import to_problem_fields
from dynident_service.shared.request_bodies import REQUESTS

RANGE = "it must be "
REQUESTS_BY_SCHEMA = {model.__name__: science for model, science in REQUESTS.items()}


@dataclass(frozen=True)
class Leaf:
    """A number in a body: what holds it, the body with "@" in its place, the field's part of it, and its schema."""

    owner: str
    field: str
    body: str
    value: str
    schema: dict[str, Any]
    pointer: str


def leaves(
    schema: dict[str, Any], owner: str = "", wrap: str = "@", pointer: str = "", depth: int = 0
) -> Iterator[Leaf]:
    if "$ref" in schema:
        owner = schema["$ref"].rsplit("/", 1)[1]
        schema = CONTRACT["components"]["schemas"][owner]
    for part in schema.get("anyOf", schema.get("oneOf", [])):
        yield from leaves(part, owner, wrap, pointer, depth)
    if depth > 8:
        return
    for name, inner in schema.get("properties", {}).items():
        inside = wrap.replace("@", f'{{{state_kind(schema, name)}"{name}": @}}')
        for value, part, place in _numbers(inner):
            yield Leaf(
                owner.removesuffix("-Input"), name, inside.replace("@", value), value, part, f"{pointer}/{name}{place}"
            )
        for deeper, text, place in _objects(inner):
            yield from leaves(deeper, owner, inside.replace("@", text), f"{pointer}/{name}{place}", depth + 1)


def _parts(schema: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str, str]]:
    """What a field holds directly, in lists or by name: its schema, the JSON around it, and the rest of the pointer."""
    for part in schema.get("anyOf", schema.get("oneOf", [schema])):
        if part.get("type") == "array":
            inner, count = (part.get("prefixItems") or [part.get("items", {})])[0], part.get("minItems", 1)
            filler = [", 1"] * (count - 1 if "prefixItems" in part else 0)
            for deeper, text, place in _parts(inner):
                yield deeper, f"[{text}{''.join(filler)}]", f"/0{place}"
        elif isinstance(part.get("additionalProperties"), dict):
            for deeper, text, place in _parts(part["additionalProperties"]):
                yield deeper, f'{{"axis": {text}}}', f"/axis{place}"
        else:
            yield part, "@", ""


def _numbers(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], str]]:
    return ((text, part, place) for part, text, place in _parts(schema) if part.get("type") in ("number", "integer"))


def _objects(schema: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str, str]]:
    return ((part, text, place) for part, text, place in _parts(schema) if "$ref" in part)


def edges(schema: dict[str, Any]) -> Iterator[tuple[float, bool]]:
    """Numbers at both ends of a range, each with whether it is within."""
    whole = schema["type"] == "integer"
    for end, side, exclusive in (
        (schema.get("minimum", schema.get("exclusiveMinimum")), -inf, "exclusiveMinimum" in schema),
        (schema.get("exclusiveMaximum", schema.get("maximum")), inf, "exclusiveMaximum" in schema),
    ):
        assert end is not None, schema
        beyond = int(end) + (1 if side > 0 else -1) if whole else nextafter(end, side)
        before = int(end) - (1 if side > 0 else -1) if whole else nextafter(end, -side)
        yield (int(end) if whole else float(end)), not exclusive
        yield (before if exclusive else beyond), exclusive
    if "not" in schema:
        yield 0, False


def operations() -> Iterator[tuple[str, str, Leaf]]:
    for path, methods in CONTRACT["paths"].items():
        for method, operation in methods.items():
            content = operation.get("requestBody", {}).get("content", {})
            if "application/json" in content:
                address = "/".join(NONE if part.startswith("{") else part for part in path.split("/"))
                yield from ((method, address, leaf) for leaf in leaves(content["application/json"]["schema"]))


def refusal(problems: list[dict[str, Any]], pointer: str) -> str | None:
    """What is said of a number at a place of a body; None where nothing is."""
    return next((one["detail"] for one in problems if one["pointer"] == pointer), None)


def refused_by_library(science: type, field: str, value: str, number: float) -> str | None:
    """What the library says of a number; None where it takes it, or refuses it for another reason than its range."""

    def usual(one: Field[Any]) -> object:
        return "x" if one.type == "str" else (1.0, 1.0, 1.0)

    needed = {
        one.name: usual(one) for one in fields(science) if one.default is MISSING and one.default_factory is MISSING
    }
    try:
        science(**{**needed, field: _to_tuples(json.loads(value.replace("@", repr(number))))})
    except DynidentError as error:
        return error.detail if RANGE in error.detail else None
    return None


def _to_tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _to_tuples(item) for name, item in value.items()}
    return tuple(_to_tuples(item) for item in value) if isinstance(value, list) else value


def same_range(first: str | None, second: str | None) -> bool:
    ranges = [None if one is None else one.partition(RANGE)[2].partition(";")[0] for one in (first, second)]
    return ranges[0] == ranges[1] != ""


def test_the_walk_through_the_bodies_sees_every_number() -> None:
    seen = list(operations())
    texts = {leaf.body for _, _, leaf in seen}
    assert len(seen) > 100
    # What a recording measured may be any number.
    measured = {"/v1/measurements/{measurement_id}/rows"}
    assert measured <= set(CONTRACT["paths"])
    for path in set(CONTRACT["paths"]) - measured:
        for operation in CONTRACT["paths"][path].values():
            content = operation.get("requestBody", {}).get("content", {}).get("application/json", {"schema": {}})
            assert {text.replace(" ", "") for text in _bodies(content["schema"])} <= {
                one.replace(" ", "") for one in texts
            }


@pytest.mark.slow
def test_every_number_of_a_body_is_refused_alike_over_http_and_by_the_library(client: TestClient) -> None:
    wrong = []
    asked_of_library = set()
    for method, address, leaf in operations():
        for number, is_within in edges(leaf.schema):
            body = leaf.body.replace("@", repr(number))
            answer = client.request(method, address, content=body, headers={"content-type": "application/json"})
            told = refusal(answer.json().get("errors") or [], leaf.pointer) if answer.status_code == 422 else None
            if (told is None) != is_within:
                wrong.append(f"{method} {address} {body}: {told}")
            science = REQUESTS_BY_SCHEMA.get(leaf.owner)
            if science is not None and leaf.field in {one.name for one in fields(science)}:
                asked_of_library.add((science, leaf.field))
                said = refused_by_library(science, leaf.field, leaf.value, number)
                if not same_range(said, told):
                    wrong.append(f"{science.__name__}.{leaf.field} = {number}: {said} / {told}")
    assert not wrong, "\n".join(wrong)
    assert len(asked_of_library) > 60


def test_what_is_said_of_a_file_is_refused_alike() -> None:
    science = REQUESTS[MeasurementMetadata]
    wrong = []
    for leaf in leaves({"$ref": "#/components/schemas/MeasurementMetadata"}):
        for number, is_within in edges(leaf.schema):
            document = json.loads(leaf.body.replace("@", repr(number)))
            told = _refused_by_model(document, leaf.pointer)
            said = refused_by_library(science, leaf.field, leaf.value, number)
            if (told is None) != is_within or not same_range(said, told):
                wrong.append(f"{leaf.field} = {number}: {said} / {told}")
    assert not wrong, "\n".join(wrong)


def _refused_by_model(document: dict[str, Any], pointer: str) -> str | None:
    import pydantic

    try:
        MeasurementMetadata.model_validate({"robot_id": "r", **document})
    except pydantic.ValidationError as error:
        found = [{**one, "loc": ("body", *one["loc"])} for one in error.errors()]
        return refusal([one.model_dump() for one in to_problem_fields(found, document)], pointer)
    return None


COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def options() -> Iterator[tuple[str, type, type, Field[Any], tuple[str, ...]]]:
    """Each option with numbers: verb, request, the part that has the field, the field, and how its value is written."""
    for verb, command in COMMANDS.items():
        hints = get_type_hints(_own(command.callback), include_extras=True)
        for hint in hints.values():
            for marker in getattr(hint, "__metadata__", ()):
                if isinstance(marker, RequestOptions):
                    yield from ((verb, marker.science, *one) for one in _options_of(marker.science, marker.but))


def _own(function: Any) -> Any:
    while hasattr(function, "__wrapped__"):
        function = function.__wrapped__
    return function


def _options_of(science: type, but: tuple[str, ...]) -> Iterator[tuple[type, Field[Any], tuple[str, ...]]]:
    for one in fields(science):
        about = get_description(one)
        if one.name in but or about.option == "-":
            continue
        written = str(one.type)
        if one.default_factory is not MISSING and isinstance(one.default_factory, type) and written[0].isupper():
            made = one.default_factory()
            if hasattr(made, "__dataclass_fields__"):
                yield from _options_of(type(made), ())
                continue
        name = about.option or "--" + one.name.replace("_", "-")
        if "Mapping[str, float]" in written:
            yield science, one, (name, "axis=@")
        elif "tuple[float, float]" in written:
            yield science, one, (name, "@", "1")
        elif "float" in written or written.startswith("int"):
            yield science, one, (name, "@")


def test_every_number_of_an_option_is_refused_alike_on_the_command_line() -> None:
    tried, places, wrong = set(), set(), []
    for verb, science, part, one, words in options():
        about = get_description(one)
        schema = {"type": "integer" if str(one.type).startswith("int") else "number", **about.range_schema}
        for number, _ in edges(schema):
            line = [words[0], *(word.replace("@", repr(number)) for word in words[1:])]
            context = COMMANDS[verb].make_context(verb, line.copy(), resilient_parsing=True)
            value = "[@]" if "tuple[float, ..." in str(one.type) else "[@, 1]" if len(words) == 3 else "@"
            value = '{"axis": @}' if "axis" in words[-1] else value
            said = refused_by_library(part, one.name, value, number)
            try:
                TypedValues(context.params).build_request(science)
                told = None
            except DynidentError as error:
                told = error.detail if RANGE in error.detail else None
                places.add((error.pointer, words[0]))
            tried.add((part, one.name))
            if not same_range(said, told):
                wrong.append(f"dynident {verb} {' '.join(line)}: {said} / {told}")
    assert not wrong, "\n".join(wrong)
    assert len(tried) > 30
    assert all(pointer == option for pointer, option in places)


@pytest.mark.parametrize(
    ("science", "field"), [(IdentificationChoices, "prior_error"), (DesignRequest, "torque_margin")]
)
def test_the_help_shows_the_range(science: type, field: str) -> None:
    about = next(get_description(one) for one in fields(science) if one.name == field)
    verb = "identify" if science is IdentificationChoices else "design"
    option = next(one for one in COMMANDS[verb].params if one.name == field)
    assert option.help == f"{about.sentence} ({about.range_text})."
