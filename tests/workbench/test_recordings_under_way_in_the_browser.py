"""A recording under way: its estimates come to the page, and at its end it is a recording like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.measurement_uploads import move_two_joints

from dynident_client import Client

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

TABLE = {
    "joints": [
        {"name": "shoulder", "alpha": 0, "d": 0, "r": 0},
        {"name": "elbow", "alpha": 0, "d": 0.5, "r": 0},
    ]
}


def test_estimates_come_while_the_robot_moves(page: Any, service: str, heard: Any, tmp_path: Path) -> None:
    rows = move_two_joints(20.0, seed=3)
    with Client(service) as live:
        robot = live.robots.create("scara", modified_dh=TABLE)
        measurement = live.measurements.begin(robot, "under way")
        page.goto(f"/?view=recording&measurement={measurement.id}")
        expect(page.locator("#live-state")).to_contain_text("No rows have arrived")
        for first in range(0, 1500, 500):
            part = {name: values[first : first + 500] for name, values in rows.items()}
            live.measurements.append_rows(measurement, part, offset=first)
            expect(page.locator("#live-state")).to_contain_text(f"{(first + 500) / 100:.3g}", timeout=30_000)
        expect(page.locator("#live-parameters tbody tr").first).to_contain_text("±")
        # A value has the decimals of its standard deviation.
        for text in page.locator("#live-parameters td.n").all_inner_texts():
            value, deviation = (part.partition(".")[2] for part in text.split(" ± "))
            assert len(value) == len(deviation) > 0
        expect(page.locator("#live-chart canvas")).to_be_visible()
        page.screenshot(path=tmp_path / "live.png", full_page=True)
        page.goto("/?view=recordings")
        expect(page.locator("main")).to_contain_text("under way")
        page.goto(f"/?view=recording&measurement={measurement.id}")
        expect(page.locator("#live-parameters tbody tr").first).to_contain_text("±", timeout=30_000)
        # With its last rows it becomes a recording like any other, before the eyes of who follows it.
        rest = {name: values[1500:] for name, values in rows.items()}
        live.measurements.append_rows(measurement, rest, offset=1500, finished=True)
        expect(page.get_by_role("heading", name="Signals as recorded")).to_be_visible(timeout=30_000)
        # A run that is not worth going on with says so.
        part = {name: values[:900].copy() for name, values in rows.items()}
        part["tau2"] = np.clip(part["tau2"], -2.0, 2.0)
        bad = live.measurements.begin(robot, "saturated")
        live.measurements.append_rows(bad, part, offset=0)
        page.goto(f"/?view=recording&measurement={bad.id}")
        expect(page.locator("#live-stop")).to_contain_text("Stop the robot", timeout=30_000)
        page.set_viewport_size({"width": 390, "height": 844})
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
        page.screenshot(path=tmp_path / "bad.png", full_page=True)
    assert heard.complaints == []


def test_an_estimate_that_fails_is_shown_as_a_problem(page: Any, service: str) -> None:
    with Client(service) as live:
        measurement = live.measurements.begin(live.robots.create("scara", modified_dh=TABLE), "failing")
    problem = '{"type": "x", "title": "Disk full", "status": 507, "detail": "The disk of the service is full."}'
    body = f"event: problem\ndata: {problem}\n\n"
    page.route("**/estimates", lambda route: route.fulfill(content_type="text/event-stream", body=body))
    page.goto(f"/?view=recording&measurement={measurement.id}")
    expect(page.locator("#live-state")).to_contain_text("The disk of the service is full.")
