"""Who installed less than they use is told what to install."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dynident.optional_dependencies import EXTRA_OF_PACKAGE, SCIENCE_PACKAGES, format_install_hint
from dynident.version import __version__
from dynident_cli.program_and_exit_codes import app

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
IMPORTED_AS = {"pin": ("pinocchio", "coal")}
FEW_IMPORTED_AS = {"opentelemetry-sdk": "opentelemetry", "opentelemetry-exporter-otlp-proto-http": "opentelemetry"}


def without_packages(program: str) -> subprocess.CompletedProcess[str]:
    """Run a program by a Python that has this project and nothing else."""
    paths = f"import sys; sys.path[:0] = [{str(ROOT / 'src')!r}, {str(ROOT / 'service')!r}]\n"
    command = [sys.executable, "-I", "-S", "-c", paths + program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_version_is_known_without_any_package() -> None:
    ended = without_packages("import dynident; print(dynident.__version__)")
    assert ended.stdout.strip() == __version__, ended.stderr


@pytest.mark.parametrize("room", ["dynident.robot", "dynident.identification", "dynident.array_types"])
def test_a_room_that_needs_science_says_so(room: str) -> None:
    ended = without_packages(f"import {room}")
    last = ended.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ModuleNotFoundError: {room} needs the package ")
    assert last.endswith("install it with: pip install 'dynident[science]'")


def test_a_name_of_the_library_says_so_too() -> None:
    ended = without_packages("import dynident; dynident.load_robot")
    assert "install it with: pip install 'dynident[science]'" in ended.stderr


def test_the_command_line_asks_for_the_extra_that_brings_it() -> None:
    ended = without_packages("from dynident_cli.__main__ import main; main()")
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


WITHOUT_SERVICE = """
import sys
for one in {left_out!r}:
    sys.modules[one] = None
from pathlib import Path
from typer.testing import CliRunner
from dynident.robot import robot_from_library, urdf_from_robot
from dynident_cli.program_and_exit_codes import app
Path("arm.urdf").write_text(urdf_from_robot(robot_from_library("scara")))
for line in {commands!r}:
    ended = CliRunner().invoke(app, line.split(), prog_name="dynident")
    print(ended.exit_code, line.split()[0], " ".join(ended.output.split())[-120:] if ended.exit_code else "")
"""
OF_SCIENCE = """\
simulate arm.urdf --rate 100 --effects stribeck@elbow --out run1.csv
simulate arm.urdf --rate 100 --seed 1 --effects stribeck@elbow --out run2.csv
simulate arm.urdf --rate 100 --seed 2 --current --drive-gains 14.9,13.3,100,1.1 --out currents.csv
design arm.urdf --kind random --duration 4 --out motion.csv
inspect run1.csv --robot arm.urdf
identify arm.urdf run1.csv -v run2.csv --out model.npz
currents arm.urdf currents.csv
compare model.npz run2.csv
diagnose model.npz run1.csv --candidates stribeck --out diagnosis.json
extend model.npz run1.csv -v run2.csv --diagnosis diagnosis.json --out better.npz
ladder better.npz
report better.npz run1.csv -v run2.csv --diagnosis diagnosis.json --out report.html
changes model.npz --before run1.csv --after run2.csv
series model.npz run1.csv run2.csv
validate model.npz inertia_matrix
essential model.npz
export model.npz --out model.c
effects"""
OF_SERVICE = "serve --port 0\ndoctor\nbackup x\nrestore x\nexport-robot rob_x a.zip\nimport-robot a.zip"


@pytest.mark.slow
def test_without_the_service_every_other_command_works_and_its_own_say_what_to_install(tmp_path: Path) -> None:
    own = [re.split(r"[<>=\[]", one)[0] for one in EXTRAS["service"] if not one.startswith("dynident")]
    renamed = {"python-multipart": "python_multipart", "pydantic-settings": "pydantic_settings"}
    left_out = [*(renamed.get(name, name.replace("-", "_")) for name in own), "dask", *EXTRA_OF_PACKAGE]
    commands = [*OF_SCIENCE.splitlines(), *OF_SERVICE.splitlines()]
    paths = {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT / "service")])}
    program = WITHOUT_SERVICE.format(left_out=left_out, commands=commands)
    command = [sys.executable, "-c", program]
    ended = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, **paths}, capture_output=True, text=True, timeout=800
    )
    told = ended.stdout.splitlines()
    assert len(told) == len(commands), ended.stderr
    for line in told[: len(OF_SCIENCE.splitlines())]:
        assert line.startswith("0 "), line
    for line in told[len(OF_SCIENCE.splitlines()) :]:
        assert line.startswith("2 "), line
        assert line.endswith("pip install 'dynident[service]'"), line
    said = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `\[science\]` \|(.*)$", said, re.MULTILINE)
    assert set(re.findall(r"`([a-z-]+)`", row)) == {line.split()[0] for line in OF_SERVICE.splitlines()}


def test_hints_name_the_extra_that_pyproject_puts_a_package_in() -> None:
    science = {re.split(r"[<>=\[]", text)[0] for text in EXTRAS["science"]}
    imported = {name for one in science for name in IMPORTED_AS.get(one, (one.replace("-", "_"),))}
    assert set(SCIENCE_PACKAGES) == imported
    few = {
        re.split(r"[<>=\[]", one)[0]: extra
        for extra in ("formats", "frames", "mcp", "otel", "postgresql")
        for one in EXTRAS[extra]
    }
    assert {FEW_IMPORTED_AS.get(name, name): extra for name, extra in few.items()} == EXTRA_OF_PACKAGE
    assert "dynident[postgresql]" in format_install_hint("psycopg")
    assert "dynident[service]" in format_install_hint("uvicorn")
    assert "dynident[science]" in format_install_hint("numpy.linalg")
