"""The lists of models, jobs, robots and recordings in a real Chromium, against a live service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import write_recording
from support.workbench_page import ask, the_robot, upload

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

FOUR = [{"effect": name} for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous")]
SPRING = {"effect": "joint_spring", "joints": ["elbow"]}


@pytest.fixture
def two_models(page: Any, tmp_path: Path) -> dict[str, str]:
    """A model without the hidden spring and one with it; their ids by name."""
    known = {one["name"]: one["id"] for one in ask(page, "/identifications?archived=true")["items"]}
    if known:
        return known
    the_robot(page)
    for role, seed in (("identification", 1), ("validation", 2)):
        upload(page, write_recording(tmp_path / f"{role}.csv", seed=seed, duration=8.0), role)
    held, fitted = (one for one in ask(page, "/measurements")["items"])
    same = {"robot_id": held["robot_id"], "measurement_ids": [fitted["id"]], "validation_ids": [held["id"]]}
    for name, effects in (("plain", FOUR), ("sprung", [*FOUR, SPRING])):
        known[name] = page.request.post("/v1/identifications", data={**same, "name": name, "effects": effects}).json()[
            "id"
        ]
    page.goto("/?view=jobs")
    expect(page.locator("#jobs-table .mark.succeeded")).to_have_count(2)
    return known


def names(page: Any) -> list[str]:
    return [text.strip() for text in page.locator("#models-table tbody tr[data-id] > th").all_text_contents()]


def test_models_are_sorted_and_filtered_and_the_address_keeps_it(page: Any, two_models: dict[str, str]) -> None:
    page.goto("/?view=models")
    rows = page.locator("#models-table tbody tr[data-id]")
    expect(rows).to_have_count(2)
    page.locator("#models-table [data-column=error] button").click()
    assert names(page) == ["sprung", "plain"]
    page.locator("#models-table [data-column=error] button").click()
    assert names(page) == ["plain", "sprung"]
    page.reload()
    expect(page.locator("#models-table [data-column=error]")).to_have_attribute("aria-sort", "descending")
    expect(rows.first).to_contain_text("plain")
    page.fill("#models-table-filter", "joint spring")
    expect(rows).to_have_count(1)
    assert "filter=joint+spring" in page.url
    page.fill("#models-table-filter", "nothing like it")
    expect(page.locator("#models-table tbody")).to_contain_text("shorten the filter")


def test_two_models_that_are_ticked_are_compared(page: Any, two_models: dict[str, str], heard: Any) -> None:
    page.goto("/?view=models")
    for name in ("plain", "sprung"):
        page.get_by_label(f"Compare {name}").check()
    page.click("#compare-two")
    expect(page.locator("#pair-settings tr[data-differs]")).to_have_text(["Joint spring on elbow–in the model"])
    first, second = (ask(page, f"/identifications/{two_models[name]}")["result"] for name in ("plain", "sprung"))
    found = page.locator("#pair-errors tr.total data").evaluate_all("all => all.map((one) => Number(one.value))")
    assert found == [
        one[kind]["moving"]["relative_total"] for kind in ("validation", "residual") for one in (first, second)
    ]
    stiffness = next(one for one in second["parameters"] if one["effect"] == "joint_spring")
    expect(page.locator("#pair-parameters tr[data-differs]", has_text=stiffness["name"])).to_contain_text("not in it")
    page.go_back()
    expect(page.locator("#models-table tbody tr[data-id]")).to_have_count(2)
    assert heard.complaints == []


def test_models_are_told_apart_by_what_differs_in_columns_that_are_chosen(
    page: Any, two_models: dict[str, str], heard: Any
) -> None:
    page.goto("/?view=models")
    cells = {name: page.locator(f"#models-table tr[data-id={two_models[name]}]") for name in ("plain", "sprung")}
    expect(cells["sprung"]).to_contain_text("Joint spring on elbow")
    expect(cells["plain"]).to_contain_text("none")
    expect(cells["plain"]).to_contain_text("identification")
    head = page.locator("#models-table thead [data-column=filters]")
    expect(head).to_have_count(0)
    page.locator("#models-table .columns-choice > summary").click()
    page.locator("#models-table [data-shows=filters]").check()
    expect(cells["plain"]).to_contain_text("decimation")
    page.locator("#models-table [data-shows=fit]").uncheck()
    page.reload()
    # This browser remembers it.
    expect(head).to_be_visible()
    expect(page.locator("#models-table thead [data-column=fit]")).to_have_count(0)
    assert heard.complaints == []


def test_the_torques_of_two_models_are_drawn_over_one_another(
    page: Any, two_models: dict[str, str], heard: Any
) -> None:
    page.goto(f"/?view=models&pair={two_models['plain']},{two_models['sprung']}")
    torque = page.locator("#overlay-torque")
    torque.locator("canvas").wait_for()
    expect(torque.locator(".u-series .u-label")).to_have_text(["time", "measured", "plain", "sprung"])
    page.locator("section[aria-label=Torques]").get_by_label("Joint").select_option("elbow")
    expect(page.locator("#overlay-residual .u-series .u-label")).to_have_text(
        ["time", "residual of plain", "residual of sprung"]
    )
    assert heard.complaints == []


def test_a_model_is_renamed_tagged_archived_and_brought_back(page: Any, two_models: dict[str, str]) -> None:
    page.goto("/?view=models")
    row = page.locator(f"#models-table tr[data-id={two_models['plain']}]")
    row.get_by_role("button", name="Change").click()
    page.locator("dialog input[name=tags]").fill("night shift, arm 3")
    page.locator("dialog input[name=name]").fill("plain again")
    page.get_by_role("button", name="Save").click()
    expect(row).to_contain_text("plain again")
    expect(row.locator(".chip")).to_have_text(["night shift", "arm 3"])
    row.get_by_role("button", name="Change").click()
    page.get_by_role("button", name="Archive", exact=True).click()
    expect(row).to_have_count(0)
    page.get_by_label("Show archived ones").check()
    expect(row).to_contain_text("archived")
    row.get_by_role("button", name="Change").click()
    page.locator("dialog input[name=name]").fill("plain")
    page.get_by_role("button", name="Save").click()
    row.get_by_role("button", name="Change").click()
    page.get_by_role("button", name="Bring back from the archive").click()
    expect(row).not_to_contain_text("archived")
    assert ask(page, f"/identifications/{two_models['plain']}")["tags"] == ["night shift", "arm 3"]


def test_a_job_has_its_log_and_a_model_is_deleted_for_good(page: Any, two_models: dict[str, str]) -> None:
    page.goto("/?view=jobs")
    page.get_by_role("button", name="Log of identification").first.click()
    log = page.locator("main ol li")
    expect(log.first).to_have_text("queued")
    expect(log.last).to_have_text("succeeded")
    made = ask(page, f"/identifications/{two_models['plain']}")
    asked = {name: made["request"][name] for name in ("measurement_ids", "validation_ids")}
    body = {"robot_id": made["robot_id"], "name": "for nothing", **asked}
    extra = page.request.post("/v1/identifications", data=body).json()["id"]
    page.goto(f"/?identification={extra}")
    page.locator("#error-table").wait_for()
    # The comparison that the page makes by itself goes with the model; a report was asked for, and so is this.
    page.wait_for_function(
        """async (id) => (await (await fetch(`/v1/comparisons?identification_id=${id}`)).json())
          .items.some((one) => one.status === 'succeeded')""",
        arg=extra,
    )
    page.get_by_role("button", name="Report", exact=True).click()
    expect(page.get_by_role("link", name="Open the report")).to_be_visible()
    page.goto("/?view=models")
    page.get_by_role("button", name="Change for nothing").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    page.get_by_role("button", name="Delete for good?").click()
    page.get_by_role("button", name="Delete it with 1 comparison, 1 report").click()
    expect(page.locator(f"#models-table tr[data-id={extra}]")).to_have_count(0)
    assert page.request.get(f"/v1/identifications/{extra}").status == 404


def test_a_report_is_found_again_and_jobs_lead_to_their_results(page: Any, two_models: dict[str, str]) -> None:
    plain = two_models["plain"]
    page.goto(f"/?identification={plain}")
    page.get_by_role("button", name="Report", exact=True).click()
    # Away before it is written: it is there afterwards, without being asked for again.
    page.get_by_text("Writing the report").wait_for()
    page.goto("/?view=models")
    page.goto(f"/?identification={plain}")
    opened = page.get_by_role("link", name="Open the report")
    content = opened.get_attribute("href")
    page.reload()
    expect(opened).to_have_attribute("href", content)
    assert len(ask(page, f"/reports?identification_id={plain}")["items"]) == 1

    # On a telephone no sentence of the report lies beside the screen, and the text in figures can be read.
    page.set_viewport_size({"width": 390, "height": 800})
    page.goto(content)
    assert page.locator("#summary .wordy td").count() > 0
    rights = "(cells) => Math.max(...cells.map((cell) => cell.getBoundingClientRect().right))"
    assert page.locator(".wordy td:visible, #summary caption").evaluate_all(rights) <= 390
    assert page.locator("#summary figure > svg").first.bounding_box()["width"] >= 700
    page.set_viewport_size({"width": 1440, "height": 900})

    page.request.post("/v1/diagnoses", data={"identification_id": plain})
    page.goto("/?view=jobs")
    rows = page.locator("#jobs-table tbody tr[data-id]")
    expect(rows.filter(has_text="diagnosis").locator(".mark.succeeded")).to_have_count(1)
    expect(rows.get_by_role("link", name="report", exact=True)).to_have_attribute("href", content)
    rows.get_by_role("link", name="diagnosis", exact=True).click()
    expect(page.get_by_role("tab", name="Missing")).to_have_attribute("aria-selected", "true")
    assert f"identification={plain}" in page.url
    page.go_back()
    rows.get_by_role("link", name="comparison", exact=True).first.click()
    expect(page.get_by_role("tab", name="Compare")).to_have_attribute("aria-selected", "true")


def test_a_robot_that_models_rest_on_is_not_deleted_and_the_page_says_what_to_do(
    page: Any, two_models: dict[str, str]
) -> None:
    page.goto("/?view=robots")
    page.get_by_role("button", name="Change two links").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    page.get_by_role("button", name="Delete for good?").click()
    expect(page.locator("dialog")).to_contain_text("archive this one")
    page.get_by_role("button", name="Close without saving").click()
    page.goto("/?view=recordings")
    expect(page.locator("#recordings-table tbody tr[data-id]")).to_have_count(2)


@pytest.mark.parametrize("view", ["models", "jobs", "robots", "recordings", "design"])
def test_no_list_is_wider_than_a_telephone(page: Any, two_models: dict[str, str], view: str) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    page.goto(f"/?view={view}")
    page.locator("main table tbody th").first.wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
