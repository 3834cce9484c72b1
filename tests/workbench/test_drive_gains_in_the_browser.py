"""Drive gains from a known load, in a real Chromium against a live service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import URDF, write_recording
from support.workbench_page import ask, upload, value_in

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

MASS, OTHER = 2.0, 1.0


def test_gains_of_a_known_load_are_shown_and_taken_over(
    page: Any, recordings: tuple[Path, Path], heard: Any, tmp_path: Path
) -> None:
    drives = {joint: {"drive_gain": 1.0} for joint in ("shoulder", "elbow")}
    body = {"name": "two links", "description": {"format": "urdf", "content": URDF}, "drives": drives}
    page.goto(f"/?view=new&robot={page.request.post('/v1/robots', data=body).json()['id']}")
    page.locator("#recordings").wait_for()
    expect(page.locator("#drive-gains")).to_be_hidden()
    upload(page, recordings[0], "identification")
    upload(page, write_recording(tmp_path / "known.csv", seed=1, load=MASS), "payload")
    upload(page, write_recording(tmp_path / "other.csv", seed=1, load=OTHER), "payload")
    page.locator("#drive-gains > summary").click()
    page.click("#identify-gains")
    expect(page.locator("#drive-gains .complaint")).to_contain_text("without the load")
    expect(page.get_by_label("Load of known")).to_have_value("loaded")
    page.get_by_label("Load of exciting").select_option("unloaded")
    page.get_by_label("Load of other").select_option("weigh")
    page.click("#identify-gains")
    expect(page.locator("#drive-gains .complaint")).to_contain_text("give mass")
    page.fill("#known-mass", str(MASS))
    page.click("#identify-gains")

    page.locator("#gains-table").wait_for()
    (found,) = ask(page, "/drive_gains")["items"]
    for gain in found["result"]["gains"]:
        assert value_in(page, "#gains-table", gain["joint"], 1) == gain["drive_gain"]
        assert gain["drive_gain"] == pytest.approx(1.0, rel=0.2)
    (load,) = found["result"]["loads"]
    assert value_in(page, "#loads-table", "other", 0) == load["mass"] == pytest.approx(OTHER, rel=0.1)
    page.screenshot(path=tmp_path / "gains.png", full_page=True)

    page.reload()
    expect(page.locator("#gains-table tbody tr")).to_have_count(2)
    page.get_by_role("button", name="Make a robot with these drive gains").last.click()
    expect(page.locator("label", has=page.locator("input[name=robot]:checked"))).to_contain_text("identified")
    (made,) = [one for one in ask(page, "/robots")["items"] if "identified" in one["name"]]
    assert [joint["drive_gain"] for joint in made["joints"]] == [one["drive_gain"] for one in found["result"]["gains"]]
    assert heard.complaints == []
