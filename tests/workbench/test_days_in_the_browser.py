"""A robot over many days, asked in a real Chromium against a live service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import write_recording
from support.workbench_page import ask, identifier, open_tab, the_robot, upload

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow


def test_a_load_is_told_with_its_day_and_later_days_join_those_that_are_kept(
    page: Any, recordings: tuple[Path, Path], heard: Any, tmp_path: Path
) -> None:
    the_robot(page)
    upload(page, recordings[0], "identification")
    for seed, load in ((6, 0.0), (7, 2.0)):
        upload(page, write_recording(tmp_path / f"night_{seed}.csv", seed=seed, load=load), "validation")
    page.click("#run")
    page.locator("#error-table").wait_for()
    model = identifier(page)
    open_tab(page, "Trust")
    page.locator("#days-form > summary").click()
    days = page.locator("#days-of-series input")
    expect(days).to_have_count(3)
    for one in days.all()[1:]:
        one.fill("")
    page.click("#follow-days")
    expect(page.locator("#days-form")).to_contain_text("at least two days")
    for number, one in enumerate(days.all()):
        one.fill(str(number + 1))
    page.click("#follow-days")
    expect(page.locator("#series-summary")).to_be_visible()
    (found,) = ask(page, f"/series?identification_id={model}")["items"]
    (change,) = (one for one in found["result"]["changes"] if one["effect"] == "payload")
    row = page.locator("#series tr[data-change=payload]")
    expect(row).to_contain_text(change["since"])
    expect(row).to_contain_text(change["evidence"])
    expect(page.locator("#days-of-series")).to_contain_text("Upload another day's recording")
    names = page.locator("#course option").all_text_contents()
    assert len(names) == len([one for one in found["result"]["courses"] if any(one["values"])])
    assert names[0].startswith(change["parameter"])
    expect(page.locator("#courses canvas")).to_be_visible()
    page.screenshot(path=tmp_path / "days.png", full_page=True)

    robot = ask(page, f"/identifications/{model}")["robot_id"]
    page.goto(f"/?view=new&robot={robot}")
    page.locator("#recordings").wait_for()
    upload(page, write_recording(tmp_path / "night_8.csv", seed=8, load=2.0), "validation")
    page.goto(f"/?identification={model}&tab=trust")
    expect(page.locator("#series-summary")).to_be_visible()
    page.locator("#days-form > summary").click()
    expect(page.locator("#days-of-series input")).to_have_count(1)
    page.click("#follow-days")
    expect(page.locator("#days-of-series")).to_contain_text("4 recordings")
    longer = ask(page, f"/series?identification_id={model}")["items"][0]
    assert longer["request"]["continues"] == found["id"]
    assert len(longer["result"]["days"]) == 4
    assert heard.complaints == []
