"""A recording that passed the checks against its robot is not checked again, by no process of the same user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.expressions import code_cache
from dynident.identification import robot_recording_import
from dynident.identification.recording_faults import build_dynamics_checks
from dynident.recordings import Check, Recording
from dynident.recordings.recording import ModelChecks
from dynident.robot import Robot

ROBOT = arm("scara")
Q, TAU = ([f"{name}{k + 1}" for k in range(ROBOT.n)] for name in ("q", "tau"))


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Recording]:
    """The recordings that were checked, with a cache of their own."""
    recordings: list[Recording] = []

    def build(robot: Robot) -> ModelChecks:
        def check(recording: Recording, q: Sequence[str], tau: Sequence[str]) -> tuple[Check, ...] | None:
            recordings.append(recording)
            return build_dynamics_checks(robot)(recording, q, tau)

        return check

    monkeypatch.setenv(code_cache.SETTING, str(tmp_path))
    monkeypatch.setattr(robot_recording_import, "build_dynamics_checks", build)
    return recordings


def make_recording(signs: Sequence[float] = (1.0, 1.0, 1.0, 1.0)) -> Recording:
    motion = fourier_motion(ROBOT, 20.0, 100.0, 1)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 3.0 * np.sign(motion.dq) + 2.0 * motion.dq
    tau += np.random.default_rng(1).normal(0.0, 0.15, tau.shape)
    return record(ROBOT, motion, np.array(signs[: ROBOT.n]) * tau)


def check(robot: Robot, recording: Recording) -> tuple[Check, ...] | None:
    return robot_recording_import.skip_passed_checks(robot)(recording, Q, TAU)


def test_what_passed_is_not_checked_again(checked: list[Recording]) -> None:
    first, again = check(ROBOT, make_recording()), check(ROBOT, make_recording())
    assert first
    assert {item.status for item in first} == {"ok"}
    assert again == first
    assert len(checked) == 1


def test_another_row_robot_name_or_library_is_checked(
    checked: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = make_recording()
    check(ROBOT, recording)
    (rows,) = recording.source.rows(0, recording.n_samples, recording.n_samples)
    other = rows.tau.copy()
    other[7, 1] += 1e-9
    check(ROBOT, replace(recording, source=replace(recording.source, tau=other)))
    check(replace(ROBOT, gravity=np.array([0.0, 0.0, -9.8])), recording)
    check(ROBOT, replace(recording, joint_names=tuple(name.upper() for name in recording.joint_names)))
    assert len(checked) == 4
    monkeypatch.setattr(robot_recording_import, "describe_library", lambda: "of tomorrow")
    check(ROBOT, recording)
    assert len(checked) == 5


def test_what_did_not_pass_is_checked_each_time(checked: list[Recording]) -> None:
    first, again = (check(ROBOT, make_recording((1.0, -1.0, 1.0, 1.0))) for _ in range(2))
    assert first
    assert {item.status for item in first} != {"ok"}
    assert again == first
    assert len(checked) == 2
