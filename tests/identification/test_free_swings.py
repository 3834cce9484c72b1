"""Robots that swing with their motors off: only ratios can be identified, which is said with them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import RecordingMetadata
from dynident.robot import robot_from_urdf

URDF = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.3"/>
<mass value="1.2"/><inertia ixx="0.04" iyy="0.04" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3.1" upper="3.1" velocity="20" effort="10"/></joint></robot>"""
ROBOT = robot_from_urdf("pendulum", URDF)
CHOICES = IdentificationChoices(tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous")))


def swing(inertia: float, moment: float, viscous: float, dry: float, seed: int) -> np.ndarray:
    """Columns t, q and a torque of zero of a pendulum that is let go."""

    def rates(t, state):
        q, v = state
        return [v, -(9.81 * moment * np.sin(q) + viscous * v + dry * np.tanh(v / 1e-3)) / inertia]

    t = np.arange(0.0, 12.0, 0.005)
    found = solve_ivp(rates, (0.0, 12.0), [2.0, 0.0], t_eval=t, max_step=0.005)
    q = found.y[0] + 1e-5 * np.random.default_rng(seed).normal(size=len(t))
    return np.column_stack([t, q, np.zeros(len(t))])


def written(tmp_path, rows: np.ndarray):
    path = tmp_path / "swing.csv"
    np.savetxt(path, rows, delimiter=",", header="t,q1,tau1", comments="", fmt="%.9g")
    return path


@pytest.mark.parametrize(
    ("inertia", "moment", "viscous", "dry"),
    [(0.15, 0.36, 0.01, 0.02), (0.5, 0.8, 0.05, 0.05), (0.05, 0.2, 0.004, 0.01)],
)
def test_a_free_swing_ends_with_its_ratios(inertia, moment, viscous, dry, tmp_path):
    path = written(tmp_path, swing(inertia, moment, viscous, dry, 0))
    recording, checks = import_for_robot(ROBOT, path, tmp_path / "stored.parquet", RecordingMetadata())
    (check,) = [check for check in checks if check.name == "constant_torque"]
    assert check.status == "warning"
    assert "only ratios" in check.detail
    with pytest.raises(DynidentError, match="only ratios can be identified") as refused:
        identify(ROBOT, [recording], [], CHOICES)
    assert "record the torque of a motion that the motors drive" in refused.value.detail
    told = {name: float(value) for name, value in re.findall(r"(\w+) = (-?[\d.e-]+)", refused.value.detail)}
    lead = max(abs(told.get(name, 0.0)) for name in ("MX1", "MY1", "MZ1"))
    assert lead == pytest.approx(1.0)
    inertias = [value for name, value in told.items() if name[:2] in ("XX", "YY", "ZZ")]
    assert max(inertias) == pytest.approx(inertia / moment, rel=0.05)
    assert told["Fv1"] == pytest.approx(viscous / moment, rel=0.3)
    assert told["Fc1"] == pytest.approx(dry / moment, rel=0.3)


def test_a_torque_that_was_not_recorded_is_asked_about(tmp_path):
    rows = swing(0.15, 0.36, 0.01, 0.02, 1)
    found = propose(Sample(("t", "q1", "tau1"), rows, {}), ROBOT)
    assert found.columns["tau1"] == "tau1"
    (question,) = found.questions
    assert "motors off" in question.detail
    assert "only ratios" in question.detail


def test_a_random_walk_of_zero_torque_has_no_ratios(tmp_path):
    rows = swing(0.15, 0.36, 0.01, 0.02, 2)
    rng = np.random.default_rng(0)
    phases = rng.uniform(0.0, 6.0, 5)
    rows[:, 1] = sum(
        0.4 * np.sin(2 * np.pi * f * rows[:, 0] + p) for f, p in zip((0.3, 0.7, 1.1, 1.6, 2.0), phases, strict=True)
    )
    path = written(tmp_path, rows)
    recording, _ = import_for_robot(ROBOT, path, tmp_path / "stored.parquet", RecordingMetadata())
    with pytest.raises(DynidentError, match="only ratios can be identified") as refused:
        identify(ROBOT, [recording], [], CHOICES)
    assert "up to a common factor" not in refused.value.detail
