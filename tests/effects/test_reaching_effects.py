"""Effects that reach beyond one joint, against Pinocchio models in which they are built as bodies and joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.effect_columns import COUNT, Evaluated
from support.oracles import FROM_PINOCCHIO, FloatArray, arm, pinocchio_torque

from dynident.effects import EffectChoice, get_effect
from dynident.robot import Robot, to_pinocchio

ROBOTS = ("ur10", "dual_arm", "crooked")


def with_inertia(found: Evaluated) -> Robot:
    """The robot with the inertial parameters that torque is predicted with."""
    return replace(found.robot, inertias=found.inertia.reshape(-1, 10))


def close(found: FloatArray, expected: FloatArray, share: float) -> None:
    np.testing.assert_allclose(found, expected, atol=share * max(1.0, float(np.abs(expected).max())))


@pytest.mark.parametrize("link", [None, 0, 1])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_payload_on_any_link_is_the_difference_of_two_pinocchio_models(name, link):
    named = () if link is None else (arm(name).joint_names[link],)
    found = Evaluated(arm(name), EffectChoice("payload", named))
    robot, rng = with_inertia(found), np.random.default_rng(3)
    carried = rng.uniform(0.5, 2.0, 10)
    heavier = found.inertia.reshape(-1, 10).copy()
    heavier[-1 if link is None else link] += carried
    expected = pinocchio_torque(replace(robot, inertias=heavier), found.q, found.dq, found.ddq)
    expected -= pinocchio_torque(robot, found.q, found.dq, found.ddq)
    close(found.values @ carried, expected * found.runs, 1e-10)


@pytest.mark.parametrize("name", [*ROBOTS, "scara"])
def test_a_position_that_is_off_changes_the_torque_by_its_slope(name):
    found = Evaluated(arm(name), EffectChoice("encoder_zero_error"))
    robot, h = with_inertia(found), 1e-5
    for j in range(robot.n):
        moved = []
        for side in (h, -h):
            q = found.q.copy()
            q[:, j] += side
            moved.append(pinocchio_torque(robot, q, found.dq, found.ddq))
        close(found.column(f"dq0{j + 1}"), (moved[0] - moved[1]) / (2 * h), 1e-7)


@pytest.mark.parametrize("name", ["ur10", "crooked"])
def test_a_joint_that_sits_elsewhere_changes_the_torque_by_its_slope(name):
    found = Evaluated(arm(name), EffectChoice("kinematic_error"))
    h = 1e-5
    for j in range(found.robot.n):
        for axis, parameter in enumerate(("dx", "dy", "dz")):
            ahead, behind = (
                pinocchio_torque(_moved(with_inertia(found), j, axis, side), found.q, found.dq, found.ddq)
                for side in (h, -h)
            )
            close(found.column(f"{parameter}{j + 1}"), (ahead - behind) / (2 * h), 1e-7)


def _moved(robot: Robot, joint: int, axis: int, by: float) -> Robot:
    placement = robot.joints[joint].placement.copy()
    placement[axis, 3] += by
    joints = list(robot.joints)
    joints[joint] = replace(joints[joint], placement=placement)
    return replace(robot, joints=tuple(joints))


@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_links_hang_behind_by_half_the_play_on_the_side_that_the_load_pushes_to(name):
    found = Evaluated(arm(name), EffectChoice("backlash", shape=(("w", 7.0),)))
    robot, h = with_inertia(found), 1e-5
    for j in range(robot.n):
        moved = []
        for side in (-h, h):
            q = found.q.copy()
            q[:, j] += side * 0.5 * np.tanh(found.load[:, j] / 7.0)
            moved.append(pinocchio_torque(robot, q, found.dq, found.ddq))
        close(found.column(f"bl{j + 1}"), (moved[0] - moved[1]) / (2 * h), 1e-7)


def path(found: Evaluated, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, dq, ddq (COUNT, n) at time t of paths that have the states' derivatives at 0."""
    terms = (found.q, found.dq, found.ddq, found.dddq, found.ddddq)
    factorial = (1, 1, 2, 6, 24)
    return tuple(  # type: ignore[return-value]
        sum(x * t**k / factorial[k] for k, x in enumerate(terms[order:])) for order in range(3)
    )


def test_links_behind_a_gear_with_play_follow_their_side_in_acceleration():
    found = Evaluated(arm("ur10"), EffectChoice("backlash", shape=(("w", 40.0),)))
    robot, h, play = with_inertia(found), 1e-3, 1e-7
    side = {t: 0.5 * np.tanh(pinocchio_torque(robot, *path(found, t)) / 40.0) for t in (-h, 0.0, h)}
    acceleration = (side[h] - 2 * side[0.0] + side[-h]) / h**2
    for j in range(6):
        ddq = found.ddq.copy()
        ddq[:, j] -= play * acceleration[:, j]
        expected = pinocchio_torque(robot, found.q, found.dq, ddq)
        expected -= pinocchio_torque(robot, found.q, found.dq, found.ddq)
        close(found.column(f"bi{j + 1}"), expected / play, 2e-3)
        rotor = np.zeros((COUNT, 6))
        rotor[:, j] = -acceleration[:, j]
        close(found.column(f"br{j + 1}"), rotor, 2e-3)


def test_links_behind_an_elastic_gear_lag_by_what_it_twists():
    """A motor at q, the link at q - C τ(t): its torque to first order in C, with the twist's own acceleration."""
    found = Evaluated(arm("ur10"), EffectChoice("joint_elasticity"))
    robot = with_inertia(found)
    h, compliance = 1e-3, 1e-7
    load = {t: pinocchio_torque(robot, *path(found, t)) for t in (-h, 0.0, h)}
    acceleration = (load[h] - 2 * load[0.0] + load[-h]) / h**2
    for j in range(6):
        q, ddq = found.q.copy(), found.ddq.copy()
        q[:, j] -= compliance * load[0.0][:, j]
        ddq[:, j] -= compliance * acceleration[:, j]
        expected = (pinocchio_torque(robot, q, found.dq, ddq) - load[0.0]) / compliance
        close(found.column(f"Ce{j + 1}") + found.column(f"Cl{j + 1}"), expected, 2e-4)
        rotor = np.zeros((COUNT, 6))
        rotor[:, j] = acceleration[:, j]
        close(found.column(f"Cr{j + 1}"), rotor, 1e-4)


def test_late_torque_is_torque_less_its_rate_times_the_delay():
    found = Evaluated(arm("ur10"), EffectChoice("torque_delay"))
    robot, h = with_inertia(found), 1e-5
    ia, _, fv, b = found.drives
    moved = []
    for t in (h, -h):
        q, dq, ddq = path(found, t)
        moved.append(pinocchio_torque(robot, q, dq, ddq) + ia * ddq + fv * dq + b)
    # Of Coulomb friction nothing changes while the joints move on.
    moving = (np.abs(found.dq) > 1e-3 * np.abs(found.ddq)).all(axis=1)
    assert np.count_nonzero(moving) > COUNT // 2
    close(found.column("delay")[moving], -((moved[0] - moved[1]) / (2 * h))[moving], 1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_rotor_that_is_carried_along_is_a_body_that_spins_in_pinocchio(name):
    robot, found = arm(name), Evaluated(arm(name), EffectChoice("rotor_coupling"))
    ratio, inertia = 40.0, 2e-3
    for j in get_effect("rotor_coupling").applicable(robot):
        spinning, carried = (_with_rotor(found, j, speed, inertia) for speed in (ratio, 0.0))
        expected = spinning - carried
        expected[:, j] -= ratio**2 * inertia * found.ddq[:, j]
        # What the carrier alone would take, and the rotor's own inertia, belong to links and rotor_inertia.
        close(ratio * inertia * found.column(f"NJ{j + 1}"), expected, 1e-9)


def _with_rotor(found: Evaluated, joint: int, ratio: float, inertia: float) -> FloatArray:
    """Torque (COUNT, n) with a massless rotor about the joint's axis on its antecedent, turning `ratio` times as fast.

    By virtual work the rotor's torque acts on the joint times the ratio.
    """
    robot = found.robot
    model = to_pinocchio(replace(robot, inertias=1e-3 * np.ones((robot.n, 10)) + np.eye(1, 10, 9)))
    described = robot.joints[joint]
    spin = pin.JointModelRevoluteUnaligned(described.axis)
    added = model.addJoint(described.parent + 1, spin, pin.SE3(described.placement), "rotor")
    tensor = inertia * np.outer(described.axis, described.axis)
    model.appendBodyToJoint(added, pin.Inertia(0.0, np.zeros(3), tensor), pin.SE3.Identity())
    data = model.createData()
    # Joints of a Pinocchio model are ordered by the tree: the rotor's coordinate is where its joint says.
    place = model.joints[added].idx_v
    order = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    out = np.empty((COUNT, robot.n))
    for k, state in enumerate(zip(found.q, found.dq, found.ddq, strict=True)):
        whole = []
        for values in state:
            full = np.empty(model.nv)
            full[order], full[place] = values, ratio * values[joint]
            whole.append(full)
        torque = np.array(pin.rnea(model, data, *whole))
        out[k] = torque[order]
        out[k, joint] += ratio * torque[place]
    return out


@pytest.mark.parametrize("name", ROBOTS)
def test_a_contact_is_a_wrench_on_the_last_link_within_its_window(name):
    start, end = 0.4, 1.1
    found = Evaluated(arm(name), EffectChoice("external_contact", shape=(("t0", start), ("t1", end))))
    model = to_pinocchio(found.robot)
    data = model.createData()
    rng = np.random.default_rng(2)
    steady, swelling = rng.normal(size=6), rng.normal(size=6)
    t = found.time
    inside = (t >= start) & (t <= end)
    assert 3 < np.count_nonzero(inside) < COUNT
    for k in range(COUNT):
        pin.computeJointJacobians(model, data, found.q[k])
        jacobian = pin.getJointJacobian(model, data, found.robot.n, pin.LOCAL_WORLD_ALIGNED)
        wrench = inside[k] * (steady + swelling * np.sin(np.pi * (t[k] - start) / (end - start)))
        close(found.values[k] @ np.concatenate([steady, swelling]), -jacobian.T @ wrench, 1e-11)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_base_that_shakes_is_a_base_on_three_slides_in_pinocchio(name):
    frequency = 6.5
    found = Evaluated(arm(name), EffectChoice("base_vibration", shape=(("f", frequency),)))
    rng = np.random.default_rng(4)
    cosine, sine = rng.normal(size=3), rng.normal(size=3)
    model = _on_slides(with_inertia(found))
    data = model.createData()
    angle = 2 * np.pi * frequency * found.time
    still = np.zeros(3)
    values = np.column_stack([cosine, sine]).ravel()
    for k in range(COUNT):
        base = cosine * np.cos(angle[k]) + sine * np.sin(angle[k])
        shaken, calm = (
            pin.rnea(
                model,
                data,
                np.concatenate([still, found.q[k]]),
                np.concatenate([still, found.dq[k]]),
                np.concatenate([acceleration, found.ddq[k]]),
            )[3:]
            for acceleration in (base, still)
        )
        close(found.values[k] @ values, np.array(shaken - calm), 1e-10)


def _on_slides(robot: Robot) -> pin.Model:
    """The robot on a base that slides along x, y and z, in that order of coordinates, and then its own joints."""
    model = pin.Model()
    model.gravity.linear = robot.gravity
    base = 0
    for axis in np.eye(3):
        base = model.addJoint(base, pin.JointModelPrismaticUnaligned(axis), pin.SE3.Identity(), f"slide{axis}")
    kinds = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
    assert robot.inertias is not None
    for joint, parameters in zip(robot.joints, robot.inertias, strict=True):
        kind = kinds[joint.kind](joint.axis)
        added = model.addJoint(joint.parent + 1 + base, kind, pin.SE3(joint.placement), joint.name)
        dynamic = np.empty(10)
        dynamic[FROM_PINOCCHIO] = parameters
        model.appendBodyToJoint(added, pin.Inertia.FromDynamicParameters(dynamic), pin.SE3.Identity())
    return model
