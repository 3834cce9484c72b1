"""Every block of the pages runs as it is written, or says on the line before it why not."""

from __future__ import annotations

import ast
import csv
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import pytest
from support.page_commands import run_commands

import dynident as dy
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import ReasonCode
from dynident.robot import Drive, robot_from_library, urdf_from_robot
from dynident_client import Client

sys.path.append(str(Path(__file__).parents[1] / "service"))
from service_helpers import serving
from support.page_blocks import blocks_of, commands

from dynident_service.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
HERE = str(Path(__file__).relative_to(ROOT))
# Where the blocks of a page are run from its own text, and in which languages; what is not run is marked in the page.
RUN_BY = {
    "README.md": ("tests/project/test_readme.py", "sh python"),
    "tutorial.md": ("docs/figures.py", "sh python"),
    "exports.md": ("tests/project/test_exports_page.py", "sh python c cpp"),
    "closed-loops.md": ("tests/identification/test_identifying_closed_loops.py", "json sh"),
    "notebook.md": ("tests/api/test_the_page_about_notebooks.py", "python"),
    "own-effects.md": ("tests/support/own_effects_page.py", "python toml sh"),
    **{page.name: ("tests/project/test_how_to_pages.py", "sh python") for page in (ROOT / "docs/how-to").glob("*.md")},
    "methods.md": (HERE, "sh"),
    "diagnosis.md": (HERE, "sh python"),
    "experiments.md": (HERE, "sh"),
    "surroundings.md": (HERE, "json"),
    "my-robot.md": (HERE, "json sh text"),
    "drive-chain.md": (HERE, "json sh"),
    "http-service.md": (HERE, "sh"),
}


def to_run(page: str, language: str) -> list[str]:
    """The blocks of a page in docs/ in one language, without those that it says are not run."""
    return [one.text for one in blocks_of(ROOT / "docs" / page) if one.language == language and not one.marked]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_is_run_by_a_test_or_says_why_not(page: Path) -> None:
    runner, languages = RUN_BY.get(page.name, (HERE, ""))
    left = {one.language or "none" for one in blocks_of(page) if not one.marked} - set(languages.split())
    assert not left, f"{page.name}: blocks in {', '.join(sorted(left))} are run by no test, and none says why"
    assert not languages or f'"{page.name}"' in (ROOT / runner).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_stand_in_blocks_that_are_seen(page: Path) -> None:
    """Not indented: such blocks have no language, and nobody runs them."""
    prose = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert not re.findall(r"^    (?:dynident|curl|docker|pip) .*$", prose, re.MULTILINE)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a SCARA's URDF, recordings under every name that the pages use, and a model."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "arm.urdf").write_text(urdf_from_robot(robot_from_library("scara")), encoding="utf-8")
    for seed, name in enumerate(("run1", "run2", "june", "july", "night1", "night2", "night3")):
        run_commands(folder, f"dynident simulate arm.urdf --rate 100 --seed {seed} --out {name}.csv")
    for seed in (1, 2):
        asked = f"simulate arm.urdf --rate 100 --seed {seed} --current --drive-gains 14.9,13.3,100,1.1"
        run_commands(folder, f"dynident {asked} --out currents{seed}.csv")
    run_commands(folder, "dynident identify arm.urdf run1.csv -v run2.csv --out model.npz")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", ["methods.md", "diagnosis.md", "drive-chain.md"])
def test_commands_of_the_page_run(cell: Path, page: str) -> None:
    for block in to_run(page, "sh"):
        assert run_commands(cell, "\n".join(commands(block)))


def called_otherwise(run: Path, file: Path) -> None:
    """The same recording as another logger would write it: other names, milliseconds, degrees."""
    rows = list(csv.reader(run.open(encoding="utf-8")))
    kinds = {"q": "actual_pos", "current": "motor_current"}
    parts = [re.fullmatch(r"([a-z]+)(\d?)", head) for head in rows[0]]
    heads = [f"{kinds[one[1]]}_{one[2]}" if one and one[1] in kinds else "time_ms" for one in parts]
    scale = [1e3 if head == "time_ms" else 1.0 for head in heads]
    scale = [
        180 / math.pi if one in ("actual_pos_1", "actual_pos_2", "actual_pos_4") else by
        for one, by in zip(heads, scale, strict=True)
    ]
    with file.open("w", newline="", encoding="utf-8") as written:
        csv.writer(written).writerows(
            [heads, *([float(x) * s for x, s in zip(row, scale, strict=True)] for row in rows[1:])]
        )


@pytest.mark.slow
def test_the_file_of_the_page_that_calls_things_otherwise_is_read(cell: Path) -> None:
    for seed, name in ((1, "fit.csv"), (2, "other.csv")):
        called_otherwise(cell / f"currents{seed}.csv", cell / name)
    told = run_commands(cell, "\n".join(commands(to_run("my-robot.md", "sh")[0])))
    assert "actual_pos_1" in told
    assert "held out" in told


def test_the_table_of_the_page_is_a_robot_of_three_joints(tmp_path: Path) -> None:
    (tmp_path / "arm.txt").write_text(to_run("my-robot.md", "text")[0], encoding="utf-8")
    assert dy.load_robot(tmp_path / "arm.txt").joint_names == ("joint1", "joint2", "joint3")


@pytest.mark.slow
def test_every_design_of_the_page_gives_its_file(cell: Path) -> None:
    for command in commands(to_run("experiments.md", "sh")[0]):
        # The page's own commands take minutes: here with little time and few samples.
        run_commands(cell, f"{command} --time-budget 1 --rate 50")
        assert (cell / command.split("--out ")[1]).stat().st_size > 0


@pytest.mark.slow
def test_the_days_of_the_page_are_followed_in_python(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell)
    model = dy.load_model(cell / "model.npz")
    runs = dy.read_recordings(cell / "run1.csv", cell / "run2.csv", robot=model.robot)
    names: dict[str, Any] = {"dy": dy, "model": model.with_data(runs[:1], runs[1:]), "runs": runs}
    for block in to_run("diagnosis.md", "python"):
        exec(block, names)
    assert names["followed"].summary


@pytest.mark.slow
def test_the_surroundings_of_the_page_are_kept(tmp_path: Path) -> None:
    (tmp_path / "cell.json").write_text(to_run("surroundings.md", "json")[0], encoding="utf-8")
    asked = "design franka_panda --kind random --surroundings cell.json"
    arms = {
        **json.loads((tmp_path / "cell.json").read_text()),
        "may_touch": [["joint5", "joint7"]],
        "link_radius": 0.05,
    }
    # The library's arm has no links by these names.
    (tmp_path / "cell.json").write_text(json.dumps(arms), encoding="utf-8")
    assert "box 'table'" in run_commands(tmp_path, f"dynident {asked} --duration 3 --rate 50 --json")


@pytest.mark.parametrize("page", ["my-robot.md", "drive-chain.md"])
def test_the_robot_of_the_page_can_be_read(tmp_path: Path, page: str) -> None:
    document = json.loads(to_run(page, "json")[0])
    text = urdf_from_robot(robot_from_library("franka_panda"))
    finger = (
        '<link name="finger"/><joint name="finger_joint" type="prismatic"><parent link="{}"/><child link="finger"/>'
    )
    finger += '<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="1"/></joint></robot>'
    last = re.findall(r'<child link="([^"]+)"', text)[-1]
    document["description"]["content"] = text.replace("</robot>", finger.format(last))
    (tmp_path / "robot.json").write_text(json.dumps(document), encoding="utf-8")
    robot = dy.load_robot(tmp_path / "robot.json")
    assert set(document["drives"]) == {
        name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if drive != Drive()
    }


@dataclass(frozen=True)
class Served:
    """A service, and the folder that it keeps its data in."""

    url: str
    data: Path


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Served]:
    data = tmp_path / "data"
    with serving(Settings(data_dir=data, workers=2, port=0, log_level="warning")) as url:
        yield Served(url, data)


@pytest.mark.slow
def test_the_requests_of_the_page_are_accepted(cell: Path, service: Served) -> None:
    if shutil.which("curl") is None:
        pytest.skip("NO CURL: the requests of http-service.md are not tested here")
    body = {"name": "arm", "description": {"format": "urdf", "content": (cell / "arm.urdf").read_text()}}
    (cell / "robot.json").write_text(json.dumps(body), encoding="utf-8")
    known: dict[str, str] = {}
    other = ""
    data = service.data
    for block in to_run("http-service.md", "sh"):
        for command in commands(block):
            if command.startswith("dynident "):
                for name in ("dynident-data", "/mnt/backup", "new-data", "other-data"):
                    command = command.replace(
                        name, str(data if name == "dynident-data" else data.parent / Path(name).name)
                    )
                run_commands(data.parent, command.replace("rob_…", known["rob"]))
                continue
            command = command.replace('"validation_ids": ["mea_…"]', f'"validation_ids": ["{other}"]')
            for prefix, identifier in known.items():
                command = command.replace(f"{prefix}_…", identifier)
            done = subprocess.run(
                ["bash", "-c", command.replace("localhost:8000", service.url)], cwd=cell, capture_output=True, text=True
            )
            made = json.loads(done.stdout)
            assert "id" in made, made
            known[made["id"][:3]] = made["id"]
            with Client(service.url) as client:
                if made["id"].startswith("rob"):
                    other = client.measurements.upload(client.robots.get(made["id"]), cell / "run2.csv").id
                if "job_id" in made:
                    assert list(client.jobs.events(made["job_id"]))
    assert set(known) >= {"rob", "mea", "idn", "val"}


def find_check_names() -> Iterator[str]:
    """The names of all checks of a recording that the library spells out where it makes the check."""
    for path in (ROOT / "src" / "dynident").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
        first = [call.args[0] for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Check"]
        yield from (name.value for name in first if isinstance(name, ast.Constant))


def test_the_table_of_checks_has_all_checks() -> None:
    page = (ROOT / "docs" / "my-robot.md").read_text(encoding="utf-8")
    # What a cure did is reported as a check, too; it finds nothing.
    names = set(find_check_names()) - {"cure"}
    assert len(names) > 20
    assert [name for name in sorted(names) if f"`{name}`" not in page] == []


def test_the_page_of_the_diagnosis_has_its_reasons_and_levels() -> None:
    page = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert [code for code in get_args(ReasonCode) if f"`{code}`" not in page] == []
    assert f"more than {RULES.part_to_part:g} times that of the fit" in page
    assert f"or that of all\n  joints together by {RULES.least_drop:.0%}".replace("%", " %") in page
