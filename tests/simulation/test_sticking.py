"""What dry friction does at zero velocity: it holds whatever it can hold, and lets go of what it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import pinocchio_torque
from support.virtual_arms import effort, fourier, plain_friction

from dynident.robot import Robot, robot_from_library
from dynident.simulation import Controller, Reference, Sensors, TrueEffect, VirtualRobot
from dynident.simulation.virtual_robot_dynamics import build_dynamics, build_first_state, build_step

STEP = 0.25e-3
EXACT = Sensors(sampling_rate=1 / STEP, encoder_counts=None, torque_noise=0.0)
SOFT = Controller(bandwidth=6.0, largest_lag=0.05)
WRIST = 4


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_library("ur10")


def _pushed(robot: Robot, effects: tuple[TrueEffect, ...], torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (m, n) of an arm at rest without gravity whose drives give the torque (m, n)."""
    free = replace(robot, gravity=np.zeros(3))
    dynamics = build_dynamics(free, effects, free.inertias)
    zero, n = np.zeros(robot.n), robot.n
    inputs = np.zeros((len(torque), dynamics.n_inputs))
    inputs[:, 2 * n : 3 * n] = torque
    start = build_first_state(dynamics, np.full(n, 0.7), zero, zero, STEP)
    samples = build_step(dynamics).run(start, inputs, STEP, zero, zero)[1]
    return samples[:, :n], samples[:, n : 2 * n]


def _growing(robot: Robot, joint: int, highest: float, seconds: float = 2.0) -> np.ndarray:
    """Torque (m, n) that grows on one joint from nothing to its highest value."""
    torque = np.zeros((round(seconds / STEP), robot.n))
    torque[:, joint] = np.linspace(0.0, highest, len(torque))
    return torque


def _slowly(reference: Reference, times: float) -> Reference:
    return Reference(reference.t * times, reference.q, reference.dq / times, reference.ddq / times**2)


def _there_and_back(robot: Robot, seconds: float) -> Reference:
    """The first joint moves by 0.4 rad, dwells for 0.3 s and moves back, each in as many seconds."""
    t = np.arange(round((2 * seconds + 0.9) * 500) + 1) / 500
    q, dq, ddq = (np.full((len(t), robot.n), at) for at in (0.7, 0.0, 0.0))
    for begins, way in ((0.3, 0.4), (0.6 + seconds, -0.4)):
        s = np.clip((t - begins) / seconds, 0.0, 1.0)
        q[:, 0] += way * s**3 * (10 - 15 * s + 6 * s**2)
        dq[:, 0] += way * 30 * s**2 * (1 - s) ** 2 / seconds
        ddq[:, 0] += way * 60 * s * (1 - s) * (1 - 2 * s) / seconds**2
    return Reference(t, q, dq, ddq)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_holds_any_torque_up_to_its_dry_friction_and_then_breaks_away(robot: Robot, joint: int) -> None:
    coulomb = 0.04 * effort(robot)[joint]
    torque = _growing(robot, joint, 1.1 * coulomb)
    _, velocity = _pushed(robot, plain_friction(robot), torque)
    held = torque[:, joint] <= coulomb
    assert not np.any(velocity[held])
    # It starts with the very next step.
    assert np.all(velocity[np.flatnonzero(~held)[1:], joint] > 0)


def test_friction_holds_an_arm_against_its_own_weight(robot: Robot) -> None:
    weight = np.abs(pinocchio_torque(robot, np.full((1, 6), 0.7), np.zeros((1, 6)), np.zeros((1, 6))))[0]
    strong = tuple(
        TrueEffect("coulomb", name, (("Fc", 1.01 * load + 0.1),))
        for name, load in zip(robot.joint_names, weight, strict=True)
    )
    dynamics = build_dynamics(robot, strong, robot.inertias)
    zero = np.zeros(6)
    start = build_first_state(dynamics, np.full(6, 0.7), zero, zero, STEP)
    samples = build_step(dynamics).run(start, np.zeros((8000, dynamics.n_inputs)), STEP, zero, zero)[1]
    assert np.array_equal(samples[:, :6], np.full((8000, 6), 0.7))
    assert not np.any(samples[:, 6:18])


def test_stribeck_friction_holds_more_than_it_takes_to_keep_moving(robot: Robot) -> None:
    joint, coulomb = 0, 0.04 * effort(robot)[0]
    excess = TrueEffect("stribeck", robot.joint_names[joint], (("Fst", 0.5 * coulomb),), (("vs", 0.02),))
    torque = _growing(robot, joint, 1.6 * coulomb)
    _, velocity = _pushed(robot, (*plain_friction(robot), excess), torque)
    gone = int(np.flatnonzero(velocity[:, joint])[0])
    assert torque[gone, joint] == pytest.approx(1.5 * coulomb, rel=1e-3)
    torque[gone + 400 :, joint] = 1.1 * coulomb
    position, velocity = _pushed(robot, (*plain_friction(robot), excess), torque)
    assert position[-1, joint] > 0.701
    assert np.all(np.diff(velocity[gone + 400 :, joint]) > 0)


@pytest.mark.parametrize("seconds", [1.0, 8.0])
def test_break_away_friction_holds_a_joint_and_lets_go_over_a_distance_at_any_speed(
    robot: Robot, seconds: float
) -> None:
    size, name = effort(robot)[0], robot.joint_names[0]
    coulomb, excess, distance = 0.04 * size, 0.03 * size, 0.01
    effects = (*plain_friction(robot), TrueEffect("break_away", name, (("Fba", excess),), (("db", distance),)))
    truth = VirtualRobot(robot, effects).measure(_there_and_back(robot, seconds), EXACT).truth
    links = pinocchio_torque(robot, truth.q, truth.dq, truth.ddq) + 0.003 * effort(robot) * truth.ddq
    dry = (truth.tau - links - 0.03 * effort(robot) * truth.dq)[:, 0]
    rests = truth.dq[:, 0] == 0
    assert np.abs(dry[rests]).max() <= (coulomb + excess) * (1 + 2e-6)
    assert np.abs(dry[rests]).max() > 0.99 * (coulomb + excess)
    begins = np.flatnonzero(rests[:-1] & ~rests[1:])
    assert len(begins) >= 2
    for first in begins:
        after = slice(first + 1, first + 1 + int(np.argmax(rests[first + 1 :]) or len(rests)))
        travelled = np.abs(truth.q[after, 0] - truth.q[first, 0])
        moving = np.abs(truth.dq[after, 0]) > 1e-3
        expected = coulomb + excess * np.exp(-travelled / distance)
        np.testing.assert_allclose(np.abs(dry[after])[moving], expected[moving], rtol=2e-2)


def test_a_motor_that_two_joints_share_holds_them_both(robot: Robot) -> None:
    own, shared = 0.04 * effort(robot)[WRIST], 2.0
    coupled = TrueEffect("transmission_coupling", robot.joint_names[WRIST], (("Fcm", shared),))
    torque = _growing(robot, WRIST, 1.2 * (own + shared))
    _, velocity = _pushed(robot, (*plain_friction(robot), coupled), torque)
    gone = int(np.flatnonzero(velocity[:, WRIST])[0])
    assert torque[gone, WRIST] == pytest.approx(own + shared, rel=1e-2)
    # Pulled apart with the same torque, the shared motor stands still and holds nothing.
    apart = _growing(robot, WRIST, 1.2 * own)
    apart[:, WRIST + 1] = -apart[:, WRIST]
    _, velocity = _pushed(robot, (*plain_friction(robot), coupled), apart)
    gone = int(np.flatnonzero(velocity[:, WRIST])[0])
    assert apart[gone, WRIST] == pytest.approx(own, rel=2e-2)


def test_a_joint_without_dry_friction_never_rests_while_it_is_moved(robot: Robot) -> None:
    oiled = tuple(one for one in plain_friction(robot) if one.effect != "coulomb")
    truth = VirtualRobot(robot, oiled).measure(fourier(robot, 4.0), EXACT).truth
    assert not np.any(truth.dq[100:-100] == 0)


@pytest.mark.parametrize("times", [1.0, 5.0])
def test_torque_at_rest_is_the_controllers_and_within_what_friction_holds(robot: Robot, times: float) -> None:
    effects = plain_friction(robot)
    truth = VirtualRobot(robot, effects, controller=SOFT).measure(_slowly(fourier(robot, 4.0), times), EXACT).truth
    rotors, viscous, coulomb = (share * effort(robot) for share in (0.003, 0.03, 0.04))
    links = pinocchio_torque(robot, truth.q, truth.dq, truth.ddq) + rotors * truth.ddq
    dry = (truth.tau - links - viscous * truth.dq) / coulomb
    rests = truth.dq == 0
    assert 0.05 < rests.mean() < 0.5
    assert np.abs(dry[rests]).max() <= 1.0 + 2e-6
    assert np.abs(dry[rests]).mean() < 0.9
    moves = np.abs(truth.dq) > 1e-3
    assert np.abs(dry - np.sign(truth.dq))[moves].max() < 1e-3
    assert np.quantile(np.abs(dry - np.sign(truth.dq))[moves], 0.99) < 1e-5


def test_a_joint_that_stops_stays_for_a_while_and_does_not_tremble(robot: Robot) -> None:
    motion = _slowly(fourier(robot, 6.0), 2.0)
    truth = VirtualRobot(robot, plain_friction(robot), controller=SOFT).measure(motion, EXACT).truth
    for j in range(robot.n):
        rests = np.concatenate([[False], truth.dq[2000:-2000, j] == 0, [False]]).astype(np.int8)
        begins, ends = np.flatnonzero(np.diff(rests) == 1), np.flatnonzero(np.diff(rests) == -1)
        assert 2 <= len(begins) < 12
        assert np.min(ends - begins) * STEP > 2e-3


def test_friction_that_grows_with_the_load_and_falls_with_speed_is_solved_for_at_any_speed(robot: Robot) -> None:
    size, roots = effort(robot), (("p", 0.5),)
    each = list(zip(robot.joint_names, size, strict=True))
    effects = (
        *plain_friction(robot),
        *(TrueEffect("load_dependent_friction", name, (("cl", 0.1),)) for name in robot.joint_names),
        *(TrueEffect("stribeck", name, (("Fst", 0.03 * limit),), (("vs", 0.03),)) for name, limit in each),
        *(TrueEffect("viscous_nonlinear", name, (("Fvn", 0.02 * limit),), roots) for name, limit in each),
    )
    truth = VirtualRobot(robot, effects, controller=SOFT).measure(_slowly(fourier(robot, 4.0), 2.0), EXACT).truth
    viscous, rotors = 0.03 * size, 0.003 * size
    load = pinocchio_torque(robot, truth.q, truth.dq, truth.ddq)
    speed = np.abs(truth.dq)
    dry = 0.04 * size + 0.1 * np.abs(load) + 0.03 * size * np.exp(-((speed / 0.03) ** 2)) + 0.02 * size * np.sqrt(speed)
    left = truth.tau - load - rotors * truth.ddq - viscous * truth.dq
    rests = truth.dq == 0
    assert np.all(np.abs(left)[rests] <= dry[rests] * (1 + 1e-5))
    moves = speed > 1e-3
    assert np.quantile(np.abs(left - dry * np.sign(truth.dq))[moves], 0.99) < 1e-4 * size.min()
