"""A design by mouse in a real Chromium, against a live service: until the file for the controller and beyond."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from support.heavy_arm import heavy_arm
from support.standing_robots import STANDER
from support.two_link_arm import URDF
from support.workbench_page import ask

from dynident.robot import library_table
from dynident_client import Client

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow


def test_an_experiment_is_designed_taken_along_and_made_by_a_virtual_robot(
    page: Any, heard: Any, tmp_path: Path
) -> None:
    robot = heavy_arm(page)
    page.goto("/?view=robots")
    page.locator(f"tr[data-id={robot}]").get_by_role("link", name="Design").click()
    page.get_by_label("Largest velocity of elbow").fill("4")
    for joint in ("shoulder", "elbow"):
        page.get_by_label(f"Noise of {joint}").fill("0.1")
    page.fill("#design-time_budget", "2")
    page.fill("#design-random_trajectories", "10")
    page.fill("#design-duration", "4")
    page.click("#run-design")
    page.locator("canvas.arm").wait_for()
    (design,) = ask(page, f"/designs?robot_id={robot}")["items"]
    assert design["request"]["limits"]["elbow"]["velocity"] == 4
    assert "shoulder" not in design["request"]["limits"]
    result = design["result"]
    expect(page.locator("#descent")).to_contain_text("the best random motion has")
    expect(page.locator("#descent canvas")).to_be_visible()
    promised = page.locator("#promises data").first.get_attribute("value")
    assert float(promised) == result["expected_parameters"][0]["standard_deviation"]

    with page.expect_download() as taken:
        page.locator("[data-format=csv]").first.click()
    lines = Path(taken.value.path()).read_text().splitlines()
    assert lines[0].startswith("t,q_shoulder,q_elbow")
    assert len(lines) == result["n_samples"] + 1
    page.click("details.slow > summary")
    with page.expect_download() as taken:
        page.locator("details.slow [data-format=csv]").click()
    slow = Path(taken.value.path()).read_text().splitlines()
    assert float(slow[-1].split(",")[0]) == pytest.approx(3 * float(lines[-1].split(",")[0]))

    # The arm is where the trajectory has it: the elbow is half a metre from the shoulder, turned about y.
    page.locator("input[type=range]").fill("2")
    shoulder = float(lines[1 + round(2 * result["sampling_rate"])].split(",")[1])
    origins = json.loads(page.locator("canvas.arm").get_attribute("data-origins"))
    assert origins[1] == pytest.approx([0.5 * math.cos(shoulder), 0.0, -0.5 * math.sin(shoulder)], abs=0.02)
    expect(page.locator("#motion-curves canvas")).to_have_count(2)

    # What notes advise is worded by what this page has.
    page.locator("summary", has_text="Notes").click()
    notes = page.locator("main").inner_text()
    assert "“Torque predicted by”" in notes
    assert "identification_id" not in notes
    assert "assume_floor" not in notes

    page.click("#simulate-design")
    page.locator("#error-table").wait_for()
    page.goto(f"/?view=design&robot={robot}")
    page.locator("#design-identification").select_option(index=1)
    page.fill("#design-time_budget", "1")
    page.fill("#design-random_trajectories", "5")
    page.fill("#design-duration", "4")
    page.click("#run-design")
    page.locator("#design-quality").wait_for()
    (better, _) = ask(page, f"/designs?robot_id={robot}")["items"]
    (known,) = ask(page, f"/identifications?robot_id={robot}")["items"]
    assert better["request"]["identification_id"] == known["id"]
    assert heard.complaints == []


def test_an_experiment_that_cannot_be_says_where_and_keeps_what_was_filled_in(page: Any) -> None:
    robot = heavy_arm(page)
    page.goto(f"/?view=design&robot={robot}")
    page.get_by_label("Distinguish two effects").check()
    page.get_by_label("First effect", exact=True).select_option("coulomb")
    page.fill("#design-duration", "-1")
    page.click("#run-design")
    expect(page.locator("[data-pointer='/trajectory/duration'] .complaint")).to_be_visible()
    expect(page.get_by_label("First effect", exact=True)).to_have_value("coulomb")


def test_obstacles_are_stated_beside_the_limits_and_complaints_stand_at_them(page: Any) -> None:
    robot = heavy_arm(page)
    page.goto(f"/?view=design&robot={robot}")
    page.fill("#design-surroundings-floor", "-3")
    page.click("#add-box")
    page.click("#add-box")
    page.get_by_label("Remove box 1").click()
    for axis, centre, edge in (("x", "5", "1"), ("y", "0", "2"), ("z", "0.1", "-1")):
        page.get_by_label(f"Centre {axis} of box 1").fill(centre)
        page.get_by_label(f"Edge {axis} of box 1").fill(edge)
    page.click("#run-design")
    expect(page.locator("[data-pointer='/surroundings/boxes/0/size/2'] .complaint")).to_be_visible()
    page.get_by_label("Edge z of box 1").fill("0.2")
    with page.expect_request("**/v1/designs") as sent:
        page.click("#run-design")
    stated = sent.value.post_data_json["surroundings"]
    assert stated["floor"] == -3
    assert stated["boxes"] == [{"name": "box 2", "center": [5, 0, 0.1], "size": [1, 2, 0.2]}]


def test_long_limits_are_shown_short_and_kept_exact(page: Any) -> None:
    exact = '<limit lower="-3.14159265" upper="3.14159265" effort="0.000066666" velocity="0.57"/>'
    content = re.sub("<limit[^>]*/>", exact, URDF)
    body = {"name": "long limits", "description": {"format": "urdf", "content": content}}
    robot = page.request.post("/v1/robots", data=body).json()["id"]
    page.goto(f"/?view=design&robot={robot}")
    # Rounded towards zero, and only where there is something to round.
    for label, shown in (
        ("Lowest position", "-3.1415"),
        ("Largest velocity", "0.57"),
        ("Largest torque", "0.00006666"),
    ):
        expect(page.get_by_label(f"{label} of elbow")).to_have_value(shown)
    page.get_by_label("Highest position of elbow").fill("1")
    with page.expect_request("**/v1/designs") as sent:
        page.click("#run-design")
    assert sent.value.post_data_json["limits"] == {"elbow": {"position": [-3.14159265, 1]}}


def test_the_arm_moves_with_its_clearances_to_what_stands_around_it(page: Any, heard: Any) -> None:
    client = Client(page.request.get("/").url)
    robot = client.robots.create("panda", modified_dh=library_table("franka_panda"))
    asked: dict[str, Any] = {
        "kind": "random",
        "trajectory": {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0},
        "random_trajectories": 3,
        "effects": [{"effect": "viscous"}],
        "surroundings": {"floor": -0.3, "boxes": [{"name": "table", "center": [0.9, 0, 0.1], "size": [0.4, 1, 0.4]}]},
    }
    design = client.designs.create(robot, **asked).wait()
    along = client.designs.clearances(design)
    page.goto(f"/?view=design&robot={robot.id}&design={design.id}")
    said = page.locator("#nearest-now")
    expect(said).to_contain_text("Closest here: ")
    said.get_by_role("button", name="Closest approach").click()
    rooms = [[far - kept for far, kept in zip(one["distance"], one["wanted"], strict=True)] for one in along["links"]]
    k = min(range(len(along["t"])), key=lambda k: min(room[k] for room in rooms))
    worst = along["links"][min(range(len(rooms)), key=lambda place: rooms[place][k])]
    expect(said).to_contain_text(f"{worst['name']} and {worst['others'][worst['to'][k]]['name']}, ")
    assert float(page.get_by_label("Time in s").input_value()) == pytest.approx(along["t"][k], abs=1e-9)
    # Both ends of every line are on what it belongs to, however the arm stands: it is as long as they are apart.
    lines = json.loads(page.locator("canvas.arm").get_attribute("data-gaps"))
    lengths = sorted(math.dist(*ends) for ends in lines)
    near = sorted(one["distance"][k] for one in along["links"] if one is worst or one["distance"][k] < 0.3)
    assert lengths == pytest.approx(near, abs=0.01)
    assert heard.complaints == []


@pytest.mark.parametrize(
    ("surroundings", "height", "words"),
    [
        ({}, "0", "an assumed floor through the base"),
        ({"floor": -0.3}, "-0.3", "the stated floor at z ="),
        ({"assume_floor": False}, "", "No floor was checked"),
    ],
    ids=["assumed", "stated", "none"],
)
def test_the_floor_that_was_checked_is_drawn_and_named(
    page: Any, heard: Any, surroundings: dict[str, Any], height: str, words: str
) -> None:
    client = Client(page.request.get("/").url)
    robot = client.robots.create("panda", modified_dh=library_table("franka_panda"))
    asked: dict[str, Any] = {
        "kind": "random",
        "trajectory": {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0},
        "random_trajectories": 3,
        "effects": [{"effect": "viscous"}],
        "surroundings": surroundings,
    }
    design = client.designs.create(robot, **asked).wait()
    page.goto(f"/?view=design&robot={robot.id}&design={design.id}")
    expect(page.locator("#floor")).to_contain_text(words)
    expect(page.locator("canvas.arm")).to_have_attribute("data-floor", height)
    # The plane is filled: more of the picture has its colour than the lines of a grid have.
    share = page.evaluate(
        """() => {
          const canvas = document.querySelector("canvas.arm");
          const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          let filled = 0;
          for (let k = 3; k < data.length; k += 4) filled += data[k] > 40 && data[k] < 100;
          return (4 * filled) / data.length;
        }"""
    )
    assert (share > 0.1) == bool(height), share
    assert heard.complaints == []


def test_the_next_experiment_of_a_diagnosis_is_filled_in(page: Any) -> None:
    robot = heavy_arm(page)
    rivals = [{"effect": "stribeck", "joints": ["elbow"]}, {"effect": "coulomb", "joints": ["elbow"]}]
    body = {"robot_id": robot, "kind": "constant_velocity", "criterion": {"name": "separation", "effects": rivals}}
    told = {"result": {"next_experiment": {"design": body, "reason": "They look alike.", "instructions": ["Be slow."]}}}
    page.route("**/v1/diagnoses/dia_1", lambda route: route.fulfill(json=told))
    page.goto("/?view=design&diagnosis=dia_1")
    expect(page.locator("main")).to_contain_text("They look alike.")
    expect(page.locator("#design-kind")).to_have_value("constant_velocity")
    expect(page.get_by_label("As proposed")).to_be_checked()
    with page.expect_request("**/v1/designs") as sent:
        page.click("#run-design")
    asked = sent.value.post_data_json
    assert asked["criterion"] == body["criterion"]


def test_a_robot_is_let_stand_on_its_feet(page: Any, heard: Any) -> None:
    client = Client(page.request.get("/").url)
    robot = client.robots.create("stander", urdf=STANDER)
    page.goto(f"/?view=design&robot={robot.id}")
    page.locator("#design-standing > summary").click()
    # A point has commas of its own.
    feet = ["left_foot@0.14,0.05,-0.02", "left_foot@-0.06,0.05,-0.02", "right_foot@0.14,-0.05,-0.02"]
    page.fill("#design-standing-feet", "; ".join(feet))
    page.fill("#design-standing-sway", "0, 0")
    page.fill("#design-standing-margin", "0.005")
    page.fill("#design-time_budget", "2")
    page.fill("#design-random_trajectories", "5")
    page.fill("#design-duration", "3")
    page.click("#run-design")
    page.locator("canvas.arm").wait_for()
    (design,) = ask(page, f"/designs?robot_id={robot.id}")["items"]
    assert design["request"]["standing"]["feet"] == feet
    assert design["request"]["standing"]["margin"] == 0.005
    expect(page.locator("main")).to_contain_text("balance")
