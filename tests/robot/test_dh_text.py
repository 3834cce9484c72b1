"""Denavit-Hartenberg tables pasted as text, classical or modified, place every joint where the formula does."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dynident.errors import DynidentError
from dynident.robot import Robot
from dynident.robot.dh_text import robot_from_dh_text
from dynident.robot.pinocchio_conversion import to_pinocchio

UR10 = (
    (0.0, np.pi / 2, 0.1273, 0.0),
    (-0.612, 0.0, 0.0, 0.0),
    (-0.5723, 0.0, 0.0, np.pi / 2),
    (0.0, np.pi / 2, 0.163941, 0.0),
    (0.0, -np.pi / 2, 0.1157, 0.0),
    (0.0, 0.0, 0.0922, 0.0),
)
CLASSICAL = """# UR10 with another zero of the elbow, classical
| i | a [m]   | alpha  | d        | theta     |
|---|---------|--------|----------|-----------|
| 1 | 0       | pi/2   | 0.1273   | q1        |
| 2 | -0.612  | 0      | 0        | q2        |
| 3 | -0.5723 | 0      | 0        | q3 + pi/2 |
| 4 | 0       | 90°    | 0.163941 | θ4        |
| 5 | 0       | -pi/2  | 0.1157   | q5        |
| 6 | 0       | 0      | 0.0922   | *         |
"""


def screw_z(angle: float, distance: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, distance], [0, 0, 0, 1]])


def screw_x(angle: float, distance: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, distance], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def joints_of(robot: Robot, q: np.ndarray) -> list[np.ndarray]:
    model = to_pinocchio(robot)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return [data.oMi[index].homogeneous for index in range(1, model.njoints)]


def test_a_classical_table_places_the_joints_as_denavit_and_hartenberg_do() -> None:
    q = np.random.default_rng(1).uniform(-2, 2, 6)
    before = np.eye(4)
    for (a, alpha, d, theta), angle, found in zip(
        UR10, q, joints_of(robot_from_dh_text("arm", CLASSICAL), q), strict=True
    ):
        # A joint turns about z of the frame before it.
        np.testing.assert_allclose(found, before @ screw_z(theta + angle, d), atol=1e-12)
        before = before @ screw_z(theta + angle, d) @ screw_x(alpha, a)


@pytest.mark.parametrize(
    "text",
    [
        "alpha_{i-1}, a_{i-1}, d, theta\n0, 0, 0.333, q1\n-90°, 0.1, 0, q2 - 90 deg\n0, 0.2, q3 + 0.05, 0",
        "modified\ntheta d a alpha\nq1 0.333 0 0\nq2-pi/2 0 0.1 -pi/2\n0 q3+0.05 0.2 0",
        "i | alpha_(i-1) [deg] | a_(i-1) [mm] | d_i [cm] | theta_i [deg]\n1 | 0 | 0 | 33.3 | q1\n"
        "2 | -90 | 100 | 0 | q2 - 90\n3 | 0 | 200 | q3 + 5 | 0",
        "modified\nalpha [deg]  a [mm]  d [mm]  theta [deg]\n0  0  333  q1\n-90  100  0  q2 - 90\n0  200  q3 + 50  0",
        "alpha[deg]; d; theta[deg]; r\n0; 0; q1; 0.333\n-90; 0.1; q2 - 90; 0\n0; 0.2; 0; q3 + 0.05",
    ],
    ids=["craig", "columns in another order", "units", "units apart", "khalil"],
)
def test_a_modified_table_is_read_in_every_common_notation(text: str) -> None:
    q = np.array([0.3, -0.7, 0.2])
    robot = robot_from_dh_text("arm", text)
    assert [joint.kind for joint in robot.joints] == ["revolute", "revolute", "prismatic"]
    rows = ((0, 0, 0.3, 0.333), (-np.pi / 2, 0.1, -0.7 - np.pi / 2, 0), (0, 0.2, 0, 0.25))
    place = np.eye(4)
    for (alpha, a, theta, d), found in zip(rows, joints_of(robot, q), strict=True):
        place = place @ screw_x(alpha, a) @ screw_z(theta, d)
        np.testing.assert_allclose(found, place, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a alpha d theta\n0 0 0 q1", "classical or modified"),
        ("classical\na alpha d theta\n0 90 0 q1", "line 3: Alpha is 90"),
        ("classical\na alpha d theta\n0 x 0 q1", "line 3: Alpha is 'x'"),
        ("classical\na alpha d theta\n0 0 q1 q1", "line 3: Theta and the offset along z are both variable"),
        ("classical\na alpha d theta\n0 0", "line 3: The row has 2 cells"),
        ("classical\na alpha theta d d\n0 0 0 0 0", "line 2: The column d occurs twice"),
        ("classical\na alpha d theta", "no rows"),
        ("some words", "no line with column names"),
    ],
)
def test_what_cannot_be_read_is_told_with_its_line(text: str, told: str) -> None:
    with pytest.raises(DynidentError, match=told.replace("(", r"\(")):
        robot_from_dh_text("arm", text)
