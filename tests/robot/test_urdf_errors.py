from __future__ import annotations

import re

import pytest
from support.urdf_texts import BODY, EVERY_KIND, joint, link, machine, one_joint

from dynident.errors import DynidentError
from dynident.robot import Description, robot_from_description

AXIS = '<axis xyz="0 0 1"/>'
TWO = (link("a"), link("b"))

BAD = {
    "nothing": ("  \n ", "The URDF is empty"),
    "not XML": ("nonsense", "line 1: The XML is malformed at column 1: syntax error"),
    "wrong closing tag": (
        one_joint().replace("</joint>", "</joints>"),
        "line 5: The XML is malformed at column 56: mismatched tag",
    ),
    "cut off": (one_joint()[:80], "line 3: The XML is malformed .*: unclosed token"),
    "line counted from the start of the text": ("\n\n<robot", "line 3: The XML is malformed"),
    "other root": ("<sdf/>", "line 1: The root element is <sdf>; a URDF needs the root element <robot>"),
    "document type": ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="r"/>', "must not have a document type declaration"),
    "xacro": (
        '<robot xmlns:xacro="x"><xacro:include filename="a"/></robot>',
        "<xacro:include> is xacro; expand the file first",
    ),
    "nested without end": ("<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>", "<a> is nested more than 100 levels"),
    "elements without end": ("<robot>" + "<a/>" * 150_000 + "</robot>", "more than 100000 elements"),
    "no link": (machine(), "line 1: The robot has no <link>"),
    "link without name": (machine("<link/>"), "line 2: A <link> has no name"),
    "same link twice": (machine(link("a"), link("a")), "line 3: The link name 'a' is used twice .first on line 2."),
    "same joint twice": (
        machine(*TWO, link("c"), joint("j", "a", "b"), joint("j", "b", "c")),
        "line 7: The joint name 'j' is used twice .first on line 5.",
    ),
    "angles in degrees": (
        one_joint(inside='<origin xyz="0 0 1" rpy="0 0 90"/>'),
        "line 5: The rpy of joint 'j' seems to be in degrees; a URDF has radians",
    ),
    "reserved name": (machine(*TWO, joint("universe", "a", "b")), "line 4: A joint cannot be called 'universe'"),
    "no joint": (machine(link("a")), "line 1: The robot has no moving joint"),
    "only fixed joints": (machine(*TWO, joint("j", "a", "b", "fixed")), "The robot has no moving joint"),
    "floating alone": (one_joint("floating"), "The robot has no moving joint"),
    "planar": (one_joint("planar"), "line 4: Joint 'j' is planar"),
    "ball": (one_joint("spherical"), "line 4: Joint 'j' is spherical"),
    "unknown type": (one_joint("hinge"), "line 4: Joint 'j' has the type 'hinge'; expected revolute, continuous"),
    "mimic": (
        one_joint(inside='<mimic joint="other"/>'),
        "line 5: Joint 'j' follows 'other', which is not a moving joint; moving joints: none",
    ),
    "unknown child": (
        machine(*TWO, joint("j", "a", "c")),
        "The child link 'c' of joint 'j' does not exist; links: a, b",
    ),
    "no parent": (one_joint().replace('<parent link="base"/>', ""), "line 4: Joint 'j' refers to no parent link"),
    "two bases": (machine(*TWO, link("c"), joint("j", "a", "b")), r"line 4: 2 links have no parent \(a, c\)"),
    "two parents": (
        machine(*TWO, link("c"), joint("j", "a", "c"), joint("k", "b", "c")),
        "line 7: Link 'c' is the child of two joints, 'j' and 'k'; closed loops",
    ),
    "a loop": (machine(*TWO, joint("j", "a", "b"), joint("k", "b", "a")), "form a loop, and no link is the base"),
    "a loop beside the base": (
        machine(link("base"), *TWO, joint("j", "a", "b"), joint("k", "b", "a")),
        "is connected to a loop of joints",
    ),
    "no direction": (one_joint(inside='<axis xyz="0 0 0"/>'), "line 5: The axis of joint 'j' has no direction"),
    "two numbers": (one_joint(inside='<axis xyz="0 1"/>'), 'line 5: xyz="0 1" in the <axis> .* expected 3 numbers'),
    "not a number": (
        one_joint(inside='<origin rpy="0 0 a"/>'),
        "rpy=.* in the <origin> of joint 'j'; expected 3 numbers",
    ),
    "infinite": (one_joint(inside='<origin xyz="0 0 inf"/>'), "xyz=.* in the <origin> of joint 'j'"),
    "limits exchanged": (
        one_joint(limit='<limit lower="2" upper="1"/>'),
        "line 5: The lower limit of joint 'j' is above",
    ),
    "limit not a number": (one_joint(limit='<limit effort="nan"/>'), 'effort="nan" .* is not a number'),
    "limit of words": (one_joint(limit='<limit effort="much"/>'), 'effort="much" .*; expected a number'),
    "negative mass": (one_joint().replace('value="2"', 'value="-2"'), "line 3: The mass of link 'arm' is negative"),
    "no mass": (one_joint().replace('<mass value="2"/>', ""), "line 3: The <inertial> of link 'arm' has no <mass>"),
    "too many links": (machine(*(link(f"l{i}", "") for i in range(2001))), "2001 links; at most 2000 are supported"),
    "no iyz": (one_joint().replace('iyz="0.03"', ""), "The <inertia> of link 'arm' has no iyz; expected a number"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_urdf_is_named_with_its_line_and_reason(text, message, capfd):
    with pytest.raises(DynidentError) as caught:
        robot_from_description("r", Description("urdf", text))
    assert re.search(message, caught.value.detail), caught.value.detail
    assert caught.value.pointer == "/description/content"
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


@pytest.mark.parametrize("cut", range(10, len(EVERY_KIND), 97))
def test_a_urdf_that_breaks_off_anywhere_is_an_error_of_the_text(cut):
    with pytest.raises(DynidentError, match="malformed"):
        robot_from_description("r", Description("urdf", EVERY_KIND[:cut]))


def test_a_sound_text_for_the_errors_above():
    assert BODY in one_joint()
    assert robot_from_description("r", Description("urdf", one_joint(inside=AXIS))).n == 1


def test_a_long_chain_of_fixed_links_is_read():
    links = (link(f"l{i}", "") for i in range(2000))
    joints = (joint(f"j{i}", f"l{i}", f"l{i + 1}", "revolute" if i == 7 else "fixed") for i in range(1999))
    assert robot_from_description("r", Description("urdf", machine(*links, *joints))).joint_names == ("j7",)
