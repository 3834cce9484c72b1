from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from support.installed_versions import older_than_locked

import dynident_client
from dynident_service.openapi import (
    ANSWERS_FOLDER,
    DESCRIPTIONS_FILE,
    build_answer_types,
    build_description_types,
    build_request_types,
    render_contract,
)
from dynident_service.openapi import REQUESTS_FILE as TYPES

# Older ones give the same schemas other names.
pytestmark = pytest.mark.skipif(older_than_locked("fastapi"), reason="the contract is written by a newer FastAPI")

FILE = Path(__file__).parents[2] / "openapi" / "openapi.json"


@cache
def rendered() -> str:
    return render_contract()


def test_the_committed_contract_is_what_the_service_does() -> None:
    assert FILE.read_text(encoding="utf-8") == rendered(), "run `python -m dynident_service.openapi`"


def test_the_types_of_the_client_are_those_of_the_contract() -> None:
    # Beside an installed package there are no sources.
    written = Path(dynident_client.__file__).with_name(Path(TYPES).name).read_text(encoding="utf-8")
    assert written == build_request_types(json.loads(rendered())), "run `python -m dynident_service.openapi`"


def test_what_the_client_says_of_robots_and_recordings_is_the_contract_s() -> None:
    written = Path(dynident_client.__file__).with_name(Path(DESCRIPTIONS_FILE).name).read_text(encoding="utf-8")
    assert written == build_description_types(json.loads(rendered())), "run `python -m dynident_service.openapi`"


def test_what_the_client_says_of_answers_is_the_contract_s() -> None:
    folder = Path(dynident_client.__file__).with_name(Path(ANSWERS_FOLDER).name)
    written = {file.name: file.read_text(encoding="utf-8") for file in folder.glob("*.py")}
    assert written == build_answer_types(json.loads(rendered())), "run `python -m dynident_service.openapi`"


def unlimited(schema: Any, components: dict[str, Any], seen: set[str], place: str) -> Iterator[str]:
    """The places of lists, and of objects with whatever names, that may be as long as one likes."""
    if isinstance(schema, list):
        for number, part in enumerate(schema):
            yield from unlimited(part, components, seen, f"{place}/{number}")
    elif isinstance(schema, dict):
        if (name := schema.get("$ref", "").rpartition("/")[2]) and name not in seen:
            seen.add(name)
            yield from unlimited(components[name], components, seen, name)
        is_open = schema.get("type") == "object" and bool(schema.get("additionalProperties", False))
        if (schema.get("type") == "array" and "maxItems" not in schema) or (is_open and "maxProperties" not in schema):
            yield place
        for key, part in schema.items():
            yield from unlimited(part, components, seen, f"{place}/{key}")


def test_every_list_in_a_request_has_a_limit() -> None:
    written = json.loads(rendered())
    seen: set[str] = set()
    operations = [one for path in written["paths"].values() for one in path.values()]
    bodies = [one["requestBody"] for one in operations if "requestBody" in one]
    assert list(unlimited(bodies, written["components"]["schemas"], seen, "")) == []
    assert {"DesignRequest", "MeasurementMetadata", "Body_put_meshes", "Samples"} <= seen


def test_an_effect_named_fifteen_thousand_times_is_refused(client: TestClient, robot: dict[str, Any]) -> None:
    body = {"robot_id": robot["id"], "kind": "random", "effects": [{"effect": "coulomb"}] * 15_000}
    refused = client.post("/v1/designs", json=body)
    assert refused.status_code == 422
    assert [one["pointer"] for one in refused.json()["errors"]] == ["/effects"]
