"""A gripper that publishes on the topic of the arm: its messages stand between those of the arm, and are no gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import log

from dynident.identification.column_inference.file_inspection import inspect_file

JOINTS = [f"iiwa_joint_{k}" for k in range(1, 7)]


def print_messages(path: Path, every: int, fingers: list[str]) -> Path:
    """What `rostopic echo` prints, with lists over two lines, and no velocities."""
    given, text = log("ur10", 3), ""

    def put(seconds: float, seq: int, names: list[str], q: np.ndarray, tau: np.ndarray) -> str:
        nsecs = round(seconds % 1.0 * 1e9)
        stamp = f"header: \n  seq: {seq}\n  stamp: \n    secs: {int(seconds)}\n    nsecs: {nsecs}\n  frame_id: ''\n"
        lists = {"name": names, "position": map(repr, q.tolist()), "velocity": [], "effort": map(repr, tau.tolist())}
        lines = (
            f"{key}: [{', '.join(items)}]".replace(f"{names[-1]}]", f"\n  {names[-1]}]") for key, items in lists.items()
        )
        return f"{stamp}{chr(10).join(lines)}\n---\n"

    for k, t in enumerate(given.t):
        text += put(1_600_000_000.0 + t, k, JOINTS, given.q[k], given.tau[k])
        if k % every == 0:
            text += put(1_600_000_000.003 + t, k, fingers, np.full(len(fingers), 0.01), np.zeros(0))
    path.write_text(text)
    return path


@pytest.mark.parametrize(("every", "fingers"), [(5, ["finger_l", "finger_r"]), (2, ["gripper"])])
def test_messages_of_a_gripper_are_no_rows_of_the_arm(tmp_path: Path, every: int, fingers: list[str]) -> None:
    found = inspect_file(print_messages(tmp_path / "echo.txt", every, fingers), log("ur10", 3).robot)
    assert found.proposal is not None
    columns = found.proposal.columns
    assert [columns[f"q{k}"] for k in range(1, 7)] == [f"position_{name}" for name in JOINTS]
    assert [columns[f"tau{k}"] for k in range(1, 7)] == [f"effort_{name}" for name in JOINTS]
    clock = next(guess for guess in found.proposal.guesses if guess.field == "columns/t")
    assert "100 Hz; jitter 0.0" in clock.reason
