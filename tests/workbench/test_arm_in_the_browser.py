"""The arm in a real Chromium: its meshes are sent by mouse, and it follows the cursor of the figures."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.closed_loop_robots import delta, five_bar, palletiser
from support.stored_recordings import robot_of, stored
from support.two_link_arm import URDF, write_recording
from support.workbench_page import ask

from dynident.robot import Robot, robot_from_modified_dh, to_pinocchio

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

TETRAHEDRON = "v 0 0 0\nv 0.5 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def with_meshes() -> str:
    """The two-link arm whose links are meshes."""
    content = URDF
    for link in ("upper", "fore"):
        mesh = f'<collision><geometry><mesh filename="package://arm/meshes/{link}.obj"/></geometry></collision>'
        content = content.replace(f'<link name="{link}"/>', f'<link name="{link}">{mesh}</link>')
    return content


def test_the_meshes_of_a_robot_are_chosen_and_drawn(page: Any, heard: Any, tmp_path: Path) -> None:
    body = {"name": "with meshes", "description": {"format": "urdf", "content": with_meshes()}}
    robot = page.request.post("/v1/robots", data=body).json()["id"]
    page.goto(f"/?view=new&robot={robot}")
    page.click("#robot-picture > summary")
    expect(page.locator("#robot-picture > summary")).to_have_text("Picture of the robot: 2 of 2 meshes missing")
    expect(page.locator("canvas.arm")).to_have_attribute("data-triangles", "0")
    for link in ("upper", "fore"):
        (tmp_path / f"{link}.obj").write_text(TETRAHEDRON)
    (tmp_path / "wrong").mkdir()
    (tmp_path / "wrong" / "upper.obj").write_text("no mesh")
    page.set_input_files("#mesh-files", tmp_path / "wrong" / "upper.obj")
    expect(page.locator("#robot-picture .box")).to_contain_text("upper.obj cannot be read as a mesh")
    page.set_input_files("#mesh-files", tmp_path / "upper.obj")
    expect(page.locator("#robot-picture > summary")).to_have_text("Picture of the robot: 1 of 2 meshes missing")
    expect(page.locator("canvas.arm")).to_have_attribute("data-triangles", "4")
    page.set_input_files("#mesh-files", tmp_path / "fore.obj")
    expect(page.locator("canvas.arm")).to_have_attribute("data-triangles", "8")
    expect(page.locator("#robot-picture > summary")).to_have_text("Picture of the robot")
    assert all(one["sha256"] for one in ask(page, f"/robots/{robot}")["meshes"])
    # The one refusal is what the browser itself complains of.
    assert [one for one in heard.complaints if "422" not in one] == []


def test_a_folder_of_meshes_is_dropped_with_all_that_is_below_it(page: Any, heard: Any, tmp_path: Path) -> None:
    body = {"name": "dropped", "description": {"format": "urdf", "content": with_meshes()}}
    robot = page.request.post("/v1/robots", data=body).json()["id"]
    meshes = tmp_path / "arm" / "meshes"
    meshes.mkdir(parents=True)
    for link in ("upper", "fore"):
        (meshes / f"{link}.obj").write_text(TETRAHEDRON)
    (tmp_path / "arm" / "readme.txt").write_text("no mesh")
    (tmp_path / "bare").mkdir()
    page.goto(f"/?view=new&robot={robot}")
    page.click("#robot-picture > summary")
    page.locator("canvas.arm").wait_for()
    drop(page, "#mesh-files", tmp_path / "bare")
    expect(page.locator("#robot-picture")).to_contain_text("It contains no STL, OBJ, DAE or PLY file.")
    with page.expect_request(lambda one: one.method == "PUT") as sent:
        drop(page, "#mesh-files", tmp_path / "arm")
    content = sent.value.post_data_buffer
    assert content is None or b"readme" not in content
    expect(page.locator("#robot-picture > summary")).to_have_text("Picture of the robot")
    expect(page.locator("canvas.arm")).to_have_attribute("data-triangles", "8")
    assert heard.complaints == []


def drop(page: Any, on: str, path: Path) -> None:
    """A file or a folder let fall from the file manager, as the browser itself is told of it."""
    zone = page.locator(".drop", has=page.locator(on))
    zone.scroll_into_view_if_needed()
    box = zone.bounding_box()
    devtools = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        devtools.send("Input.dispatchDragEvent", {"type": kind, "x": box["x"] + 9, "y": box["y"] + 9, "data": data})


@pytest.mark.sweep
@pytest.mark.parametrize("machine", [five_bar, palletiser, delta])
def test_links_in_a_closed_loop_stand_where_the_library_has_them(
    page: Any, heard: Any, machine: Callable[[], dict[str, Any]]
) -> None:
    document = json.dumps(machine())
    robot = robot_from_modified_dh(machine.__name__, machine())
    body = {"name": machine.__name__, "description": {"format": "modified_dh", "content": document}}
    made = page.request.post("/v1/robots", data=body).json()["id"]
    q = robot.linkage.closure.draw_postures(np.random.default_rng(4), 30)
    page.goto(f"/?view=new&robot={made}")
    found = page.evaluate(
        """async ([id, positions]) => {
          const [{ post }, { origin }] = await Promise.all(
            ["api", "arm/kinematics"].map((one) => import(`/workbench/js/${one}.js`)));
          const { poses } = await post(`/robots/${id}/poses`, { positions });
          return poses.map((frames) => frames.map((pose) => pose && origin(pose)));
        }""",
        [made, q.tolist()],
    )
    np.testing.assert_allclose(np.array(found, dtype=float), origins_of(robot, q), atol=1e-5)
    page.click("#robot-picture > summary")
    page.locator("canvas.arm").wait_for()
    assert None not in json.loads(page.locator("canvas.arm").get_attribute("data-origins"))
    assert "cannot be closed" not in page.locator("#robot-picture").inner_text()
    assert heard.complaints == []


def origins_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Origins (m, N, 3) of the tree's frames by Pinocchio at driven positions (m, n)."""
    model = to_pinocchio(robot.linkage.tree)
    data, found = model.createData(), []
    for position in robot.linkage.compute_positions(q):
        pin.forwardKinematics(model, data, position)
        found.append([data.oMi[k].translation.copy() for k in range(1, model.njoints)])
    return np.array(found)


def test_an_arm_that_is_opened_twice_at_once_is_there_once(page: Any, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "short.csv", seed=3, duration=10.0, rate=100.0)
    page.goto(f"/?view=recording&measurement={stored(page, robot_of(page), path)}")
    page.locator(".joint-row .u-over").first.wait_for()
    asked: list[str] = []
    page.on("request", lambda one: asked.append(one.url) if one.url.endswith("/geometry") else None)
    page.evaluate("""async () => {
      const beside = document.querySelector('.arm-beside');
      for (const open of [true, false, true, false, true]) {
        beside.open = open;
        await new Promise((resolve) => setTimeout(resolve, 1));
      }
    }""")
    page.locator("canvas.arm").first.wait_for()
    page.wait_for_load_state("networkidle")
    assert (page.locator("canvas.arm").count(), len(asked)) == (1, 1)


def test_the_arm_is_where_it_was_at_the_moment_under_the_cursor(page: Any, heard: Any, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "short.csv", seed=3, duration=10.0, rate=100.0)
    page.goto(f"/?view=recording&measurement={stored(page, robot_of(page), path)}")
    follows_the_cursor(page, "position ")
    assert heard.complaints == []


def follows_the_cursor(page: Any, word: str) -> None:
    """The elbow is half a metre from the shoulder, turned about y by what the figure says."""
    over = page.locator(".joint-row .u-over").first
    over.wait_for()
    page.click(".arm-beside > summary")
    page.locator("canvas.arm").wait_for()
    over.hover()
    values = page.locator(".joint-row .chart-title .note").first
    expect(values).to_contain_text(word)
    said = values.inner_text().split(word)[1].replace("\N{MINUS SIGN}", "-")
    position = float(re.split(r"[^0-9.e-]", said)[0])
    page.wait_for_timeout(200)
    origins = json.loads(page.locator("canvas.arm").get_attribute("data-origins"))
    assert origins[1] == pytest.approx([0.5 * math.cos(position), 0.0, -0.5 * math.sin(position)], abs=0.02)
