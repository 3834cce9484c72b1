from __future__ import annotations

import contextlib
import json
import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import RigidTransform, Rotation

from dynident.errors import DynidentError
from dynident.robot import (
    Description,
    Limits,
    joint_frames,
    robot_from_description,
    robot_from_library,
    robot_from_modified_dh,
    robot_from_urdf,
    to_pinocchio,
    tool_path,
)

CONSTANTS = ("gamma", "b", "alpha", "d", "theta", "r")
angles = st.floats(-math.pi, math.pi)
lengths = st.floats(-2, 2)


@st.composite
def tables(draw):
    """Tables of 1 to 6 rows on any tree."""
    rows = []
    for index in range(draw(st.integers(1, 6))):
        row = {key: draw(lengths if key in ("b", "d", "r") else angles) for key in CONSTANTS}
        rows.append({**row, "antecedent": draw(st.integers(0, index)), "sigma": draw(st.integers(0, 1))})
    return rows


def turn(axis: str, angle: float) -> RigidTransform:
    return RigidTransform.from_rotation(Rotation.from_euler(axis, angle))


def slide(*translation: float) -> RigidTransform:
    return RigidTransform.from_translation(translation)


def scipy_frames(rows: list[dict], q: np.ndarray) -> list[np.ndarray]:
    """Rot(z, γ) Trans(z, b) Rot(x, α) Trans(x, d) Rot(z, θ) Trans(z, r), one factor after the other."""
    frames = [RigidTransform.identity()]
    for row, position in zip(rows, q, strict=True):
        theta = row["theta"] + (position if row["sigma"] == 0 else 0)
        r = row["r"] + (position if row["sigma"] == 1 else 0)
        frames.append(
            frames[row["antecedent"]]
            * turn("z", row["gamma"])
            * slide(0, 0, row["b"])
            * turn("x", row["alpha"])
            * slide(row["d"], 0, 0)
            * turn("z", theta)
            * slide(0, 0, r)
        )
    return [frame.as_matrix() for frame in frames[1:]]


@settings(max_examples=60, deadline=None)
@given(rows=tables(), q=arrays(float, 6, elements=st.floats(-4, 4)))
def test_frames_of_any_tree_are_the_product_of_its_six_elementary_motions(rows, q):
    robot = robot_from_modified_dh("r", rows)
    q = q[: len(rows)]
    np.testing.assert_allclose(joint_frames(robot, q[None])[0], scipy_frames(rows, q), atol=1e-9)


PANDA_URDF_ORIGINS = (
    ("0 0 0.333", "0 0 0"),
    ("0 0 0", "-1.5707963267948966 0 0"),
    ("0 -0.316 0", "1.5707963267948966 0 0"),
    ("0.0825 0 0", "1.5707963267948966 0 0"),
    ("-0.0825 0.384 0", "-1.5707963267948966 0 0"),
    ("0 0 0", "1.5707963267948966 0 0"),
    ("0.088 0 0", "1.5707963267948966 0 0"),
)
"""As the manufacturer's URDF writes them."""


@settings(max_examples=30, deadline=None)
@given(q=arrays(float, 7, elements=st.floats(-3, 3)))
def test_the_table_and_the_urdf_of_one_arm_give_the_same_frames(q):
    links = "".join(f'<link name="l{i}"/>' for i in range(8))
    joints = "".join(
        f'<joint name="joint{i + 1}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/></joint>'
        for i, (xyz, rpy) in enumerate(PANDA_URDF_ORIGINS)
    )
    from_urdf = robot_from_urdf("panda", f'<robot name="p">{links}{joints}</robot>')
    from_table = robot_from_library("franka_panda")
    np.testing.assert_allclose(joint_frames(from_urdf, q[None]), joint_frames(from_table, q[None]), atol=1e-12)
    assert from_urdf.joint_names == from_table.joint_names


def test_mass_properties_are_moved_to_the_origin_of_the_frame():
    center, tensor = [0.1, -0.2, 0.3], [0.2, 0.01, 0.02, 0.3, -0.03, 0.4]
    row = {"mass_properties": {"mass": 2.0, "center_of_mass": center, "inertia": tensor}}
    x, y, z = center
    expected = [
        0.2 + 2 * (y * y + z * z),
        0.01 - 2 * x * y,
        0.02 - 2 * x * z,
        0.3 + 2 * (x * x + z * z),
        -0.03 - 2 * y * z,
        0.4 + 2 * (x * x + y * y),
        2 * x,
        2 * y,
        2 * z,
        2.0,
    ]
    np.testing.assert_allclose(robot_from_modified_dh("r", [row]).inertias, [expected], atol=1e-15)


def test_inertial_parameters_are_kept_as_stated():
    inertia = {
        "XX": 0.5,
        "XY": 0.01,
        "XZ": 0.02,
        "YY": 0.6,
        "YZ": 0.03,
        "ZZ": 0.7,
        "MX": 0.1,
        "MY": 0.2,
        "MZ": 0.3,
        "M": 4,
    }
    robot = robot_from_modified_dh("r", [{"inertia": inertia}, {}])
    np.testing.assert_allclose(robot.inertias, [list(inertia.values()), [0] * 10], atol=1e-15)


def test_defaults_make_a_serial_arm_of_revolute_joints():
    robot = robot_from_modified_dh("r", [{}, {"alpha": "pi/2"}, {"antecedent": 1}, {"antecedent": "joint2"}])
    assert robot.joint_names == ("joint1", "joint2", "joint3", "joint4")
    assert [joint.parent for joint in robot.joints] == [-1, 0, 0, 1]
    assert {joint.kind for joint in robot.joints} == {"revolute"}
    assert robot.inertias is None
    np.testing.assert_array_equal(robot.gravity, [0, 0, -9.81])


def test_antecedents_by_number_by_name_and_the_base():
    rows = [
        {"name": "a"},
        {"name": "b", "antecedent": 0},
        {"name": "c", "antecedent": "a"},
        {"name": "d", "antecedent": 2},
    ]
    robot = robot_from_modified_dh("r", [*rows, {"name": "e", "antecedent": "base"}])
    assert [joint.parent for joint in robot.joints] == [-1, -1, 0, 1, -1]


def test_gravity_of_the_table_holds_unless_another_is_stated():
    table = {"joints": [{}], "gravity": [0, 9.81, 0], "title": "on a wall"}
    np.testing.assert_array_equal(robot_from_modified_dh("r", table).gravity, [0, 9.81, 0])
    np.testing.assert_array_equal(robot_from_modified_dh("r", table, gravity=(0, 0, 0)).gravity, [0, 0, 0])


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("pi", math.pi),
        ("-pi/2", -math.pi / 2),
        ("+3*pi/4", 0.75 * math.pi),
        ("0.5 * pi", math.pi / 2),
        ("π/3", math.pi / 3),
        ("-1.5e-1", -0.15),
        (" 2 ", 2.0),
    ],
)
def test_angles_may_be_written_as_fractions_of_pi(text, value):
    placement = robot_from_modified_dh("r", [{"theta": text}]).joints[0].placement
    np.testing.assert_allclose(placement[:2, 0], [math.cos(value), math.sin(value)], atol=1e-15)


def test_a_locked_joint_of_a_table_carries_its_link_with_the_one_before():
    arm = robot_from_library("franka_panda")
    locked = robot_from_description(
        "r", Description(arm.description.format, arm.description.content), locked_joints={"joint5": 0.7, "joint6": 1.0}
    )
    assert locked.joint_names == ("joint1", "joint2", "joint3", "joint4", "joint7")
    assert locked.locked_joints == {"joint5": 0.7, "joint6": 1.0}
    q, dq = np.array([0.1, -0.2, 0.3, -1.0, 0.7, 1.0, 0.4]), np.array([0.5, 0.4, 0.3, 0.2, 0, 0, 0.1])
    free = [0, 1, 2, 3, 6]
    full, reduced = to_pinocchio(arm), to_pinocchio(locked)
    np.testing.assert_allclose(
        pin.rnea(reduced, reduced.createData(), q[free], dq[free], dq[free]),
        pin.rnea(full, full.createData(), q, dq, dq)[free],
        atol=1e-12,
    )


def test_the_tool_path_follows_a_point_of_the_last_link():
    robot = robot_from_modified_dh("r", [{}, {"d": 1.0}])
    q = np.array([[0.0, 0.0], [math.pi / 2, 0.0], [0.0, math.pi / 2]])
    np.testing.assert_allclose(tool_path(robot, q), [[1, 0, 0], [0, 1, 0], [1, 0, 0]], atol=1e-15)
    point = np.array([0.5, 0.0, 0.2])
    np.testing.assert_allclose(
        tool_path(robot, q, point=point), [[1.5, 0, 0.2], [0, 1.5, 0.2], [1, 0.5, 0.2]], atol=1e-15
    )
    np.testing.assert_allclose(tool_path(robot, q, joint=0), np.zeros((3, 3)), atol=1e-15)


def test_limits_of_the_table_are_read():
    limits = {"position": ["-pi", "pi"], "velocity": 2, "acceleration": 3, "jerk": None, "effort": 5}
    robot = robot_from_modified_dh("r", [{"limits": limits}])
    assert robot.joints[0].limits == Limits((-math.pi, math.pi), 2.0, 3.0, None, 5.0)


BAD = {
    "not JSON": ('{"joints": [\n{]}', "", "line 2: The JSON is malformed at column 2"),
    "a number": ("3", "", "Expected a list of joints"),
    "no rows": ([], "", "Expected a list of joints"),
    "no joints": ({"title": "x"}, "/joints", "Expected a list of joints"),
    "unknown top field": ({"joints": [{}], "rows": 1}, "/rows", "Unknown field 'rows'; expected joints, gravity"),
    "a row is a list": ([[]], "/0", "Expected an object with name, antecedent, sigma"),
    "unknown field": ({"joints": [{}, {"a": 0.3}]}, "/joints/1/a", "Unknown field 'a'; expected name"),
    "empty name": ([{"name": ""}], "/0/name", "a non-empty text"),
    "name twice": ([{"name": "a"}, {"name": "a"}], "/1/name", "'a' is used twice"),
    "called base": ([{"name": "base"}], "/0/name", "No joint can be called 'base'"),
    "called universe": ([{"name": "universe"}], "/0/name", "No joint can be called 'universe'"),
    "sigma": ([{"sigma": 2}], "/0/sigma", r"Expected 0 \(revolute\) or 1 \(prismatic\)"),
    "code": ([{"alpha": "__import__('os')"}], "/0/alpha", "is not a number; expected one such as"),
    "division by zero": ([{"alpha": "pi/0"}], "/0/alpha", "is not a number"),
    "true": ([{"r": True}], "/0/r", "True is not a number"),
    "infinite": ('[{"r": 1e999}]', "/0/r", "inf is not a number"),
    "huge integer": ('[{"r": 1' + "0" * 400 + "}]", "/0/r", "is not a number"),
    "later antecedent": ([{"antecedent": 1}], "/0/antecedent", "antecedent 1 is not above this row; expected 0 or"),
    "unknown antecedent": ([{}, {"antecedent": "hip"}], "/1/antecedent", "'hip' .* name or number of joint1"),
    "limits exchanged": (
        [{"limits": {"position": [2, 1]}}],
        "/0/limits/position",
        r"\[2.0, 1.0\].*the lower one first",
    ),
    "one limit": ([{"limits": {"position": [2]}}], "/0/limits/position", "Expected a list of 2 numbers"),
    "limit of zero": ([{"limits": {"velocity": 0}}], "/0/limits/velocity", "velocity is 0.0; it must be"),
    "unknown limit": ([{"limits": {"torque": 1}}], "/0/limits/torque", "Unknown field 'torque'"),
    "unknown inertial": ([{"inertia": {"xx": 1}}], "/0/inertia/xx", "Unknown field 'xx'; expected XX, XY"),
    "no mass": ([{"inertia": {"XX": 1}}], "/0/inertia/M", "positive mass"),
    "inertia twice": (
        [{"inertia": {}, "mass_properties": {}}],
        "/0/mass_properties",
        "either inertia or mass_properties",
    ),
    "no centre": (
        [{"mass_properties": {"mass": 1}}],
        "/0/mass_properties/center_of_mass",
        "'center_of_mass' is missing",
    ),
    "gravity": ({"joints": [{}], "gravity": [0, "a", 0]}, "/gravity/1", "'a' is not a number"),
}


@pytest.mark.parametrize(("table", "pointer", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_table_is_named_with_the_field_and_the_reason(table, pointer, message):
    content = table if isinstance(table, str) else json.dumps(table)
    with pytest.raises(DynidentError, match=message) as caught:
        robot_from_description("r", Description("modified_dh", content))
    assert caught.value.pointer == "/description/content" + pointer


@settings(max_examples=200, deadline=None)
@given(
    value=st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(
                    [
                        "joints",
                        "name",
                        "antecedent",
                        "sigma",
                        "alpha",
                        "limits",
                        "inertia",
                        "mass_properties",
                        "M",
                        "mass",
                    ]
                ),
                inner,
                max_size=4,
            )
        ),
        max_leaves=8,
    )
)
def test_any_json_is_a_robot_or_an_error_for_the_user(value):
    with contextlib.suppress(DynidentError):
        assert robot_from_description("r", Description("modified_dh", json.dumps({"joints": [value]}))).n == 1
