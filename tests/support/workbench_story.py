"""The whole story, from an empty service to the noise floor and a report, step by step, by one hand or the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from playwright.sync_api import Locator, Page, expect
from support.two_link_arm import NOISE, URDF

FARTHEST = 400
"""Presses of Tab from anywhere on a page to anywhere else on it."""


class Hands(Protocol):
    """How somebody works with a page."""

    page: Page

    def press(self, what: Locator) -> None:
        """Press a button, follow a link, choose a tab, open what is folded."""

    def write(self, where: Locator, text: str) -> None:
        """Put a text into a field."""

    def choose(self, where: Locator, option: str) -> None:
        """Choose an option of a list, by how it begins."""

    def give(self, where: Locator, file: Path) -> None:
        """Choose a file."""


@dataclass
class Mouse:
    """Clicks; what has to be written is written by keys, as everybody does."""

    page: Page

    def press(self, what: Locator) -> None:
        what.click()

    def write(self, where: Locator, text: str) -> None:
        where.click()
        where.fill(text)

    def choose(self, where: Locator, option: str) -> None:
        labels = where.locator("option").all_inner_texts()
        where.select_option(label=next(one for one in labels if one.startswith(option)))

    def give(self, where: Locator, file: Path) -> None:
        with self.page.expect_file_chooser() as chosen:
            where.click()
        chosen.value.set_files(file)


@dataclass
class Keyboard:
    """Tab, arrows, Enter and letters alone: what these do not reach cannot be used."""

    page: Page

    def reach(self, what: Locator) -> None:
        """Go on with Tab until it has the focus."""
        what.wait_for()
        handle = what.element_handle()
        for _ in range(FARTHEST):
            if handle.evaluate("one => one === document.activeElement"):
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"Tab does not reach {what}")

    def press(self, what: Locator) -> None:
        if what.get_attribute("role") == "tab":
            self._turn_to(what)
        else:
            self.reach(what)
            self.page.keyboard.press("Enter")

    def write(self, where: Locator, text: str) -> None:
        self.reach(where)
        self.page.keyboard.press("Control+a")
        self.page.keyboard.insert_text(text)

    def choose(self, where: Locator, option: str) -> None:
        self.reach(where)
        self.page.keyboard.type(option)

    def give(self, where: Locator, file: Path) -> None:
        self.reach(where)
        with self.page.expect_file_chooser() as chosen:
            self.page.keyboard.press("Enter")
        chosen.value.set_files(file)

    def _turn_to(self, tab: Locator) -> None:
        self.reach(self.page.get_by_role("tab", selected=True))
        for _ in range(10):
            if tab.get_attribute("aria-selected") == "true":
                return
            self.page.keyboard.press("ArrowRight")
        raise AssertionError(f"the arrows do not lead to {tab}")


@dataclass
class Story:
    """What somebody does, and what came of it: `models` are the ids of the first and the last."""

    hands: Hands
    files: tuple[Path, Path]
    name: str = "two links"
    models: list[str] = field(default_factory=list)

    def told(self) -> Iterator[str]:
        """Do it, step after step; gives what has just been begun."""
        page, hands = self.hands.page, self.hands
        page.goto("/?view=new")
        page.locator("#new-robot").wait_for()
        if page.locator("#new-robot[open]").count() == 0:
            hands.press(page.locator("#new-robot > summary"))
        hands.write(page.locator("#robot-description"), URDF)
        hands.write(page.locator("#robot-name"), self.name)
        hands.press(page.locator("#create-robot"))
        # Somebody else's robot may be there, too.
        mine = page.locator("label", has=page.locator("input[name=robot]:checked"))
        expect(mine).to_contain_text(self.name)
        yield "the robot"
        for file, role in zip(self.files, ("identification", "validation"), strict=True):
            hands.give(page.locator("#recordings"), file)
            form = page.locator("form.card").last
            expect(form.get_by_role("button", name="Confirm and store")).to_be_enabled()
            hands.write(form.locator("input[name=name]"), f"{self.name}, {role}")
            hands.choose(form.locator("select[name=role]"), role)
            hands.press(form.get_by_role("button", name="Confirm and store"))
            expect(page.locator(".stored").get_by_role("link", name=f"{self.name}, {role}")).to_be_visible()
            yield role
        hands.write(page.locator("#model-name"), f"{self.name}, first")
        hands.press(page.locator("#run"))
        page.wait_for_url("**identification=*")
        yield "identifying"
        page.locator("#error-table").wait_for()
        self._at_a_model()
        hands.press(page.get_by_role("tab", name="Missing"))
        hands.press(page.locator("#diagnose"))
        yield "diagnosing"
        expect(page.locator("#verdict")).to_have_attribute("data-verdict", "missing_effect")
        expect(page.locator("#cards article").first).to_contain_text("(joint spring?) on elbow")
        hands.press(page.locator("#add-recommended"))
        yield "adding"
        expect(page.locator("#step")).to_contain_class("good")
        expect(page.locator("#step")).to_contain_text("Joint spring on elbow")
        self._at_a_model()
        hands.press(page.get_by_role("tab", name="Verdict"))
        row = page.locator("#error-table tbody tr", has=page.locator("th", has_text="elbow")).first
        assert float(row.locator("data").nth(3).get_attribute("value")) < 2 * NOISE
        hands.press(page.get_by_role("tab", name="Compare"))
        page.locator("#torque-chart canvas").wait_for()
        yield "at the noise floor"
        hands.press(page.get_by_role("button", name="Report", exact=True))
        opened = page.get_by_role("link", name="Open the report")
        expect(opened).to_be_visible()
        report = page.request.get(opened.get_attribute("href")).text()
        assert self.models[-1] in report, "the report leads back to its model"
        yield "reported"

    def _at_a_model(self) -> None:
        self.models.append(self.hands.page.evaluate("new URLSearchParams(location.search).get('identification')"))
