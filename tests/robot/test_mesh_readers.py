"""Meshes of four formats give the triangles that they hold, whatever way these are written."""

from __future__ import annotations

import numpy as np
import pytest
from support.file_mutations import CORNERS, dae_file, obj_file, ply_file, stl_file, stl_text

from dynident.robot.link_meshes import read_surface
from dynident.robot.mesh_readers import read_triangles


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = points[triangles].swapaxes(0, 1)
    return float((a * np.cross(b, c)).sum() / 6)


def read(tmp_path, name: str, content: bytes):
    (tmp_path / name).write_bytes(content)
    return read_triangles(tmp_path / name)


BIG = ply_file().replace(b"little", b"big")
BIG = BIG[: BIG.index(b"end_header\n") + 11] + CORNERS.astype(">f4").tobytes()
BIG += b"".join(
    b"\x03" + np.array(face, dtype=">i4").tobytes() for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
)
COLOURED = ply_file(binary=False).replace(b"property float z\n", b"property float z\nproperty uchar red\n")
COLOURED = b"\n".join(
    line + (b" 255" if len(line.split()) == 3 and b" " in line and line[:1] in b"01" else b"")
    for line in COLOURED.split(b"\n")
)
RELATIVE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf -4 -2 -3\nf -4 -3 -1\r\nf 1/1 4/2 3/3\nf 2 3 \\\n4\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("part.stl", stl_file()),
        ("part.STL", b"solid" + stl_file()[5:]),
        ("part.stl", stl_file() + b"more behind the triangles"),
        ("part.stl", stl_text()),
        ("part.stl", stl_text().replace(b"1", b"1.0E+00").upper()),
        ("part.obj", obj_file()),
        ("part.obj", RELATIVE),
        ("part.ply", ply_file()),
        ("part.ply", BIG),
        ("part.ply", ply_file(binary=False)),
        ("part.ply", COLOURED),
        ("part.dae", dae_file()),
    ],
)
def test_a_tetrahedron_is_one_in_every_format(tmp_path, name, content):
    points, triangles = read(tmp_path, name, content)
    assert points.shape == (4, 3)
    assert triangles.shape == (4, 3)
    assert volume(points, triangles) == pytest.approx(1 / 6)
    assert points.max(axis=0) == pytest.approx([1.0, 1.0, 1.5 if name.endswith("dae") else 1.0])


def test_faces_of_four_corners_become_two_triangles(tmp_path):
    cube = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [cube, *(f"f {face}" for face in faces), ""]
    points, triangles = read(tmp_path, "part.obj", "\n".join(lines).encode())
    assert triangles.shape == (12, 3)
    assert volume(points, triangles) == pytest.approx(1.0)


def test_a_dae_is_in_metres_where_its_nodes_stand_each_part_with_its_own_corners(tmp_path):
    content = dae_file().replace(b'meter="1"', b'meter="0.001"')
    node = (
        b"<node><translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 2 2</scale>"
        b'<instance_geometry url="#part"/></node></visual_scene>'
    )
    points, triangles = read(tmp_path, "part.dae", content.replace(b"</visual_scene>", node))
    assert triangles.shape == (8, 3)
    assert volume(points, triangles) == pytest.approx((1 + 8) / 6 * 1e-9)
    assert points.min(axis=0) == pytest.approx([0, 0, 0])
    assert points.max(axis=0) == pytest.approx([0.01, 0.002, 0.002])


@pytest.mark.parametrize(
    ("element", "corners"),
    [
        ('<polylist count="4"><input semantic="VERTEX" source="#vertices" offset="0"/><vcount>3 3 3 3</vcount>{}', 4),
        ('<polygons count="4"><input semantic="VERTEX" source="#vertices" offset="0"/>{}', 4),
        ('<tristrips count="1"><input semantic="VERTEX" source="#vertices" offset="0"/><p>0 2 1 3 0 2</p>', 4),
        ('<trifans count="1"><input semantic="VERTEX" source="#vertices" offset="0"/><p>0 2 1 3 2</p>', 3),
    ],
)
def test_every_primitive_of_a_dae_gives_triangles(tmp_path, element, corners):
    head, _, rest = dae_file().decode().partition("<triangles")
    inner, _, rest = rest.partition("</triangles>")
    faces = inner.partition("<p>")[2].partition("</p>")[0].split()
    lists = [" ".join(faces[k : k + 3]) for k in range(0, 12, 3)]
    text = f"<p>{' '.join(faces)}</p>" if "polylist" in element else "".join(f"<p>{one}</p>" for one in lists)
    name = element[1:].partition(" ")[0]
    content = f"{head}{element.format(text)}</{name}>{rest}".encode()
    points, triangles = read(tmp_path, "part.dae", content)
    assert len(triangles) == corners
    if name != "trifans":
        assert volume(points, triangles) == pytest.approx(1 / 6)


def test_what_a_mesh_names_is_not_opened(tmp_path, monkeypatch):
    opened = []
    path = tmp_path / "part.obj"
    path.write_bytes(obj_file())
    (tmp_path / "part.mtl").write_text("newmtl grey\n")
    before = type(path).read_bytes
    monkeypatch.setattr(type(path), "read_bytes", lambda self: opened.append(self.name) or before(self))
    monkeypatch.setattr("builtins.open", lambda *_, **__: pytest.fail("another file was opened"))
    read_triangles(path)
    assert opened == ["part.obj"]


def test_corners_farther_away_than_any_machine_is_large_are_refused(tmp_path):
    (tmp_path / "part.stl").write_bytes(stl_file())
    with pytest.raises(ValueError, match="more than 1e\\+06 m from the origin"):
        read_surface(tmp_path / "part.stl", np.full(3, 1e300), np.eye(4))
