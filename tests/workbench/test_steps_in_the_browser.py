"""What the workbench says of a step of the ladder, in a real Chromium, against a live service."""

from __future__ import annotations

import json
from typing import Any

import pytest

from dynident_service.identifications.adapters import add_ladder_tables
from dynident_service.identifications.wire_types import LadderStep, Lineage

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

SHOW = """async ([{ items: rungs, tables, last_step: lastStep }, shown]) => {
  const { ladderSection } = await import('/workbench/js/ladder.js');
  const model = {
    lastStep, ladder: Object.fromEntries(tables.map((one) => [one.name, one])),
    id: shown, joints: ['shoulder', 'elbow'], joint: 'elbow', rungs, measurement: null, robot: { id: 'none' },
    identification: { id: shown, parent_id: rungs.at(-2).id, robot_id: 'none' },
    effects: { items: [], byId: new Map() }, contains: () => false, addEventListener: () => {},
    floorOf: (joint) => (joint === 'elbow' ? 0.2 : null),
  };
  document.getElementById('main').replaceChildren(ladderSection(model, new AbortController().signal));
}"""


def rung(name: str, held_out: list[float], total: float, **more: Any) -> dict[str, Any]:
    rms = [10 * one for one in held_out]
    errors = {"relative": held_out, "relative_total": total, "rms": rms, "moving": None}
    made: dict[str, Any] = {"id": name, "added": [], "removed": [], "effects": [], "n_parameters": 10, "name": None}
    made |= {"parent_id": None, "status": "succeeded", "residual": errors, "validation": errors}
    return {**made, **more}


def lineage(*rungs: dict[str, Any]) -> dict[str, Any]:
    """The answer of the service about such a ladder."""
    steps = [LadderStep.model_validate(one) for one in rungs]
    return add_ladder_tables(Lineage(items=steps), ["shoulder", "elbow"]).model_dump(mode="json")


def test_a_joint_that_got_worse_is_warned_of_though_the_whole_error_fell(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    page.evaluate(SHOW, [lineage(rung("a", [0.20, 0.05], 0.16), rung("b", [0.10, 0.07], 0.09, best=True)), "b"])
    expect(page.locator("#step")).to_contain_class("warning")
    expect(page.locator("#step")).to_contain_text("Worse than before on elbow")
    expect(page.locator("#keep-best")).to_have_count(0)
    # One click to the curves of the model and of the one before it.
    assert "pair=a%2Cb" in page.locator("#compare-parent").get_attribute("href")

    page.evaluate(SHOW, [lineage(rung("a", [0.20, 0.05], 0.16), rung("b", [0.10, 0.05], 0.09, best=True)), "b"])
    expect(page.locator("#step")).to_contain_class("good")


def told(panel: Any) -> str:
    """What who does not see a figure hears of it, with plain spaces."""
    return " ".join(panel.get_by_role("img").get_attribute("aria-label").split())


def test_a_waterfall_tells_of_every_joint_what_each_model_took_and_how_far_the_noise_is(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    page.evaluate(SHOW, [lineage(rung("a", [0.20, 0.05], 0.16), rung("b", [0.10, 0.07], 0.09, best=True)), "b"])
    shoulder, elbow = (page.locator(f"#waterfall .panel[data-joint={joint}]") for joint in ("shoulder", "elbow"))
    assert told(shoulder) == "shoulder: 20.0 %, then 10.0 %"
    expect(shoulder.locator("rect.falls")).to_have_count(1)
    expect(shoulder.locator("line.floor")).to_have_count(0)
    # A floor of 0.2 N m beside an error of 0.7 N m, which is 7 %.
    assert told(elbow) == "elbow: 5.00 %, then 7.00 %; the noise floor is 2.00 %"
    expect(elbow.locator("rect.rises")).to_have_count(1)
    tops = [float(elbow.locator(one).get_attribute("y")) for one in ("rect.first", "rect.rises")]
    floor = float(elbow.locator("line.floor").get_attribute("y1"))
    bottom = tops[0] + float(elbow.locator("rect.first").get_attribute("height"))
    assert tops[1] < tops[0] < floor < bottom
    assert (bottom - floor) / (bottom - tops[0]) == pytest.approx(0.02 / 0.05, abs=0.01)


def test_the_best_model_of_a_ladder_is_gone_back_to_by_the_keyboard(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    page.evaluate(
        SHOW, [lineage(rung("a", [0.2, 0.05], 0.16, best=True), rung("b", [0.3, 0.05], 0.21, rises=True)), "b"]
    )
    expect(page.locator("#step")).to_contain_class("warning")
    page.route("**/v1/identifications/a", lambda route: route.fulfill(status=404, body=json.dumps({"title": "none"})))
    page.locator("#keep-best").focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/?identification=a&tab=missing&joint=elbow")


ASKED_AHEAD = """async () => {
  const { ahead, get } = await import('/workbench/js/api.js');
  const asked = [];
  const answered = window.fetch;
  window.fetch = (path, ...more) => { asked.push(path); return answered(path, ...more); };
  ahead('/effects');
  const first = await get('/effects');
  const onceAsked = asked.length;
  const second = await get('/effects');
  ahead('/robots/none');
  const complaint = await get('/robots/none').catch((error) => error.status);
  window.fetch = answered;
  return { onceAsked, asked, same: JSON.stringify(first) === JSON.stringify(second), complaint };
}"""


def test_an_answer_asked_for_ahead_is_taken_once_and_an_error_is_still_told(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    found = page.evaluate(ASKED_AHEAD)
    assert found["onceAsked"] == 1
    # Who asks again sees what is there now; and what failed ahead is asked for anew.
    assert found["asked"].count("/v1/effects") == 2
    assert found["asked"].count("/v1/robots/none") == 2
    assert found["same"]
    assert found["complaint"] == 404


DRIFT = """async (distance) => {
  const { driftFigure } = await import('/workbench/js/ladder_figures.js');
  const drawn = driftFigure({ joint_names: distance[0].map((_, k) => `joint ${k}`), after: [0.1], distance });
  return drawn.querySelectorAll('line.grid').length;
}"""


@pytest.mark.parametrize("distance", [[4e-3, 5e-3, 6e-3, 7.5e-3], [6e-3, 7e-3, 8e-3], [3e-3], [1e-4, 0.5]])
def test_an_axis_of_drifts_has_values_however_near_they_are_to_each_other(page: Any, distance: list[float]) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    assert 1 <= page.evaluate(DRIFT, [distance]) <= 12
