"""The tabs of a model and their addresses, in a real Chromium against a live service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.workbench_page import ask, identifier, open_tab, the_robot, upload

import dynident as dy
from dynident.robot import library_table
from dynident_client import Client

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="this test needs axe-playwright-python")
expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

ELSEWHERE = ("validations", "series", "measurements?")
"""What only tabs other than the verdict ask for."""


@pytest.fixture
def model(page: Any, recordings: tuple[Path, Path]) -> str:
    """The page at a model; gives its id."""
    known = ask(page, "/identifications")["items"]
    if known:
        page.goto(f"/?identification={known[-1]['id']}")
    else:
        the_robot(page)
        upload(page, recordings[0], "identification")
        upload(page, recordings[1], "validation")
        page.click("#run")
    page.locator("#error-table").wait_for()
    return identifier(page)


def chosen(page: Any, name: str) -> None:
    """Exactly this tab is chosen, and its panel alone is shown."""
    tab = page.get_by_role("tab", selected=True)
    expect(tab).to_have_text(name)
    expect(page.locator("[role=tabpanel]:visible")).to_have_attribute("aria-labelledby", tab.get_attribute("id"))


def test_a_tab_is_in_the_address_and_back_and_reload_keep_to_it(page: Any, model: str, heard: Any) -> None:
    chosen(page, "Verdict")
    open_tab(page, "Data")
    page.wait_for_url("**tab=data*")
    expect(page.locator("#data-table tbody tr")).to_have_count(2)
    open_tab(page, "Parameters")
    page.go_back()
    chosen(page, "Data")
    page.reload()
    chosen(page, "Data")
    page.go_back()
    chosen(page, "Verdict")
    assert heard.complaints == []


def test_tabs_are_walked_along_with_the_arrow_keys(page: Any, model: str) -> None:
    page.get_by_role("tab", name="Verdict").focus()
    for key, name in (("ArrowRight", "Compare"), ("End", "Data"), ("ArrowRight", "Verdict"), ("ArrowLeft", "Data")):
        page.keyboard.press(key)
        chosen(page, name)
        expect(page.get_by_role("tab", name=name)).to_be_focused()
    expect(page.locator("[role=tab][tabindex='0']")).to_have_count(1)


def test_only_what_the_open_tab_needs_is_asked_for(page: Any, model: str) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.reload()
    page.locator("#fitness-summary").wait_for()
    assert not [one for one in asked if "/v1/" in one and one.split("/v1/")[1].startswith(ELSEWHERE)]
    assert not [one for one in asked if "/series" in one or "/residual_map" in one]
    open_tab(page, "Compare")
    page.locator("#torque-chart canvas").wait_for()
    assert [one for one in asked if "/series" in one]


def test_the_comparison_is_made_once_and_before_its_tab_is_opened(page: Any, model: str) -> None:
    # A page that is open asks for one, too.
    page.wait_for_load_state("networkidle")
    page.goto("about:blank")
    while there := ask(page, f"/comparisons?identification_id={model}")["items"]:
        for one in there:
            page.request.delete(f"/v1/comparisons/{one['id']}")
    made: list[str] = []
    page.on("request", lambda one: made.append(one.url) if one.method == "POST" and "/comparisons" in one.url else None)
    page.goto(f"/?identification={model}")
    page.wait_for_function(
        """async (id) => (await (await fetch(`/v1/comparisons?identification_id=${id}`)).json())
          .items.some((one) => one.status === 'succeeded')""",
        arg=model,
    )
    open_tab(page, "Compare")
    page.locator("#torque-chart canvas").wait_for()
    assert len(made) == 1
    # Opened before it was begun, it is begun by the tab, and not twice.
    page.request.delete(f"/v1/comparisons/{ask(page, f'/comparisons?identification_id={model}')['items'][0]['id']}")
    made.clear()
    page.goto(f"/?identification={model}&tab=compare")
    page.locator("#torque-chart canvas").wait_for()
    page.wait_for_load_state("networkidle")
    assert len(made) == 1


def test_an_address_of_a_stretch_without_a_tab_still_shows_the_stretch(page: Any, model: str) -> None:
    page.goto(f"/?identification={model}&joint=elbow&from=2&to=4")
    chosen(page, "Compare")
    expect(page.locator("#zoom-state")).to_contain_text("elbow, 2.000 s to 4.000 s")


def test_the_line_under_the_charts_names_the_stretch_that_it_counts_while_the_next_is_read(
    page: Any, model: str
) -> None:
    page.goto(f"/?identification={model}&tab=compare&joint=elbow&from=2&to=4")
    said = page.locator("#zoom-state")
    expect(said).to_contain_text("elbow, 2.000 s to 4.000 s")
    held: list[Any] = []
    page.route("**/series?*", lambda route: held.append(route))
    page.locator(".charts").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_url("**from=2.5*")
    # What is known of the other joint is still of the stretch before.
    page.keyboard.press("ArrowUp")
    expect(said).to_contain_text("shoulder, 2.000 s to 4.000 s")
    for one in held:
        one.continue_()
    page.unroute("**/series?*")
    expect(said).to_contain_text("shoulder, 2.500 s to 4.500 s")


def test_parameters_stand_by_effect_with_their_links(page: Any, model: str) -> None:
    open_tab(page, "Parameters")
    parameters = ask(page, f"/identifications/{model}")["result"]["parameters"]
    rows = page.locator("#parameters table").first.locator("tbody tr")
    expect(rows).to_have_count(len(parameters) + len({one["effect"] for one in parameters}))
    first = rows.nth(1)
    assert rows.first.get_attribute("class") == "group"
    expect(first).to_contain_text(parameters[0]["name"])
    expect(first.locator("td").first).to_have_text(parameters[0]["link"])


def test_the_verdict_is_the_services_and_leads_to_the_next_click(page: Any, model: str) -> None:
    found = ask(page, f"/identifications/{model}/verdict")
    expect(page.locator("#fitness-summary")).to_have_text(found["summary"])
    for use in found["uses"]:
        line = page.locator(f"#uses li[data-use={use['use']}]")
        expect(line).to_contain_text(use["reason"])
        expect(line).to_contain_text(use["next_step"])
        words = {"yes": "✓ fit", "limited": "! within limits", "no": "✕ not fit", "not_judged": "? not judged"}
        expect(line.locator(".chip")).to_have_text(words[use["state"]])
    if found["drift"] is not None:
        expect(page.locator("#drift tbody tr")).to_have_count(len(found["drift"]["joint_names"]))
        expect(page.locator("#drift-figure polyline")).to_have_count(len(found["drift"]["joint_names"]))
    page.click("#next-click")
    chosen(page, "Data" if found["stop"] else "Missing")
    if not found["stop"]:
        # One click: the diagnosis that it is about begins by itself.
        expect(page.locator("#verdict")).to_be_visible()


def test_another_estimator_is_tried_with_all_that_the_model_was_made_of(page: Any, model: str) -> None:
    def with_bodies_that_cannot_exist(route: Any) -> None:
        answer = route.fetch()
        found = answer.json()
        for use in found["uses"]:
            use["next_action"] = "identify_feasible"
        route.fulfill(response=answer, json=found)

    page.route("**/verdict", with_bodies_that_cannot_exist)
    page.reload()
    page.locator("#uses li[data-use=simulation]").get_by_role("button", name="Do it here").click()
    page.wait_for_url(lambda address: model not in address)
    page.locator("#error-table").wait_for()
    before, after = (ask(page, f"/identifications/{one}")["request"] for one in (model, identifier(page)))
    assert after.pop("estimator") == "feasible" != before.pop("estimator")
    assert after == before
    # The new model's verdict may be on its way.
    page.unroute_all(behavior="ignoreErrors")


def test_a_diagnosis_on_its_way_is_found_again_after_a_reload(page: Any, model: str) -> None:
    open_tab(page, "Missing")
    with page.expect_response(lambda answer: answer.url.endswith("/v1/diagnoses") and answer.request.method == "POST"):
        page.click("#diagnose")
    page.reload()
    chosen(page, "Missing")
    expect(page.locator("#verdict")).to_be_visible()
    open_tab(page, "Verdict")
    expect(page.locator("#error-table")).to_contain_text("noise floor")


def test_a_limb_leaves_its_joints_alone_in_tables_and_figures(
    page: Any, service: str, heard: Any, tmp_path: Path
) -> None:
    client, path = Client(service), tmp_path / "both arms.csv"
    known = dy.design(dy.load_robot("dual_arm"), kind="random", duration=8.0, sampling_rate=100.0)
    known.simulate().to_frame().to_csv(path, index=False)
    robot = client.robots.create("both arms", modified_dh=library_table("dual_arm"))
    model = client.identifications.create(robot, [client.measurements.upload(robot, path)]).wait()
    limbs = ask(page, f"/robots/{robot.id}")["limbs"]
    arm = next(limb for limb in limbs if limb["parent"] is not None and len(limb["joints"]) > 1)
    page.goto(f"/?identification={model.id}&tab=verdict")
    rows = page.locator("#error-table tbody tr:visible th")
    expect(rows).to_have_count(known.robot.n + 1)
    button = page.locator("nav.limbs").get_by_role("button", name=arm["title"], exact=True)
    button.focus()
    page.keyboard.press("Enter")
    expect(button).to_have_attribute("aria-pressed", "true")
    expect(rows).to_have_text([*arm["joints"], "all joints"])
    open_tab(page, "Compare")
    names = page.locator(".joint-row:visible button")
    expect(names).to_have_text(arm["joints"])
    # The chosen joint is one of them, and the address brings all of it back.
    page.reload()
    expect(names).to_have_text(arm["joints"])
    expect(page.locator(".joint-row:visible button[aria-pressed=true]")).to_have_count(1)
    assert axe.Axe().run(page, context="nav.limbs").response["violations"] == []
    page.locator("nav.limbs button").first.click()
    expect(names).to_have_count(known.robot.n)
    # Where columns are matched to joints, these have the names of the description.
    page.goto(f"/?view=new&robot={robot.id}")
    expect(page.get_by_text("guesses the columns")).to_contain_text(f"Joints: {', '.join(known.robot.joint_names)}.")
    assert heard.complaints == []


HIDE = """async () => {
  const { limbTree } = await import('/workbench/js/limbs.js');
  const limbs = [['', 'b'], [''], ['b']].map((joints, k) => ({ title: `limb ${k}`, joints, parent: k ? 0 : null }));
  limbTree({ limbs }, () => {}, new AbortController().signal).querySelectorAll('button')[2].click();
  return document.adoptedStyleSheets.at(-1).cssRules.length;
}"""


def test_a_joint_without_a_name_is_hidden_as_well(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    assert page.evaluate(HIDE) == 1
