"""Every link of every page leads somewhere: files, and the headings in them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SKIPPED = {".venv", "demo-output", "dynident-data", "site", "dist", "build"}
PAGES = sorted(
    page
    for page in ROOT.rglob("*.md")
    if not any(part in SKIPPED or part.startswith(".venv") for part in page.relative_to(ROOT).parts)
)
ADDRESS = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)
HOME = "https://github.com/dynident/dynident/blob/main/"


def without_code(text: str) -> str:
    """A page without its fenced blocks and code spans, in which brackets are no links."""
    return re.sub(r"`[^`\n]+`", "", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL))


def anchors_of(page: Path) -> set[str]:
    """The anchors of its headings, as the forges and the site make them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    found: set[str] = set()
    for heading in headings:
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip().lower()
        found.add(re.sub(r"[^\w\- ]", "", plain).replace(" ", "-"))
    return found | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))


def links_of(page: Path) -> list[str]:
    text = without_code(page.read_text(encoding="utf-8"))
    return re.findall(r"\]\(<?([^)\s>]+)>?[^)]*\)", text) + re.findall(r'(?:src|href)="([^"]+)"', text)


def test_there_are_pages_with_links() -> None:
    assert sum(len(links_of(page)) for page in PAGES) > 60
    assert "experiments.md" in {target for page in PAGES for target in links_of(page)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in links_of(page):
        if target.startswith(HOME):
            file, _, anchor = target.removeprefix(HOME).partition("#")
            place = ROOT / file
        elif ADDRESS.match(target):
            continue
        else:
            file, _, anchor = target.partition("#")
            place = (page.parent / file).resolve() if file else page
        assert place.exists(), target
        if anchor:
            assert anchor in anchors_of(place), target


def test_every_page_stands_in_the_contents_of_the_site() -> None:
    # Sphinx is not asked for by who only runs the tests, so the settings are read as text.
    settings = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    pages = [page.stem for page in (ROOT / "docs").glob("*.md")]
    assert [page for page in pages if f'"{page}"' not in settings and f'"docs/{page}"' not in settings] == []
