"""Texts that describe no robot are refused within a second, whatever their length."""

from __future__ import annotations

import time
import tracemalloc

import pytest
from support.file_mutations import MJCF, URDF

from dynident.api.robot_files import load_robot
from dynident.errors import DynidentError
from dynident.robot import robot_from_modified_dh, robot_from_urdf
from dynident.robot.dh_text import robot_from_dh_text
from dynident.robot.json_fields import expect_number, parse_json
from dynident.robot.xml_text import read_root

SECONDS, MEMORY = 5.0, 100 * 2**20
"""Of processor time under `tracemalloc`, which is four to five times slower; without it within a second."""
COMMENTS = "<!-- a --> " * 100_000


@pytest.fixture(autouse=True)
def bounded():
    tracemalloc.start()
    begin = time.process_time()
    yield
    assert time.process_time() - begin < SECONDS
    assert tracemalloc.get_traced_memory()[1] < MEMORY
    tracemalloc.stop()


@pytest.mark.parametrize(("text", "name"), [(URDF, "arm.urdf"), (MJCF, "arm.xml")])
def test_a_file_with_very_many_comments_is_read(tmp_path, text, name):
    if text is MJCF:
        pytest.importorskip("mujoco")
    path = tmp_path / name
    path.write_text(COMMENTS + text)
    robot = load_robot(path)
    assert robot.name == "arm"
    assert robot.joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (COMMENTS, "malformed"),
        ("<!-- a " * 100_000, "malformed"),
        (COMMENTS + "<mujoc", "malformed"),
        ("<robot " + 'name=" ' * 100_000, "malformed"),
        ("<robot>" + "<a>" * 300_000, "nested more than 100"),
        ("<robot>" + "<a/>" * 300_000, "more than 100000 elements"),
        ("<mujoco>" + "<body>" * 300_000, "nested more than 100"),
    ],
)
def test_hostile_xml_is_refused_at_once(tmp_path, text, reason):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(DynidentError, match=reason):
        load_robot(path)


def test_the_root_of_a_text_is_told_without_reading_the_rest():
    root = read_root(f'<?xml version="1.0"?>\n{COMMENTS}\n<robot name="arm"><link')
    assert root is not None
    assert (root.tag, root.attributes) == ("robot", {"name": "arm"})
    assert read_root("a table") is None


@pytest.mark.parametrize("name", ["arm.urdf", "arm.xml"])
def test_a_page_of_the_web_in_place_of_a_description_is_called_that(tmp_path, name):
    path = tmp_path / name
    path.write_text("\n\n<!DOCTYPE html>\n<html><head></head><body>&lt;robot&gt;<br></body></html>")
    with pytest.raises(DynidentError, match=r"web page.*download the file itself"):
        load_robot(path)


def test_a_pointer_in_place_of_a_description_says_how_to_fetch_it(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n")
    with pytest.raises(DynidentError, match="git lfs pull"):
        load_robot(path)


def test_a_line_of_spaces_in_a_table_takes_no_time():
    table = "modified\nalpha a d theta\n0 0 0 q1" + " " * 300_000 + "x\n"
    assert robot_from_dh_text("arm", table).n == 1


def test_a_number_of_very_many_digits_takes_no_time():
    assert expect_number("1" * 100 + "e-90", "", "") == pytest.approx(1.111e9, rel=1e-3)
    with pytest.raises(DynidentError, match="is not a number"):
        expect_number("1" * 100_000 + "x", "", "")
    with pytest.raises(DynidentError, match="cannot be read"):
        parse_json("1" * 100_000, "", "")


@pytest.mark.parametrize("name", ["a\nb", "a\r", "a\u2028b", "a\x00"])
def test_names_have_no_line_breaks_and_no_control_characters(name):
    with pytest.raises(DynidentError, match="without control characters"):
        robot_from_modified_dh("arm", {"joints": [{"name": name}]})


def test_other_names_are_those_of_their_users():
    names = ['a, "b"', "Gelenk 1 µ°", "関節", "a\u00a0b"]
    robot = robot_from_modified_dh("arm", {"joints": [{"name": name} for name in names]})
    assert robot.joint_names == tuple(names)


def test_halves_of_characters_are_refused_in_every_text():
    with pytest.raises(DynidentError, match="incomplete character"):
        robot_from_urdf("arm", URDF.replace("shoulder", "shoulder\ud800"))
    with pytest.raises(DynidentError, match="incomplete character"):
        parse_json('{"a": ["\\udfff"]}', "", "")
    with pytest.raises(DynidentError, match="incomplete character"):
        parse_json('{"\\udfff": 1}', "", "")
    assert parse_json('"\\ud83e\\udd16"', "", "") == "🤖"
