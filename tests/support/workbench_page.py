"""Requests to the service beside the workbench's page, and looks at the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import URDF

expect = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright").expect
STORED = ".stored > .scroll > table > tbody > tr > th"


def the_robot(page: Any) -> None:
    page.goto("/?view=new")
    page.locator("#new-robot").wait_for()
    if page.locator("#new-robot[open]").count() == 0:
        page.locator("#new-robot > summary").click()
    page.fill("#robot-description", URDF)
    page.fill("#robot-name", "two links")
    with page.expect_response(
        lambda answer: answer.url.endswith("/v1/robots") and answer.request.method == "POST"
    ) as made:
        page.click("#create-robot")
    # Another robot may be there: until this one is chosen, its steps are on the page.
    expect(page.locator(f"input[name=robot][value={made.value.json()['id']}]")).to_be_checked()
    page.locator("#recordings").wait_for()
    # They are drawn anew once its measurements are read.
    page.wait_for_load_state("networkidle")


def upload(page: Any, path: Path, role: str) -> None:
    page.set_input_files("#recordings", path)
    form = page.locator("form.card").last
    form.locator("select[name=role]").select_option(role)
    form.get_by_role("button", name="Confirm and store").click()
    expect(page.locator(STORED).get_by_text(path.stem, exact=True)).to_be_visible()


def open_tab(page: Any, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click()


def value_in(page: Any, table: str, row: str, column: int) -> float:
    """The exact value behind a figure of a table: the `column`-th figure of the row that so begins."""
    found = page.locator(f"{table} tbody tr", has=page.locator("th", has_text=row)).first
    return float(found.locator("data").nth(column).get_attribute("value"))


def identifier(page: Any) -> str:
    return str(page.evaluate("new URLSearchParams(location.search).get('identification')"))


def ask(page: Any, path: str) -> Any:
    return page.request.get(f"/v1{path}").json()


CONTRASTS = """() => {
  const channels = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = (element) => {
    for (let one = element; one; one = one.parentElement) {
      const found = channels(getComputedStyle(one).backgroundColor);
      if (found.length === 3 || found[3] > 0.9) return found;
    }
    return [255, 255, 255];
  };
  const poor = [];
  for (const one of document.querySelectorAll('main *, aside *, header *')) {
    const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || one.disabled || one instanceof SVGElement || !one.checkVisibility()) continue;
    const [a, b] = [light(channels(getComputedStyle(one).color)), light(ground(one))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) poor.push(`${ratio.toFixed(2)} ${one.outerHTML.slice(0, 120)}`);
  }
  return poor;
}"""
"""Texts whose contrast against their ground is below 4.5, which WCAG asks for."""
