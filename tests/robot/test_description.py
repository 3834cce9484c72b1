from __future__ import annotations

import json
import math

import numpy as np
import pytest
from support.urdf_texts import EVERY_KIND, one_joint

from dynident.errors import DynidentError
from dynident.robot import Description, Drive, Limits, robot_from_description
from dynident.robot.joint import list_limbs

ARM = Description("urdf", EVERY_KIND)
TABLE = Description("modified_dh", '[{"name": "a/b"}, {"name": "c"}]')


def test_drives_stand_in_the_order_of_the_joints():
    robot = robot_from_description(
        "r", ARM, drives={"slide": Drive(drive_gain=12.0), "turn": Drive(None, 100.0, 0.1, 2.0)}
    )
    assert [drive.gain for drive in robot.drives] == [20.0, None, 12.0, None, None, None]


def test_gravity_is_that_stated_in_the_base_frame():
    robot = robot_from_description("r", ARM, gravity=[0.0, 1.0, -9.7])
    np.testing.assert_array_equal(robot.gravity, [0, 1, -9.7])


def test_the_description_is_kept_as_it_came():
    assert robot_from_description("r", ARM).description == ARM
    assert robot_from_description("r", TABLE).description == TABLE


BAD = {
    "unknown format": (
        {"description": Description("sdf", "")},  # type: ignore[arg-type]
        "/description/format",
        "Unknown format 'sdf'; expected urdf, mjcf, modified_dh",
    ),
    "limits of an unknown joint": (
        {"limits": {"knee": Limits()}},
        "/limits/knee",
        "no joint 'knee'. The joints are: turn, lift",
    ),
    "drive of an unknown joint": (
        {"drives": {"knee": Drive()}},
        "/drives/knee",
        "no joint 'knee'. The joints are: turn, lift",
    ),
    "unknown joint locked": (
        {"locked_joints": {"knee": 0.0}},
        "/locked_joints/knee",
        "no joint 'knee'. The joints are: turn",
    ),
    "fixed joint locked": ({"locked_joints": {"mount": 0.0}}, "/locked_joints/mount", "'mount' is fixed in the desc"),
    "locked nowhere": (
        {"locked_joints": {"lift": math.nan}},
        "/locked_joints/lift",
        "locked at nan; expected a number",
    ),
    "drive of a locked joint": (
        {"locked_joints": {"lift": 0.0}, "drives": {"lift": Drive(1.0)}},
        "/drives/lift",
        "'lift' is locked, so it cannot have a drive",
    ),
    "everything locked": (
        {"description": TABLE, "locked_joints": {"a/b": 0.0, "c": 1.0}},
        "/locked_joints",
        "Every joint is locked",
    ),
    "a name with a slash": (
        {"description": TABLE, "limits": {"a/c": Limits()}},
        "/limits/a~1c",
        "no joint 'a/c'",
    ),
    "flat gravity": ({"gravity": [0, -9.81]}, "/gravity", "expected three numbers in m/s²"),
    "gravity unknown": ({"gravity": [0, 0, math.nan]}, "/gravity", "expected three numbers in m/s²"),
}


@pytest.mark.parametrize(("arguments", "pointer", "message"), BAD.values(), ids=BAD.keys())
def test_a_setting_that_does_not_fit_is_named_with_its_place(arguments, pointer, message):
    with pytest.raises(DynidentError, match=message) as caught:
        robot_from_description("r", **{"description": ARM, **arguments})
    assert caught.value.pointer == pointer


@pytest.mark.parametrize(
    ("make", "pointer", "message"),
    [
        (lambda: Limits(velocity=-1), "/velocity", "velocity is -1; it must be 1e-06 to 1e"),
        (lambda: Limits((1, -1)), "/position", r"\[1, -1\]; give two numbers, the lower one first"),
        (lambda: Limits((0, math.inf)), "/position/1", "position is inf; it must be"),
        (lambda: Drive(0.0), "/drive_gain", "drive_gain is 0.0; it must be .* but 0"),
        (lambda: Drive(coupling={"a": math.nan}), "/coupling/a", "coupling of a is nan; it must be"),
        (lambda: Drive(gear_ratio=math.nan), "/gear_ratio", "gear_ratio is nan; it must be"),
        (
            lambda: Drive(10.0, 100.0, 0.2),
            "/drive_gain",
            r"drive_gain is 10.0, but .* give 20 \[12.17\]; give only one",
        ),
    ],
)
def test_limits_and_drives_that_cannot_be_are_refused_where_they_are_made(make, pointer, message):
    with pytest.raises(DynidentError, match=message) as caught:
        make()
    assert caught.value.pointer == pointer


def test_numbers_of_a_description_that_limit_nothing_count_as_not_known():
    wide = Limits.from_description((-1e300, 1e300), velocity=1e30, effort=0.0)
    assert wide == Limits()
    assert Limits.from_description((-1.0, 1.0), 2.0, 3.0) == Limits((-1.0, 1.0), velocity=2.0, effort=3.0)


def test_equal_statements_of_a_drive_gain_do_not_contradict():
    robot = robot_from_description("r", Description("urdf", one_joint()), drives={"j": Drive(20.0, 100.0, 0.2)})
    assert robot.drives[0].gain == 20.0


@pytest.mark.parametrize(
    "description",
    [
        Description("modified_dh", '[{"d": 1e308, "gamma": 1, "alpha": 1}, {"d": -1e308, "b": 1e308, "alpha": 2}]'),
        Description("modified_dh", '[{"inertia": {"M": 1e-300, "MX": 1e300, "XX": 1}}]'),
        Description(
            "urdf", one_joint(inside='<origin xyz="1e308 1e308 1e308" rpy="1 1 1"/>').replace("0.1 ", "1e308 ")
        ),
    ],
)
def test_numbers_beyond_computing_are_refused(description):
    with pytest.raises(DynidentError, match="too large; expected values") as caught:
        robot_from_description("r", description)
    assert caught.value.pointer == "/description/content"


def test_more_joints_than_a_machine_has_are_refused_before_they_fill_the_memory():
    with pytest.raises(DynidentError, match="101 moving joints; at most 100") as caught:
        robot_from_description("r", Description("modified_dh", json.dumps([{}] * 101)))
    assert caught.value.pointer == "/description/content"
    assert robot_from_description("r", Description("modified_dh", json.dumps([{}] * 100))).n == 100


def test_a_robot_that_branches_has_limbs() -> None:
    before = {"l_hip_joint": None, "l_knee_joint": "l_hip_joint", "waist_joint": None}
    before |= {"l_arm_joint": "waist_joint", "r_arm_joint": "waist_joint", "r_hand_joint": "r_arm_joint"}
    limbs = list_limbs(before)
    assert [(limb.title, limb.parent) for limb in limbs] == [
        ("all 6 joints", None),
        ("l_hip to l_knee, 2 joints", 0),
        ("waist", 0),
        ("l_arm", 2),
        ("r_arm to r_hand, 2 joints", 2),
    ]
    assert limbs[4].joints == ("r_arm_joint", "r_hand_joint")
    assert list_limbs({"a": None, "b": "a"}) == []
    assert list_limbs({}) == []


def test_coordinates_of_a_moving_base_are_no_limb_and_are_not_counted() -> None:
    before = {"base_x": None, "base_y": "base_x", "base_yaw": "base_y"}
    before |= {"l_hip_joint": "base_yaw", "l_knee_joint": "l_hip_joint", "r_hip_joint": "base_yaw"}
    limbs = list_limbs(before, 3)
    assert [(limb.title, limb.parent) for limb in limbs] == [
        ("all 3 joints", None),
        ("l_hip to l_knee, 2 joints", 0),
        ("r_hip", 0),
    ]
    assert limbs[0].joints == tuple(before)
    del before["r_hip_joint"]
    assert list_limbs(before, 3) == []
