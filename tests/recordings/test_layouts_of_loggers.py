"""Files in the layouts of many loggers: columns, order, units and times are told without a question, and read right."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from logger_layouts import LAYOUTS, WITHOUT_TIME, Recorded
from oracles import arm, fourier_motion, pinocchio_torque

from dynident.desk.reading import read_recordings
from dynident.identification.imports.guess import propose
from dynident.identification.imports.inspecting import sample_of
from dynident.identification.imports.units import factor_of
from dynident.robot import Robot

CASES = [("ur10", 200.0, 1), ("franka_panda", 125.0, 2), ("crooked", 250.0, 3)]
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@cache
def machine(name: str) -> Robot:
    return arm(name)


def recorded(name: str, rate: float, seed: int) -> Recorded:
    """Measured on a robot that moves by its description, with friction and some noise."""
    robot, rng = machine(name), np.random.default_rng(seed)
    motion = fourier_motion(robot, 10.0, rate, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = tau + 0.01 * np.abs(tau).max(axis=0) * (np.sign(motion.dq) + rng.normal(0.0, 0.3, tau.shape))
    slides = tuple(joint.kind == "prismatic" for joint in robot.joints)
    return Recorded(tuple(robot.joint_names), motion.t, motion.q, motion.dq, tau, slides, rng)


def read_as_proposed(path: Path, robot: Robot, rate: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t (m,), q and tau (m, n) of a file in SI, in the robot's order, as its columns and units are proposed."""
    sample = sample_of(path, rate)
    proposal = propose(sample, robot)
    assert proposal.questions == ()
    values = dict(zip(sample.names, sample.values.T, strict=True))
    signals = []
    for kind in ("q", "tau"):
        for j, joint in enumerate(robot.joints):
            unit = proposal.units.get(f"{kind}{j + 1}", proposal.units.get(kind))
            factor = 1.0 if unit is None else factor_of(kind, joint.kind, unit)
            signals.append(factor * values[proposal.columns[f"{kind}{j + 1}"]])
    t = _TIMES[proposal.units.get("t", "s")] * values[proposal.columns["t"]]
    both = np.column_stack(signals)
    return t - t[0], both[:, : robot.n], both[:, robot.n :]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_read_as_it_was_measured(tmp_path, layout, case):
    name, rate, _ = case
    robot, run = machine(name), recorded(*case)
    path = LAYOUTS[layout](tmp_path, run)
    t, q, tau = read_as_proposed(path, robot, rate if layout in WITHOUT_TIME else None)
    # Whole nanoseconds since 1970 lose their last 256 as numbers.
    np.testing.assert_allclose(t, run.t[: len(t)], atol=1e-6)
    for measured, truth in ((q, run.q), (tau, run.tau)):
        wrong = np.abs(measured - truth[: len(t)])
        # Between samples a signal is read in a straight line, which smooths its noise.
        assert np.quantile(wrong, 0.99) < 0.02 * np.abs(truth).max()
        if layout not in ("sparse_topics", "file_a_signal"):
            assert wrong.max() < 1e-6 * np.abs(truth).max()


@pytest.mark.parametrize("layout", ["rostopic", "sparse_topics", "json_lines", "iso_dates", "file_a_signal", "no_time"])
def test_an_import_gives_what_the_look_at_the_file_proposed(tmp_path, layout):
    case = CASES[0]
    robot, run = machine(case[0]), recorded(*case)
    path, rate = LAYOUTS[layout](tmp_path, run), case[1] if layout in WITHOUT_TIME else None
    proposal = propose(sample_of(path, rate), robot)
    files = tuple(path.parent / one for one in path.name.split("+"))
    (item,) = read_recordings(
        files, robot=robot, columns=dict(proposal.columns), units=dict(proposal.units), rate=rate
    )
    assert item.recording.n_samples >= len(run.t) - 2
    assert abs(item.recording.sampling_rate - case[1]) < 0.01 * case[1]
    frame = item._columns().values
    for j, joint in enumerate(robot.joint_names):
        stored = frame[f"tau_{joint}"][: len(run.t)]
        assert np.corrcoef(stored, run.tau[: len(stored), j])[0, 1] > 0.99
