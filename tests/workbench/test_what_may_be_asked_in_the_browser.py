"""A field that the contract gains is in the page's forms at once, and what is filled in there is asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.heavy_arm import heavy_arm
from support.workbench_page import the_robot, upload

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

SETTLE = {"type": "number", "default": 0.0, "description": "Rest at the end, in s", "x-unit": "s"}
SIDES = {
    "enum": ["left", "right"],
    "default": "left",
    "description": "Where it begins",
    "x-choices": [
        {"name": "left", "label": "left", "words": "From the left."},
        {"name": "right", "label": "right", "words": "From the right."},
    ],
}
TEMPERED = {"properties": {"name": {"const": "tempered"}, "power": {"type": "number", "default": 1.0}}}


def with_more(page: Any) -> None:
    """Answer the page with a contract that has more fields than the service's."""
    contract = page.request.get("/openapi.json").json()
    schemas = contract["components"]["schemas"]
    schemas["DesignRequest"]["properties"] |= {"settle": SETTLE, "beginning": SIDES}
    schemas["IdentificationRequest"]["properties"]["patience"] = {"type": "integer", "default": 3}
    estimator = schemas["IdentificationRequest"]["properties"]["estimator"]
    estimator["x-choices"].append({"name": "tempered", "label": "tempered", "words": "With a power."})
    estimator["anyOf"] = [{"enum": estimator.pop("enum")}, {"$ref": "#/components/schemas/Tempered"}]
    schemas["Tempered"] = TEMPERED
    page.route("**/openapi.json", lambda route: route.fulfill(json=contract))


def asked(page: Any, path: str, button: str) -> dict[str, Any]:
    """The body that a click posts; the service never sees it."""
    page.route(f"**/v1/{path}", lambda route: route.fulfill(status=422, json={"title": "seen", "detail": "seen"}))
    with page.expect_request(f"**/v1/{path}") as posted:
        page.click(button)
    page.get_by_text("seen").first.wait_for()
    return dict(json.loads(posted.value.post_data))


def test_a_new_option_of_a_design_is_a_field_of_its_form_and_goes_out_once_it_is_changed(page: Any) -> None:
    robot = heavy_arm(page)
    with_more(page)
    page.goto(f"/?view=design&robot={robot}")
    page.locator("#design-more summary").click()
    expect(page.get_by_label("Settle (s)")).to_have_value("0")
    body = asked(page, "designs", "#run-design")
    # What is as it always is goes without saying, but for the time that the page gives the search.
    assert (body["trajectory"], body["time_budget"]) == ({}, 15)
    assert not {"settle", "beginning", "seed", "model"} & set(body)
    page.get_by_label("Settle (s)").fill("0.5")
    page.get_by_label("Where it begins").select_option("right")
    expect(page.get_by_text("From the right.")).to_be_visible()
    page.get_by_label("Paces").fill("1, 0.5")
    body = asked(page, "designs", "#run-design")
    assert (body["settle"], body["beginning"], body["trajectory"]) == (0.5, "right", {"paces": [1, 0.5]})


def test_an_estimator_brings_the_fields_of_its_options_with_it(page: Any, recordings: tuple[Path, Path]) -> None:
    with_more(page)
    the_robot(page)
    upload(page, recordings[0], "identification")
    page.locator("#identify").wait_for()
    page.get_by_text("How to identify").click()
    expect(page.locator("#estimator-options input")).to_have_count(0)
    page.select_option("#estimator", "tempered")
    body = asked(page, "identifications", "#run")
    assert body["estimator"] == "tempered"
    page.get_by_label("Power").fill("2.5")
    page.get_by_label("Patience").fill("4")
    assert "known" not in body
    page.fill("#identify-known", "Ia2 = 0.29, Fc1=3")
    body = asked(page, "identifications", "#run")
    assert body["known"] == {"Ia2": 0.29, "Fc1": 3}
    assert (body["estimator"], body["patience"]) == ({"name": "tempered", "power": 2.5}, 4)
    # The effects that are marked are those of the contract for recordings of a real robot, and of the README.
    marked = [one["effect"] for one in body["effects"]]
    assert sorted(marked) == sorted(["rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"])
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert "--effects default,offset" in readme
