"""Every effect that is a function of one joint's signals, by the formula that it prints."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.effect_columns import COUNT, Evaluated
from support.oracles import arm, pinocchio_rows

from dynident.effects import (
    DAHL,
    STOP,
    TRAVEL,
    EffectChoice,
    MemorySignal,
    RunSignal,
    Signals,
    build_columns,
    get_effect,
)
from dynident.effects.hysteresis_states import MemoryStates
from dynident.effects.mechanical_structure import get_horizontal_directions
from dynident.robot import Robot

ROBOTS = ("ur10", "scara", "dual_arm")


def sign(v):
    return np.sign(v)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_plain_effects_are_their_formulas(robot_name):
    found = Evaluated(
        arm(robot_name),
        *(EffectChoice(name) for name in ("rotor_inertia", "coulomb", "viscous", "offset", "viscous_asymmetric")),
        EffectChoice("joint_spring"),
    )
    for j in range(found.robot.n):
        q, v, a = found.q[:, j], found.dq[:, j], found.ddq[:, j]
        expected = {"Ia": a, "Fc": sign(v), "Fv": v, "b": 1 + 0 * v, "Fva": abs(v), "ks": q, "bs": 1 + 0 * v}
        for name, column in expected.items():
            np.testing.assert_allclose(found.column(f"{name}{j + 1}")[:, j], column, rtol=1e-14)


@settings(max_examples=8, deadline=None)
@given(vs=st.floats(1e-3, 1.0), p=st.floats(0.25, 3.0), k=st.sampled_from([1.0, 2.0, 17.3]), d0=st.floats(1e-4, 0.1),
    law=st.sampled_from([1.0, -1.0]), delta=st.floats(0.5, 3.0),
)  # fmt: skip
def test_effects_with_a_shape_are_their_formulas_for_any_shape(vs, p, k, d0, law, delta):
    found = Evaluated(
        arm("ur10"),
        EffectChoice("stribeck", shape=(("vs", vs), ("delta", delta))),
        EffectChoice("viscous_nonlinear", shape=(("p", p),)),
        EffectChoice("load_dependent_friction"),
        EffectChoice("position_dependent_friction", shape=(("k", k),)),
        EffectChoice("torque_ripple", shape=(("k", k),)),
        EffectChoice("presliding", shape=(("d0", d0), ("law", law))),
        EffectChoice("break_away", shape=(("db", d0),)),
    )
    operator = STOP if law > 0 else DAHL
    operators = (operator, TRAVEL)
    assert found.signals.memory_signals == tuple(MemorySignal(one, j, d0) for one in operators for j in range(6))
    for j in range(6):
        q, v, load, z = found.q[:, j], found.dq[:, j], found.load[:, j], found.z[:, j]
        travelled = np.abs(found.z[:, 6 + j])
        expected = {
            "Fst": np.exp(-(np.abs(v / vs) ** delta)) * sign(v),
            "Fvn": np.abs(v) ** p * sign(v),
            "cl": np.abs(load) * sign(v),
            "Fpc": np.cos(k * q) * sign(v),
            "Fps": np.sin(k * q) * sign(v),
            "Ac": np.cos(k * q),
            "As": np.sin(k * q),
            "Fz": z,
            "cz": np.abs(load) * z,
            "Fba": (1 - travelled) * sign(v),
        }
        for name, column in expected.items():
            np.testing.assert_allclose(found.column(f"{name}{j + 1}")[:, j], column, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_friction_that_differs_between_directions_has_a_column_for_each(robot_name):
    found = Evaluated(arm(robot_name), EffectChoice("coulomb_asymmetric"))
    for j in range(found.robot.n):
        moving = found.dq[:, j] != 0
        v = found.dq[moving, j]
        np.testing.assert_array_equal(found.column(f"Fcp{j + 1}")[moving, j], np.where(v > 0, 1.0, 0.0))
        np.testing.assert_array_equal(found.column(f"Fcn{j + 1}")[moving, j], np.where(v > 0, 0.0, -1.0))


@settings(max_examples=10, deadline=None)
@given(tw=st.floats(1.0, 1e4))
def test_friction_that_drifts_is_friction_times_temperature_or_decay(tw):
    found = Evaluated(
        arm("scara"), EffectChoice("temperature_friction"), EffectChoice("warm_up_friction", shape=(("Tw", tw),))
    )
    for j in range(found.robot.n):
        v = found.dq[:, j]
        warmer, cold = found.temperature[:, j] - 25.0, np.exp(-found.time / tw)
        expected = {"Fvt": warmer * v, "Fct": warmer * sign(v), "Fvw": cold * v, "Fcw": cold * sign(v)}
        for name, column in expected.items():
            np.testing.assert_allclose(found.column(f"{name}{j + 1}")[:, j], column, rtol=1e-12, atol=1e-300)


def test_friction_is_as_stated_at_25_degrees():
    signals = Signals(arm("ur10"))
    for column in build_columns([EffectChoice("temperature_friction")], signals):
        torque = ca.substitute(column.torque, signals.temperature, ca.SX.ones(6, 1) * 25.0)
        assert ca.DM(ca.substitute(torque, signals.dq, ca.SX.ones(6, 1))).is_zero()


@settings(max_examples=10, deadline=None)
@given(
    phi=st.floats(-3, 3),
    a=st.floats(0.2, 0.5),
    b=st.floats(0.02, 0.19),
    stiffness=st.floats(10, 1e4),
    free=st.floats(0.0, 0.2),
)
def test_a_compensating_spring_takes_the_slope_of_its_energy(phi, a, b, stiffness, free):
    found = Evaluated(arm("ur10"), EffectChoice("gravity_compensator", shape=(("phi", phi), ("r", b / a))))
    assert [column.name for column in found.columns] == [f"{p}{j}" for j in (2, 3, 4) for p in ("kab", "kal")]

    def energy(q):
        length = np.hypot(a + b * np.cos(q - phi), b * np.sin(q - phi))
        return 0.5 * stiffness * (length - free) ** 2

    for j in (1, 2, 3):
        torque = stiffness * b * (a * found.column(f"kab{j + 1}") - free * found.column(f"kal{j + 1}"))[:, j]
        q, h = found.q[:, j], 1e-5
        slope = (energy(q + h) - energy(q - h)) / (2 * h)
        np.testing.assert_allclose(torque, slope, atol=1e-5 * stiffness * a * b)


def test_a_compensating_spring_sits_on_the_first_joints_that_gravity_loads():
    robot = arm("ur10")
    assert get_effect("gravity_compensator").applicable(robot) == (1, 2, 3)


@pytest.mark.parametrize("robot_name", ["ur10", "dual_arm"])
def test_a_cable_pulls_both_its_joints_by_the_slope_of_one_energy(robot_name):
    robot = arm(robot_name)
    found = Evaluated(robot, EffectChoice("cable_force"))
    h = 1e-6
    for j in get_effect("cable_force").applicable(robot):
        x, y = found.q[:, j], found.q[:, j + 1]
        for a, b in ((1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (3, 0), (0, 3), (1, 0), (0, 1)):
            expected = np.zeros((COUNT, robot.n))
            expected[:, j] = ((x + h) ** a - (x - h) ** a) / (2 * h) * y**b
            expected[:, j + 1] = x**a * ((y + h) ** b - (y - h) ** b) / (2 * h)
            np.testing.assert_allclose(found.column(f"u{a}{b}_{j + 1}"), expected, atol=1e-6)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_gains_that_are_off_scale_the_torque_of_motors(robot_name):
    found = Evaluated(arm(robot_name), EffectChoice("drive_gain_error"), EffectChoice("drive_gain_saturation"))
    ia, fc, fv, b = found.drives
    motor = found.load + ia * found.ddq + fv * found.dq + b + fc * sign(found.dq)
    for j in range(found.robot.n):
        np.testing.assert_allclose(found.column(f"eps{j + 1}")[:, j], motor[:, j], rtol=1e-9, atol=1e-9)
        squared = motor[:, j] * np.abs(motor[:, j])
        np.testing.assert_allclose(found.column(f"sat{j + 1}")[:, j], squared, rtol=1e-9, atol=1e-9)


def test_an_effect_in_some_runs_is_nothing_in_all_others():
    robot = arm("ur10")
    name = robot.joint_names[0]
    found = Evaluated(
        robot,
        EffectChoice("offset", (name,), runs=("cold", "warm#2")),
        EffectChoice("offset", (name,), runs=("warm#3",)),
        EffectChoice("viscous", (name,)),
    )
    assert found.run_signals == (RunSignal(("cold", "warm#2")), RunSignal(("warm#3",)))
    for k in (0, 1):
        np.testing.assert_array_equal(found.values[:, 0, k], found.runs[:, k])
    np.testing.assert_array_equal(found.values[:, 0, 2], found.dq[:, 0])
    assert [column.runs for column in found.columns] == [("cold", "warm#2"), ("warm#3",), ()]
    assert len({column.key for column in found.columns}) == 3


def test_a_payload_is_in_those_runs_that_are_said_to_carry_one():
    found = Evaluated(arm("ur10"), EffectChoice("payload"))
    assert found.run_signals == (RunSignal(()),)
    carried = found.runs[:, 0] == 1
    assert carried.any()
    assert not found.values[~carried].any()
    assert np.abs(found.values[carried]).max(axis=(1, 2)).min() > 0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_shared_motor_brakes_both_joints_by_its_own_friction_and_inertia(side):
    robot = arm("ur10")
    found = Evaluated(robot, EffectChoice("transmission_coupling", (robot.joint_names[4],), (("side", side),)))
    speed, acceleration = found.dq[:, 4] + side * found.dq[:, 5], found.ddq[:, 4] + side * found.ddq[:, 5]
    # Virtual work: the motor turns with q5 + side q6, so its torque acts on joint 6 times side.
    for name, torque in (("Iam5", acceleration), ("Fvm5", speed), ("Fcm5", np.sign(speed))):
        expected = np.zeros((COUNT, 6))
        expected[:, 4], expected[:, 5] = torque, side * torque
        np.testing.assert_allclose(found.column(name), expected, rtol=1e-13)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_a_tilted_base_is_what_a_change_of_gravity_does_to_pinocchios_torque(robot_name):
    robot = arm(robot_name)
    found = Evaluated(robot, EffectChoice("base_tilt"))
    for name, direction in zip(("gx", "gy"), get_horizontal_directions(robot.gravity), strict=True):
        tilted = Robot(
            robot.name, robot.joints, robot.gravity + direction, robot.drives, robot.description, robot.inertias
        )
        rows = pinocchio_rows(tilted, found.q, found.dq, found.ddq) - pinocchio_rows(
            robot, found.q, found.dq, found.ddq
        )
        np.testing.assert_allclose(found.column(name), rows @ found.inertia, atol=1e-8)


@given(g=st.tuples(*[st.floats(-10, 10)] * 3).filter(lambda g: np.linalg.norm(g) > 0.1))
def test_the_directions_of_a_tilt_are_across_gravity(g):
    first, second = get_horizontal_directions(np.array(g))
    frame = np.array([first, second, np.array(g) / np.linalg.norm(g)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)


def test_under_common_gravity_a_tilt_is_named_by_the_axes_x_and_y():
    first, second = get_horizontal_directions(np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose([first, second], [[1, 0, 0], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize(
    "choice",
    [
        EffectChoice("coulomb"),
        EffectChoice("viscous"),
        EffectChoice("stribeck", shape=(("vs", 0.3),)),
        EffectChoice("viscous_nonlinear", shape=(("p", 0.5),)),
        EffectChoice("load_dependent_friction"),
        EffectChoice("transmission_coupling", shape=(("side", -1.0),)),
        EffectChoice("break_away"),
    ],
    ids=lambda choice: choice.effect,
)
@pytest.mark.parametrize("smooth", [0.0, 0.01])
def test_friction_takes_energy_from_the_motion(choice, smooth):
    found = Evaluated(arm("ur10"), choice, smooth_sign=smooth)
    power = np.einsum("mnc,mn->mc", found.values, found.dq)
    resistive = [k for k, column in enumerate(found.columns) if column.parameter != "Iam"]
    assert (power[:, resistive] >= 0).all()


def test_presliding_takes_energy_over_every_closed_path():
    # z follows the path as a stop operator; what it takes over a cycle is the area of its loop.
    rng = np.random.default_rng(0)
    for size in (1e-3, 5e-3, 0.1):
        angle = np.linspace(0, 2 * np.pi, 4001)
        q = size * (np.sin(angle) + 0.5 * np.sin(3 * angle + rng.uniform(0, 6)))
        q = np.concatenate([q, q[1:], q[1:]])
        z = MemoryStates([MemorySignal(STOP, 0, 2e-3)]).push(q[:, None])[:, 0]
        last = slice(8000, None)
        assert np.sum(0.5 * (z[last][1:] + z[last][:-1]) * np.diff(q[last])) >= -1e-12


def test_smooth_friction_tends_to_the_exact_one_away_from_rest():
    choices = [EffectChoice(name) for name in ("coulomb", "stribeck", "load_dependent_friction")]
    exact = Evaluated(arm("ur10"), *choices)
    errors = []
    for width in (0.1, 0.01, 0.001):
        smooth = Evaluated(arm("ur10"), *choices, smooth_sign=width)
        moving = np.abs(exact.dq).min(axis=1) > 0.02
        errors.append(np.abs(smooth.values - exact.values)[moving].max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-12


def test_friction_at_rest_is_zero_whether_smooth_or_not():
    for smooth in (0.0, 0.01):
        found = Evaluated(arm("ur10"), EffectChoice("coulomb"), EffectChoice("stribeck"), smooth_sign=smooth)
        assert not found.values[0].any()
