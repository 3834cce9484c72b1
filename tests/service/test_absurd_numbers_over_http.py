"""A number that nobody means, anywhere in a body or an address, is answered by 4xx or taken: never by 500."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient
from support.one_joint_robots import one_joint_urdf
from support.openapi_contract import CONTRACT

from dynident_client import Client

ABSURD = ("1e300", "1e-300", "Infinity", "-Infinity", "NaN", "-1", "0", str(2**70), "1e999", "9" * 5000)
NONE = "xxx_01m8dfgap685y6e1s7z5jh44kp"


def _schemas(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A schema's own alternatives, references followed."""
    if "$ref" in schema:
        yield from _schemas(CONTRACT["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]])
    elif "anyOf" in schema or "oneOf" in schema:
        for one in schema.get("anyOf", schema.get("oneOf", [])):
            yield from _schemas(one)
    else:
        yield schema


def state_kind(schema: dict[str, Any], name: str) -> str:
    """The kind by which one of several schemas is chosen, as a body states it before its other fields."""
    kind = schema["properties"].get("kind", {}).get("const")
    return f'"kind": "{kind}", ' if kind and name != "kind" else ""


def _bodies(schema: dict[str, Any], depth: int = 0) -> Iterator[str]:
    """JSON texts that hold one number for "@"; everything else is left out."""
    for one in _schemas(schema):
        kind = one.get("type")
        if kind in ("number", "integer"):
            yield "@"
        elif kind == "array" and depth < 8:
            count = one.get("minItems", 1) if "prefixItems" in one else 1
            for item in one.get("prefixItems", [one.get("items", {})])[:1]:
                yield from (f"[{', '.join([text] + ['1'] * (count - 1))}]" for text in _bodies(item, depth + 1))
        elif kind == "object" and depth < 8:
            for name, inner in one.get("properties", {}).items():
                yield from (f'{{{state_kind(one, name)}"{name}": {text}}}' for text in _bodies(inner, depth + 1))
            if isinstance(one.get("additionalProperties"), dict):
                yield from (f'{{"axis": {text}}}' for text in _bodies(one["additionalProperties"], depth + 1))


def _operations(place: str) -> list[tuple[str, str, str]]:
    """Method, path and the name of every numeric parameter, or every body with one number."""
    found = []
    for path, methods in CONTRACT["paths"].items():
        for method, operation in methods.items():
            if place == "query":
                found += [
                    (method, path, one["name"])
                    for one in operation.get("parameters", [])
                    if one["in"] == "query"
                    and any(s.get("type") in ("number", "integer") for s in _schemas(one["schema"]))
                ]
            else:
                content = operation.get("requestBody", {}).get("content", {})
                if "application/json" in content:
                    found += [(method, path, body) for body in _bodies(content["application/json"]["schema"])]
    return found


def test_the_contract_has_numbers_to_try() -> None:
    assert len(_operations("query")) > 10
    assert len(_operations("body")) > 100


@pytest.mark.parametrize("number", ABSURD)
def test_an_absurd_number_in_an_address_is_no_error_of_ours(client: TestClient, number: str) -> None:
    for method, path, name in _operations("query"):
        address = path
        for part in ("robot", "measurement", "design", "identification", "comparison", "diagnosis", "series", "job"):
            address = address.replace(f"{{{part}_id}}", NONE)
        answer = client.request(method, address, params={name: number})
        assert answer.status_code < 500, (method, path, name, answer.text)


@pytest.mark.sweep
@pytest.mark.parametrize("number", ABSURD)
def test_an_absurd_number_in_a_body_is_no_error_of_ours(client: TestClient, robot: dict[str, Any], number: str) -> None:
    for method, path, body in _operations("body"):
        if method != "post":
            continue
        text = body.replace("@", number)
        needed = {"robot_id": robot["id"], "measurement_ids": [NONE], "identification_id": NONE}
        stated = ", ".join(
            f'"{name}": {json.dumps(value)}' for name, value in needed.items() if f'"{name}"' not in text
        )
        for sent in (text, f"{{{stated}, {text[1:]}" if text.startswith("{") else text):
            answer = client.post(path, content=sent, headers={"content-type": "application/json"})
            assert answer.status_code < 500, (path, sent[:200], answer.text)
            if answer.status_code == 202:
                client.post(f"/v1/jobs/{answer.json()['job_id']}/cancel")


@pytest.mark.slow
def test_an_absurd_number_asked_of_what_there_is_is_no_error_of_ours(live: Client) -> None:
    robot = live.robots.create("pendulum", urdf=one_joint_urdf("pendulum"))
    trajectory = {"duration": 6.0, "sampling_rate": 100.0, "harmonics": 3}
    design = live.designs.create(robot, trajectory=trajectory, starts=1, random_trajectories=1).wait()
    simulation = live.simulations.create(robot, design=design).wait()
    run = live.measurements.get(simulation.result["measurement_id"])
    model = live.identifications.create(robot, [run]).wait()
    comparison, diagnosis = live.comparisons.create(model, run).wait(), live.diagnoses.create(model).wait()
    ids: dict[str, Any] = {"robot": robot, "measurement": run, "design": design, "identification": model}
    ids |= {"comparison": comparison, "diagnosis": diagnosis, "job": simulation}
    needed = {
        "joint": "axis",
        "against": "q_axis",
        "variable": "q_axis",
        "signals": "q_axis",
        "rank": 1,
        "format": "csv",
    }
    answered = set()
    for method, path, name in _operations("query"):
        address = path
        for part, one in ids.items():
            address = address.replace(f"{{{part}_id}}", one.id if part != "job" else one.job_id)
        if "{" in address or "events" in address:
            continue
        known = [one["name"] for one in CONTRACT["paths"][path][method]["parameters"]]
        for number in ABSURD:
            asked = {key: value for key, value in needed.items() if key in known} | {name: number}
            answer = live._transport._http.request(method, address, params=asked)
            assert answer.status_code < 500, (method, path, asked, answer.text)
            answered |= {(path, name)} if answer.is_success else set()
    assert len(answered) >= 5, answered
