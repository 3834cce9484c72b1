"""The workbench in a real Chromium, against a live service."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import NOISE, URDF
from support.workbench_page import CONTRASTS, STORED, ask, expect, identifier, open_tab, the_robot, upload, value_in

pytestmark = pytest.mark.slow


@pytest.fixture
def model(page: Any, recordings: tuple[Path, Path]) -> str:
    """The page at a model that lacks the spring; gives its id."""
    known = ask(page, "/identifications")["items"]
    first = next((one for one in known if one["status"] == "succeeded" and one["parent_id"] is None), None)
    if first is not None:
        page.goto(f"/?identification={first['id']}")
    else:
        the_robot(page)
        upload(page, recordings[0], "identification")
        upload(page, recordings[1], "validation")
        page.fill("#model-name", "first try")
        page.click("#run")
    page.locator("#error-table").wait_for()
    return identifier(page)


def test_the_whole_story_can_be_done_in_the_browser(
    first_page: Any, recordings: tuple[Path, Path], heard: Any, tmp_path: Path
) -> None:
    page = first_page
    page.goto("/")
    expect(page.get_by_role("heading", name="Begin with a robot")).to_be_visible()
    page.screenshot(path=tmp_path / "1_begin.png", full_page=True)
    the_robot(page)
    upload(page, recordings[0], "identification")
    upload(page, recordings[1], "validation")
    page.screenshot(path=tmp_path / "2_ready.png", full_page=True)
    page.fill("#model-name", "first try")
    page.click("#run")

    page.locator("#error-table").wait_for()
    before = identifier(page)
    result = ask(page, f"/identifications/{before}")["result"]
    assert value_in(page, "#error-table", "elbow", 0) == result["residual"]["moving"]["rms"][1]
    assert value_in(page, "#error-table", "elbow", 2) == result["residual"]["relative"][1]
    validation = result["validation"]
    assert value_in(page, "#error-table", "all joints", 2) == validation["moving"]["relative_total"]
    assert value_in(page, "#error-table", "all joints", 3) == validation["relative_total"]
    for warning in result["warnings"]:
        expect(page.locator("#warnings")).to_contain_text(warning)
    open_tab(page, "Compare")
    # Measured, predicted and residual are drawn: not one colour only.
    page.locator("#torque-chart canvas").wait_for()
    expect(page.locator("#zoom-state")).to_contain_text("samples")
    assert page.evaluate(COLOURS_IN_CHART) > 20

    open_tab(page, "Missing")
    page.click("#diagnose")
    page.locator("#verdict").wait_for()
    assert page.locator("#verdict").get_attribute("data-verdict") == "missing_effect"
    card = page.locator("#cards article").first
    expect(card.get_by_role("heading")).to_contain_text("(joint spring?) on elbow")
    expect(card.locator(".chart canvas")).to_be_visible()
    ranked = ask(page, f"/diagnoses?identification_id={before}")["items"][0]["result"]["candidates"]
    assert page.locator("#cards article").count() == sum(one["significant"] for one in ranked)
    shown = [float(one.get_attribute("value")) for one in card.locator(".before-after data").all()]
    assert shown == [ranked[0]["error_before"], ranked[0]["error_after"]]
    expect(card.get_by_role("button", name="Add: Torque in proportion to the position")).to_be_enabled()
    card.screenshot(path=tmp_path / "3_card.png")
    first = page.locator("#candidates tbody tr").first
    assert first.get_attribute("data-effect") == "joint_spring"
    expect(first).to_contain_text("elbow")
    first.get_by_role("button", name="Torque in proportion to the position (joint spring?)", exact=True).click()
    evidence = page.locator("tr.evidence").first
    expect(evidence.locator("canvas")).to_be_visible()
    expect(evidence).to_contain_text("Residual of elbow over position, and the fitted effect")
    evidence.screenshot(path=tmp_path / "3_evidence.png")
    floor = ask(page, f"/diagnoses?identification_id={before}")["items"][0]["result"]["noise_floor"]
    assert value_in(page, "#error-table", "elbow", 6) == floor[1]
    # What is open stands there as a question, with the effects that it is about.
    asked = page.locator("#open-questions li")
    doubts = ask(page, f"/diagnoses?identification_id={before}")["items"][0]["result"]["doubts"]
    titles = {one["id"]: one["title"] for one in ask(page, "/effects")["items"]}
    expect(asked).to_have_count(len(doubts))
    for line, doubt in zip(asked.all(), doubts, strict=True):
        for choice in (doubt["suspect"], *doubt["rivals"]):
            expect(line).to_contain_text(titles[choice["effect"]])
    page.click("#next-experiment")
    expect(page.get_by_text("Next experiment.")).to_be_visible(timeout=60_000)
    page.screenshot(path=tmp_path / "3_diagnosed.png", full_page=True)

    # A bad stretch says where the arm was, how fast, under which load, and what would explain it.
    open_tab(page, "Compare")
    page.get_by_role("group", name="Joint", exact=True).get_by_role("button", name="elbow").click()
    page.locator("#worst button").first.click()
    expect(page.locator("#pose thead")).to_contain_text("positionspeedload of the rigid bodymeasuredresidual")
    expect(page.locator("#explained tbody tr").first).to_contain_text("(joint spring?)elbow")
    # And the residual is a map over any two signals.
    with page.expect_response(lambda answer: "/residual_map" in answer.url and "x=load_shoulder" in answer.url) as read:
        page.get_by_label("Across", exact=True).select_option("load_shoulder")
    assert "y=dq_elbow" in read.value.url
    expect(page.locator("svg.heat")).to_contain_text("load torque of shoulder (N m)")
    open_tab(page, "Missing")

    page.click("#add-recommended")
    page.locator("#ladder-table").wait_for()
    after = identifier(page)
    assert after != before
    rungs = ask(page, f"/identifications/{after}/lineage")["items"]
    shown = [[value_in(page, "#ladder-table", str(rung + 1), column) for column in (0, 1)] for rung in range(2)]
    assert shown == [[one[kind]["moving"]["relative_total"] for kind in ("residual", "validation")] for one in rungs]
    assert shown[1][1] < 0.2 * shown[0][1]
    assert value_in(page, "#ladder-joints", "elbow", 1) < 0.2 * value_in(page, "#ladder-joints", "elbow", 0)
    expect(page.locator("#step")).to_contain_text("Joint spring on elbow")
    open_tab(page, "Verdict")
    rms = value_in(page, "#error-table", "elbow", 3)
    assert rms < 2 * NOISE
    open_tab(page, "Compare")
    page.locator(".profiles canvas").nth(2).wait_for()
    page.screenshot(path=tmp_path / "4_ladder.png", full_page=True)

    page.get_by_role("button", name="Report", exact=True).click()
    opened = page.get_by_role("link", name="Open the report")
    assert "<svg" in page.request.get(opened.get_attribute("href")).text()
    page.get_by_role("button", name="Report as PDF").click()
    expect(page.get_by_text("one PDF")).to_be_visible()
    assert page.request.get(opened.get_attribute("href")).body().startswith(b"%PDF")
    assert heard.complaints == []
    assert heard.hosts == {page.url.split("/")[2]}


def test_spectra_and_memory_of_the_residual_follow_the_joint(page: Any, model: str, tmp_path: Path) -> None:
    open_tab(page, "Compare")
    spectra = page.locator("#spectra")
    expect(spectra.locator("canvas")).to_have_count(3)
    page.locator(".choices").get_by_role("button", name="shoulder").first.click()
    expect(spectra).to_contain_text("Autocorrelation of the residual of shoulder")
    expect(spectra.locator("canvas")).to_have_count(3)
    expect(spectra).to_contain_text("per turn")
    expect(page.locator("#comparison-notes")).to_contain_text("noise floor")
    page.locator("section", has=page.locator("#spectra-title")).screenshot(path=tmp_path / "spectra.png")


def test_what_was_added_is_removed_again_and_two_ladders_stand_beside_each_other(
    page: Any, model: str, heard: Any, tmp_path: Path
) -> None:
    made = {}
    for joint in ("elbow", "shoulder"):
        body = {"effects": [{"effect": "joint_spring", "joints": [joint]}], "name": f"spring on {joint}"}
        made[joint] = page.request.post(f"/v1/identifications/{model}/extend", data=body).json()["id"]
        page.wait_for_function(
            "async (id) => (await (await fetch(`/v1/identifications/${id}`)).json()).status === 'succeeded'",
            arg=made[joint],
        )
    page.goto(f"/?identification={made['shoulder']}")
    expect(page.locator("#warnings")).to_contain_text("Joint spring")
    open_tab(page, "Missing")
    page.locator("#ladder-table").get_by_role("button", name="Remove").click()
    expect(page.locator("#step")).to_contain_text("Removed Joint spring on shoulder")
    back = ask(page, f"/identifications/{identifier(page)}")
    assert back["parent_id"] == made["shoulder"]
    assert value_in(page, "#ladder-table", "3", 1) == back["result"]["validation"]["moving"]["relative_total"]

    # The ladder that stands there at first answers late: what the user chose since must stay.
    late: list[Any] = []
    page.route("**/lineage?*", lambda route: route.continue_() if late else late.append(route))
    page.locator("#compare-ladders > summary").click()
    page.select_option("#other-ladder", made["elbow"])
    table = page.locator("#ladder-differences")
    expect(table).to_contain_text("Joint spring on elbow")
    late[0].continue_()
    page.wait_for_timeout(500)
    expect(table).to_contain_text("Joint spring on elbow")
    found = ask(page, f"/identifications/{identifier(page)}/lineage?against={made['elbow']}")
    assert value_in(page, "#ladder-differences", "2", 2) == found["differences"][1]["validation_moving_total"]
    expect(page.locator("#two-ladders svg polyline")).to_have_count(2)
    page.locator("section", has=page.locator("#ladder-title")).screenshot(path=tmp_path / "two_ladders.png")
    assert heard.complaints == []


def test_what_is_shown_is_in_the_address(page: Any, model: str) -> None:
    page.locator("#error-table").get_by_role("button", name="shoulder").click()
    assert "joint=shoulder" in page.url
    open_tab(page, "Compare")
    expect(page.locator("#zoom-state")).to_contain_text("shoulder")
    page.reload()
    expect(page.locator("#zoom-state")).to_contain_text("shoulder")
    page.get_by_role("link", name="New model").click()
    page.locator("#recordings").wait_for()
    page.go_back()
    page.locator("#zoom-state").wait_for()
    assert identifier(page) == model
    assert "joint=shoulder" in page.url


def test_a_zoom_fetches_every_sample_of_the_stretch(page: Any, model: str) -> None:
    open_tab(page, "Compare")
    expect(page.locator("#zoom-state")).to_contain_text("samples")
    # The chosen joint is drawn before the others, which ask for their series, too.
    page.wait_for_load_state("networkidle")
    chart = page.locator("#torque-chart .u-over")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/series" in request.url else None)
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 80, steps=5)
    with page.expect_response(lambda response: "/series" in response.url and "from=" in response.url) as answered:
        page.mouse.up()
    series = answered.value.json()
    assert len(asked) == 2, "one a joint"
    assert len(series["t"]) == series["n_samples"]
    expect(page.locator("#zoom-state")).to_contain_text(f"{series['n_samples']} samples")
    page.locator(".charts").focus()
    page.keyboard.press("Escape")
    whole = ask(page, f"/comparisons?identification_id={model}")["items"][0]["result"]["n_samples"]
    expect(page.locator("#zoom-state")).to_contain_text(f"{whole} samples")
    page.locator("#worst button").first.click()
    expect(page.locator("#zoom-state")).not_to_contain_text(f"{whole} samples")


def test_a_figure_stays_where_it_is_while_those_of_other_joints_come(page: Any, model: str) -> None:
    held: list[Any] = []
    first: list[str] = []

    def one_by_one(route: Any) -> None:
        if first:
            held.append(route)
            return
        first.append(route.request.url)
        route.continue_()

    page.route("**/series?*", one_by_one)
    page.goto(f"/?identification={model}&tab=compare")
    chart = page.locator("#torque-chart .u-over")
    chart.wait_for()
    place = "one => one.getBoundingClientRect().top - one.closest('.charts').getBoundingClientRect().top"
    before = chart.evaluate(place)
    assert "joint=elbow" in first[0], "which stands beneath the shoulder"
    page.unroute("**/series?*")  # Which lets go what is held.
    expect(page.locator(".joint-row .u-over")).to_have_count(3)
    assert chart.evaluate(place) == before


def test_the_arm_of_a_comparison_follows_the_cursor_too(page: Any, heard: Any, model: str) -> None:
    page.goto(f"/?identification={model}&tab=compare")
    page.locator(".joint-row .u-over").first.wait_for()
    page.click(".arm-beside > summary")
    page.locator("canvas.arm").wait_for()
    before = page.locator("canvas.arm").get_attribute("data-origins")
    page.locator(".joint-row .u-over").first.hover()
    expect(page.locator("canvas.arm")).not_to_have_attribute("data-origins", before)
    assert heard.complaints == []


def test_an_effect_by_hand_that_does_not_help_is_added_with_a_warning(page: Any, model: str) -> None:
    open_tab(page, "Missing")
    page.locator("#by-hand > summary").click()
    page.select_option("#effect-by-hand", "torque_ripple")
    page.locator("#by-hand input[value=shoulder]").check()
    page.locator("#by-hand input[value=elbow]").uncheck()
    page.get_by_role("button", name="Add to the model").click()
    # No grid holds the period of a ripple: the field that is wanted says so.
    expect(page.locator("#by-hand .field .complaint")).to_contain_text("waves per turn")
    page.fill("#by-hand input[name=k]", "7")
    page.get_by_role("button", name="Add to the model").click()
    page.locator("#ladder-table").wait_for()
    added = ask(page, f"/identifications/{identifier(page)}")
    assert added["parent_id"] == model
    assert [(one["effect"], one["joints"]) for one in added["added"]] == [("torque_ripple", ["shoulder"])]
    first, last = [one["validation"] for one in ask(page, f"/identifications/{identifier(page)}/lineage")["items"]]
    worse = any(to > 1.005 * was for was, to in zip(first["relative"], last["relative"], strict=True))
    good = last["relative_total"] < first["relative_total"] and not worse
    expect(page.locator("#step")).to_contain_class("good" if good else "warning")


def test_a_mistake_is_explained_beside_the_field_that_caused_it(
    page: Any, recordings: tuple[Path, Path], tmp_path: Path, heard: Any
) -> None:
    the_robot(page)
    page.set_input_files("#recordings", recordings[0])
    form = page.locator("form.card").last
    form.locator("input[name=windows]").fill("20 to 10")
    form.get_by_role("button", name="Confirm and store").click()
    windows = page.locator("[data-pointer='/metadata/windows']")
    expect(windows.locator(".complaint")).to_contain_text("the end must be later than the start")
    form.locator("input[name=windows]").fill("")
    form.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(STORED)).to_have_count(1)

    broken = tmp_path / "broken.csv"
    broken.write_text("t,q_shoulder,q_elbow\n0,0,0\n0.01,0,0\n")
    page.set_input_files("#recordings", broken)
    page.locator("form.card").last.get_by_role("button", name="Confirm and store").click()
    box = page.locator("form.card .box.error")
    expect(box).to_contain_text("tau")
    assert not any("TypeError" in one for one in heard.complaints)


def test_a_dropped_description_names_the_joints_and_takes_their_drive_gains(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").evaluate("(details) => { details.open = true; }")
    dropped = page.evaluate_handle(
        """(text) => {
          const data = new DataTransfer();
          data.items.add(new File([text], 'dropped.urdf'));
          return data;
        }""",
        URDF,
    )
    page.locator("#new-robot .drop").dispatch_event("drop", {"dataTransfer": dropped})
    # By its own name; that of the file is for a description without one.
    expect(page.locator("#robot-name")).to_have_value("two_links")
    page.locator("#new-robot").get_by_text("Recordings will have currents").click()
    page.get_by_label("Drive gain of elbow in N m/A").first.fill("12.5")
    with page.expect_response(lambda answer: answer.url.endswith("/v1/robots") and answer.status == 201) as made:
        page.click("#create-robot")
    assert [joint["drive_gain"] for joint in made.value.json()["joints"]] == [None, 12.5]
    expect(page.locator("input[name=robot]:checked + strong")).to_have_text("two_links")


def test_a_description_that_cannot_be_read_is_explained_beside_it(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").evaluate("(details) => { details.open = true; }")
    page.fill("#robot-name", "broken")
    page.fill("#robot-description", URDF.replace('child link="fore"', 'child link="hand"'))
    page.click("#create-robot")
    expect(page.locator("[data-pointer='/description'] .complaint")).to_contain_text("hand")


def test_a_service_that_asks_for_a_key_is_used_with_one(page: Any, locked_service: str, heard: Any) -> None:
    page.goto(locked_service)
    page.get_by_role("textbox", name="Key").fill("open-sesame")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Begin with a robot")).to_be_visible()
    page.fill("#robot-description", URDF)
    page.fill("#robot-name", "behind the key")
    page.click("#create-robot")
    expect(page.locator("input[name=robot]:checked + strong")).to_have_text("behind the key")
    assert heard.complaints == []


def test_a_running_job_is_shown_with_its_progress_and_can_be_cancelled(page: Any, model: str) -> None:
    robot = ask(page, f"/identifications/{model}")["robot_id"]
    trajectory = {"harmonics": 15, "duration": 60, "sampling_rate": 500}
    body = {"robot_id": robot, "time_budget": 300, "starts": 500, "trajectory": trajectory}
    job = page.request.post("/v1/designs", data=body).json()["job_id"]
    strip = page.locator("#jobs .progress", has_text="design")
    expect(strip).to_be_visible()
    strip.get_by_role("button", name="Cancel").click()
    expect(strip).to_have_count(0)
    assert ask(page, f"/jobs/{job}")["state"] == "cancelled"


READY = {
    "Verdict": "#fitness-summary",
    "Compare": ".profiles canvas",
    "Missing": "#diagnose",
    "Parameters": "#parameters table",
    "Trust": "li[data-kind=direct]",
    "Data": "#data-table",
}
"""The tabs of a model, and what is there when one is shown."""


# Colours depend on the scheme alone, places on the width alone.
USUAL = ((1440, "light"), (800, "light"), (390, "dark"))


@pytest.mark.parametrize(
    ("width", "scheme"),
    [
        pytest.param(*look, marks=[] if look in USUAL else pytest.mark.thorough)
        for look in product((1440, 800, 390), ("light", "dark"))
    ],
)
def test_the_page_fits_and_is_readable(
    page: Any, model: str, width: int, scheme: str, tmp_path: Path, thorough: bool
) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    for name, ready in READY.items():
        open_tab(page, name)
        page.locator(ready).first.wait_for()
        if thorough:
            page.screenshot(path=tmp_path / f"{name.lower()}_{width}_{scheme}.png", full_page=True)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        assert page.evaluate(CONTRASTS) == [], name
    page.goto(f"/?view=new&robot={ask(page, f'/identifications/{model}')['robot_id']}")
    page.locator("#identify").wait_for()
    if thorough:
        page.screenshot(path=tmp_path / f"new_{width}_{scheme}.png", full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(CONTRASTS) == []


def test_every_control_has_a_name_and_is_reached_by_the_keyboard(page: Any, model: str) -> None:
    nameless = """[...document.querySelectorAll('button, input, select, textarea, a[href]')].filter((one) =>
        !(one.textContent.trim() || one.ariaLabel || one.labels?.length)).map((one) => one.outerHTML)"""
    open_tab(page, "Compare")
    page.locator("#torque-chart canvas").wait_for()
    assert page.evaluate(nameless) == []
    assert page.evaluate('document.querySelectorAll(\'[tabindex]:not([tabindex="0"], [tabindex="-1"])\').length') == 0
    shoulder = page.locator(".choices").get_by_role("button", name="shoulder")
    shoulder.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#zoom-state")).to_contain_text("shoulder")
    page.locator(".charts").focus()
    whole = page.locator("#zoom-state").inner_text()
    page.keyboard.press("+")
    expect(page.locator("#zoom-state")).not_to_have_text(whole)
    page.goto(f"/?view=new&robot={ask(page, f'/identifications/{model}')['robot_id']}")
    page.locator("#identify").wait_for()
    assert page.evaluate(nameless) == []


COLOURS_IN_CHART = """() => {
  const canvas = document.querySelector('#residual-chart canvas');
  return new Set(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data).size;
}"""


def test_runs_that_overlap_in_time_are_drawn_one_after_another_with_gaps(page: Any) -> None:
    page.goto("/")
    line = page.evaluate(
        """async () => {
          const { find, timeline } = await import('/workbench/js/timeline.js');
          const series = { t: [0, 1, 2, 0.5, 1.5, 9], segment: [0, 0, 0, 1, 1, 2], residual: [1, 1, 1, 5, 5, 1] };
          const made = timeline(series, ['residual']);
          return { ...made, found: find(made, 0.4, 1.6, made.values.residual) };
        }"""
    )
    assert line["shifted"]
    assert all(later > earlier for earlier, later in pairwise(line["x"]))
    assert line["times"] == [0, 1, 2, None, 0.5, 1.5, None, 9]
    assert line["values"]["residual"] == [1, 1, 1, None, 5, 5, None, 1]
    # Of two stretches with these times the worse one is meant.
    assert [line["found"]["from"], line["found"]["to"]] == [line["x"][4], line["x"][5]]


def test_every_formula_of_the_catalogue_is_set_as_mathematics(page: Any) -> None:
    page.goto("/")
    formulas = [one["formula"] for one in ask(page, "/effects")["items"]]
    tags = page.evaluate(
        """async (formulas) => {
          const { formula } = await import('/workbench/js/formula.js');
          return formulas.map((text) => formula(text).tagName);
        }""",
        formulas,
    )
    assert dict(zip(formulas, tags, strict=True)) == dict.fromkeys(formulas, "math")


def test_constants_that_are_a_choice_between_kinds_are_chosen_by_their_words(page: Any) -> None:
    page.goto("/")
    items = ask(page, "/effects")["items"]
    kinds = [(one["id"], spec) for one in items for spec in one["shape_parameters"] if spec.get("words")]
    assert {(effect, spec["name"]) for effect, spec in kinds} >= {
        ("presliding", "law"),
        ("transmission_coupling", "side"),
    }
    for effect, spec in kinds:
        for known in spec["words"]:
            added = page.evaluate(
                """async ([items, effect, name, value]) => {
                  const { addByHand } = await import('/workbench/js/add_effect.js');
                  const effects = { items, byId: new Map(items.map((one) => [one.id, one])) };
                  let added = null;
                  const add = (choices) => { added = choices; };
                  const hand = addByHand({ effects, joints: ['a', 'b'], joint: 'a' }, add);
                  document.body.append(hand);
                  const choose = (where, text) => {
                    const control = hand.querySelector(where);
                    control.value = [...control.options].find((one) => one.text === text).value;
                    control.dispatchEvent(new Event('change'));
                  };
                  choose('select[name=effect]', effects.byId.get(effect).title);
                  const word = effects.byId.get(effect).shape_parameters.find((one) => one.name === name)
                    .words.find((one) => one.value === value).word;
                  choose(`select[name=${name}]`, word);
                  hand.querySelector('form').requestSubmit();
                  hand.remove();
                  return added;
                }""",
                [items, effect, spec["name"], known["value"]],
            )
            assert added[0]["shape_parameters"] == {spec["name"]: known["value"]}


def test_files_that_were_chosen_stay_when_the_robot_is_changed(page: Any, recordings: tuple[Path, Path]) -> None:
    the_robot(page)
    page.set_input_files("#recordings", recordings[0])
    form = page.locator("form.card")
    form.locator("input[name=name]").fill("kept")
    page.locator("summary", has_text="The recordings have currents").click()
    page.locator("[data-gain-of]").last.fill("2")
    page.get_by_role("button", name="Make a robot with these drive gains").click()
    chosen = page.locator("label", has=page.locator("input[name=robot]:checked"))
    expect(chosen).to_contain_text("with drive gains")
    expect(form.locator("input[name=name]")).to_have_value("kept")
    form.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(STORED).get_by_text("kept", exact=True)).to_be_visible()
    (stored,) = [one for one in ask(page, "/measurements")["items"] if one["name"] == "kept"]
    assert stored["robot_id"] == chosen.locator("input").get_attribute("value")
