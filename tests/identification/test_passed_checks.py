"""A recording that passed the checks against its robot is not checked again, by no process of the same user."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType

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
    monkeypatch.setattr(code_cache, "describe_library", lambda: "of tomorrow")
    check(ROBOT, recording)
    assert len(checked) == 5


def test_what_did_not_pass_is_checked_each_time(checked: list[Recording]) -> None:
    first, again = (check(ROBOT, make_recording((1.0, -1.0, 1.0, 1.0))) for _ in range(2))
    assert first
    assert {item.status for item in first} != {"ok"}
    assert again == first
    assert len(checked) == 2


def find_entries(folder: Path) -> list[Path]:
    """Return the files of checks; those of compiled code hold no list."""
    hash_size = sha256().digest_size
    return [path for path in (folder / "code").iterdir() if path.read_bytes()[hash_size:].startswith(b"[")]


@pytest.mark.parametrize("data", [b"\xff", b"{}", b"null", b"5", b"[]", b"[[1]]", b"[[1, 2]]", b'{"ab": 1}', b'["ab"]'])
def test_an_entry_of_something_else_is_checked_again(checked: list[Recording], tmp_path: Path, data: bytes) -> None:
    first = check(ROBOT, make_recording())
    (entry,) = find_entries(tmp_path)
    entry.write_bytes(sha256(data).digest() + data)
    assert check(ROBOT, make_recording()) == first
    assert len(checked) == 2


def test_nothing_is_kept_of_what_did_not_pass(checked: list[Recording], tmp_path: Path) -> None:
    check(ROBOT, make_recording((1.0, -1.0, 1.0, 1.0)))
    assert find_entries(tmp_path) == []


def test_what_cannot_be_pickled_is_checked_each_time(checked: list[Recording]) -> None:
    recording = replace(make_recording(), payload=MappingProxyType({"mass": 1.0}))
    assert check(ROBOT, recording) == check(ROBOT, recording)
    assert len(checked) == 2


def test_without_a_cache_nothing_is_hashed(checked: list[Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(code_cache.SETTING, "")
    monkeypatch.setattr(robot_recording_import, "sha256", lambda *_: pytest.fail("there is no cache"))
    assert check(ROBOT, make_recording())
    assert len(checked) == 1


def test_another_python_or_package_is_another_library(monkeypatch: pytest.MonkeyPatch) -> None:
    described = code_cache.describe_library.__wrapped__()
    for package in ("numpy", "scipy", "casadi", "pin"):
        with monkeypatch.context() as patch:
            patch.setattr(code_cache, "version", lambda name, own=package: "0.0" if name == own else version(name))
            assert code_cache.describe_library.__wrapped__() != described
    monkeypatch.setattr(sys, "version", "4.0")
    assert code_cache.describe_library.__wrapped__() != described
