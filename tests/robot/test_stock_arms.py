"""Arms as their makers describe them, with their meshes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from dynident.errors import DynidentError, Note, word_notes, write_argument
from dynident.motion import Surroundings
from dynident.motion.collision.exact_distances import build_solid
from dynident.motion.collision.free_space import build_free_space
from dynident.robot import collision_geometry, robot_from_urdf
from dynident.robot.collision_reader import UNCHECKED
from dynident.robot.collision_shapes import Hull
from dynident_cli.request_options import write_option

STOCK = next(Path(sys.prefix).glob("lib*/python3*/site-packages/cmeel.prefix/share/example-robot-data/robots"), None)
ARMS = {
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    # With two fingers, of which one mimics the other.
    "panda": "panda_description/urdf/panda.urdf",
}
UP = np.array([0.0, 0.0, 0.3])
PRISM = """
<robot name="arm">
  <link name="base"/>
  <link name="one"><collision><geometry><mesh filename="package://arm/meshes/{name}.stl"/></geometry></collision></link>
  <link name="two"><collision><geometry><mesh filename="package://arm/meshes/two.stl"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="swing" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 .5"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""


def stl_of_prism(corners: int) -> str:
    """A prism whose lids are polygons: more than three corners lie in one plane, as in most drawn parts."""
    angle = np.arange(corners) * 2 * np.pi / corners
    rim = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.zeros(corners)])
    lids = [[base[0], base[k], base[k + 1]] for base in (rim, rim + UP) for k in range(1, corners - 1)]
    body = [[rim[k - 1], rim[k], rim[k] + UP] for k in range(corners)]
    body += [[rim[k - 1], rim[k] + UP, rim[k - 1] + UP] for k in range(corners)]
    faces = "\n".join(
        "facet normal 0 0 1\nouter loop\n"
        + "\n".join("vertex {:.9f} {:.9f} {:.9f}".format(*corner) for corner in face)
        + "\nendloop\nendfacet"
        for face in [*lids, *body]
    )
    return f"solid p\n{faces}\nendsolid p\n"


@pytest.mark.parametrize("corners", [4, 6, 24])
def test_a_hull_with_many_corners_in_one_plane_has_the_distances_of_the_part(corners: int) -> None:
    angle = np.arange(corners) * 2 * np.pi / corners
    rim = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.zeros(corners)])
    made = build_solid("prism", -1, [Hull(np.concatenate([rim, rim + UP]))])
    assert made.shapes[0].num_points == 2 * corners
    assert made.reach == pytest.approx(np.hypot(0.1, 0.3))


@pytest.mark.sweep
@pytest.mark.parametrize("name", ARMS)
def test_a_stock_arm_is_checked_for_collision_with_all_its_meshes(name: str) -> None:
    if STOCK is None:
        pytest.skip("NO STOCK ROBOTS: pip install example-robot-data")
    robot = robot_from_urdf(name, (STOCK / ARMS[name]).read_text(encoding="utf-8"))
    low, high = (np.array([(joint.limits.position or (-3, 3))[end] for joint in robot.joints]) for end in (0, 1))
    surroundings = Surroundings(mesh_folders=(str(STOCK.parent),))
    space = build_free_space(robot, surroundings, low, high)
    assert space is not None
    assert not [note for note in space.notes if isinstance(note, Note) and note.code == UNCHECKED]


def test_a_folder_without_any_of_the_meshes_is_refused_with_the_files_sought(tmp_path: Path) -> None:
    robot = robot_from_urdf("arm", PRISM.format(name="one"))
    with pytest.raises(DynidentError) as refused:
        collision_geometry(robot, mesh_folders=[tmp_path])
    assert str(tmp_path / "arm" / "meshes" / "one.stl") in refused.value.detail
    assert str(tmp_path / "meshes" / "one.stl") in refused.value.detail
    assert refused.value.pointer == "/surroundings/mesh_folders"


def test_a_mesh_that_is_not_there_beside_others_is_told_of_in_capitals(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "one.stl").write_text(stl_of_prism(6))
    robot = robot_from_urdf("arm", PRISM.format(name="one"))
    found = collision_geometry(robot, mesh_folders=[tmp_path])
    assert [body.name for body in found.bodies] == ["one"]
    assert isinstance(found.notes[0], Note)
    assert found.notes[0].code == UNCHECKED
    assert not found.notes[0].remedies
    (note,) = collision_geometry(robot).notes
    assert word_notes([note], write_option)[0].endswith("Give the meshes: --meshes FOLDER.")
    assert "mesh_folders=[" in word_notes([note], write_argument)[0]
    assert str(tmp_path / "arm" / "meshes" / "two.stl") in found.notes[0]
