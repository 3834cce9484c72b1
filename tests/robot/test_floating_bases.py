"""Robots whose base moves: coordinates of the base in front of the joints, against Pinocchio's free-flyer."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from test_clamped_bases import INERTIAL, MJCF, URDF

from dynident.array_types import FloatArray
from dynident.effects import LINKS, ReferenceParameters, Signals, build_columns
from dynident.errors import DynidentError
from dynident.regressors.model_structure import find_inertial_base_parameters
from dynident.regressors.observation_matrix import Observation
from dynident.robot import Description, Robot, robot_from_description
from dynident.robot.description_and_json import robot_from_document, robot_to_document, set_base
from dynident.robot.description_formats import BASE_JOINTS
from dynident.robot.pinocchio_conversion import compute_described_torque, from_dynamic_parameters

TREE = f"""<robot name="walker"><link name="trunk">{INERTIAL}</link><link name="thigh">{INERTIAL}</link>
<link name="shin">{INERTIAL}</link><link name="arm">{INERTIAL}</link>
<joint name="hip" type="revolute"><parent link="trunk"/><child link="thigh"/><origin xyz="0 0.1 -0.2" rpy="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="9" effort="9"/></joint>
<joint name="knee" type="revolute"><parent link="thigh"/><child link="shin"/><origin xyz="0.02 0 -0.4"/>
<axis xyz="0 0.8 0.6"/><limit lower="-1" upper="1" velocity="9" effort="9"/></joint>
<joint name="shoulder" type="prismatic"><parent link="trunk"/><child link="arm"/><origin xyz="0 -0.1 0.3"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="9" effort="9"/></joint></robot>"""


def walker(base: str | None = "floating", text: str = TREE) -> Robot:
    return set_base(robot_from_description("walker", Description("urdf", text)), base)  # type: ignore[arg-type]


def to_free_flyer(
    model: pin.Model, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a state for a model with a free-flyer, and the Jacobian of its velocity with respect to the coordinates.

    The twist and its rate come from differences of Pinocchio's own configurations along the motion, so that nothing
    here repeats the formulas of the code under test.
    """

    def configuration(time: float) -> FloatArray:
        x = q + dq * time + 0.5 * ddq * time**2
        turn = pin.rpy.rpyToMatrix(x[5], x[4], x[3])
        return np.concatenate([x[:3], pin.Quaternion(turn).coeffs(), x[6:]])

    def velocity(time: float) -> FloatArray:
        h = 1e-4
        ends = [
            pin.difference(model, configuration(time), configuration(time + step)) for step in (-h, h, -2 * h, 2 * h)
        ]
        return (8 * (ends[1] - ends[0]) - (ends[3] - ends[2])) / (12 * h)

    h = 1e-3
    rate = (8 * (velocity(h) - velocity(-h)) - (velocity(2 * h) - velocity(-2 * h))) / (12 * h)
    jacobian = np.eye(model.nv)
    for k in range(6):
        step = np.zeros(len(q))
        step[k] = 1e-5
        forward, back = (
            np.concatenate([x[:3], pin.Quaternion(pin.rpy.rpyToMatrix(x[5], x[4], x[3])).coeffs(), x[6:]])
            for x in (q + step, q - step)
        )
        jacobian[:, k] = pin.difference(model, back, forward) / 2e-5
    return configuration(0.0), velocity(0.0), rate, jacobian


def exact_free_flyer(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return twist, its rate and the Jacobian (6, 6) of the twist in closed form, from axes of the three angles."""
    yaw, pitch, roll = q[3:6]
    down = pin.rpy.rpyToMatrix(roll, pitch, yaw).T
    axes = np.column_stack(
        [down @ [0.0, 0.0, 1.0], pin.rpy.rpyToMatrix(roll, 0.0, 0.0).T @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    )
    omega = axes @ dq[3:6]
    linear = down @ dq[:3]
    # An axis that is fixed in the frame of the angles before it turns, in the base's frame, with what comes behind it.
    after = [omega, axes[:, 2] * dq[5], np.zeros(3)]
    after[0] = axes[:, 1] * dq[4] + axes[:, 2] * dq[5]
    bias = sum(-np.cross(after[k], axes[:, k]) * dq[3 + k] for k in range(3))
    rate = np.concatenate([down @ ddq[:3] - np.cross(omega, linear), axes @ ddq[3:6] + bias])
    jacobian = np.block([[down, np.zeros((3, 3))], [np.zeros((3, 3)), axes]])
    return np.concatenate([linear, omega]), rate, jacobian


def test_rows_and_torques_are_those_of_a_free_flyer() -> None:
    robot = walker()
    model = pin.buildModelFromXML(TREE, pin.JointModelFreeFlyer())
    data = model.createData()
    signals = Signals(robot)
    matrix = Observation.from_columns(robot, build_columns([LINKS], signals), signals)
    rng = np.random.default_rng(3)
    q, dq, ddq = (rng.uniform(-size, size, (40, robot.n)) for size in (1.2, 2.0, 5.0))
    entries = matrix.evaluate(q, dq, ddq, reference=ReferenceParameters.massless(robot), memory=np.zeros((40, 0)))
    rows = np.zeros((40, robot.n, matrix.n_columns))
    rows[:, matrix.entry_rows, matrix.entry_columns] = entries
    torque = compute_described_torque(robot, q, dq, ddq)
    for k in range(40):
        twist, rate, of_base = exact_free_flyer(q[k], dq[k], ddq[k])
        turn = pin.Quaternion(pin.rpy.rpyToMatrix(q[k, 5], q[k, 4], q[k, 3])).coeffs()
        state = (
            np.concatenate([q[k, :3], turn, q[k, 6:]]),
            np.concatenate([twist, dq[k, 6:]]),
            np.concatenate([rate, ddq[k, 6:]]),
        )
        jacobian = np.eye(robot.n)
        jacobian[:6, :6] = of_base
        regressor = pin.computeJointTorqueRegressor(model, data, *state)
        ours = from_dynamic_parameters(regressor.reshape(robot.n, 4, 10)).reshape(robot.n, 40)
        np.testing.assert_allclose(rows[k], jacobian.T @ ours, atol=1e-10)
        np.testing.assert_allclose(torque[k], jacobian.T @ pin.rnea(model, data, *state), atol=1e-10)


def test_the_closed_form_of_this_test_agrees_with_differences_of_configurations() -> None:
    model = pin.buildModelFromXML(TREE, pin.JointModelFreeFlyer())
    rng = np.random.default_rng(5)
    q, dq, ddq = (rng.uniform(-size, size, 9) for size in (1.2, 2.0, 5.0))
    _, velocity, rate, jacobian = to_free_flyer(model, q, dq, ddq)
    twist, twist_rate, of_base = exact_free_flyer(q, dq, ddq)
    np.testing.assert_allclose(velocity[:6], twist, atol=1e-8)
    np.testing.assert_allclose(rate[:6], twist_rate, atol=1e-5)
    np.testing.assert_allclose(jacobian[:6, :6], of_base, atol=1e-8)


def test_base_parameters_are_as_many_as_with_a_free_flyer_and_span_the_same_rows() -> None:
    robot = walker()
    base = find_inertial_base_parameters(robot)
    model = pin.buildModelFromXML(TREE, pin.JointModelFreeFlyer())
    data, rng = model.createData(), np.random.default_rng(0)
    stack = []
    for _ in range(60):
        q = pin.integrate(model, pin.neutral(model), 3 * rng.uniform(-1, 1, model.nv))
        stack.append(
            pin.computeJointTorqueRegressor(model, data, q, rng.uniform(-2, 2, model.nv), rng.uniform(-5, 5, model.nv))
        )
    regressor = from_dynamic_parameters(np.vstack(stack).reshape(-1, 4, 10)).reshape(-1, 40)
    assert base.count == np.linalg.matrix_rank(regressor, tol=1e-8)
    # What the base parameters combine is all that the rows show: W = W[kept] grouping.
    np.testing.assert_allclose(regressor[:, list(base.kept)] @ base.grouping, regressor, atol=1e-8)
    # The trunk has all ten parameters of a body in free space: they begin the list, and belong to its link.
    assert base.names[0] == "XX6"
    assert robot.joints[5].link == "trunk"


@pytest.mark.parametrize(
    "description",
    [
        Description("urdf", URDF.format(kind="floating", inertial=INERTIAL)),
        Description("mjcf", MJCF.format(joint="<freejoint/>", key="")),
        Description("mjcf", MJCF.format(joint='<joint type="free"/>', key="")),
    ],
)
def test_a_floating_joint_of_the_root_makes_a_floating_base_wherever_the_file_puts_it(description: Description) -> None:
    robot = robot_from_description("leg", description)
    assert robot.base == "floating"
    assert robot.joint_names == (*BASE_JOINTS["floating"], "hip")
    assert repr(robot) == "Robot(leg: 1 joints on a floating base: hip)"
    # The frame of the base is that of the trunk: the hip lies where the trunk has it.
    np.testing.assert_allclose(robot.joints[6].placement[:3, 3], [0.0, 0.1, 0.0], atol=1e-12)
    assert robot.inertias is not None
    masses = robot.inertias[:, 9]
    assert masses[:5].tolist() == [0.0] * 5
    assert masses[5:].tolist() == ([2.0, 2.0] if description.format == "urdf" else [5.0, 2.0])
    again = robot_from_document(json.loads(json.dumps(robot_to_document(robot))))
    assert (again.base, again.joint_names) == ("floating", robot.joint_names)
    np.testing.assert_array_equal(again.inertias, robot.inertias)


def test_a_planar_base_has_three_coordinates() -> None:
    robot = walker("planar")
    assert robot.joint_names == ("base_x", "base_y", "base_yaw", "hip", "knee", "shoulder")
    # Mass, first moments across the plane and the moment of inertia about the vertical are what such a base shows.
    only_trunk = [name for name in find_inertial_base_parameters(robot).names if name.endswith("3")]
    assert {"M3", "ZZ3"} <= set(only_trunk)
    assert "XX3" not in {
        find_inertial_base_parameters(robot).names[k] for k in find_inertial_base_parameters(robot).kept
    }


def test_what_cannot_be_is_refused_with_a_sentence() -> None:
    with pytest.raises(DynidentError, match="'base_x', which is the name of a coordinate of a floating base"):
        walker(text=TREE.replace('"hip"', '"base_x"'))
    with pytest.raises(DynidentError, match="The base is 'flying'; expected fixed, floating"):
        walker("flying")
    with pytest.raises(DynidentError, match="no joint 'base_z'"):
        robot_from_description("walker", Description("urdf", TREE), locked_joints={"base_z": 0.0})
    table = "classical\na alpha d theta\n0 pi/2 0.3 q1\n0.4 0 0 q2\n"
    with pytest.raises(DynidentError, match="describes no root link, so its base cannot be floating"):
        set_base(robot_from_description("arm", Description("dh", table)), "floating")
    two = MJCF.replace("</worldbody>", '<body name="ball"><freejoint/><geom size="1"/></body></worldbody>')
    with pytest.raises(
        DynidentError,
        match=r"The bodies trunk, ball are all children of the world; .* leave out .* what is not a part of it",
    ):
        robot_from_description("leg", Description("mjcf", two.format(joint="<freejoint/>", key="")))
    carried = TREE.replace('<link name="trunk">', '<link name="world"/><link name="trunk">').replace(
        "</robot>",
        '<joint name="carrier" type="floating"><parent link="world"/><child link="trunk"/><origin rpy="{} 2"/></joint>'
        "</robot>",
    )
    assert walker("planar", carried.format("0 0")).joint_names[:3] == ("base_x", "base_y", "base_yaw")
    assert walker("floating", carried.format("0 0.4")).base == "floating"
    for tilt in ("0 0.4", "-0.01 0"):
        with pytest.raises(DynidentError, match="'carrier' tilts the root link, but the z axis of a planar base"):
            walker("planar", carried.format(tilt))
    tilted = MJCF.format(joint="", key="")  # by 11°
    with pytest.raises(DynidentError, match="Body 'trunk' is tilted, but the z axis of a planar base is vertical"):
        set_base(robot_from_description("leg", Description("mjcf", tilted)), "planar")
