"""The page for contributors is short, and what it names is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import dynident.testing
from dynident.effects import CATALOGUE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PATHS = sorted(set(re.findall(r"`((?:src|service|tests|docs|\.ci)/[\w./-]+)`", PAGE)))


def test_it_is_one_page() -> None:
    assert len(PAGE.splitlines()) <= 65
    assert len(PATHS) > 12


@pytest.mark.parametrize("path", PATHS)
def test_what_it_names_is_there(path: str) -> None:
    assert (ROOT / path).exists()


def test_the_readme_leads_to_it() -> None:
    assert "](CONTRIBUTING.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_checks_that_it_names_are_there() -> None:
    for name in re.findall(r"dynident\.testing\.(\w+)", PAGE):
        assert callable(getattr(dynident.testing, name))


def test_files_among_the_effects_are_found_by_themselves() -> None:
    from dynident.effects.catalogue import list_package_effects

    found = {effect.id for effect in list_package_effects()}
    assert found
    assert found <= set(CATALOGUE)
