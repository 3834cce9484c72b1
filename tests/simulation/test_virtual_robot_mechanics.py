"""The virtual robot's motion against Pinocchio and against conservation of energy."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from support.virtual_arms import fourier, plain_friction

from dynident.robot import robot_from_library, to_pinocchio
from dynident.simulation import Sensors, TrueEffect, VirtualRobot
from dynident.simulation.virtual_robot_dynamics import build_dynamics, build_first_state, build_step

ARMS = ("franka_panda", "ur10", "scara", "dual_arm")
EXACT = Sensors(encoder_counts=None, torque_noise=0.0)


def _run(robot_name: str, duration: float, h: float, effects: tuple[TrueEffect, ...] = ()) -> np.ndarray:
    """States [q, dq, ddq, tau] of a robot that nobody controls, let go in the middle of its ranges."""
    robot = robot_from_library(robot_name)
    dynamics = build_dynamics(robot, effects, robot.inertias)
    zero = np.zeros(robot.n)
    steps = round(duration / h)
    start = np.array([np.mean(joint.limits.position or (-0.5, 1.5)) for joint in robot.joints]) + 0.3
    model = to_pinocchio(robot)
    fall = pin.aba(model, model.createData(), start, zero, zero)
    state = build_first_state(dynamics, start, zero, fall, h)
    return build_step(dynamics).run(state, np.zeros((steps, dynamics.n_inputs)), h, zero, zero)[1]


@pytest.mark.parametrize("name", ["franka_panda", "ur10"])
def test_a_falling_arm_without_friction_keeps_its_energy(name: str) -> None:
    robot = robot_from_library(name)
    n = robot.n
    samples = _run(name, 1.0, 0.25e-3)
    model = to_pinocchio(robot)
    data = model.createData()
    energy = np.array([pin.computeMechanicalEnergy(model, data, s[:n], s[n : 2 * n]) for s in samples[::20]])
    kinetic = np.array([pin.computeKineticEnergy(model, data, s[:n], s[n : 2 * n]) for s in samples[::20]])
    assert kinetic.max() > 5.0
    assert np.ptp(energy) < 1e-4 * kinetic.max()


def test_the_energy_error_falls_with_the_square_of_the_step() -> None:
    robot = robot_from_library("ur10")
    model = to_pinocchio(robot)
    data = model.createData()
    drift = []
    for h in (1e-3, 0.5e-3):
        samples = _run("ur10", 1.0, h)
        drift.append(np.ptp([pin.computeMechanicalEnergy(model, data, s[:6], s[6:12]) for s in samples]))
    assert drift[0] / drift[1] == pytest.approx(4.0, rel=0.25)


@pytest.mark.parametrize("name", ["franka_panda", "ur10"])
def test_friction_only_ever_takes_energy_out(name: str) -> None:
    robot = robot_from_library(name)
    n = robot.n
    # Without rotors: Pinocchio's energy knows the links alone.
    friction = tuple(effect for effect in plain_friction(robot) if effect.effect != "rotor_inertia")
    samples = _run(name, 1.0, 0.25e-3, friction)
    model = to_pinocchio(robot)
    data = model.createData()
    energy = np.array([pin.computeMechanicalEnergy(model, data, s[:n], s[n : 2 * n]) for s in samples])
    assert energy[0] - energy[-1] > 1.0
    assert np.diff(energy).max() < 1e-4


@pytest.mark.parametrize("name", ARMS)
def test_accelerations_are_those_of_pinocchio_for_the_same_torque(name: str) -> None:
    robot = robot_from_library(name)
    truth = VirtualRobot(robot).measure(fourier(robot, 3.0), EXACT).truth
    model = to_pinocchio(robot)
    data = model.createData()
    expected = np.array(
        [pin.aba(model, data, *row) for row in zip(truth.q[::25], truth.dq[::25], truth.tau[::25], strict=True)]
    )
    assert truth.ddq[::25] == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_rotor_inertia_adds_to_the_mass_matrix() -> None:
    robot = robot_from_library("ur10")
    rotors = tuple(effect for effect in plain_friction(robot) if effect.effect == "rotor_inertia")
    truth = VirtualRobot(robot, rotors).measure(fourier(robot, 3.0), EXACT).truth
    model = to_pinocchio(robot)
    model.armature = np.array([effect.values[0][1] for effect in rotors])
    data = model.createData()
    expected = np.array(
        [pin.aba(model, data, *row) for row in zip(truth.q[::25], truth.dq[::25], truth.tau[::25], strict=True)]
    )
    assert truth.ddq[::25] == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


@pytest.mark.sweep
@pytest.mark.parametrize("name", ARMS)
def test_velocities_and_accelerations_are_derivatives_of_the_positions(name: str) -> None:
    robot = robot_from_library(name)
    sensors = Sensors(sampling_rate=4000.0, encoder_counts=None, torque_noise=0.0)
    truth = VirtualRobot(robot, plain_friction(robot)).measure(fourier(robot, 1.0), sensors).truth
    h = 1 / 4000
    assert (truth.q[2:] - truth.q[:-2]) / (2 * h) == pytest.approx(truth.dq[1:-1], abs=1e-9)
    second = (truth.q[2:] - 2 * truth.q[1:-1] + truth.q[:-2]) / h**2
    assert second == pytest.approx(truth.ddq[1:-1], abs=1e-6 * np.abs(truth.ddq).max())


def test_halving_the_internal_step_changes_the_torque_by_less_than_the_noise() -> None:
    robot = robot_from_library("ur10")
    reference = fourier(robot, 4.0)
    coarse, fine = (
        VirtualRobot(robot, plain_friction(robot), longest_step=step).measure(reference, EXACT).truth
        for step in (0.25e-3, 0.125e-3)
    )
    limits = np.array([joint.limits.effort for joint in robot.joints])
    # In the moments of a reversal the two break away at different instants; a recording's noise is 0.5 % of the limit.
    assert np.sqrt(np.mean((coarse.tau - fine.tau) ** 2, axis=0)) == pytest.approx(np.zeros(6), abs=2e-3 * limits.min())
    assert np.abs(coarse.q - fine.q).max() < 2e-4
