"""The whole story by keyboard alone, by two people at once, and with the service restarted, in a real Chromium."""

from __future__ import annotations

import contextlib
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright")

from conftest import Heard, beside, free_port, listened_page, started
from support.stored_recordings import foreign
from support.workbench_page import ask
from support.workbench_story import Keyboard, Mouse, Story

pytestmark = pytest.mark.slow


def test_two_people_tell_their_stories_at_once_one_by_the_keyboard_alone_and_one_on_a_telephone(
    browser: Any, recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    heard = Heard()
    # With other columns, in degrees.
    theirs = [foreign(path, tmp_path / f"{path.stem}.csv") for path in recordings]
    (tmp_path / "service").mkdir()
    with beside(tmp_path / "service") as service:
        desk, telephone = (listened_page(browser, service, heard, width) for width in (1440, 390))
        # A page that hears of a mouse was not used by the keyboard alone.
        desk.add_init_script("addEventListener('pointerdown', () => console.error('a pointer was used'))")
        stories = [
            Story(Keyboard(desk), (theirs[0], theirs[1]), "at the desk"),
            Story(Mouse(telephone), recordings, "on the way"),
        ]
        for steps in zip_longest(*(story.told() for story in stories)):
            assert steps[0] == steps[1]
            for page in (desk, telephone):
                assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0, steps
        assert steps[0] == "reported"
        models = [ask(desk, f"/identifications/{identifier}") for story in stories for identifier in story.models]
        assert len({model["id"] for model in models}) == 4
        assert [model["parent_id"] for model in models] == [None, models[0]["id"], None, models[2]["id"]]
        errors = [model["result"]["validation"]["relative_total"] for model in models]
        assert errors[1] < 0.2 * errors[0]
        assert errors[3] < 0.2 * errors[2]
        # Each has what is theirs, and sees that the other's is there.
        for page in (desk, telephone):
            page.goto("/?view=models")
            page.locator("#models-table tbody tr[data-id]").nth(3).wait_for()
            page.context.close()
    assert heard.complaints == []
    assert heard.hosts == {service.removeprefix("http://")}


def test_the_story_goes_on_where_it_was_when_the_service_is_restarted(
    browser: Any, recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    heard, port = Heard(), free_port()
    with contextlib.ExitStack() as running:
        service = running.enter_context(started(tmp_path, port))
        page = listened_page(browser, service, heard)
        story, restarts = Story(Mouse(page), recordings), []
        for step in story.told():
            if step in ("identifying", "diagnosing"):
                running.close()
                running.enter_context(started(tmp_path, port))
                restarts.append(step)
            # The diagnosis has come, and what it recommends is being added.
            if step == "adding":
                break
        assert restarts == ["identifying", "diagnosing"]
        assert len(story.models) == 1
        page.context.close()
    # The browser tells of every connection that broke, and of nothing else.
    assert [one for one in heard.complaints if "ERR_" not in one] == []


def test_a_view_that_is_asked_for_while_the_service_is_restarted_says_so_and_comes(
    browser: Any, tmp_path: Path
) -> None:
    heard, port = Heard(), free_port()
    with contextlib.ExitStack() as running:
        page = listened_page(browser, running.enter_context(started(tmp_path, port, science=False)), heard)
        page.goto("/?view=models")
        nothing = page.get_by_text("No model yet")
        nothing.wait_for()
        page.locator("#views").get_by_text("Robots").click()
        page.get_by_role("heading", name="Robots").wait_for()
        running.close()
        page.locator("#views").get_by_text("Models", exact=True).click()
        away = page.get_by_text("The service does not answer; trying again")
        away.wait_for()
        running.enter_context(started(tmp_path, port, science=False))
        nothing.wait_for()
        away.wait_for(state="detached")
        page.context.close()
    assert [one for one in heard.complaints if "ERR_" not in one] == []
