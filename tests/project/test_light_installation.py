"""Who installed less than they use is told what to install."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dynident.extras import FEW_NEED, SCIENCE, install_hint
from dynident.version import __version__
from dynident_service.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
IMPORTED_AS = {"pin": ("pinocchio", "coal")}


def without_packages(program: str) -> subprocess.CompletedProcess[str]:
    """Run a program by a Python that has this project and nothing else."""
    paths = f"import sys; sys.path[:0] = [{str(ROOT / 'src')!r}, {str(ROOT / 'service')!r}]\n"
    command = [sys.executable, "-I", "-S", "-c", paths + program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_version_is_known_without_any_package() -> None:
    ended = without_packages("import dynident; print(dynident.__version__)")
    assert ended.stdout.strip() == __version__, ended.stderr


@pytest.mark.parametrize("room", ["dynident.robot", "dynident.identification", "dynident.arrays"])
def test_a_room_that_needs_science_says_so(room: str) -> None:
    ended = without_packages(f"import {room}")
    last = ended.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ModuleNotFoundError: {room} needs the package ")
    assert last.endswith("install it with: pip install 'dynident[science]'")


def test_a_name_of_the_library_says_so_too() -> None:
    ended = without_packages("import dynident; dynident.load_robot")
    assert "install it with: pip install 'dynident[science]'" in ended.stderr


def test_the_command_line_asks_for_the_extra_that_brings_it() -> None:
    ended = without_packages("from dynident_service.command_line import main; main()")
    assert ended.returncode == 1
    assert ended.stderr.strip().endswith("pip install 'dynident[science]'")


def test_a_service_that_should_keep_its_tables_in_postgresql_says_what_that_needs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    monkeypatch.setenv("DYNIDENT_DATABASE_URL", "postgresql://user@localhost/nothing")
    ended = CliRunner().invoke(app, ["serve", "--port", "0", "--data-dir", str(tmp_path)])
    assert ended.exit_code == 2
    assert "pip install 'dynident[postgresql]'" in " ".join(ended.output.split())


def test_hints_name_the_extra_that_pyproject_puts_a_package_in() -> None:
    science = {re.split(r"[<>=\[]", text)[0] for text in EXTRAS["science"]}
    imported = {name for one in science for name in IMPORTED_AS.get(one, (one.replace("-", "_"),))}
    assert set(SCIENCE) == imported
    few = {re.split(r"[<>=\[]", text)[0]: extra for extra in ("formats", "postgresql") for text in EXTRAS[extra]}
    assert few == FEW_NEED
    assert "dynident[postgresql]" in install_hint("psycopg")
    assert "dynident[service]" in install_hint("uvicorn")
    assert "dynident[science]" in install_hint("numpy.linalg")
