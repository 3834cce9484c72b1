"""Slow sweeps identify gravity and friction, and say that they show no inertia."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects.effect_choices import DEFAULT_EFFECTS, LINKS, OFFSETS
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models.fit_model import describe_slow_motion
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident.verdict import verdict

RATE = 50.0
CHOICES = IdentificationChoices((*DEFAULT_EFFECTS, OFFSETS))


def sweep(robot: Robot, seed: int, seconds: float = 240.0) -> Motion:
    """All joints back and forth at constant speeds of 0.04 to 0.1 rad/s, with rounded corners."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    size = rng.uniform(0.6, 1.2, robot.n)
    turns = t[:, None] * rng.uniform(0.04, 0.1, robot.n) / (4.0 * size) + rng.uniform(0.0, 1.0, robot.n)
    middles = [0.5 * sum(joint.limits.position or (0.0, 0.0)) for joint in robot.joints]
    q = gaussian_filter1d(size * (4.0 * np.abs(turns % 1.0 - 0.5) - 1.0) + middles, 0.15 * RATE, axis=0)
    dq = np.gradient(q, t, axis=0)
    return Motion(t, q, dq, np.gradient(dq, t, axis=0))


def recorded(robot: Robot, motion: Motion, seed: int, name: str) -> Recording:
    effort = np.array([joint.limits.effort for joint in robot.joints])
    friction = 0.04 * effort * np.sign(motion.dq) + 0.03 * effort * motion.dq
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + friction
    noise = 0.005 * effort * np.random.default_rng(seed).normal(size=tau.shape)
    return record(robot, motion, tau + noise, name)


@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
def test_a_slow_sweep_shows_gravity_and_friction_and_says_what_it_lacks(name: str) -> None:
    robot = arm(name)
    fitted, other = (recorded(robot, sweep(robot, seed), seed, f"sweep{seed}") for seed in (1, 2))
    model = identify(robot, [fitted], [other], CHOICES)
    assert model.held_out is not None
    assert model.held_out.relative_total < 0.05
    assert model.warnings[0].startswith("The motion shows gravity and friction, but hardly any inertia")
    judged = {use.use: use for use in verdict(model, [fitted], [other]).uses}
    assert (judged["simulation"].state, judged["feed_forward"].state) == ("no", "limited")
    assert all("faster motion" in judged[use].next_step for use in ("simulation", "feed_forward"))
    effort = np.array([joint.limits.effort for joint in robot.joints])
    dry = {parameter.link: parameter.value for parameter in model.parameters if parameter.effect == "coulomb"}
    assert [dry[joint] for joint in robot.joint_names] == pytest.approx(list(0.04 * effort), rel=0.15)


@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
def test_a_motion_that_shows_inertia_is_not_called_slow(name: str) -> None:
    robot = arm(name)
    model = identify(robot, [recorded(robot, fourier_motion(robot, 20.0, 100.0, 3), 3, "fast")], [], CHOICES)
    assert not any("hardly any inertia" in warning for warning in model.warnings)


def test_a_model_without_friction_does_not_blame_the_motion_alone() -> None:
    robot = arm("ur10")
    model = identify(robot, [recorded(robot, sweep(robot, 1), 1, "sweep")], [], IdentificationChoices((LINKS,)))
    slow = describe_slow_motion(model.parameters)
    assert slow is not None
    assert "gravity and friction" not in slow
    assert "it has no friction" in slow
