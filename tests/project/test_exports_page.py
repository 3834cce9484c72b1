"""The page about exports holds: its commands write the files, and its programs read the same torque from each."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.page_blocks import blocks_of
from support.page_commands import run_commands

PAGE = Path(__file__).resolve().parents[2] / "docs" / "exports.md"


def blocks(language: str) -> list[str]:
    return [one.text for one in blocks_of(PAGE) if one.language == language and not one.marked]


def run(command: list[str], folder: Path) -> str:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=800, env={**os.environ, "PATH": path}, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", text)])


@pytest.mark.slow
def test_the_files_of_the_page_tell_the_same_torque(tmp_path: Path) -> None:
    export, compile_it = blocks("sh")
    run_commands(tmp_path, export)
    program = "import numpy\nnumpy.set_printoptions(precision=15, linewidth=400)\n" + "\n".join(blocks("python"))
    said = run([sys.executable, "-c", program], tmp_path)
    torque = {line.split()[0]: numbers(line) for line in said.splitlines()}
    assert set(torque) == {"urdf", "mjcf", "whole", "casadi", "json"}
    np.testing.assert_allclose(torque["mjcf"], torque["urdf"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(torque["whole"], torque["json"], rtol=1e-9, atol=1e-9)
    # CasADi prints six digits.
    np.testing.assert_allclose(torque["casadi"], torque["json"], rtol=1e-5)
    # The offset of each joint, which links do not have, is between the two kinds of formats.
    assert 0 < np.abs(torque["json"] - torque["urdf"]).max() < 1.0
    if shutil.which("gcc") is None:
        pytest.skip("NO C COMPILER: the page's C program is not tested here")
    (tmp_path / "main.c").write_text(blocks("c")[0], encoding="utf-8")
    run(["bash", "-c", compile_it], tmp_path)
    np.testing.assert_allclose(numbers(run(["./main"], tmp_path)), torque["json"], rtol=1e-9)
    (tmp_path / "main.cpp").write_text(blocks("cpp")[0], encoding="utf-8")
    run(["g++", "-std=c++17", "-O2", "main.cpp", "-o", "main_cpp"], tmp_path)
    lines = run(["./main_cpp"], tmp_path).splitlines()
    np.testing.assert_allclose(numbers(lines[0]), torque["json"], rtol=1e-9)
