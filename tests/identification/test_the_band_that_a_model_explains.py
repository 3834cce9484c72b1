"""Filters follow what the model explains where the motion's spectrum would let in what it cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import WITH_OFFSET
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.advice.prediction_error import evaluate_rows
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


@pytest.mark.parametrize("noise", [2e-5, 4e-5, 8e-5, 5e-4])
def test_the_wider_filter_of_the_acceleration_lets_in_no_noise_that_spoils_a_model(noise, monkeypatch):
    robot = arm("ur10")
    other = fourier_motion(robot, 15.0, 500.0, 2)

    def build_torque(motion: Motion) -> np.ndarray:
        return pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 4 * np.sign(motion.dq) + 3 * motion.dq

    def find_errors() -> np.ndarray:
        """Mean squares (n,) of the errors on another motion, over recordings with noise on encoders and torques."""
        squares = []
        for seed in (1, 11, 12, 13):
            rng, motion = np.random.default_rng(seed), fourier_motion(robot, 30.0, 500.0, seed)
            tau = build_torque(motion) + rng.normal(0, 0.2, motion.q.shape)
            noisy = replace(motion, q=motion.q + noise * rng.normal(size=motion.q.shape))
            found = identify(robot, [record(robot, noisy, tau)], [], CHOICES)
            wrong = evaluate_rows(found, other.q, other.dq, other.ddq) @ found.values - build_torque(other)
            squares.append((wrong**2).mean(axis=0))
        return np.mean(squares, axis=0)

    errors = find_errors()
    monkeypatch.setattr(Preprocessing, "find_acceleration_cutoff", lambda *_: None)
    assert (np.sqrt(errors / find_errors()) < 1.03).all()


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
