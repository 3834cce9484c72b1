"""A robot is read from whatever file describes it, xacro, MJCF and pasted tables among them."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

import dynident as dy
from dynident.errors import DynidentError

XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="parts.xacro"/>
  <link name="base"/>
  <xacro:joint n="1" parent="base" child="upper"/><xacro:joint n="2" parent="upper" child="lower"/>
</robot>"""
PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="length" value="${0.2 * 2}"/>
  <xacro:macro name="joint" params="n parent child">
    <joint name="joint${n}" type="revolute"><parent link="${parent}"/><child link="${child}"/>
      <origin xyz="0 0 ${length}"/><axis xyz="0 1 0"/>
      <limit lower="${-pi}" upper="${pi}" velocity="2" effort="50"/></joint>
    <link name="${child}"/>
  </xacro:macro>
</robot>"""


def test_a_xacro_file_is_expanded_with_what_it_includes(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "arm.urdf.xacro").write_text(XACRO)
    (tmp_path / "parts.xacro").write_text(PARTS)
    robot = dy.load_robot(tmp_path / "arm.urdf.xacro")
    assert robot.joint_names == ("joint1", "joint2")
    assert robot.joints[1].placement[2, 3] == pytest.approx(0.4)
    assert "xacro:" not in robot.description.content


def test_a_xacro_file_that_cannot_be_expanded_says_why(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "arm.xacro").write_text(XACRO)
    with pytest.raises(DynidentError, match=r"parts\.xacro"):
        dy.load_robot(tmp_path / "arm.xacro")


def test_a_pasted_table_and_an_mjcf_model_are_files_of_a_robot_too(tmp_path: Path) -> None:
    (tmp_path / "arm.txt").write_text("classical\na alpha d theta\n0 pi/2 0.3 q1\n0.4 0 0 q2\n0.3 0 0 q3\n")
    assert dy.load_robot(tmp_path / "arm.txt", locked_joints={"joint3": 0.1}).joint_names == ("joint1", "joint2")
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body><joint name="a"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    assert dy.load_robot(tmp_path / "arm.xml").joint_names == ("a",)


def test_a_file_of_something_else_says_what_was_tried(tmp_path: Path) -> None:
    (tmp_path / "arm.txt").write_text("shopping list")
    with pytest.raises(DynidentError, match="neither XML"):
        dy.load_robot(tmp_path / "arm.txt")


@pytest.mark.parametrize("place", ["ws/src/arm_moveit/config", "ws/src/arm_description/urdf", "elsewhere"])
def test_packages_are_found_in_the_folders_above_a_xacro_file_and_where_ros_says(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    package, folder = tmp_path / "ws/src/arm_description/urdf", tmp_path / place
    package.mkdir(parents=True)
    folder.mkdir(parents=True, exist_ok=True)
    (package / "parts.xacro").write_text(PARTS)
    including = XACRO.replace('"parts.xacro"', '"$(find arm_description)/urdf/parts.xacro"')
    (folder / "arm.xacro").write_text(including)
    if place == "elsewhere":
        with pytest.raises(
            DynidentError, match=r"no folder of the package 'arm_description'.*ROS_PACKAGE_PATH"
        ) as told:
            dy.load_robot(folder / "arm.xacro")
        assert str(told.value).count("arm_description") == 1
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere{os.pathsep}{tmp_path / 'ws/src'}")
    assert dy.load_robot(folder / "arm.xacro").joint_names == ("joint1", "joint2")
    assert "ament_index_python" not in sys.modules


@pytest.mark.parametrize(
    ("encoding", "comment"), [("utf-8-sig", ""), ("utf-16", ""), ("cp1252", "<!-- Gelenk für 90° -->"), ("utf-8", "\n")]
)
def test_a_urdf_is_read_in_the_encodings_that_editors_write(tmp_path: Path, encoding: str, comment: str) -> None:
    text = (
        f'{comment}<robot name="arm"><link name="base"/><link name="upper"/><joint name="a" type="continuous">'
        '<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint></robot>'
    )
    (tmp_path / "arm.urdf").write_bytes(text.encode(encoding))
    assert dy.load_robot(tmp_path / "arm.urdf").joint_names == ("a",)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "<sdf", "give the URDF or xacro that it was made from"),
        ('value="1"', 'value="-1"', "leave out this <inertial>"),
        ('value="1"', 'value="${mass}" xmlns:xacro="http://www.ros.org/wiki/xacro"', "define it by <xacro:property>"),
    ],
)
def test_a_description_that_cannot_be_used_says_what_to_do(tmp_path: Path, old: str, new: str, words: str) -> None:
    pytest.importorskip("xacro")
    text = (
        '<robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="1"/><inertia ixx="1" ixy="0" '
        'ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="a" type="continuous"><parent link="base"/>'
        '<child link="upper"/><axis xyz="0 1 0"/></joint></robot>'
    )
    ends = text.replace("</robot>", "</sdf>") if new == "<sdf" else text
    (tmp_path / "arm.urdf").write_text(ends.replace(old, new, 1))
    with pytest.raises(DynidentError, match=words):
        dy.load_robot(tmp_path / "arm.urdf")


MODEL = """<mujoco model="arm"><compiler angle="degree"/><include file="parts/defaults.xml"/><worldbody>
<body name="upper"><joint class="swing" name="a"/><geom size="0.1" mass="1"/><include file="parts/fore.xml"/></body>
</worldbody></mujoco>"""
DEFAULTS = '<mujocoinclude><default><default class="swing"><joint range="-30 40" axis="0 1 0"/></default></default>'
FORE = """<mujocoinclude><body name="fore" pos="0 0 0.4"><joint class="swing" name="b"/><geom size="0.1" mass="0.5"/>
</body></mujocoinclude>"""


def write_model(folder: Path, fore: str = FORE) -> Path:
    (folder / "parts").mkdir()
    (folder / "parts" / "defaults.xml").write_text(f"{DEFAULTS}</mujocoinclude>")
    (folder / "parts" / "fore.xml").write_text(fore)
    (folder / "arm.xml").write_text(MODEL)
    return folder / "arm.xml"


def test_an_mjcf_model_is_read_with_the_files_that_it_includes(tmp_path: Path) -> None:
    robot = dy.load_robot(write_model(tmp_path))
    assert (robot.name, robot.joint_names) == ("arm", ("a", "b"))
    assert robot.joints[1].limits.position == pytest.approx((-0.5236, 0.6981), abs=1e-4)
    # What is stored of the robot needs no other file.
    assert "<include" not in robot.description.content


@pytest.mark.parametrize(
    ("fore", "words"),
    [
        (None, "the file 'parts/fore.xml' of this <include> is not there"),
        ('<mujocoinclude><include file="parts/defaults.xml"/></mujocoinclude>', "included twice, or includes itself"),
        ("<mujocoinclude><body>", "parts/fore.xml: .*malformed"),
        (f'<mujocoinclude>\n<include file="{"x" * 300}"/></mujocoinclude>', "line 2: .*x{90}.* is not there"),
        (f"<mujocoinclude>{'<frame>' * 98}{'</frame>' * 98}</mujocoinclude>", "line 2: .*nested more than 100 levels"),
    ],
)
def test_an_include_that_cannot_be_followed_says_why(tmp_path: Path, fore: str | None, words: str) -> None:
    path = write_model(tmp_path, fore or "")
    if fore is None:
        (tmp_path / "parts" / "fore.xml").unlink()
    with pytest.raises(DynidentError, match=words):
        dy.load_robot(path)


def test_includes_within_frames_in_many_files_are_nested_too_deep(tmp_path: Path) -> None:
    opening, closing = "<frame>" * 90, "</frame>" * 90
    for k in range(30):
        text = f'<mujocoinclude>{opening}<include file="part{k + 1}.xml"/>{closing}</mujocoinclude>'
        (tmp_path / f"part{k}.xml").write_text(text)
    (tmp_path / "arm.xml").write_text('<mujoco><worldbody><include file="part0.xml"/></worldbody></mujoco>')
    with pytest.raises(DynidentError, match="nested more than 100 levels"):
        dy.load_robot(tmp_path / "arm.xml")


def test_an_include_in_an_included_file_may_name_a_file_beside_it(tmp_path: Path) -> None:
    path = write_model(tmp_path, '<mujocoinclude><include file="hand.xml"/></mujocoinclude>')
    (tmp_path / "parts" / "hand.xml").write_text(FORE)
    assert dy.load_robot(path).joint_names == ("a", "b")
    # One in the folder of the model comes first.
    (tmp_path / "hand.xml").write_text(FORE.replace('name="b"', 'name="c"'))
    assert dy.load_robot(path).joint_names == ("a", "c")


@pytest.mark.parametrize("wrong", ["", FORE.replace("class", 'type="ball" class')], ids=["own", "included"])
def test_lines_of_a_model_with_includes_are_those_of_its_own_text(tmp_path: Path, wrong: str) -> None:
    path = write_model(tmp_path, wrong or FORE)
    if not wrong:
        path.write_text(MODEL.replace("</worldbody>", '\n\n<body name="x"><joint type="ball"/></body></worldbody>'))
    with pytest.raises(DynidentError, match=rf"line {2 if wrong else 5}: Body .* ball joint"):
        dy.load_robot(path)


URDF = """<?xml version="1.0"?>
<robot name="it's"><link name="base"/><link name="upper"/><joint name="a" type="revolute"><parent link="base"/>
<child link="upper"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="2" effort="5"/></joint></robot>"""


@pytest.mark.parametrize(
    "printed",
    [
        f"String value is: {URDF}",
        f"data: {json.dumps(URDF)}\n---\n",
        "data: '" + URDF.replace("'", "''") + "'\n---\n",
        "robot_description: |\n" + "".join(f"  {line}\n" for line in URDF.splitlines()),
        f"/publisher:\n  ros__parameters:\n    robot_description: {json.dumps(URDF)}\n    use_sim_time: false\n",
        "/publisher:\n  rate: 20.0\n  robot_description: '" + URDF.replace("'", "''") + "'\n  use_sim_time: false\n",
    ],
    ids=["parameter", "quoted", "single", "block", "dumped", "dumped single"],
)
def test_a_description_that_ros_printed_is_read(tmp_path: Path, printed: str) -> None:
    (tmp_path / "arm.txt").write_text(printed)
    robot = dy.load_robot(tmp_path / "arm.txt")
    assert (robot.name, robot.joint_names) == ("it's", ("a",))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("solid base\n facet normal 0 0 1\n", "a mesh"),
        ("# from CAD\nv 0 0 1\nv 0 1 0\n", "a mesh"),
        ("#usda 1.0\n", "a stage of USD"),
        ("PK\x03\x04", "unpack it, and give the URDF in it"),
        ('<robot name="a"><group name="arm"/></robot>', "has no <link>. An SRDF only adds to a URDF"),
        ("L(1) = Link([0 0.1 0 pi/2]);\n", "a program: write the Denavit-Hartenberg table"),
    ],
)
def test_a_file_that_describes_no_robot_is_named(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "arm.txt").write_text(content)
    with pytest.raises(DynidentError, match=words):
        dy.load_robot(tmp_path / "arm.txt")


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<xacro:macro name="arm" params="p"><link name="${p}"/></xacro:macro>', "the file that calls its macros"),
        ('<xacro:arg name="reach"/><link name="a"/>', "its default, or expand the file with it first"),
    ],
)
def test_xacro_without_what_it_needs_says_what_to_do(tmp_path: Path, inside: str, words: str) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "arm.xacro").write_text(f'<robot name="a" xmlns:xacro="http://ros.org/wiki/xacro">{inside}</robot>')
    with pytest.raises(DynidentError, match=words):
        dy.load_robot(tmp_path / "arm.xacro")
