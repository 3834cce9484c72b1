"""Weighing a payload by runs without and with it, and not weighing what the motion does not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.identification import PayloadEstimate
from dynident.identification.loads.payload_weighing import compare_estimates, payload_from_pair
from dynident.recordings import Preprocessing

BAND = Preprocessing(12.0, 12.0, 5)
PAYLOAD = np.array([0.06, 0, 0, 0.06, 0, 0.01, 0, 0, 0.3, 3.0])


def run(name: str, loaded: bool, amplitude: float = 1.2, offset: float = 0.0, seed: int = 0):
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 200.0, seed=2, amplitude=amplitude)
    inertias = robot.inertias.copy()
    if loaded:
        inertias[-1] += PAYLOAD
    tau = pinocchio_torque(replace(robot, inertias=inertias), motion.q, motion.dq, motion.ddq)
    tau = tau + 4.0 * np.sign(motion.dq) + 3.0 * motion.dq + offset
    return record(robot, motion, tau + 0.5 * np.random.default_rng(seed).normal(size=tau.shape), name)


def test_a_payload_is_weighed_where_the_motion_shows_it():
    # Whatever changed in the offsets between the runs: a wide motion tells it from gravity.
    for offset in (0.0, 1.0):
        runs = [run("free", False)], run("carrying", True, offset=offset, seed=1)
        found = payload_from_pair(arm("ur10"), *runs, preprocessing=BAND)
        assert found.identifiable, found.reason
        assert found.mass == pytest.approx(3.0, abs=0.15)
        assert found.interval[0] < 3.0 < found.interval[1]


def test_a_payload_that_a_small_motion_does_not_show_gets_no_number():
    small = [run("free", False, 0.01)], run("carrying", True, 0.01, offset=4.0, seed=1)
    found = payload_from_pair(arm("ur10"), *small, preprocessing=BAND)
    assert not found.identifiable
    assert found.mass is None
    assert found.interval is None
    assert "friction" in found.reason
    assert "motion" in found.reason


def test_no_payload_is_not_weighed():
    found = payload_from_pair(arm("ur10"), [run("free", False)], run("empty", False, seed=1), preprocessing=BAND)
    assert not found.identifiable
    assert found.mass is None


@pytest.mark.parametrize(
    ("alike", "apart", "identifiable", "says"),
    [
        ((3.0, 0.05), (3.02, 0.08), True, "agree"),
        ((0.25, 0.016), (-0.38, 0.04), False, "not identifiable"),
        ((3.0, 0.8), (3.1, 1.0), False, "more than a quarter"),
        ((-0.5, 0.1), (-0.5, 0.1), False, "no payload"),
    ],
)
def test_verdicts_follow_from_both_estimates(alike, apart, identifiable, says):
    found = compare_estimates(PayloadEstimate(alike[0], alike[1], 0.0), PayloadEstimate(apart[0], apart[1], 0.0))
    assert found.identifiable == identifiable
    assert says in found.reason
    assert (found.mass is None) != identifiable
