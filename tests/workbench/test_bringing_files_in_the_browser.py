"""From an empty service to stored recordings with few clicks: names, gains, columns, several files at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import URDF
from support.workbench_page import STORED, ask, the_robot

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect

PASTE = """([field, text]) => {
  const clipboardData = new DataTransfer();
  clipboardData.setData("text", text);
  field.dispatchEvent(new ClipboardEvent("paste", { clipboardData, bubbles: true, cancelable: true }));
}"""


def paste(page: Any, selector: str, text: str) -> None:
    page.evaluate(PASTE, [page.locator(selector).element_handle(), text])


def test_a_robot_is_called_by_its_own_name_and_a_pasted_row_fills_its_gains(first_page: Any, heard: Any) -> None:
    page = first_page
    page.goto("/?view=new")
    page.fill("#robot-description", URDF)
    expect(page.locator("#robot-name")).to_have_value("two_links")
    # A name that somebody gave stays.
    page.fill("#robot-name", "mine")
    page.fill("#robot-description", URDF.replace("two_links", "other"))
    expect(page.locator("#robot-name")).to_have_value("mine")
    # Few recordings have currents: the table of gains is folded, and the button is in sight without scrolling.
    expect(page.locator("[data-gain-of=shoulder]")).to_be_hidden()
    box = page.locator("#create-robot").bounding_box()
    assert box["y"] + box["height"] <= page.viewport_size["height"]
    # What is wrong in it unfolds it.
    page.evaluate("document.querySelector('[data-gain-of=shoulder]').value = '0'")
    page.click("#create-robot")
    expect(page.locator("#new-robot .complaint")).to_be_visible()
    expect(page.locator("[data-gain-of=shoulder]")).to_be_focused()
    paste(page, "[data-gain-of=shoulder]", "14.9, 13.3")
    gains = [page.input_value(f"[data-gain-of={joint}]") for joint in ("shoulder", "elbow")]
    assert gains == ["14.9", "13.3"]
    page.click("#create-robot")
    page.locator("#recordings").wait_for()
    (robot,) = ask(page, "/robots")["items"]
    assert [joint["drive_gain"] for joint in robot["joints"]] == [14.9, 13.3]
    assert heard.complaints == []


def test_what_is_pasted_into_a_gain_and_is_no_row_of_numbers_is_left_to_the_browser(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    if page.locator("#new-robot[open]").count() == 0:
        page.locator("#new-robot > summary").click()
    page.fill("#robot-description", URDF)
    paste(page, "[data-gain-of=shoulder]", "about 14 and 13")
    paste(page, "[data-gain-of=shoulder]", "1, 2, 3, 4")
    # More numbers than joints fill what there is.
    assert [page.input_value(f"[data-gain-of={joint}]") for joint in ("shoulder", "elbow")] == ["1", "2"]


def test_files_get_their_roles_by_their_names_else_by_their_length(page: Any) -> None:
    def drop(**lines: int) -> list[str]:
        page.locator("#recordings").set_input_files(
            [
                {"name": f"{name}.csv", "mimeType": "text/csv", "buffer": b"t,q\n" * count}
                for name, count in lines.items()
            ]
        )
        roles = page.locator("form.card select[name=role]")
        expect(roles).to_have_count(len(lines))
        chosen = [roles.nth(place).input_value() for place in range(len(lines))]
        discard = page.locator("form.card").get_by_role("button", name="Leave it out")
        while discard.count():
            discard.first.click()
        return chosen

    the_robot(page)
    assert drop(run_val=9, run_train=3, run3=5) == ["validation", "identification", "validation"]
    # Something has to be fitted, whatever the names say.
    assert drop(friction_test=9, test1=3, test2=5) == ["friction", "validation", "identification"]
    assert drop(test=3) == ["identification"]


@pytest.mark.slow
def test_all_files_are_confirmed_at_once_above_their_folded_columns(
    page: Any, heard: Any, recordings: tuple[Path, Path]
) -> None:
    the_robot(page)
    page.set_input_files("#recordings", [str(path) for path in recordings])
    confirm = page.get_by_role("button", name="Confirm and store")
    expect(confirm).to_have_count(2)
    expect(confirm.last).to_be_enabled()
    card = page.locator("form.card").first
    expect(card.locator("table.columns")).to_be_hidden()
    columns = card.locator("details", has=page.locator("table.columns"))
    expect(columns.locator("summary")).to_have_text("5 columns of the file, 5 used")
    assert confirm.first.bounding_box()["y"] < columns.bounding_box()["y"]
    columns.locator("summary").click()
    expect(card.locator("svg.sparkline")).to_have_count(5)
    # What is chosen there counts.
    card.locator("[data-column=tau_elbow]").select_option("")
    expect(columns.locator("summary")).to_have_text("5 columns of the file, 4 used")
    card.locator("[data-column=tau_elbow]").select_option("tau2")
    page.click("#confirm-all")
    for path in recordings:
        expect(page.locator(STORED).get_by_text(path.stem, exact=True)).to_be_visible()
    expect(page.locator("#confirm-all")).to_be_hidden()
    assert heard.complaints == []


@pytest.mark.slow
def test_files_that_are_confirmed_while_they_are_inspected_are_stored(
    page: Any, heard: Any, recordings: tuple[Path, Path]
) -> None:
    the_robot(page)
    # Inspecting takes a while: whoever does not wait for it is not left without an answer.
    page.route("**/v1/imports", lambda route: (page.wait_for_timeout(500), route.continue_()))
    page.set_input_files("#recordings", [str(path) for path in recordings])
    expect(page.get_by_role("button", name="Confirm and store").first).to_be_disabled()
    page.click("#confirm-all")
    for path in recordings:
        expect(page.locator(STORED).get_by_text(path.stem, exact=True)).to_be_visible()
    assert heard.complaints == []


@pytest.mark.slow
def test_files_of_single_signals_are_joined_to_one_recording(
    page: Any, heard: Any, recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    rows = [line.split(",") for line in recordings[0].read_text().splitlines()]
    parts = []
    for name, columns in (("positions", (0, 1, 2)), ("torques", (0, 3, 4))):
        parts.append(tmp_path / f"{name}.csv")
        parts[-1].write_text("\n".join(",".join(row[k] for k in columns) for row in rows))
    the_robot(page)
    page.set_input_files("#recordings", [str(path) for path in parts])
    expect(page.locator("form.card")).to_have_count(2)
    # Each button stands before its own explanation, and breaks no sentence.
    join = page.locator("p", has=page.locator("#join-all"))
    expect(join).to_have_text("All of them are one recordingif each file has one signal, such as positions or torques")
    page.click("#join-all")
    expect(page.locator("form.card")).to_have_count(1)
    expect(page.locator("form.card strong").first).to_have_text("positions.csv + torques.csv")
    page.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(STORED).get_by_text("positions", exact=True)).to_be_visible()
    assert heard.complaints == []


@pytest.mark.slow
def test_what_a_finding_names_is_done_by_a_button(page: Any, recordings: tuple[Path, Path], tmp_path: Path) -> None:
    # Torque in N mm on one joint: a factor, which no check applies by itself.
    head, *rows = recordings[0].read_text().splitlines()
    scaled = [",".join((*cells[:4], str(1000.0 * float(cells[4])))) for cells in (row.split(",") for row in rows)]
    path = tmp_path / "scaled.csv"
    path.write_text("\n".join((head, *scaled)))
    the_robot(page)
    page.set_input_files("#recordings", str(path))
    confirm = page.get_by_role("button", name="Confirm and store")
    expect(confirm).to_be_enabled()
    for choice in page.locator("form.card select[required]").all():
        choice.select_option(index=1)
    confirm.click()
    card = page.locator("form.card, main details").filter(has=page.locator("table.checks")).first
    card.locator("button.apply").first.wait_for()
    for text in card.locator("table.checks td").all_inner_texts():
        assert '": ' not in text, text


@pytest.mark.slow
def test_a_filter_is_stated_and_the_others_are_chosen_from_the_data(
    page: Any, heard: Any, recordings: tuple[Path, Path]
) -> None:
    the_robot(page)
    page.set_input_files("#recordings", str(recordings[0]))
    page.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(STORED).get_by_text(recordings[0].stem, exact=True)).to_be_visible()
    page.locator(".methods > summary").click()
    page.locator("#filters").get_by_label("Torque cutoff").fill("7.5")
    with page.expect_request(lambda asked: asked.method == "POST" and "identifications" in asked.url) as sent:
        page.click("#run")
    assert json.loads(sent.value.post_data)["preprocessing"] == {"torque_cutoff": 7.5}
    page.locator("#error-table").wait_for()
    used = ask(page, "/identifications")["items"][0]["result"]["preprocessing"]
    assert used["torque_cutoff"] == 7.5
    assert used["position_cutoff"] > 7.5
    assert heard.complaints == []


@pytest.mark.slow
def test_an_empty_service_offers_sample_data_and_well_known_arms(first_page: Any, heard: Any) -> None:
    page = first_page
    page.goto("/")
    arms = page.locator("#known-robot option")
    expect(arms).to_contain_text(["dual_arm", "franka_panda", "scara", "ur10"])
    page.click("#sample-data")
    for number in (1, 2):
        expect(page.locator(STORED).get_by_text(f"sample run {number}", exact=True)).to_be_visible(timeout=120_000)
    expect(page.locator("select[aria-label^='Use of sample run 2']")).to_have_value("hold")
    page.locator("#known-robots > summary").click()
    page.locator("#known-robot").select_option("ur10")
    page.click("#create-known")
    expect(page.locator("label", has=page.locator("input[name=robot]:checked"))).to_contain_text("ur10")
    assert heard.complaints == []
