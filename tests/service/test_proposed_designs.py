"""The design that a diagnosis proposes is one that the service accepts, as it is."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for

from dynident.advice import NextExperiment, Separation
from dynident.advice.discriminating_experiments import EXPERIMENTS, Question
from dynident.effects import EffectChoice
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import library_table
from dynident_service.designs.adapters import to_checked_request, to_design_request
from dynident_service.designs.wire_types import DesignRequest
from dynident_service.diagnoses.adapters import restore_next_experiment, show_next_experiment
from dynident_service.diagnoses.wire_types import NextExperiment as Shown
from dynident_service.robots.adapters import restore_robot
from dynident_service.robots.wire_types import RobotRequest

PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
PAIRS = {
    "constant_speeds": (("stribeck", {"vs": 0.1}), ("viscous_nonlinear", {"p": 2.0})),
    "reversals": (("presliding", {"d0": 0.004}), ("stribeck", {"vs": 0.05})),
    "slow_sweep": (("torque_ripple", {"k": 20.0}), ("joint_spring", {})),
    "with_payload": (("load_dependent_friction", {}), ("drive_gain_saturation", {})),
    "paces": (("torque_delay", {}), ("joint_elasticity", {})),
    "whole_range": (("base_tilt", {}), ("offset", {})),
}


@pytest.fixture(scope="module")
def scara(client: TestClient) -> dict[str, Any]:
    body = {"name": "scara", "description": {"format": "modified_dh", "content": library_table("scara")}}
    return {"asked": body, **client.post("/v1/robots", json=body).json()}


def advice(robot: dict[str, Any], name: str) -> NextExperiment:
    machine = restore_robot(RobotRequest.model_validate(robot["asked"]).model_dump(mode="json"))
    joint = machine.joint_names[1]
    whole = ("base_tilt", "torque_delay")
    suspect, rival = (
        EffectChoice(effect, () if effect in whole else (joint,), tuple(shape.items())) for effect, shape in PAIRS[name]
    )
    noise = dict.fromkeys(machine.joint_names, 0.1)
    question = Question(PLAIN, suspect, rival, (joint,), build_bounds(machine, {}), noise, 200.0)
    known = Separation("Fst2", "N m", 0.1, float("inf"), None)
    return NextExperiment("It tells.", EXPERIMENTS[name].design(question), known, known, ("Do it.",))


@pytest.mark.parametrize("name", PAIRS)
def test_a_proposed_design_is_accepted_as_it_is(client: TestClient, scara: dict[str, Any], name: str) -> None:
    proposed = show_next_experiment(advice(scara, name), scara["id"])
    assert {"robot_id", "kind", "effects", "criterion", "trajectory"} <= set(proposed.design)
    answer = client.post("/v1/designs", json=proposed.design)
    assert answer.status_code == 202, answer.text
    client.post(f"/v1/jobs/{answer.json()['job_id']}/cancel")
    # Nothing of the wish is lost on the wire.
    robot = restore_robot(RobotRequest.model_validate(scara["asked"]).model_dump(mode="json"))
    assert to_checked_request(DesignRequest.model_validate(proposed.design), robot) == advice(scara, name).design


def test_a_proposed_design_counts_the_measurements_at_hand(scara: dict[str, Any]) -> None:
    body = show_next_experiment(advice(scara, "reversals"), scara["id"], ["mea_1", "mea_2"], "idn_1").design
    assert body["earlier_ids"] == ["mea_1", "mea_2"]
    assert body["identification_id"] == "idn_1"
    assert to_design_request(DesignRequest.model_validate(body)) == advice(scara, "reversals").design


def test_a_proposed_experiment_is_stored_and_read_back(scara: dict[str, Any]) -> None:
    found = advice(scara, "reversals")
    stored = show_next_experiment(found, scara["id"]).model_dump(mode="json")
    assert stored["present_separation"]["standard_deviation"] is None
    assert restore_next_experiment(Shown.model_validate(stored)) == found


def test_what_older_diagnoses_proposed_can_still_be_read() -> None:
    old = {"reason": "It tells.", "design": {"robot_id": "rob_1", "kind": "constant_velocity"}}
    found = restore_next_experiment(Shown.model_validate(old))
    assert found.design == to_design_request(DesignRequest.model_validate(old["design"]))
    assert found.expected_separation is None


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"criterion": {"name": "separation", "effects": [{"effect": "magic"}]}}, "/criterion/effects/0"),
        ({"criterion": {"name": "separation"}}, "/criterion/effects"),
        ({"criterion": {"name": "parameters"}}, "/criterion/parameters"),
        ({"trajectory": {"paces": [2.0]}}, "/trajectory/paces/0"),
        ({"kind": "reversals", "trajectory": {"amplitudes": [-1.0]}}, "/trajectory/amplitudes/0"),
    ],
)
def test_a_wish_that_cannot_be_met_is_refused_by_its_place(
    client: TestClient, scara: dict[str, Any], change: dict[str, Any], pointer: str
) -> None:
    answer = client.post("/v1/designs", json={"robot_id": scara["id"], **change})
    assert answer.status_code == 422
    assert pointer in [one["pointer"] for one in answer.json()["errors"]]


def wait(client: TestClient, path: str) -> dict[str, Any]:
    def ended() -> Any:
        shown = client.get(path).json()
        return shown if shown["status"] in ("succeeded", "failed") else None

    shown = wait_for(ended, 120.0)
    assert shown["status"] == "succeeded", shown
    return dict(shown)


def test_the_next_experiment_is_computed_when_it_is_asked_for(client: TestClient, scara: dict[str, Any]) -> None:
    def create(path: str, body: dict[str, object]) -> str:
        answer = client.post(path, json=body)
        assert answer.status_code == 202, answer.text
        return f"{path}/{answer.json()['id']}"

    motion = {"duration": 8.0, "sampling_rate": 200.0}
    simulation = wait(client, create("/v1/simulations", {"robot_id": scara["id"], "trajectory": motion}))["result"]
    told = {"robot_id": scara["id"], "measurement_ids": [simulation["measurement_id"]]}
    model = wait(client, create("/v1/identifications", told))["id"]
    # This motion does not show the effect, which is asked for.
    asked = {"identification_id": model, "candidates": ["load_dependent_friction"]}
    diagnosis = create("/v1/diagnoses", asked)
    result = wait(client, diagnosis)["result"]
    assert [doubt["suspect"]["effect"] for doubt in result["doubts"]] == ["load_dependent_friction"]
    assert result["next_experiment"] is None
    address = client.post(f"{diagnosis}/next_experiment").headers["location"]
    assert client.post(f"{diagnosis}/next_experiment").headers["location"] == address
    experiment = wait(client, address)["result"]["experiment"]
    assert "Load-dependent Coulomb friction" in experiment["reason"]
    assert experiment["design"]["identification_id"] == model
    assert client.get(diagnosis).json()["result"]["next_experiment"] == experiment
    assert client.get("/v1/next_experiments").json()["items"][0]["result"]["experiment"] == experiment
    # The search belongs to the diagnosis, and goes with it, unless something else needs the diagnosis.
    report = create("/v1/reports", {"identification_id": model, "diagnosis_id": diagnosis.rsplit("/", 1)[1]})
    assert client.delete(diagnosis).status_code == 409
    assert client.get(address).status_code == 200
    wait(client, report)
    assert client.delete(report).status_code == 204
    assert client.delete(diagnosis).status_code == 204
    assert client.get(address).status_code == 404
