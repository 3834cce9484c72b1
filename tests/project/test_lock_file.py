"""The lock file belongs to pyproject.toml and names the public index alone."""

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def locked() -> list[dict[str, Any]]:
    packages: list[dict[str, Any]] = tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]
    return packages


def test_every_locked_package_comes_from_the_public_index(locked: list[dict[str, Any]]) -> None:
    others = [package for package in locked if package["name"] != "dynident"]
    assert len(others) > 50
    for package in others:
        assert package["source"] == {"registry": "https://pypi.org/simple"}, package["name"]
        for file in [*package.get("wheels", []), *([package["sdist"]] if "sdist" in package else [])]:
            assert file["url"].startswith("https://files.pythonhosted.org/"), file["url"]


def test_the_lock_file_holds_the_requirements_of_pyproject(locked: list[dict[str, Any]]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras: dict[str, list[str]] = project["optional-dependencies"]
    wanted = {("", *_split(text)) for text in project["dependencies"]}
    for extra in extras:
        wanted |= {(extra, *_split(text)) for text in _flat(extra, extras)}
    ours = next(package for package in locked if package["name"] == "dynident")
    held = set()
    for entry in ours["metadata"]["requires-dist"]:
        stated = re.search(r"extra == '(\w+)'", entry.get("marker", ""))
        held.add((stated.group(1) if stated else "", entry["name"], entry.get("specifier", "")))
    assert held == wanted, "run `uv lock` after changing the dependencies"


def test_the_notice_lists_what_is_installed_beside_us(locked: list[dict[str, Any]]) -> None:
    beside = runpy.run_path(str(ROOT / ".ci" / "notice.py"))["installed_beside"]()
    text = (ROOT / "NOTICE").read_text(encoding="utf-8")
    listed = re.findall(r"^(\S+)  (\S.*)$", text, re.MULTILINE)
    assert {name for name, _ in listed} == beside, "run .ci/notice.py"
    assert not [name for name, licence in listed if "not stated" in licence or "not installed" in licence]


def _flat(extra: str, extras: dict[str, list[str]]) -> list[str]:
    """Requirements of an extra, those of the extras that it builds on among them."""
    found: list[str] = []
    for text in extras[extra]:
        inner = re.fullmatch(r"dynident\[(\w+)\]", text)
        found += _flat(inner.group(1), extras) if inner else [text]
    return found


def _split(requirement: str) -> tuple[str, str]:
    """Name and version range of a requirement such as "psycopg[binary]>=3.2"."""
    found = re.fullmatch(r"([A-Za-z0-9_.-]+)(?:\[[\w,-]+\])?(.*)", requirement)
    assert found is not None, requirement
    return found.group(1), found.group(2)
