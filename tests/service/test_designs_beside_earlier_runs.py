"""Designs over HTTP that complement earlier runs, for another model's rows, and as a message for ROS 2."""

from __future__ import annotations

import pytest
import yaml

from dynident.robot import library_table
from dynident_client import Client, ProblemError

SMALL = {"duration": 6.0, "harmonics": 3, "sampling_rate": 50.0}


@pytest.mark.slow
def test_a_design_complements_a_run_and_goes_to_ros2(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    drives = [{"effect": "coulomb"}, {"effect": "viscous"}]
    simulation = live.simulations.create(robot, effects=drives, seed=1, trajectory={**SMALL, "sampling_rate": 200.0})
    run = simulation.wait().result["measurement_id"]
    quick = {"trajectory": SMALL, "starts": 1, "random_trajectories": 5}
    noise = dict.fromkeys((joint["name"] for joint in robot.joints), 1.0)
    alone = live.designs.create(robot, **quick, noise=noise).wait().result
    design = live.designs.create(robot, **quick, noise=noise, earlier_ids=[run]).wait()
    expected = [
        [one["standard_deviation"] for one in result["expected_parameters"]] for result in (alone, design.result)
    ]
    assert sum(after < before for before, after in zip(*expected, strict=True)) > 0.7 * len(expected[0])
    message = yaml.safe_load(live.designs.trajectory(design, "ros2"))
    assert message["joint_names"] == design.result["joints"]
    assert len(message["points"]) == design.result["n_samples"]
    # A run that a design rests on stays.
    with pytest.raises(ProblemError) as refused:
        live.measurements.delete(run)
    assert refused.value.status == 409
    power = live.designs.create(robot, **quick, model="power").wait().result
    assert power["criterion_values"]["condition_number"] > design.result["criterion_values"]["condition_number"]


@pytest.mark.slow
def test_torque_limits_of_a_design_count_the_friction_of_a_model(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    drives = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    simulation = live.simulations.create(robot, effects=drives, seed=1, trajectory={**SMALL, "sampling_rate": 200.0})
    run = live.measurements.get(simulation.wait().result["measurement_id"])
    model = live.identifications.create(robot, [run]).wait()
    quick = {"trajectory": SMALL, "kind": "random", "random_trajectories": 3}
    design = live.designs.create(robot, **quick, identification_id=model.id).wait()
    assert any("by the identified model" in note for note in design.result["notes"])
    # The model that a design rests on stays.
    with pytest.raises(ProblemError) as refused:
        live.identifications.delete(model)
    assert refused.value.status == 409
    other = live.robots.create("panda", modified_dh=library_table("franka_panda"))
    for machine, identifier in ((other, model.id), (robot, "idn_nothing")):
        with pytest.raises(ProblemError) as refused:
            live.designs.create(machine, **quick, identification_id=identifier)
        assert refused.value.status == 422
        assert refused.value.errors[0]["pointer"] == "/identification_id"


def test_designs_for_what_there_is_not_are_refused_with_the_field(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    for wrong, pointer in (
        ({"model": "base_wrench"}, "/model"),
        ({"kind": "constant_velocity", "model": "energy"}, "/model"),
        ({"earlier_ids": ["mea_nothing"]}, "/earlier_ids/0"),
    ):
        with pytest.raises(ProblemError) as refused:
            live.designs.create(robot, **wrong)
        assert refused.value.status == 422
        assert refused.value.errors[0]["pointer"] == pointer


@pytest.mark.slow
def test_a_report_shows_what_the_design_promised_beside_what_was_achieved(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    noise = dict.fromkeys((joint["name"] for joint in robot.joints), 0.5)
    drives = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    quick = {"trajectory": {**SMALL, "sampling_rate": 200.0}, "starts": 1, "random_trajectories": 5}
    design = live.designs.create(robot, **quick, noise=noise).wait()
    run = live.simulations.create(robot, effects=drives, seed=1, design=design).wait().result["measurement_id"]
    model = live.identifications.create(robot, [live.measurements.get(run)]).wait()
    report = live.reports.create(model, design=design).wait()
    page = live.reports.content(report).decode()
    assert "Promised and achieved" in page
    assert "The experiment" in page
    other = live.robots.create("another", modified_dh=library_table("scara"))
    stranger = live.designs.create(other, kind="random", **quick).wait()
    with pytest.raises(ProblemError) as refused:
        live.reports.create(model, design=stranger)
    assert refused.value.errors[0]["pointer"] == "/design_id"
