"""The README holds word by word: its thresholds and every snippet, run in its order on a virtual robot."""

import os
import re
import runpy
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.page_commands import run_commands

from dynident.identification import thresholds
from dynident.robot import robot_from_library, urdf_from_robot
from dynident.validation.contact_detection import HAND_CONTACT_FORCE_LIMIT

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROGRAMS = Path(sys.executable).parent


def test_the_page_of_effects_is_that_of_the_catalogue() -> None:
    page = runpy.run_path(str(ROOT / "docs" / "effects_table.py"))["page"]()
    assert page == (ROOT / "docs" / "effects.md").read_text(encoding="utf-8"), "run `python docs/effects_table.py`"


def test_the_thresholds_are_those_of_the_program() -> None:
    text = re.sub(r"\s+", " ", README[README.index("## Is my result any good?") : README.index("## In Python")])
    low, high = (f"{100 * share:.0f}" for share in thresholds.USUAL)
    least, most = (f"{100 * share:.0f}" for share in thresholds.USUAL_IN_FULL)
    for sentence in (
        f"at most {thresholds.LARGEST_ERROR:.0%} ({thresholds.LARGEST_TO_WEIGH:.0%} to weigh payloads), and no joint "
        f"above {thresholds.LARGEST_OF_JOINT:.0%}, each where it moves",
        f"above {HAND_CONTACT_FORCE_LIMIT:g} N the model is not fit",
        f"above {thresholds.STOP:.0%} means *stop*",
        f"{low}-{high}% is usual",
        f"{least}-{most}% once the missing effects are in",
        f"below {thresholds.FIRST_CONDITION_NUMBER:.0f} is good",
        f"per parameter** ({thresholds.EQUATIONS_PER_PARAMETER:.0f} and more)",
    ):
        assert sentence.replace("%", " %") in text, sentence
    assert thresholds.DETERMINED == 0.1
    assert "above a tenth of their value" in text
    assert f"more than {thresholds.OVERFIT:g} times the error of the fit" in text
    assert (thresholds.NOTABLE_DRIFT, thresholds.LARGEST_DRIFT) == (0.25, 0.5)
    assert "a quarter of its travel within half a second (above a half, the model is not fit)" in text


def test_the_two_commands_are_those_that_the_check_of_everything_runs() -> None:
    script = ROOT / ".ci" / "readme_block.py"
    for heading, end in (("See it work", "dynident demo\n"), ("Run the tests", "pytest -n auto --dist worksteal\n")):
        block = subprocess.run([sys.executable, script, heading], check=True, capture_output=True, text=True).stdout
        assert block.endswith(end)
        assert block in README
        assert f'readme "{heading}"' in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a user has the robot's URDF and works through the README."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "arm.urdf").write_text(urdf_from_robot(robot_from_library("ur10")), encoding="utf-8")
    run_commands(folder, blocks("Use it on my robot", "sh")[0])
    # The robot that the reader has at hand: it plays the designed motion twice, then another.
    hidden = "--effects stribeck@elbow_joint --rate 200"
    run_commands(folder, f"dynident simulate arm.urdf --trajectory trajectory.csv {hidden} --runs 2 --out run1.csv")
    run_commands(folder, f"dynident simulate arm.urdf {hidden} --seed 1 --out run2.csv")
    return folder


@pytest.mark.slow
def test_the_steps_on_my_robot_end_in_a_better_model_and_a_report(folder: Path) -> None:
    told = "".join(run_commands(folder, block) for block in blocks("Use it on my robot", "sh")[1:])
    assert "stribeck" in (folder / "diagnosis.json").read_text(encoding="utf-8")
    assert "Stribeck" in told
    assert "</html>" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_python_snippet_finds_the_missing_effect(folder: Path) -> None:
    told = python(folder, blocks("In Python", "python")[0])
    assert "Stribeck friction on elbow_joint" in told
    before, after = (float(share) for share in re.findall(r"([\d.]+)%", told.split("held-out error")[1])[:2])
    assert after < before


@pytest.fixture
def service(tmp_path: Path) -> Iterator[int]:
    """The service, started as the README says, but on a free port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = int(found.getsockname()[1])
    command = blocks("As a service", "sh")[0].strip().replace("8000", str(port))
    started = subprocess.Popen(["/bin/sh", "-c", f"exec {command}"], cwd=tmp_path, env=environment())
    try:
        wait_until_ready(f"http://127.0.0.1:{port}/readyz")
        yield port
    finally:
        started.terminate()
        started.wait(30)


@pytest.mark.slow
def test_the_client_snippet_ends_in_a_report(folder: Path, service: int) -> None:
    (folder / "report.html").unlink(missing_ok=True)
    told = python(folder, blocks("As a service", "python")[0].replace("8000", str(service)))
    first, *_, last = (float(number) for number in re.findall(r"[\d.]+(?:e-\d+)?", told))
    assert last < first
    assert "</html>" in (folder / "report.html").read_text(encoding="utf-8")


def blocks(heading: str, language: str) -> list[str]:
    """The fenced blocks of a language in a section, in their order."""
    section = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", README, re.MULTILINE | re.DOTALL)
    assert section is not None, heading
    found = re.findall(rf"^```{language}\n(.*?)^```$", section.group(1), re.MULTILINE | re.DOTALL)
    assert found
    return found


def environment() -> dict[str, str]:
    return {**os.environ, "PATH": f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "200"}


def python(folder: Path, block: str) -> str:
    return run([sys.executable, "-c", block], folder)


def run(command: list[str], folder: Path) -> str:
    ended = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=800)
    assert ended.returncode == 0, f"{command[-1]}\n{ended.stdout}\n{ended.stderr}"
    return ended.stdout


def wait_until_ready(url: str) -> None:
    deadline = time.monotonic() + 60
    while True:
        try:
            urllib.request.urlopen(url, timeout=5).close()
            return
        except (urllib.error.URLError, OSError):
            assert time.monotonic() < deadline, "the service does not become ready"
            time.sleep(0.1)
