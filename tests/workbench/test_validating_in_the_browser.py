"""Choosing a method, validating a model and taking it along, in a real Chromium against a live service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.workbench_page import ask, identifier, open_tab, the_robot, upload

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow


def test_a_method_is_chosen_validated_and_exported(
    page: Any, recordings: tuple[Path, Path], heard: Any, tmp_path: Path
) -> None:
    the_robot(page)
    upload(page, recordings[0], "identification")
    upload(page, recordings[1], "validation")
    page.locator("details.methods > summary").click()
    expect(page.locator("#steps")).to_be_hidden()
    page.locator("#strategy").select_option("sequential")
    expect(page.locator("#steps")).to_be_visible()
    page.locator("#steps").select_option("wrist_then_shoulder")
    page.locator("#strategy").select_option("global")
    page.locator("#model").select_option("filtered")
    expect(page.locator("#model-hint")).to_contain_text("without accelerations")
    page.screenshot(path=tmp_path / "form.png", full_page=True)
    page.click("#run")

    open_tab(page, "Trust")
    page.locator("#validations-title").wait_for()
    request = ask(page, f"/identifications/{identifier(page)}")["request"]
    assert (request["model"], request["strategy"], request["prior"]) == ("filtered", "global", None)
    expect(page.locator("section[aria-label=Model]")).to_contain_text("filtered dynamic model")

    page.click("#validate-all")
    page.locator("#validate-all:enabled").wait_for(timeout=120_000)
    kept = ask(page, f"/validations?identification_id={identifier(page)}&limit=100")["items"]
    found = {one["request"]["kind"]: one["result"] for one in kept if one["status"] == "succeeded"}
    assert {"direct", "cross", "inertia_matrix", "simulation", "methods"} <= set(found)
    for kind, result in found.items():
        line = page.locator(f"ul.verdicts li[data-kind={kind}]")
        expect(line.locator(".chip")).to_have_class(f"chip verdict {result['verdict']}")
        expect(line).to_contain_text(result["reason"])
    rows = page.locator("#methods-table tbody tr")
    assert rows.count() == sum(one["held_out"] is not None for one in found["methods"]["methods"])
    first = found["methods"]["methods"][0]
    shown = rows.first.locator("data").nth(2).get_attribute("value")
    assert float(shown) == first["held_out"]["moving"]["relative_total"]
    page.screenshot(path=tmp_path / "validated.png", full_page=True)

    page.reload()
    expect(page.locator("ul.verdicts li[data-kind=cross] .chip")).to_have_class(
        f"chip verdict {found['cross']['verdict']}"
    )
    page.click("#exports > summary")
    with page.expect_download() as download:
        page.get_by_role("link", name="JSON", exact=True).click()
    assert b"parameters" in Path(download.value.path()).read_bytes()
    assert download.value.suggested_filename.endswith(".json")
    assert heard.complaints == []


def test_essential_parameters_are_found_on_demand(page: Any, recordings: tuple[Path, Path]) -> None:
    the_robot(page)
    upload(page, recordings[0], "identification")
    upload(page, recordings[1], "validation")
    page.click("#run")
    open_tab(page, "Parameters")
    page.get_by_role("button", name="Essential parameters").click()
    found = page.locator("#essential")
    expect(found).to_contain_text("essential")
    answer = ask(page, f"/identifications/{identifier(page)}/essential")
    expect(found.locator("table").last.locator("tbody tr:not(.group)")).to_have_count(len(answer["essential"]))


def test_a_model_that_no_links_have_says_so_and_offers_the_nearest(page: Any, recordings: tuple[Path, Path]) -> None:
    the_robot(page)
    upload(page, recordings[0], "identification")
    page.click("#run")
    page.locator("#error-table").wait_for()
    # What the service says is its own test; here it is what the page makes of it.
    page.route(
        "**/export?format=urdf",
        lambda route: route.fulfill(
            status=422,
            content_type="application/problem+json",
            body='{"title": "Not physically feasible", "status": 422, "detail": "no bodies: the link of elbow"}',
        ),
    )
    page.click("#exports > summary")
    page.get_by_role("link", name="URDF", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("the link of elbow")
    with page.expect_download() as download:
        page.click("#export-nearest")
    assert b"<robot" in Path(download.value.path()).read_bytes()
    with page.expect_download() as download:
        page.get_by_role("link", name="C code", exact=True).click()
    assert download.value.suggested_filename.startswith("dynident_")
