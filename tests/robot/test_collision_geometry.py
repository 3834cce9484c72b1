from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.errors import DynidentError
from dynident.robot import collision_geometry, robot_from_library, robot_from_modified_dh, robot_from_urdf
from dynident.robot.collision_shapes import (
    Block,
    Capsule,
    Cylinder,
    compute_segment_distance,
    enclose_points,
    enclose_shape,
)
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.link_meshes import slice_mesh

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="one"><collision><origin xyz="0 0 .3"/><geometry>{shape}</geometry></collision></link>
  <link name="flange"><collision><origin xyz=".1 0 0"/><geometry><sphere radius=".05"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="swing" type="revolute"><parent link="one"/><child link="flange"/><origin xyz="0 0 .5" rpy="0 0 1.2"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""
TETRAHEDRON = """solid t
facet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet
facet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet
facet normal -1 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 1 0\nendloop\nendfacet
facet normal 1 1 1\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet
endsolid t
"""


def contains(capsule: Capsule, points: np.ndarray) -> bool:
    return all(compute_segment_distance(p, capsule.start, capsule.end) <= capsule.radius + 1e-9 for p in points)


@given(seed=st.integers(0, 10_000), stretch=st.floats(0.05, 5.0))
@settings(max_examples=40, deadline=None)
def test_a_capsule_contains_what_it_is_put_around(seed, stretch):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3)) * [1.0, 1.0, stretch] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    assert contains(enclose_points(points), points)
    placement = np.eye(4)
    placement[:3, 3] = rng.normal(size=3)
    block = Block(placement, rng.uniform(0.1, 2.0, 3))
    assert contains(enclose_shape(block), block.corners)
    cylinder = Cylinder(placement, 0.2, stretch)
    assert contains(enclose_shape(cylinder), cylinder.corners)


def test_slices_of_an_elbow_fit_closer_than_one_capsule_and_contain_its_surface():
    arm, across = np.random.default_rng(0).uniform(-0.05, 0.05, (2, 200, 3))
    arm[:, 0] *= 20
    across[:, 2] *= 20
    points = np.concatenate([arm, across + np.array([1.0, 0, 1.0])])
    triangles = np.array([(k, k + 1, k + 2) for k in [*range(198), *range(200, 398)]])
    pieces = slice_mesh(points, triangles)
    capsules = [enclose_points(piece) for piece in pieces]
    assert sum(capsule.volume for capsule in capsules) < 0.6 * enclose_points(points).volume
    for face in triangles[::20]:
        for share in np.random.default_rng(1).dirichlet([1, 1, 1], 5):
            assert any(contains(capsule, [share @ points[face]]) for capsule in capsules)


def test_a_mesh_is_found_in_the_folders_and_said_to_be_missing_without_them(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.stl").write_text(TETRAHEDRON)
    text = ARM.format(shape='<mesh filename="package://arm/meshes/t.stl" scale=".1 .1 .1"/>')
    robot = robot_from_urdf("arm", text)
    found = collision_geometry(robot, mesh_folders=[tmp_path])
    corners = np.concatenate([shape.corners for shape in found.bodies[0].shapes])
    for corner in ([0, 0, 0.3], [0.1, 0, 0.3], [0, 0.1, 0.3], [0, 0, 0.4]):
        assert np.linalg.norm(corners - corner, axis=1).min() < 1e-6
    assert ((corners - [0, 0, 0.3]).sum(axis=1) < 0.1 + 1e-6).all()
    missing = collision_geometry(robot)
    assert missing.bare == ("one",)
    assert "package://arm/meshes/t.stl of link 'one' (not found" in missing.notes[0]
    (tmp_path / "meshes" / "t.stl").write_text("nothing")
    assert "of link 'one' (" in collision_geometry(robot, mesh_folders=[tmp_path]).notes[0]


def test_the_shapes_of_a_locked_joint_go_with_the_link_before():
    text = ARM.format(shape='<capsule radius=".1" length=".2"/>')
    free = robot_from_urdf("arm", text)
    locked = robot_from_urdf("arm", text, locked_joints={"swing": 0.7})
    places = []
    for robot, q in ((free, [[0.4, 0.7]]), (locked, [[0.4]])):
        frames = joint_frames(robot, np.array(q))[0]
        bodies = collision_geometry(robot).bodies
        places.append([shape.transform(frames[body.joint]).start for body in bodies for shape in body.shapes])
    np.testing.assert_allclose(places[0], places[1], atol=1e-9)


def test_a_shape_without_sizes_is_refused_with_its_link():
    robot = robot_from_urdf("arm", ARM.format(shape='<box size="1 0 1"/>'))
    with pytest.raises(DynidentError, match=r"line 4: size=\"1 0 1\" of the <box> in the <collision> of link 'one'"):
        collision_geometry(robot)


def test_known_arms_have_capsules_on_every_link_and_tables_take_them():
    for name in ("franka_panda", "ur5", "ur10", "ur10e"):
        geometry = collision_geometry(robot_from_library(name))
        assert [body.joint for body in geometry.bodies] == list(range(-1, robot_from_library(name).n))
    row = {"d": 0.3, "capsules": [{"from": [0, 0, 0], "to": [0.2, 0, 0], "radius": 0.05}]}
    robot = robot_from_modified_dh("two", [row, row])
    assert [len(body.shapes) for body in collision_geometry(robot).bodies] == [1, 1]
    with pytest.raises(DynidentError) as caught:
        robot_from_modified_dh("two", [row, {**row, "capsules": [{"from": [0, 0, 0], "radius": 0}]}])
    assert caught.value.pointer == "/1/capsules/0/radius"


def test_links_without_shapes_become_capsules_between_the_joints_where_a_radius_is_given():
    robot = robot_from_library("scara")
    assert collision_geometry(robot).bodies == ()
    stated = collision_geometry(replace(robot, name="tubes"), link_radius=0.04)
    assert stated.bare == ()
    elbow = next(body for body in stated.bodies if body.joint == 0)
    np.testing.assert_allclose(elbow.shapes[0].end, robot.joints[1].placement[:3, 3])
