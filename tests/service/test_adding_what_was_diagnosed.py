"""Adding an effect that a diagnosis has found: as it is recommended, as it is ranked, and by its name alone."""

from __future__ import annotations

import pytest

from dynident.robot import library_table
from dynident_client import Client

pytestmark = pytest.mark.slow


def test_a_ripple_is_added_as_it_was_found_and_by_its_name_alone_with_the_wave_that_was_found(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    joint = robot.joints[0]["name"]
    drive = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    hidden = {
        "effect": "torque_ripple",
        "joints": [joint],
        "parameters": {"Ac": 2.0, "As": 1.0},
        "shape_parameters": {"k": 17.0},
    }
    trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
    runs = []
    for seed in (1, 2):
        made = live.simulations.create(robot, effects=[*drive, hidden], seed=seed, trajectory=trajectory).wait()
        runs.append(live.measurements.get(made.result["measurement_id"]))
    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    diagnosis = live.diagnoses.create(model).wait()
    found = diagnosis.result["recommended"][0]
    assert (found["effect"], found["joints"]) == ("torque_ripple", [joint])

    ranked = diagnosis.result["candidates"][0]
    carried = {key: ranked[key] for key in ("effect", "joints", "shape_parameters", "runs")}
    assert found == {**carried, "question": ""}
    for added in (found, {"effect": "torque_ripple", "joints": [joint]}):
        better = live.identifications.extend(model, [added]).wait()
        assert better.result["effects"][-1]["shape_parameters"] == found["shape_parameters"]
        assert better.result["validation"]["relative_total"] < 0.7 * model.result["validation"]["relative_total"]


def test_held_out_recordings_of_other_days_refuse_nothing(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    drive = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    new = {
        "effect": "torque_ripple",
        "joints": [robot.joints[0]["name"]],
        "parameters": {"Ac": 2.0, "As": 1.0},
        "shape_parameters": {"k": 17.0},
    }
    trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
    runs = []
    for seed, effects in ((1, drive), (2, drive), (3, [*drive, new])):
        made = live.simulations.create(robot, effects=effects, seed=seed, trajectory=trajectory).wait()
        runs.append(live.measurements.get(made.result["measurement_id"]))
    model = live.identifications.create(robot, runs[:1], validation=runs[1:2]).wait()
    later = live.diagnoses.create(model, measurements=runs[2:]).wait()
    assert [found["effect"] for found in later.result["recommended"]] == ["torque_ripple"]
    # The recording that was held out can be diagnosed itself.
    assert live.diagnoses.create(model, measurements=runs[1:2]).wait().result["recommended"] == []
