"""Currents over HTTP: told by parameters in units of current; what does not fit, refused."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from fastapi.testclient import TestClient
from support.oracles import arm, fourier_motion, pinocchio_torque

from dynident.progress import ignore_progress
from dynident.robot import urdf_from_robot
from dynident_client import Client, Computed, ProblemError, Record
from dynident_service.drive_gains.jobs import find_currents
from dynident_service.jobs.task_input_output import ObjectCache, Task
from dynident_service.storage_and_engine import Services

ARM = arm("scara")
GAINS = np.array([14.0, 12.5, 80.0, 1.5])
ONES = {name: {"drive_gain": 1} for name in ARM.joint_names}


def written(path: Path, seed: int) -> Path:
    motion = fourier_motion(ARM, 15.0, 100.0, seed)
    torque = pinocchio_torque(ARM, motion.q, motion.dq, motion.ddq) + 4 * np.sign(motion.dq) + 3 * motion.dq
    current = torque / GAINS + np.random.default_rng(seed).normal(0.0, 0.005, torque.shape)
    columns = {"t": motion.t}
    for j in range(ARM.n):
        columns |= {f"q{j + 1}": motion.q[:, j], f"current{j + 1}": current[:, j]}
    pacsv.write_csv(pa.table(columns), path)
    return path


class Lab:
    """A robot whose gains nobody knows, and two runs."""

    def __init__(self, client: Client, folder: Path) -> None:
        self.client = client
        self.urdf = urdf_from_robot(ARM)
        self.robot = client.robots.create("scara", urdf=self.urdf, drives=ONES)
        self.fit, self.other = (
            client.measurements.upload(self.robot, written(folder / f"{seed}.csv", seed)) for seed in (0, 1)
        )

    def asked(self, **changed: Any) -> Computed:
        good = {"robot": self.robot, "measurements": [self.fit], "validation": [self.other]}
        return self.client.current_models.create(**{**good, **changed})

    def refused(self, **changed: Any) -> tuple[str, str]:
        with pytest.raises(ProblemError) as caught:
            self.asked(**changed)
        assert caught.value.status == 422
        return caught.value.errors[0]["pointer"], caught.value.errors[0]["detail"]


@pytest.fixture(scope="module")
def lab(client: TestClient, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab(Client("http://127.0.0.1", transport=client._transport), tmp_path_factory.mktemp("currents"))


def test_every_joint_tells_its_current_on_a_motion_that_it_has_not_seen(lab: Lab, services: Services) -> None:
    made = lab.asked()
    # A worker may have been fast: then there is nothing to cancel.
    with suppress(ProblemError):
        made.cancel()
    stored = services.resources.get("current_models", made.id)
    joints = find_currents(
        Task(stored, {}, services.resources, services.objects, ObjectCache(), ignore_progress)
    ).result["joints"]
    assert [one["joint"] for one in joints] == list(ARM.joint_names)
    for joint, gain in zip(joints, GAINS, strict=True):
        assert joint["held_out_relative"] < 0.1
        assert 0 < joint["held_out_rms"] < 0.1
        viscous = next(one for one in joint["parameters"] if one["name"].startswith("Fv"))
        assert viscous["value"] == pytest.approx(3.0 / gain, rel=0.2)
        assert viscous["judgement"] == "determined"


@pytest.mark.slow
def test_models_of_currents_are_computed_listed_keep_their_runs_and_are_deleted(lab: Lab) -> None:
    made = lab.asked(name="without gains", validation=[]).wait()
    assert made.result["joints"][0]["held_out_rms"] is None
    kept = lab.client.current_models
    assert made.id in [one.id for one in kept.all(robot_id=lab.robot.id)]
    with pytest.raises(ProblemError) as needed:
        lab.client.measurements.delete(lab.fit)
    assert needed.value.status == 409
    kept.delete(made)
    assert made.id not in [one.id for one in kept.all()]


def test_a_robot_that_states_no_gain_has_no_currents(lab: Lab) -> None:
    bare: Record = lab.client.robots.create("bare", urdf=lab.urdf)
    pointer, detail = lab.refused(robot=bare)
    assert pointer == "/robot_id"
    assert '"drive_gain": 1' in detail


def test_a_wrist_whose_motors_are_coupled_is_refused(lab: Lab) -> None:
    last, before = ARM.joint_names[-1], ARM.joint_names[-2]
    drives = {**ONES, last: {"drive_gain": 1, "coupling": {before: 1.0}}}
    coupled = lab.client.robots.create("coupled", urdf=lab.urdf, drives=drives)
    pointer, detail = lab.refused(robot=coupled)
    assert pointer == "/robot_id"
    assert "act on several joints" in detail


def test_effects_that_rest_on_the_torque_are_refused_before_anything_is_computed(lab: Lab) -> None:
    pointer, detail = lab.refused(effects=["rigid_body", "load_dependent_friction"])
    assert pointer == "/effects/1"
    assert "without the gains" in detail


def test_a_measurement_that_is_not_there_is_named(lab: Lab) -> None:
    assert lab.refused(measurements=["mea_nothing"])[0] == "/measurement_ids/0"
