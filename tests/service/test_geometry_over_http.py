"""Where a robot's links are, over HTTP: what a picture of it needs."""

from __future__ import annotations

import math

import pytest
from fastapi.testclient import TestClient

URDF = """<robot name="arm"><link name="base"/>
 <joint name="lift" type="prismatic"><parent link="base"/><child link="mast"/><origin xyz="0 0 0.2"/>
  <axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="100"/></joint>
 <link name="mast"><collision><geometry><sphere radius="0.07"/></geometry></collision></link>
 <joint name="turn" type="revolute"><parent link="mast"/><child link="arm"/><origin xyz="0.3 0 0"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="9"/></joint><link name="arm"/>
 <joint name="echo" type="revolute"><parent link="arm"/><child link="jaw"/><axis xyz="0 1 0"/>
  <mimic joint="turn" multiplier="-2" offset="0.1"/><limit lower="-2" upper="2" velocity="1" effort="9"/></joint>
 <link name="jaw"/></robot>"""


def test_the_geometry_has_every_frame_what_it_follows_and_the_capsules_of_the_links(client: TestClient) -> None:
    body = {"name": "arm", "description": {"format": "urdf", "content": URDF}}
    robot = client.post("/v1/robots", json=body).json()
    found = client.get(f"/v1/robots/{robot['id']}/geometry").json()
    assert found["joints"] == ["lift", "turn"]
    frames = {one["name"]: one for one in found["frames"]}
    assert [frames[name]["ratios"] for name in ("lift", "turn", "echo")] == [[1, 0], [0, 1], [0, -2]]
    assert frames["echo"]["offset"] == 0.1
    assert [row[3] for row in frames["turn"]["placement"]] == [0.3, 0, 0, 1]
    assert found["frames"][frames["turn"]["parent"]]["name"] == "lift"
    (capsule,) = found["capsules"]
    assert found["frames"][capsule["frame"]]["name"] == "lift"
    assert capsule["radius"] == 0.07


def test_the_geometry_of_a_robot_that_is_not_there_is_a_problem(client: TestClient) -> None:
    answer = client.get("/v1/robots/rob_nothing/geometry")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_poses_follow_the_joints_and_what_follows_these(client: TestClient) -> None:
    body = {"name": "arm", "description": {"format": "urdf", "content": URDF}}
    robot = client.post("/v1/robots", json=body).json()
    names = [one["name"] for one in client.get(f"/v1/robots/{robot['id']}/geometry").json()["frames"]]
    positions = [[0.0, 0.0], [0.5, math.pi / 2]]
    first, second = client.post(f"/v1/robots/{robot['id']}/poses", json={"positions": positions}).json()["poses"]
    assert first[names.index("turn")][3::4] == [0.3, 0.0, 0.2]
    assert second[names.index("turn")][3::4] == [0.3, 0.0, 0.7]
    assert second[names.index("turn")][:3] == pytest.approx([0.0, 0.0, 1.0], abs=1e-5)
    # The jaw turns back by twice as much, and a tenth of a radian less.
    angle = math.pi / 2 - 2 * math.pi / 2 + 0.1
    assert second[names.index("echo")][:3] == pytest.approx([math.cos(angle), 0.0, math.sin(angle)], abs=1e-5)


def test_a_posture_with_too_few_positions_is_told_by_its_place(client: TestClient) -> None:
    body = {"name": "arm", "description": {"format": "urdf", "content": URDF}}
    robot = client.post("/v1/robots", json=body).json()
    answer = client.post(f"/v1/robots/{robot['id']}/poses", json={"positions": [[0.0, 0.0], [0.0]]})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/positions/1"
