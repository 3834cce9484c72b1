"""What has changed since another day, through the contract."""

from __future__ import annotations

import pytest

from dynident.robot import library_table
from dynident_client import Client, ProblemError

pytestmark = pytest.mark.slow


def test_a_mass_that_was_mounted_is_told_with_its_link_and_interval_and_an_unchanged_robot_as_such(
    live: Client,
) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    drive = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    link = robot.joints[1]["name"]
    mass = {"effect": "payload", "joints": [link], "parameters": {"Mp": 2.0, "MXp": 0.4, "ZZp": 0.09}}
    runs = []
    for seed, effects in ((1, drive), (2, drive), (3, [*drive, mass])):
        trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
        made = live.simulations.create(robot, effects=effects, seed=seed, trajectory=trajectory).wait()
        runs.append(live.measurements.get(made.result["measurement_id"]))
    first, same, loaded = runs
    model = live.identifications.create(robot, [first]).wait()
    found = live.diagnoses.create(model, measurements=[loaded], baseline=[first, same]).wait()
    (change,) = found.result["changes"]
    assert (change["effect"], change["joints"]) == ("payload", [link])
    assert change["p_value"] <= 0.01
    low, high = change["interval"]
    assert low < change["value"] < high
    assert change["unit"] in ("kg", "kg m")
    assert change["evidence"]
    # What friction did is told of each joint, which nothing has worn here.
    assert [one["joint"] for one in found.result["friction"]] == [one["name"] for one in robot.joints]
    assert all(abs(one["value"]) < 0.1 * one["before"] for one in found.result["friction"])
    drawn = live.diagnoses.evidence(found, rank=1)
    assert drawn["error_drop"] == found.result["candidates"][0]["error_drop"] > 0.2
    assert drawn["explained"] > 0.3

    quiet = live.diagnoses.create(model, measurements=[same], baseline=[first]).wait()
    assert quiet.result["changes"] == []
    alone = live.diagnoses.create(model, measurements=[same]).wait().result
    assert (alone["changes"], alone["friction"]) == (None, [])
    # A report of it holds the table.
    report = live.reports.create(model, diagnosis=found).wait()
    written = live.reports.content(report).decode()
    assert "Changes since the baseline" in written
    assert "Friction of each joint since the baseline" in written


def test_a_baseline_that_is_not_there_or_of_another_robot_is_refused_with_its_place(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    trajectory = {"duration": 6.0, "periods": 1, "sampling_rate": 100.0}
    made = live.simulations.create(robot, effects=[{"effect": "coulomb"}], trajectory=trajectory).wait()
    run = live.measurements.get(made.result["measurement_id"])
    model = live.identifications.create(robot, [run]).wait()
    for measurements in ([run], None):
        with pytest.raises(ProblemError) as refused:
            live.diagnoses.create(model, measurements=measurements, baseline=[run])
        assert refused.value.errors[0]["pointer"] == "/baseline_ids/0"
        assert "as an earlier and as a later measurement" in refused.value.detail
    with pytest.raises(ProblemError) as refused:
        live.diagnoses.create(model, measurements=[run], baseline=["nowhere"])
    assert refused.value.status in (404, 422)
    assert any("/baseline_ids/0" in str(one) for one in refused.value.problem.get("errors", [refused.value.problem]))
