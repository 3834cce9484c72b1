from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dynident.errors import DynidentError
from dynident.robot import robot_from_urdf

BAR = (
    '<inertial><origin xyz="0.1 0.02 -0.03" rpy="0.1 0.2 0.3"/><mass value="2"/>'
    '<inertia ixx="0.1" ixy="0.01" ixz="-0.02" iyy="0.2" iyz="0.03" izz="0.25"/></inertial>'
)


def one_joint(kind: str = "revolute", axis: str = '<axis xyz="0 0 1"/>', extra: str = "") -> str:
    return (
        f'<robot name="r"><link name="base"/><link name="arm">{BAR}</link>\n'
        f'<joint name="j" type="{kind}"><parent link="base"/><child link="arm"/>{axis}\n'
        f'<limit lower="-1" upper="2" velocity="3" effort="4"/></joint>{extra}</robot>'
    )


def test_inertial_parameters_are_those_of_the_tensor_about_the_joint_frame():
    robot = robot_from_urdf("r", one_joint())
    rotation = pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)
    center = np.array([0.1, 0.02, -0.03])
    tensor = np.array([[0.1, 0.01, -0.02], [0.01, 0.2, 0.03], [-0.02, 0.03, 0.25]])
    about_origin = rotation @ tensor @ rotation.T + 2 * (center @ center * np.eye(3) - np.outer(center, center))
    expected = [*about_origin[np.triu_indices(3)], *(2 * center), 2]
    assert robot.inertias is not None
    np.testing.assert_allclose(robot.inertias, [expected], atol=1e-15)


def test_limits_come_from_the_urdf():
    limits = robot_from_urdf("r", one_joint()).joints[0].limits
    assert (limits.position, limits.velocity, limits.effort) == ((-1.0, 2.0), 3.0, 4.0)


def test_malformed_xml_is_named_with_its_line():
    with pytest.raises(DynidentError, match="line 3: The XML is malformed at column 56: mismatched tag"):
        robot_from_urdf("r", one_joint().replace("</joint>", "</joints>"))
