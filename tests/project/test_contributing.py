"""The page for contributors is short, what it names is there, and like cases of tests are sampled."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from types import SimpleNamespace

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


def test_of_cases_that_differ_in_a_seed_alone_a_fifth_is_run_and_of_every_kind_one() -> None:
    left_out: list[object] = []
    config = SimpleNamespace(hook=SimpleNamespace(pytest_deselected=lambda items: left_out.extend(items)))

    def case(name: str, **indices: int) -> SimpleNamespace:
        number = "-".join(map(str, indices.values()))
        return SimpleNamespace(nodeid=f"{name}[{number}]", keywords=(), callspec=SimpleNamespace(indices=indices))

    drawn = [case("drawn", arm=arm, seed=seed) for arm in range(3) for seed in range(40)]
    kinds = [case("kinds", arm=arm) for arm in range(40)]
    items = [*drawn, *kinds]
    runpy.run_path(str(ROOT / "tests" / "conftest.py"))["_sample_sweeps"](config, items)
    assert [item for item in items if item in kinds] == kinds
    assert {item.callspec.indices["arm"] for item in items if item.callspec.indices.get("seed") == 0} == {0, 1, 2}
    assert 0.1 < (len(items) - len(kinds)) / len(drawn) < 0.3
    assert len(left_out) + len(items) == len(drawn) + len(kinds)
