"""A small arm with one hidden effect, as files that a user would have."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.running_commands import dynident, write_run

from dynident.robot.bundled_arms import library_table


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the robot, two recordings, and a first model."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "arm.json").write_text(library_table("scara"), encoding="utf-8")
    write_run(folder / "run1.csv", 1)
    write_run(folder / "run2.csv", 2)
    answer = dynident(
        "identify", folder / "arm.json", folder / "run1.csv", "-v", folder / "run2.csv", "-o", folder / "model.npz"
    )
    assert answer.code == 0, answer.err
    return folder
