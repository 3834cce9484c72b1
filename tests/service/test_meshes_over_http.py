"""Meshes of a robot over HTTP: uploaded, never fetched; they count for collisions and are there for a picture."""

from __future__ import annotations

import io
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from support.arm_with_meshes import ARM, rod

from dynident_client import Client, ProblemError
from dynident_client.resource_objects import Robot

STOCK = next(Path(sys.prefix).glob("lib*/python3*/site-packages/cmeel.prefix/share/example-robot-data/robots"), None)
QUICK = {
    "kind": "random",
    "trajectory": {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0},
    "random_trajectories": 3,
    "effects": [{"effect": "viscous"}],
}
TWICE = ARM.replace("arm/meshes/one.stl", "arm/left/two.stl").replace("arm/meshes/two.stl", "arm/right/two.stl")

INERTIAL = (
    '<inertial><origin xyz="0 0 0.2"/><mass value="3"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def folder_with(folder: Path, **files: bytes) -> Path:
    meshes = folder / "arm" / "meshes"
    meshes.mkdir(parents=True)
    for name, content in files.items():
        (meshes / f"{name}.stl").write_bytes(content)
    return folder / "arm"


def top_of(client: Client, robot: Robot, frame: int) -> float:
    """The highest point of the surfaces of a frame, in it."""
    surfaces = [one for one in client.robots.geometry(robot)["surfaces"] if one["frame"] == frame]
    return float(np.max([np.max(one["points"], axis=0)[2] for one in surfaces]))


def test_a_robot_says_which_meshes_it_needs_and_has_those_that_are_sent(live: Client, tmp_path: Path) -> None:
    robot = live.robots.create("arm", urdf=ARM)
    assert [(one["name"], one["links"], one["sha256"]) for one in robot["meshes"]] == [
        ("package://arm/meshes/one.stl", ["one"], None),
        ("package://arm/meshes/two.stl", ["two"], None),
    ]
    assert live.robots.geometry(robot)["surfaces"] == []
    answer = live.robots.send_meshes(robot, folder_with(tmp_path, one=rod(), other=rod(0.1)))
    assert [bool(one["sha256"]) for one in answer["meshes"]] == [True, False]
    geometry = live.robots.geometry(robot)
    (surface,) = geometry["surfaces"]
    assert surface["frame"] == 0
    assert len(surface["triangles"]) == 16
    assert top_of(live, robot, 0) == pytest.approx(0.4)
    assert "package://arm/meshes/two.stl of link 'two'" in " ".join(geometry["notes"])
    # The other one later, and the first one anew: what came before stays unless it is replaced.
    live.robots.send_meshes(robot, folder_with(tmp_path / "later", one=rod(0.3), two=rod(0.2)))
    assert [top_of(live, robot, frame) for frame in (0, 1)] == pytest.approx([0.3, 0.2])
    assert all(one["sha256"] and one["size"] == len(rod()) for one in live.robots.get(robot)["meshes"])


def test_a_design_keeps_clear_of_the_floor_with_the_meshes_that_were_sent(live: Client, tmp_path: Path) -> None:
    heavy = ARM.replace('<link name="one">', '<link name="one">' + INERTIAL).replace(
        '<link name="two">', '<link name="two">' + INERTIAL
    )
    robot = live.robots.create("arm", urdf=heavy)
    cell = {"floor": -0.05, "clearance": 0.01}
    with pytest.raises(Exception, match="no collision geometry"):
        live.designs.create(robot, **QUICK, surroundings=cell).wait()
    live.robots.send_meshes(robot, folder_with(tmp_path, one=rod(), two=rod()))
    design = live.designs.create(robot, **QUICK, surroundings=cell).wait()
    near = {one["joint"] for one in design.result["margins"] if one["limit"] == "clearance"}
    assert any("two" in name for name in near)
    assert not [note for note in design.result["notes"] if "COLLISION IS NOT CHECKED" in note]


def test_a_robot_made_from_another_one_has_its_meshes_and_so_has_its_bundle(live: Client, tmp_path: Path) -> None:
    first = live.robots.create("arm", urdf=ARM)
    live.robots.send_meshes(first, folder_with(tmp_path, one=rod(), two=rod(0.2)))
    second = live.robots.create("arm on a wall", urdf=ARM, gravity=[9.81, 0, 0], meshes_of=first.id)
    assert [one["sha256"] for one in second["meshes"]] == [one["sha256"] for one in live.robots.get(first)["meshes"]]
    with zipfile.ZipFile(io.BytesIO(b"".join(live.robots.bundle(second)))) as bundle:
        assert {one["sha256"] for one in second["meshes"]} <= {name.rpartition("/")[2] for name in bundle.namelist()}
    live.robots.delete(first)
    assert top_of(live, second, 1) == pytest.approx(0.2)
    with pytest.raises(ProblemError) as refused:
        live.robots.create("none", urdf=ARM, meshes_of=first.id)
    assert refused.value.errors[0]["pointer"] == "/meshes_of"


def test_what_is_no_mesh_of_the_robot_is_refused_with_its_name(live: Client, tmp_path: Path) -> None:
    robot = live.robots.create("arm", urdf=ARM)
    with pytest.raises(ProblemError, match=r"one\.stl cannot be read as a mesh") as refused:
        live.robots.send_meshes(robot, folder_with(tmp_path, one=b"no mesh at all"))
    assert (refused.value.status, refused.value.errors[0]["pointer"]) == (422, "/files")
    with pytest.raises(ValueError, match="has the name of a mesh"):
        live.robots.send_meshes(robot, folder_with(tmp_path / "others", other=rod()))
    twice = live.robots.create("two of a name", urdf=TWICE)
    with pytest.raises(ProblemError, match=r"could be package://arm/left/two\.stl or package://arm/right/two\.stl"):
        live.robots.send_meshes(twice, folder_with(tmp_path / "bare", two=rod()))
    assert all(one["sha256"] is None for one in live.robots.get(twice)["meshes"])
    (tmp_path / "arm" / "left").mkdir()
    (tmp_path / "arm" / "left" / "two.stl").write_bytes(rod())
    answer = live.robots.send_meshes(twice, tmp_path / "arm" / "left")
    assert [bool(one["sha256"]) for one in answer["meshes"]] == [True, False]
    table = live.robots.create("table", modified_dh={"joints": [{"alpha": 0, "d": 0, "theta": 0, "r": 0, "sigma": 0}]})
    with pytest.raises(ProblemError, match="names no meshes"):
        live.robots.put_meshes(table, {"one.stl": tmp_path / "arm/meshes/one.stl"})


def test_a_stock_arm_is_there_as_a_picture_of_a_few_thousand_triangles(live: Client) -> None:
    if STOCK is None:
        pytest.skip("NO STOCK ROBOTS: pip install example-robot-data")
    robot = live.robots.create("z1", urdf=STOCK / "z1_description" / "urdf" / "z1.urdf")
    live.robots.send_meshes(robot, STOCK / "z1_description")
    geometry = live.robots.geometry(robot)
    assert geometry["notes"] == []
    assert 500 < sum(len(one["triangles"]) for one in geometry["surfaces"]) <= 10_000


@pytest.mark.parametrize("names", [("m/" + 300 * "x" + ".stl", "two.stl"), ("arm.stl", "arm.stl/two.stl")])
def test_names_that_no_files_can_have_are_refused_with_the_name(
    live: Client, tmp_path: Path, names: tuple[str, str]
) -> None:
    urdf = ARM.replace("package://arm/meshes/one.stl", names[0]).replace("package://arm/meshes/two.stl", names[1])
    robot = live.robots.create("arm", urdf=urdf)
    (tmp_path / "a.stl").write_bytes(rod())
    with pytest.raises(ProblemError, match="a file cannot have the name of the mesh"):
        live.robots.put_meshes(robot, dict.fromkeys(names, tmp_path / "a.stl"))


def test_meshes_that_come_at_once_are_all_there_and_in_the_picture(live: Client, tmp_path: Path) -> None:
    robot = live.robots.create("arm", urdf=ARM)
    folders = [folder_with(tmp_path / name, **{name: rod()}) for name in ("one", "two")]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda folder: live.robots.send_meshes(robot, folder), folders))
    assert all(one["sha256"] for one in live.robots.get(robot)["meshes"])
    assert {one["frame"] for one in live.robots.geometry(robot)["surfaces"]} == {0, 1}
