"""The how-tos hold: each page's commands and programs run in their order, as one with a small arm would type them."""

from __future__ import annotations

import contextlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.floating_robots import WALKER, compute_motor_torque, draw_motion, stand_on_shin, write_log
from support.page_blocks import Block, blocks_of, commands
from support.page_commands import run_commands

from dynident.robot import robot_from_library, urdf_from_robot

PAGES = Path(__file__).resolve().parents[2] / "docs" / "how-to"
# What a page promises, in what its blocks tell.
PROMISED = {
    "foreign-file.md": ("actual_pos_1", "held out", "Stribeck friction"),
    "gripper.md": ("'tool_roll')", "held-out error", "model written to model.npz"),
    "currents.md": ("held out",),
    "my-error-is-12-percent.md": ("held out", "noise"),
    "point-to-point-robot.md": ("held out", "stands"),
    "which-effect.md": ("reversals.csv",),
    "floating-base.md": ("3 joints on a floating base", "base_roll", "held out", "mass of the walker: 12.7 kg"),
    "humanoid.md": ("a robot of more than 12 joints", "held out", "21 others", " of 29 joints;", "written to g1.npz"),
    "small-arm-with-lerobot.md": ("units/q deg", "held out", "model written to arm.npz", "Stribeck friction"),
    "how-many-runs.md": ("goal of 3.00 % is reached", "The model is runs/model.npz", "Campaign(scara"),
    "simulator-and-controller.md": ("positions after 100 steps", "gravity and offsets", "model.c"),
}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a reader has: a SCARA's URDF, also with a gripper, and two recordings, also as currents."""
    folder = tmp_path_factory.mktemp("how-to")
    text = urdf_from_robot(robot_from_library("scara"))
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    last = re.findall(r'<child link="([^"]+)"', text)[-1]
    finger = (
        f'<link name="finger"/><joint name="finger_joint" type="prismatic"><parent link="{last}"/>'
        '<child link="finger"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="1"/></joint></robot>'
    )
    (folder / "arm_with_gripper.urdf").write_text(text.replace("</robot>", finger), encoding="utf-8")
    (folder / "walker.urdf").write_text(WALKER, encoding="utf-8")
    for seed in (1, 2):
        motion = draw_motion(seed)
        torque, wrench = compute_motor_torque(motion)
        write_log(folder / f"harness{seed}.csv", motion, torque, {"base": wrench}, noise=0.01, seed=seed)
        torque, wrench = stand_on_shin(motion)
        write_log(folder / f"sensor{seed}.csv", motion, torque, {"shin": wrench}, noise=0.01, seed=seed)
        write_log(folder / f"standing{seed}.csv", motion, torque, noise=0.01, seed=seed)
    for seed in (1, 2):
        # Wear at low speed, so that there is something to be diagnosed.
        asked = f"simulate arm.urdf --rate 100 --seed {seed}"
        run_commands(folder, f"dynident {asked} --effects stribeck@elbow --out run{seed}.csv")
        run_commands(folder, f"dynident {asked} --current --drive-gains 14.9,13.3,100,1.1 --out currents{seed}.csv")
    return folder


def in_order(page: Path) -> Iterator[Block]:
    """The blocks to run: those that prepare first."""
    text = page.read_text(encoding="utf-8")
    setup = re.findall(r"^```python setup\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    yield from (Block("python", one, False) for one in setup)
    yield from (one for one in blocks_of(page) if not one.marked and one.language in ("sh", "python"))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(PROMISED))
def test_the_page_can_be_followed(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    shutil.copytree(cell, tmp_path, dirs_exist_ok=True)
    said: list[str] = []

    def dynident(*arguments: str) -> None:
        said.append(run_commands(tmp_path, " ".join(["dynident", *arguments])))

    names: dict[str, Any] = {"dynident": dynident}
    for block in in_order(PAGES / name):
        if block.language == "python":
            with contextlib.chdir(tmp_path):
                exec(block.text, names)
            said.append(capsys.readouterr().out)
        else:
            said.append(run_commands(tmp_path, "\n".join(commands(block.text))))
    told = re.sub(r"\s+", " ", "".join(said))
    for words in PROMISED[name]:
        assert words in told, told


def test_every_page_is_followed_and_none_needs_more_than_six_commands_to_the_first_error() -> None:
    assert {page.name for page in PAGES.glob("*.md")} == set(PROMISED)
    first = (PAGES / "foreign-file.md").read_text(encoding="utf-8").split("## If a question is open")[0]
    typed = re.findall(r"^(?:pip|dynident) .*$", first, re.MULTILINE)
    assert typed[0].startswith("pip install")
    assert next(k for k, line in enumerate(typed) if "identify" in line) < 6
    assert len(typed) <= 6
