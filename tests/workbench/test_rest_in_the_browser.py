"""An arm that rests between its moves, in the browser: the band at rest, its errors, a rung for each effect."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from support.joints_at_rest import write_resting_run
from support.oracles import arm

from dynident.robot import library_table

playwright = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright")
expect = playwright.expect
pytestmark = pytest.mark.slow
ROBOT = arm("scara")


def done(page: Any, identifier: str) -> str:
    """Wait until a model is identified."""
    end = time.monotonic() + 120.0
    while (status := page.request.get(f"/v1/identifications/{identifier}").json()["status"]) != "succeeded":
        assert status in ("queued", "running")
        assert time.monotonic() < end
        time.sleep(0.2)
    return identifier


@pytest.fixture
def models(page: Any, tmp_path: Path) -> list[str]:
    """Ids of a first model and of one with two effects more."""
    page.goto("/")
    body = {"name": "scara", "description": {"format": "modified_dh", "content": library_table("scara")}}
    robot = page.request.post("/v1/robots", data=body).json()["id"]
    runs = []
    for seed in (1, 2):
        content = write_resting_run(ROBOT, tmp_path / f"run{seed}.csv", seed).read_bytes()
        sent = {
            "file": {"name": "run.csv", "mimeType": "text/csv", "buffer": content},
            "metadata": json.dumps({"robot_id": robot, "name": f"run{seed}"}),
        }
        runs.append(page.request.post("/v1/measurements", multipart=sent).json()["id"])
    asked = {"robot_id": robot, "measurement_ids": runs[:1], "validation_ids": runs[1:]}
    first = done(page, page.request.post("/v1/identifications", data=asked).json()["id"])
    added = [{"effect": "offset"}, {"effect": "stribeck", "joints": [ROBOT.joint_names[1]]}]
    made = page.request.post(f"/v1/identifications/{first}/extend", data={"effects": added})
    return [first, done(page, made.json()["id"])]


def test_rest_is_drawn_as_what_friction_may_hold_and_every_effect_has_its_rung(
    page: Any, models: list[str], heard: Any, tmp_path: Path
) -> None:
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.goto(f"/?identification={models[1]}&tab=compare")
        expect(page.locator("#zoom-state")).to_contain_text("Where the background is grey, the joint stands still")
        page.locator("#torque-chart canvas").wait_for()
        page.screenshot(path=tmp_path / f"rest_{scheme}.png", full_page=True)
    moving = page.locator("#torque-title ~ *").last
    expect(moving).to_contain_text("where the joint moves")
    page.get_by_role("tab", name="Missing").click()
    ladder = page.locator("#ladder-table tbody tr")
    expect(ladder).to_have_count(3)
    expect(ladder.nth(1)).to_contain_text("Torque offset")
    expect(ladder.nth(0).get_by_role("link")).to_have_count(1)
    # What was made on the way is no model of its own.
    expect(ladder.nth(1).get_by_role("link")).to_have_count(0)
    expect(page.locator("#ladder-table")).to_contain_text("✓ best")
    expect(page.locator("#best-rung")).to_contain_text("predicts held-out data best")
    expect(page.locator("#step")).to_contain_text("Added Torque offset on all joints; Stribeck friction on elbow")
    page.locator("#ladder-table").get_by_role("link", name="1", exact=True).click()
    page.wait_for_url(f"**identification={models[0]}*")
    assert heard.complaints == []
