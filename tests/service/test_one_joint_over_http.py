"""Robots of one joint, whatever their axis hides, from the description to the report, through the client."""

from __future__ import annotations

import pytest
from support.one_joint_robots import ONE_JOINT, one_joint_urdf

from dynident.validation.validation_request import TRIALS
from dynident_client import Client

pytestmark = pytest.mark.slow

SHORT = {"duration": 6.0, "sampling_rate": 100.0, "harmonics": 3}


@pytest.mark.sweep
@pytest.mark.parametrize("name", ONE_JOINT)
def test_a_robot_of_one_joint_goes_the_whole_way(live: Client, name: str) -> None:
    robot = live.robots.create(name, urdf=one_joint_urdf(name))
    assert live.robots.geometry(robot)
    assert live.robots.poses(robot, [[0.1]])
    design = live.designs.create(robot, trajectory=SHORT, starts=1, random_trajectories=2).wait()
    assert design.result["n_samples"] > 600
    assert live.designs.clearances(design)["t"]
    for ending in ("csv", "parquet", "json", "ros2"):
        assert live.designs.trajectory(design, ending)
    drive = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}, {"effect": "stribeck"}]
    runs = []
    for seed, duration in ((1, 6.0), (2, 7.0), (3, 8.0)):
        trajectory = {**SHORT, "duration": duration, "periods": 3}
        simulation = live.simulations.create(robot, effects=drive, seed=seed, trajectory=trajectory).wait()
        runs.append(live.measurements.get(simulation.result["measurement_id"]))
    model = live.identifications.create(robot, runs[:1], validation=runs[1:2]).wait()
    assert model.result["validation"]["relative_total"] < 0.2
    assert live.identifications.essential(model)
    assert live.identifications.correlation(model)
    assert live.identifications.tables(model)
    assert live.identifications.verdict(model)
    diagnosis = live.diagnoses.create(model).wait()
    assert [one["effect"] for one in diagnosis.result["recommended"]] == ["stribeck"]
    better = live.identifications.extend(model, diagnosis.result["recommended"]).wait()
    back = live.identifications.remove(better, [{"effect": "stribeck"}]).wait()
    assert live.identifications.compare_lineages(back, model)["items"]
    comparison = live.comparisons.create(better, runs[2]).wait()
    joint = robot.joints[0]["name"]
    assert live.comparisons.series(comparison, joint)["t"]
    assert live.comparisons.residual_map(comparison, joint, f"q_{joint}")["count"]
    assert live.comparisons.spectrum(comparison, joint, "angle") is not None
    assert live.comparisons.autocorrelation(comparison, joint)["effective_samples"] > 0
    for kind in TRIALS.names:
        if kind != "payload":
            options = {"longest": 3.0} if kind in ("simulation", "filters") else {}
            assert live.validations.create(better, kind, **options).wait().result["verdict"]
    followed = live.series.create(model, [[one] for one in runs]).wait()
    assert live.series.figure(followed)
    changes = live.diagnoses.create(model, measurements=runs[2:], baseline=runs[:1]).wait()
    assert changes.result["verdict"]
    for ending in ("json", "urdf", "mjcf", "c", "casadi"):
        assert live.identifications.export(better, ending, nearest=True)
    for ending in ("html", "pdf", "json"):
        report = live.reports.create(better, diagnosis=diagnosis, design=design, format=ending)
        assert live.reports.content(report.wait())
