"""What the model so far predicts, against Pinocchio and against differences in time and space."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import ARMS, FloatArray, arm, crooked_urdf, pinocchio_torque, random_states

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns, count_reference_parameters
from dynident.effects.newton_euler import build_inverse_dynamics, build_link_jacobian
from dynident.effects.rigid_body_rows import to_constant
from dynident.errors import DynidentError
from dynident.regressors.observation_matrix import Observation
from dynident.robot import Robot, robot_from_library, robot_from_urdf, to_pinocchio

COUNT = 5


@dataclass(frozen=True)
class State:
    """q and its four derivatives (n,), and the parameters of the torque predicted (14 n,)."""

    derivatives: tuple[FloatArray, ...]
    reference: FloatArray

    @property
    def q(self) -> FloatArray:
        return self.derivatives[0]


def states(robot: Robot, seed: int = 0) -> list[State]:
    """States of the description's links with drives of any size."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = random_states(robot, COUNT, seed)
    third, fourth = rng.uniform(-20, 20, (COUNT, robot.n)), rng.uniform(-80, 80, (COUNT, robot.n))
    assert robot.inertias is not None
    reference = np.concatenate([robot.inertias.reshape(-1), rng.uniform(0.1, 2.0, 4 * robot.n)])
    assert len(reference) == count_reference_parameters(robot)
    return [State(row, reference) for row in zip(q, dq, ddq, third, fourth, strict=True)]


@cache
def _function(name: str, what: str) -> ca.Function:
    s = Signals(arm(name))
    inputs = [s.q, s.dq, s.ddq, s.dddq, s.ddddq, s.reference]
    return ca.Function("f", inputs, [ca.densify(getattr(s.predicted, what))])


def predicted(name: str, what: str, state: State) -> FloatArray:
    found = np.array(_function(name, what)(*state.derivatives, state.reference))
    return found.ravel() if found.shape[1] == 1 else found


def torque(robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    return pinocchio_torque(robot, q[None], dq[None], ddq[None])[0]


def along(state: State, t: float) -> list[FloatArray]:
    """q and its derivatives (n,) at time t of a path that has those of the state at 0."""
    terms = list(state.derivatives)
    return [
        sum(x * t**k / float(np.prod(range(1, k + 1))) for k, x in enumerate(terms[order:]))  # type: ignore[misc]
        for order in range(3)
    ]


def close(found: FloatArray, expected: FloatArray, share: float) -> bool:
    return bool(np.abs(found - expected).max() <= share * max(1.0, float(np.abs(expected).max())))


@pytest.mark.parametrize("name", ARMS)
def test_the_load_is_pinocchios_inverse_dynamics(name: str) -> None:
    for state in states(arm(name)):
        assert close(predicted(name, "load", state), torque(arm(name), *state.derivatives[:3]), 1e-11)


@settings(max_examples=10, deadline=None)
@given(data=st.data(), n=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_any_tree_of_any_axes_has_pinocchios_inverse_dynamics(data: st.DataObject, n: int, seed: int) -> None:
    parents = tuple(data.draw(st.integers(-1, k - 1)) for k in range(n))
    sliding = tuple(k for k in range(n) if data.draw(st.booleans()))
    robot = robot_from_urdf("tree", crooked_urdf(n, seed, sliding, parents))
    s = Signals(robot)
    expression = build_inverse_dynamics(robot, s.q, s.dq, s.ddq, to_constant(robot.gravity), s.reference[: 10 * n])
    function = ca.Function("f", [s.q, s.dq, s.ddq, s.reference], [expression])
    for state in states(robot, seed):
        found = np.array(function(*state.derivatives[:3], state.reference)).ravel()
        assert close(found, torque(robot, *state.derivatives[:3]), 1e-11)


@pytest.mark.parametrize("name", ARMS)
def test_its_slope_over_position_and_its_mass_matrix_are_pinocchios(name: str) -> None:
    model = to_pinocchio(arm(name))
    data = model.createData()
    for state in states(arm(name), 1):
        slope, _, mass = pin.computeRNEADerivatives(model, data, *state.derivatives[:3])
        assert close(predicted(name, "load_over_position", state), np.array(slope), 1e-10)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert close(predicted(name, "mass", state), mass, 1e-10)


@pytest.mark.parametrize("name", ARMS)
def test_its_rates_are_those_along_a_path_through_the_state(name: str) -> None:
    h = 1e-4
    for state in states(arm(name), 2):
        before, here, after = (torque(arm(name), *along(state, t)) for t in (-h, 0.0, h))
        assert close(predicted(name, "load_rate", state), (after - before) / (2 * h), 1e-5)
        assert close(predicted(name, "load_acceleration", state), (after - 2 * here + before) / h**2, 1e-4)


@pytest.mark.parametrize("name", ["ur10", "scara", "dual_arm", "crooked"])
def test_its_slope_over_origins_is_what_moving_a_joint_does(name: str) -> None:
    robot, h = arm(name), 1e-5
    found = {k: predicted(name, "load_over_origins", state) for k, state in enumerate(states(robot, 3))}
    for joint in range(robot.n):
        for axis in range(3):
            moved = [_moved(robot, joint, axis, side * h) for side in (1.0, -1.0)]
            for k, state in enumerate(states(robot, 3)):
                ahead, behind = (torque(one, *state.derivatives[:3]) for one in moved)
                assert close(found[k][:, 3 * joint + axis], (ahead - behind) / (2 * h), 1e-6)


def _moved(robot: Robot, joint: int, axis: int, by: float) -> Robot:
    placement = robot.joints[joint].placement.copy()
    placement[axis, 3] += by
    joints = list(robot.joints)
    joints[joint] = replace(joints[joint], placement=placement)
    return replace(robot, joints=tuple(joints))


@pytest.mark.parametrize("name", ARMS)
def test_the_torque_of_another_gravity_is_pinocchios_at_rest(name: str) -> None:
    robot, gravity = arm(name), np.array([0.7, -0.4, 0.9])
    model = to_pinocchio(robot)
    data = model.createData()
    model.gravity.linear = gravity
    s = Signals(robot)
    function = ca.Function("g", [s.q, s.reference], [s.predicted.build_gravity_torque(gravity)])
    for state in states(robot, 4):
        expected = pin.computeGeneralizedGravity(model, data, state.q)
        assert close(np.array(function(state.q, state.reference)).ravel(), np.array(expected), 1e-11)


@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_the_torque_of_motors_is_load_rotors_friction_and_offset(name: str) -> None:
    n = arm(name).n
    for state in states(arm(name), 5):
        ia, fc, fv, b = state.reference[10 * n :].reshape(4, n)
        _, dq, ddq, third, _ = state.derivatives
        load, rate = predicted(name, "load", state), predicted(name, "load_rate", state)
        smooth = load + ia * ddq + fv * dq + b
        np.testing.assert_allclose(predicted(name, "smooth", state), smooth, rtol=1e-12)
        np.testing.assert_allclose(predicted(name, "motor", state), smooth + fc * np.sign(dq), rtol=1e-12)
        np.testing.assert_allclose(predicted(name, "smooth_rate", state), rate + ia * third + fv * ddq, rtol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_the_tools_jacobian_is_pinocchios(name: str) -> None:
    robot = arm(name)
    model = to_pinocchio(robot)
    data = model.createData()
    s = Signals(robot)
    function = ca.Function("j", [s.q], [build_link_jacobian(robot, s.q, robot.n - 1)])
    for state in states(robot, 6):
        pin.computeJointJacobians(model, data, state.q)
        expected = pin.getJointJacobian(model, data, robot.n, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(np.array(function(state.q)), expected, atol=1e-12)


def test_parameters_that_torque_is_predicted_with_have_names():
    rng = np.random.default_rng(0)
    robot = robot_from_library("ur10")
    vector = rng.normal(size=14 * 6)
    known = ReferenceParameters.from_vector(vector, robot)
    assert known.inertias.shape == (6, 10)
    np.testing.assert_array_equal(known.rotors, vector[60:66])
    np.testing.assert_array_equal(known.constant, vector[78:])
    np.testing.assert_array_equal(known.vector, vector)
    links = ReferenceParameters.from_vector(vector[:60], robot)
    np.testing.assert_array_equal(links.vector, [*vector[:60], *np.zeros(24)])


@pytest.mark.parametrize("length", [0, 59, 66, 72, 83, 85])
def test_parameters_of_half_of_the_motors_are_not_filled_up_with_nothing(length):
    robot = robot_from_library("ur10")
    with pytest.raises(DynidentError, match="expected 60 for the links alone, or 84 with Ia, Fc, Fv and b"):
        ReferenceParameters.from_vector(np.zeros(length), robot)


@pytest.mark.parametrize(("links", "joints"), [(5, 6), (6, 5), (7, 7)])
def test_parameters_of_another_robot_predict_no_torque_of_this_one(links, joints):
    robot = robot_from_library("ur10")
    signals = Signals(robot)
    observation = Observation.from_columns(robot, build_columns([EffectChoice("drive_gain_error")], signals), signals)
    other = ReferenceParameters.from_links(np.zeros((links, 10)), joints)
    with pytest.raises(DynidentError, match=f"for {links} links and {joints} driven joints, but ur10 has 6 and 6"):
        observation.evaluate(*np.zeros((3, 1, 6)), reference=other, memory=np.zeros((1, 0)))
