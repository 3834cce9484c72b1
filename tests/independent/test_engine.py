"""The other engine hides what it says it hides: torques against formulas written down here."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio
import pytest
from engine import Arm, FloatArray, Hidden, Instruments, Plan, Run, fourier_motion, record, usual_drives
from engine.disturbances import Delay, GainError
from engine.friction import AsymmetricViscous, LoadFriction, PowerViscous
from engine.robots import arm_by_name
from engine.structure import Compensator, Coupling, Payload, Ripple, Spring, Tilt

from dynident.robot import to_pinocchio

ROBOT = arm_by_name("ur10")
DRIVES = usual_drives(ROBOT)
MOTION = fourier_motion(ROBOT, 8.0, 3, rise=2.0)
EXACT = Instruments(counts=2**40, noise=0.0)


@cache
def _run(hidden: Hidden | None) -> Run:
    return record(Arm(ROBOT, DRIVES, (hidden,) if hidden else ()), MOTION, EXACT, plan=Plan())


def _states(run: Run) -> tuple[FloatArray, FloatArray, FloatArray]:
    step = float(run.t[1] - run.t[0])
    dq = np.gradient(run.q, step, axis=0)
    return run.q, dq, np.gradient(dq, step, axis=0)


def _torque(run: Run, gravity: FloatArray, payload: pinocchio.Inertia | None = None) -> FloatArray:
    """Links and rotors, Coulomb and viscous friction (m, n)."""
    model = to_pinocchio(ROBOT)
    model.gravity.linear = gravity
    if payload is not None:
        model.appendBodyToJoint(ROBOT.n, payload, pinocchio.SE3.Identity())
    data = model.createData()
    q, dq, ddq = _states(run)
    links = np.array([pinocchio.rnea(model, data, *rows) for rows in zip(q, dq, ddq, strict=True)])
    return np.asarray(links + DRIVES.rotor * ddq + DRIVES.coulomb * np.sign(dq) + DRIVES.viscous * dq)


def _close(run: Run, expected: FloatArray, added: FloatArray, share: float = 0.02) -> None:
    """Torque as expected, within a share of what the effect adds, wherever no joint is near a reversal."""
    _, dq, _ = _states(run)
    clear = (np.abs(dq) > 0.05).all(axis=1) & (run.t > 1.0)
    gap = (run.tau - expected)[clear]
    assert np.sqrt((gap**2).mean(axis=0)).max() < share * np.sqrt((added[clear] ** 2).mean(axis=0)).max()


def test_a_clean_arm_moves_as_rigid_body_dynamics_say() -> None:
    run = _run(None)
    expected = _torque(run, ROBOT.gravity)
    _close(run, expected, expected, 0.001)


J = 1
SPEED = float(np.abs(MOTION.dq[:, J]).max())
X0 = float(MOTION.q[0, J]) + 0.7


def _spring(q: FloatArray, v: FloatArray, load: FloatArray) -> FloatArray:
    return 30.0 * (q - 0.3)


def _compensator(q: FloatArray, v: FloatArray, load: FloatArray) -> FloatArray:
    x = q - X0
    length = np.sqrt(0.3**2 + 0.2**2 + 2 * 0.3 * 0.2 * np.cos(x))
    return -900.0 * 0.3 * 0.2 * np.sin(x) * (length - 0.1) / length


@pytest.mark.parametrize(
    ("hidden", "law"),
    [
        (Spring(J, 30.0, 0.3), _spring),
        (Compensator(J, 900.0, 0.3, 0.2, 0.1, X0), _compensator),
        (Ripple(J, (4.0,), (15.0,), (0.7,)), lambda q, v, load: 4.0 * np.sin(15.0 * q + 0.7)),
        (AsymmetricViscous(J, 4.0), lambda q, v, load: 4.0 * np.abs(v)),
        (PowerViscous(J, 6.0, 3.0), lambda q, v, load: 6.0 * v**3),
        (LoadFriction(J, 0.1), lambda q, v, load: 0.1 * np.abs(load) * np.sign(v)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Hidden) else "",
)
def test_an_effect_on_a_joint_adds_the_torque_of_its_law(hidden: Hidden, law) -> None:  # type: ignore[no-untyped-def]
    run = _run(hidden)
    plain = _torque(run, ROBOT.gravity)
    q, dq, ddq = _states(run)
    friction = DRIVES.rotor * ddq + DRIVES.coulomb * np.sign(dq) + DRIVES.viscous * dq
    added = np.zeros_like(plain)
    added[:, J] = law(q[:, J], dq[:, J], (plain - friction)[:, J])
    _close(run, plain + added, added)


def test_a_motor_that_turns_two_joints_resists_their_sum() -> None:
    run = _run(Coupling(4, 1.0, 0.1, 0.8, 1.5))
    _, dq, ddq = _states(run)
    speed, rate = dq[:, 4] + dq[:, 5], ddq[:, 4] + ddq[:, 5]
    added = np.zeros_like(dq)
    added[:, 4] = added[:, 5] = 0.1 * rate + 0.8 * speed + 1.5 * np.sign(speed)
    clear = np.abs(speed) > 0.05
    expected = np.where(clear[:, None], _torque(run, ROBOT.gravity) + added, run.tau)
    _close(run, expected, added)


def test_a_tilted_base_tilts_gravity() -> None:
    run = _run(Tilt(0.03, 0.0))
    tilted = _torque(run, np.array([0.0, 9.81 * np.sin(0.03), -9.81 * np.cos(0.03)]))
    _close(run, tilted, tilted - _torque(run, ROBOT.gravity))


def test_a_payload_is_a_body_on_the_last_link() -> None:
    run = _run(Payload(2.0, (0.01, 0.02, 0.1), 0.05, (0,)))
    body = pinocchio.Inertia(2.0, np.array([0.01, 0.02, 0.1]), 2.0 * 0.05**2 * np.eye(3))
    loaded = _torque(run, ROBOT.gravity, body)
    _close(run, loaded, loaded - _torque(run, ROBOT.gravity))


def test_a_payload_of_another_run_is_not_there() -> None:
    assert np.array_equal(_run(Payload(2.0, (0.0, 0.0, 0.1), 0.05, (1,))).tau, _run(None).tau)


def test_a_gain_error_scales_what_is_measured_and_not_the_motion() -> None:
    run, plain = _run(GainError(J, 0.07)), _run(None)
    assert np.array_equal(run.q, plain.q)
    assert run.tau[:, J] == pytest.approx(1.07 * plain.tau[:, J])


def test_a_delay_moves_the_torque_and_not_the_motion() -> None:
    run, plain = _run(Delay(4e-3)), _run(None)
    assert np.array_equal(run.q, plain.q)
    assert np.allclose(run.tau[4:], plain.tau[:-4], atol=1e-6)
