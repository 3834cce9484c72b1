"""Files that are dropped, recordings that are looked at, and what a model says of them, in a real Chromium."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import pytest
from support.stored_recordings import FOREIGN, foreign, robot_of, stored
from support.two_link_arm import write_recording
from support.workbench_page import CONTRASTS, ask

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
pytestmark = pytest.mark.slow

ARM = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds of the arm."""
    return write_recording(tmp_path_factory.mktemp("short") / "short.csv", seed=3, duration=10.0, rate=100.0)


def test_a_renamed_file_in_degrees_is_dropped_and_its_guesses_confirmed(
    page: Any, short: Path, heard: Any, tmp_path: Path
) -> None:
    robot = robot_of(page)
    page.goto(f"/?view=new&robot={robot}")
    page.locator("#recordings").wait_for()
    dropped = page.evaluate_handle(
        """(text) => {
          const data = new DataTransfer();
          data.items.add(new File([text], 'night shift.csv'));
          return data;
        }""",
        foreign(short, tmp_path / "foreign.csv").read_text(),
    )
    page.locator(".drop", has=page.locator("#recordings")).dispatch_event("drop", {"dataTransfer": dropped})
    card = page.locator("form.card")
    expect(card.get_by_label("What axis 2 pos is")).to_have_value("q2")
    expect(card.get_by_label("What axis 2 moment is")).to_have_value("tau2")
    expect(card.get_by_label("Unit of q", exact=True)).to_have_value("deg")
    expect(card).to_contain_text("looks like deg")
    expect(card.locator("table.columns tbody tr")).to_have_count(len(FOREIGN))
    card.locator("summary", has_text="columns of the file").click()

    # What is wrong is said beside it, and nothing that was typed or chosen is lost.
    card.locator("input[name=name]").fill("by night")
    card.locator("input[name=windows]").fill("8 to 2")
    card.get_by_label("What axis 1 pos is").select_option("q2")
    expect(card.get_by_label("What axis 2 pos is")).to_have_value("q1")
    card.get_by_role("button", name="Confirm and store").click()
    expect(card.locator("[data-pointer='/metadata/windows'] .complaint")).to_be_visible()
    expect(card.locator("input[name=name]")).to_have_value("by night")
    expect(card.get_by_label("What axis 1 pos is")).to_have_value("q2")
    card.get_by_label("What axis 1 pos is").select_option("q1")
    card.locator("input[name=windows]").fill("")
    page.screenshot(path=tmp_path / "import.png", full_page=True)
    card.get_by_role("button", name="Confirm and store").click()
    page.locator(".stored").get_by_role("link", name="by night").click()

    expect(page.get_by_role("heading", name="by night")).to_be_visible()
    (measurement,) = ask(page, f"/measurements?robot_id={robot}")["items"]
    found = ask(page, f"/measurements/{measurement['id']}/raw?to=0.5&signals=q1,q2,tau1,tau2")
    with short.open() as opened:
        lines = list(csv.DictReader(opened))[: found["n_samples"]]
    for signal, name in (("q1", "q_shoulder"), ("q2", "q_elbow"), ("tau1", "tau_shoulder"), ("tau2", "tau_elbow")):
        assert found["signals"][signal] == pytest.approx([float(line[name]) for line in lines], abs=1e-6)
    assert heard.complaints == []


def test_a_file_that_was_looked_at_and_left_is_gone_on_with(page: Any, short: Path) -> None:
    robot = robot_of(page)
    page.goto(f"/?view=new&robot={robot}")
    page.set_input_files("#recordings", short)
    expect(page.get_by_role("button", name="Confirm and store")).to_be_enabled()
    page.reload()
    page.locator("summary", has_text="1 file inspected before").click()
    page.get_by_role("button", name="Continue").click()
    page.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(".stored").get_by_role("link", name="short")).to_be_visible()


def test_velocity_and_temperature_are_shown_as_recorded_where_the_file_has_them(
    page: Any, short: Path, heard: Any, tmp_path: Path
) -> None:
    with short.open() as opened:
        lines = list(csv.DictReader(opened))
    more = {f"{kind}_{joint}": value for kind, value in (("dq", 0.5), ("temperature", 31.0)) for joint in ARM}
    with (tmp_path / "warm.csv").open("w", newline="") as target:
        writer = csv.DictWriter(target, [*lines[0], *more])
        writer.writeheader()
        writer.writerows({**line, **more} for line in lines)
    measurement = stored(page, robot_of(page), tmp_path / "warm.csv")
    page.goto(f"/?view=recording&measurement={measurement}")
    also = page.locator("#also-show")
    expect(also.locator("option")).to_have_text(["nothing more", "velocity", "temperature"])
    with page.expect_response(lambda answer: "temperature_elbow" in answer.url) as read:
        also.select_option("temperature")
    assert set(read.value.json()["signals"]["temperature_elbow"]) == {31.0}
    expect(page.locator("[data-signal=temperature_elbow] canvas")).to_be_visible()
    also.select_option("")
    expect(page.locator("[data-signal]")).to_have_count(0)
    expect(page.locator(".joint-row canvas")).to_have_count(2)
    assert heard.complaints == []


def test_a_window_that_is_dragged_makes_a_revision(page: Any, short: Path, heard: Any, tmp_path: Path) -> None:
    measurement = stored(page, robot_of(page), short)
    page.goto(f"/?view=recording&measurement={measurement}")
    expect(page.locator("#zoom-state")).to_contain_text("samples as recorded")
    expect(page.locator(".joint-row canvas")).to_have_count(2)
    expect(page.locator("#make-revision")).to_be_hidden()
    figure = page.locator(".joint-row .u-over").first
    figure.scroll_into_view_if_needed()
    box = figure.bounding_box()
    page.mouse.move(box["x"] + 1, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 40, steps=5)
    page.mouse.up()
    page.screenshot(path=tmp_path / "dragged.png", full_page=True)
    page.locator("#make-revision").click()
    expect(page.locator("#undo-revision")).to_be_visible()
    revision = page.evaluate("new URLSearchParams(location.search).get('measurement')")
    made = ask(page, f"/measurements/{revision}")
    assert made["parent_id"] == measurement
    ((start, end),) = made["windows"]
    assert start == pytest.approx(3.0, abs=0.1)
    assert end == pytest.approx(9.99)
    # Both have the same samples: only one of them is to be identified from.
    page.get_by_role("link", name="Identify a model with it").click()
    expect(page.get_by_label("Use of short r1")).to_have_value("fit")
    expect(page.get_by_label("Use of short", exact=True)).to_have_value("")
    page.go_back()
    # The other way is the keyboard's.
    page.get_by_label("Beginning in s").fill("4")
    page.keyboard.press("Tab")
    expect(page.locator("#make-revision")).to_be_visible()
    page.get_by_role("button", name="Discard").click()
    expect(page.get_by_label("Beginning in s")).to_have_value(str(start))
    assert heard.complaints == []


def test_a_check_is_applied_and_undone(page: Any, short: Path, tmp_path: Path) -> None:
    with short.open() as opened:
        lines = list(csv.DictReader(opened))
    turned = tmp_path / "turned.csv"
    with turned.open("w", newline="") as written:
        writer = csv.DictWriter(written, lines[0])
        writer.writeheader()
        writer.writerows({**line, "tau_elbow": -float(line["tau_elbow"])} for line in lines)
    measurement = stored(page, robot_of(page), turned, accept=["torque_sign", "torque_order"])
    page.goto(f"/?view=recording&measurement={measurement}")
    page.get_by_role("button", name="Apply: torque of elbow with the opposite sign").first.click()
    expect(page.locator(".box.good")).to_contain_text("torque of elbow with the opposite sign")
    revision = page.evaluate("new URLSearchParams(location.search).get('measurement')")
    assert ask(page, f"/measurements/{revision}")["request"]["signs"] == {"tau2": -1}
    page.click("#undo-revision")
    expect(page.get_by_role("heading", name="turned", exact=True)).to_be_visible()
    assert measurement in page.url
    assert page.request.get(f"/v1/measurements/{revision}").status == 404


@pytest.fixture
def model(page: Any, short: Path) -> str:
    """A model that lacks the spring."""
    known = ask(page, "/identifications")["items"]
    if known:
        return str(known[0]["id"])
    robot = robot_of(page)
    asked = {
        "robot_id": robot,
        "measurement_ids": [stored(page, robot, short)],
        "effects": [{"effect": one} for one in ("rigid_body", "coulomb", "viscous")],
    }
    made = page.request.post("/v1/identifications", data=asked).json()["id"]
    end = time.monotonic() + 120.0
    while (status := ask(page, f"/identifications/{made}")["status"]) != "succeeded":
        assert status in ("queued", "running")
        assert time.monotonic() < end
        time.sleep(0.1)
    return str(made)


def test_the_wheel_zooms_all_joints_and_the_zoom_survives_a_reload(
    page: Any, model: str, heard: Any, tmp_path: Path
) -> None:
    page.goto(f"/?identification={model}&tab=compare&joint=elbow")
    expect(page.locator(".joint-row canvas")).to_have_count(3)
    said = page.locator("#zoom-state")
    expect(said).to_contain_text("elbow, 0")
    chart = page.locator("#torque-chart .u-over")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60)
    page.mouse.wheel(0, -1000)
    page.wait_for_url("**from=*to=*")
    before = page.url
    page.locator(".charts").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("(before) => location.href !== before", arg=before)
    query = page.evaluate("Object.fromEntries(new URLSearchParams(location.search))")
    start, end = float(query["from"]), float(query["to"])
    assert 1.0 < start < end < 9.0
    expect(said).to_contain_text(f"elbow, {start:.3f} s to {end:.3f} s")
    expect(said).to_contain_text("all drawn")
    shown = said.inner_text()
    page.reload()
    expect(said).to_have_text(shown)
    with page.expect_response(lambda answer: "/raw" in answer.url and answer.status == 200):
        page.locator("#raw-torque").check()
    page.locator("#torque-chart .u-over").click(position={"x": 80, "y": 60})
    expect(page.locator("#moment")).to_contain_text("the residual is largest at")
    expect(page.locator("#pose tbody tr")).to_have_count(2)
    expect(page.locator("#moment")).to_contain_text("has no diagnosis yet")
    page.locator(".joint-row").get_by_role("button", name="shoulder").click()
    assert "joint=shoulder" in page.url
    assert f"from={query['from']}" in page.url
    page.screenshot(path=tmp_path / "compare.png", full_page=True)
    assert heard.complaints == []


def test_the_share_that_an_effect_explains_is_that_of_its_curve(page: Any) -> None:
    page.goto("/")
    shares = page.evaluate(
        """async () => {
          const { explainedShare } = await import('/workbench/js/compare/explained_share.js');
          const line = { times: [0, 1, 2], values: { residual: [0, 2, 4], q: [0, 1, 2] } };
          const over = (variable, fitted) => explainedShare({ variable, x: [0, 1, 2], fitted }, line, [0, 1, 2]);
          const position = [over('position', [0, 2, 4]), over('position', [0, 1, 2])];
          return [...position, over('time', [0, -2, -4]), over('phase', [0])];
        }"""
    )
    assert shares == [1, 0.75, -3, None]


def test_on_a_narrow_screen_nothing_runs_off_it(page: Any, short: Path, tmp_path: Path) -> None:
    robot = robot_of(page)
    measurement = stored(page, robot, short)
    page.set_viewport_size({"width": 390, "height": 844})

    def fits(view: str) -> None:
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.screenshot(path=tmp_path / f"{view}_{scheme}.png", full_page=True)
            assert page.evaluate(CONTRASTS) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 390

    page.goto(f"/?view=recording&measurement={measurement}")
    expect(page.locator(".joint-row canvas")).to_have_count(2)
    fits("recording")
    page.goto(f"/?view=new&robot={robot}")
    page.set_input_files("#recordings", short)
    expect(page.get_by_role("button", name="Confirm and store")).to_be_enabled()
    fits("import")
