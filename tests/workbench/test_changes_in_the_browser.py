"""What has changed since an earlier day, asked in a real Chromium against a live service."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import write_recording
from support.workbench_page import ask, identifier, the_robot, upload

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow


def test_a_load_that_was_mounted_since_is_told_with_its_interval_and_is_no_part_of_the_model(
    page: Any, recordings: tuple[Path, Path], heard: Any, tmp_path: Path
) -> None:
    page.goto("/")
    the_robot(page)
    upload(page, recordings[0], "identification")
    page.click("#run")
    page.locator("#error-table").wait_for()
    model = identifier(page)
    robot = ask(page, f"/identifications/{model}")["robot_id"]
    page.goto(f"/?view=new&robot={robot}")
    page.locator("#recordings").wait_for()
    upload(page, write_recording(tmp_path / "today.csv", seed=5, load=2.0), "identification")
    page.goto(f"/?identification={model}&tab=missing")
    page.locator("#changes-form > summary").click()
    page.locator("#days select").first.wait_for()
    for select in page.locator("#days select").all():
        select.select_option("")
    page.click("#what-changed")
    expect(page.locator("#changes-form")).to_contain_text("at least one recording before and one after")
    page.get_by_label("exciting").select_option("before")
    page.get_by_label("today").select_option("after")
    page.click("#what-changed")
    page.locator("#changes table").wait_for()
    (found,) = ask(page, f"/diagnoses?identification_id={model}")["items"]
    first = found["result"]["changes"][0]
    assert first["effect"] == "payload"
    row = page.locator("#changes tr[data-change]").first
    assert row.get_attribute("data-change") == "payload"
    shown = [one.get_attribute("value") for one in row.locator("data").all()]
    assert str(first["value"]) in shown
    expect(row).to_contain_text(first["evidence"])
    expect(page.locator("#candidates tr[data-effect=payload]")).to_contain_text("since the baseline")
    # What friction did is drawn as well: an interval a joint, whose ends are said to whoever does not see it.
    drawn = page.locator("#friction-since [role=img]")
    assert drawn.count() == len(found["result"]["friction"]) > 0
    expect(drawn.first).to_have_attribute("aria-label", re.compile(r"%.* to .*%"))
    page.screenshot(path=tmp_path / "changes.png", full_page=True)
    page.reload()
    page.locator("#changes table").wait_for()
    # The menu leads to the same, whatever model was looked at.
    page.get_by_role("link", name="Changes", exact=True).click()
    page.locator("section[aria-labelledby=since-title] #changes table").wait_for()
    expect(page.get_by_label("Model", exact=True)).to_have_value(model)
    expect(page.locator("#since-title + * #days select").first).to_be_visible()
    assert heard.complaints == []
