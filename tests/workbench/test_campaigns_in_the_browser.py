"""A campaign by mouse: begun, its motions made by the virtual robot, until the goal is reached."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from support.heavy_arm import heavy_arm
from support.workbench_page import ask

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow


def test_a_campaign_goes_on_until_its_goal_is_reached(page: Any, heard: Any, tmp_path: Path) -> None:
    robot = heavy_arm(page)
    page.goto("/?view=campaigns")
    page.select_option("#campaign-robot", robot)
    page.fill("#campaign-error", "0.05")
    page.fill("#campaign-duration", "4")
    expect(page.locator("#campaign-form")).to_contain_text("a run may take half or a quarter of it")
    page.get_by_text("More options").click()
    # What only other kinds of designs have is not asked.
    expect(page.locator("#campaign-sets, #campaign-speeds, #campaign-joints")).to_have_count(0)
    page.fill("#campaign-time_budget", "2")
    page.fill("#campaign-name", "five per cent")
    page.click("#begin-campaign")
    state = page.locator("#campaign-state")
    expect(state).to_have_attribute("data-state", "asking")
    for number in range(4):
        page.click("#ask")
        page.locator("#simulate-run").wait_for(timeout=60_000)
        if number == 1:
            expect(page.locator("main")).to_contain_text("promises an error of")
            page.screenshot(path=tmp_path / "waiting.png", full_page=True)
        # What is under way is followed by a page that is opened later as well.
        page.click("#simulate-run")
        expect(page.locator("#campaign-runs tbody tr")).to_have_count(number + 1, timeout=90_000)
        if state.get_attribute("data-state") == "reached":
            break
    expect(state).to_have_attribute("data-state", "reached")
    expect(page.locator("#campaign-chart canvas")).to_be_visible()
    page.screenshot(path=tmp_path / "reached.png", full_page=True)
    page.set_viewport_size({"width": 390, "height": 844})
    # The figure is drawn again in the new width.
    page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    page.screenshot(path=tmp_path / "narrow.png", full_page=True)
    page.set_viewport_size({"width": 1280, "height": 800})
    (campaign,) = ask(page, f"/campaigns?robot_id={robot}")["items"]
    assert campaign["achieved"] <= 0.05
    assert "five per cent: 1 run" in {model["name"] for model in ask(page, "/identifications")["items"]}
    page.get_by_role("link", name="All campaigns").click()
    expect(page.locator("#campaigns-table")).to_contain_text("goal reached")
    expect(page.locator("#campaigns-table")).to_contain_text(re.compile(r"\d\s%5\.00\s%"))
    assert heard.complaints == []


def test_obstacles_of_a_campaign_are_those_of_all_its_motions(page: Any) -> None:
    robot = heavy_arm(page)
    page.goto("/?view=campaigns")
    page.select_option("#campaign-robot", robot)
    page.fill("#campaign-surroundings-floor", "-2")
    page.click("#begin-campaign")
    page.locator("#campaign-state").wait_for()
    (campaign,) = ask(page, f"/campaigns?robot_id={robot}")["items"]
    assert campaign["request"]["surroundings"]["floor"] == -2


def test_a_load_is_weighed_after_it_was_mounted(page: Any, heard: Any, tmp_path: Path) -> None:
    robot = heavy_arm(page)
    page.goto("/?view=campaigns")
    page.select_option("#campaign-robot", robot)
    page.select_option("#campaign-goal", "PayloadGoal")
    page.fill("#campaign-mass_error", "0.3")
    page.fill("#campaign-unloaded_runs", "1")
    page.fill("#campaign-duration", "4")
    page.get_by_text("More options").click()
    page.fill("#campaign-time_budget", "2")
    page.screenshot(path=tmp_path / "form.png", full_page=True)
    page.click("#begin-campaign")
    state = page.locator("#campaign-state")
    expect(state).to_contain_text("Leave the load off.")
    for number in range(4):
        page.click("#ask")
        page.locator("#simulate-run").wait_for(timeout=60_000)
        page.click("#simulate-run")
        expect(page.locator("#campaign-runs tbody tr")).to_have_count(number + 1, timeout=90_000)
        if number == 0:
            expect(state).to_contain_text("Mount the load now")
        if state.get_attribute("data-state") == "reached":
            break
    expect(state).to_contain_text(re.compile("The goal is reached: mass .* kg"))
    page.screenshot(path=tmp_path / "weighed.png", full_page=True)
    assert heard.complaints == []
