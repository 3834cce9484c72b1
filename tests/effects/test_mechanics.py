"""The rigid body against Pinocchio, and its two derivations against each other."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.oracles import ARMS, FROM_PINOCCHIO, arm, crooked_urdf, pinocchio_rows, random_states

from dynident.effects.effect_signals import Signals
from dynident.effects.rigid_body_rows import build_dynamic_rows
from dynident.robot import Robot, robot_from_modified_dh, robot_from_urdf, to_pinocchio, urdf_from_robot

DRAWN = settings(max_examples=40, deadline=None)


def states(n: int):
    return st.tuples(
        arrays(float, n, elements=st.floats(-100, 100)),
        arrays(float, n, elements=st.floats(-10, 10)),
        arrays(float, n, elements=st.floats(-50, 50)),
    )


def function_of(signals: Signals, expression: ca.SX) -> ca.Function:
    return ca.Function("f", [signals.q, signals.dq, signals.ddq], [ca.densify(expression)])


_ROWS: dict[str, ca.Function] = {}


def rows_at(name: str, q, dq, ddq) -> np.ndarray:
    if name not in _ROWS:
        signals = Signals(arm(name))
        _ROWS[name] = function_of(signals, signals.mechanics.rows)
    return np.array(_ROWS[name](q, dq, ddq))


@pytest.mark.parametrize("name", ARMS)
@DRAWN
@given(data=st.data())
def test_rows_of_the_dynamic_model_are_pinocchios_regressor_at_any_state(name, data):
    q, dq, ddq = data.draw(states(arm(name).n))
    expected = pinocchio_rows(arm(name), q[None], dq[None], ddq[None])[0]
    scale = max(1.0, float(np.abs(expected).max()))
    assert np.abs(rows_at(name, q, dq, ddq) - expected).max() < 1e-10 * scale


@settings(max_examples=15, deadline=None)
@given(data=st.data(), n=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_any_tree_of_any_axes_has_pinocchios_regressor(data, n, seed):
    parents = tuple(data.draw(st.integers(-1, k - 1)) for k in range(n))
    sliding = tuple(k for k in range(n) if data.draw(st.booleans()))
    robot = robot_from_urdf("tree", crooked_urdf(n, seed, sliding, parents))
    signals = Signals(robot)
    q, dq, ddq = random_states(robot, 3, seed)
    function = function_of(signals, signals.mechanics.rows)
    expected = pinocchio_rows(robot, q, dq, ddq)
    found = np.array([function(*state) for state in zip(q, dq, ddq, strict=True)])
    assert np.abs(found - expected).max() < 1e-10 * max(1.0, np.abs(expected).max())


def test_the_same_arm_as_modified_dh_table_and_as_urdf_has_the_same_rows():
    lengths = ((0, 0, 0.4, 0), (0.1, -np.pi / 2, 0, 0), (0.35, 0, 0, -np.pi / 2), (0, np.pi / 2, 0.3, 0))
    sigma = (0, 0, 1, 0)
    table = [
        {"antecedent": k, "sigma": sigma[k], "gamma": 0, "b": 0, "d": d, "alpha": alpha, "r": r, "theta": theta}
        for k, (d, alpha, r, theta) in enumerate(lengths)
    ]
    from_table = robot_from_modified_dh("arm", table)
    joints = []
    for k, (d, alpha, r, theta) in enumerate(lengths):
        # Rot(x, α) Trans(x, d) Rot(z, θ) Trans(z, r): written by hand, with URDF's Rz Ry Rx.
        rotation = pin.rpy.rpyToMatrix(alpha, 0, 0) @ pin.rpy.rpyToMatrix(0, 0, theta)
        origin = np.array([d, 0, 0]) + rotation @ np.array([0, 0, r])
        roll, pitch, yaw = pin.rpy.matrixToRpy(rotation).tolist()
        kind = "prismatic" if sigma[k] else "revolute"
        joints.append(
            f'<link name="l{k + 1}"/><joint name="j{k + 1}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{" ".join(repr(float(x)) for x in origin)}" rpy="{roll!r} {pitch!r} {yaw!r}"/>'
            '<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        )
    from_urdf = robot_from_urdf("arm", f'<robot name="arm"><link name="l0"/>{"".join(joints)}</robot>')
    assert [j.kind for j in from_urdf.joints] == [j.kind for j in from_table.joints]
    both = []
    for robot in (from_table, from_urdf):
        signals = Signals(robot)
        function = function_of(signals, signals.mechanics.rows)
        both.append([np.array(function(*s)) for s in zip(*random_states(robot, 20), strict=True)])
    np.testing.assert_allclose(both[0], both[1], atol=1e-10)


@pytest.mark.parametrize("name", ARMS)
def test_a_robot_written_as_urdf_and_read_again_has_the_same_rows(name):
    robot = arm(name)
    again = robot_from_urdf(robot.name, urdf_from_robot(robot))
    q, dq, ddq = random_states(robot, 5)
    signals = Signals(again)
    function = function_of(signals, signals.mechanics.rows)
    expected = pinocchio_rows(robot, q, dq, ddq)
    found = np.array([function(*s) for s in zip(q, dq, ddq, strict=True)])
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("name", ARMS)
def test_energy_rows_are_pinocchios_energy_regressors(name):
    robot = arm(name)
    model = to_pinocchio(robot)
    data = model.createData()
    signals = Signals(robot)
    kinetic, potential = signals.mechanics.energies
    function = ca.Function("e", [signals.q, signals.dq], [ca.densify(kinetic), ca.densify(potential)])
    order = (10 * np.arange(robot.n)[:, None] + FROM_PINOCCHIO).reshape(-1)
    for q, dq, _ in zip(*random_states(robot, 20, 3), strict=True):
        e, u = (np.array(row).ravel() for row in function(q, dq))
        expected_e = np.array(pin.computeKineticEnergyRegressor(model, data, q, dq)).ravel()[order]
        expected_u = np.array(pin.computePotentialEnergyRegressor(model, data, q)).ravel()[order]
        np.testing.assert_allclose(e, expected_e, atol=1e-11 * max(1, np.abs(expected_e).max()))
        np.testing.assert_allclose(u, expected_u, atol=1e-11 * max(1, np.abs(expected_u).max()))


@pytest.mark.parametrize("name", ARMS)
def test_energies_of_the_description_are_pinocchios_energies(name):
    robot = arm(name)
    model = to_pinocchio(robot)
    data = model.createData()
    signals = Signals(robot)
    kinetic, potential = signals.mechanics.energies
    function = ca.Function("e", [signals.q, signals.dq], [kinetic, potential])
    inertias = robot.inertias.reshape(-1)
    q, dq, _ = (s[0] for s in random_states(robot, 1, 4))
    e, u = (float(np.array(row).ravel() @ inertias) for row in function(q, dq))
    assert e == pytest.approx(pin.computeKineticEnergy(model, data, q, dq), rel=1e-11)
    assert u == pytest.approx(pin.computePotentialEnergy(model, data, q), rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_lagranges_equations_of_the_energy_rows_are_the_rows_of_the_dynamic_model(name):
    robot = arm(name)
    signals = Signals(robot)
    kinetic, potential = (ca.densify(row) for row in signals.mechanics.energies)
    b1 = ca.jacobian(kinetic, signals.dq).T  # (n, 10 n): B1 of [12.36]
    along = ca.jtimes(b1, ca.vertcat(signals.q, signals.dq), ca.vertcat(signals.dq, signals.ddq))
    rows = along + (ca.jacobian(potential, signals.q) - ca.jacobian(kinetic, signals.q)).T
    function = function_of(signals, ca.horzcat(rows, ca.densify(signals.mechanics.rows)))
    for state in zip(*random_states(robot, 10, 6), strict=True):
        both = np.array(function(*state))
        lagrange, direct = both[:, : 10 * robot.n], both[:, 10 * robot.n :]
        np.testing.assert_allclose(lagrange, direct, atol=1e-9 * max(1.0, np.abs(direct).max()))


@pytest.mark.parametrize("name", ARMS)
def test_a_joint_has_entries_only_for_the_links_it_moves(name):
    robot = arm(name)
    rows = Signals(robot).mechanics.rows
    filled = np.array(ca.DM(rows.sparsity(), 1)).reshape(robot.n, 10 * robot.n) != 0
    for joint in range(robot.n):
        links = {int(k) // 10 for k in np.flatnonzero(filled[joint])}
        assert links <= set(robot.list_subtree(joint))


def test_gravity_may_point_anywhere():
    base = arm("ur10")
    sideways = Robot(base.name, base.joints, np.array([3.0, -9.0, 1.0]), base.drives, base.description, base.inertias)
    signals = Signals(sideways)
    function = function_of(signals, signals.mechanics.rows)
    q, dq, ddq = random_states(sideways, 4, 8)
    expected = pinocchio_rows(sideways, q, dq, ddq)
    found = np.array([function(*s) for s in zip(q, dq, ddq, strict=True)])
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


def test_rounded_constants_shorten_the_rows_without_changing_them():
    robot = arm("franka_panda")
    signals = Signals(robot)
    rows = build_dynamic_rows(robot, signals.q, signals.dq, signals.ddq, signals.mechanics.gravity)
    assert rows.nnz() < 0.55 * rows.numel()
    assert ca.Function("n", [signals.q, signals.dq, signals.ddq], [ca.cse(rows)]).n_instructions() < 4000
