"""Filters follow what the model explains where the motion's spectrum would let in what it cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import WITH_OFFSET
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording
from dynident.robot import Robot

CHOICES = IdentificationChoices(WITH_OFFSET)


def run(name: str, seed: int, rattling: float, rate: float = 400.0) -> tuple[Robot, Recording]:
    """An arm whose encoders rattle at 12 to 60 Hz, by so much of the speed, which its torques do not show."""
    rng = np.random.default_rng(seed)
    robot = arm(name)
    motion = fourier_motion(robot, 12.0, rate, seed)
    effort = np.array([joint.limits.effort for joint in robot.joints])
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.03 * effort * (np.sign(motion.dq) + motion.dq)
    tau += 0.002 * effort * rng.normal(size=tau.shape)
    q = motion.q.copy()
    for frequency in rng.uniform(12.0, 60.0, 20):
        phases = rng.uniform(0.0, 2 * np.pi, robot.n)
        size = rattling * np.sqrt((motion.dq**2).mean(axis=0) * 2 / 20) / (2 * np.pi * frequency)
        q += size * np.sin(2 * np.pi * frequency * motion.t[:, None] + phases)
    return robot, record(robot, replace(motion, q=q), tau, f"run{seed}")


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
def test_an_arm_that_rattles_is_identified_below_it_and_said_to(name, seed):
    robot, learnt = run(name, seed, 1.0)
    tried = run(name, seed + 10, 1.0)[1]
    found = identify(robot, [learnt], [tried], CHOICES)
    cutoff = found.preprocessing.torque_cutoff
    assert 4.0 <= cutoff < 15.0
    assert found.fit.relative_total < 0.05
    assert found.held_out.relative_total < 0.3
    assert f"Below {cutoff:g} Hz the model leaves" in found.warnings[0]
    assert "is flexible" in found.preprocessing.reasons[0]


@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
def test_filters_of_an_arm_that_is_explained_stay_as_its_motion_asks(name):
    robot, learnt = run(name, 3, 0.0)
    found = identify(robot, [learnt], [], CHOICES)
    assert not any("is flexible" in warning for warning in found.warnings)
    assert found.preprocessing.torque_cutoff > 4.0


def test_filters_that_were_given_stay():
    robot, learnt = run("ur10", 0, 1.0)
    given = Preprocessing(60.0, 60.0, 1)
    found = identify(robot, [learnt], [], replace(CHOICES, preprocessing=given))
    assert found.preprocessing == given
    assert not any("is flexible" in warning for warning in found.warnings)


@pytest.mark.parametrize("pair", [(1, 3), (1, 4)])
def test_torques_in_another_order_are_no_matter_of_the_band(pair):
    robot = arm("ur10")
    motion = fourier_motion(robot, 12.0, 400.0, 5)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 5.0 * np.sign(motion.dq)
    tau[:, list(pair)] = tau[:, list(reversed(pair))]
    found = identify(robot, [record(robot, motion, tau, "run")], [], CHOICES)
    assert found.fit.relative_total > 0.2
    assert not any("is flexible" in warning for warning in found.warnings)
