"""Is it told what a column called "effort" holds? Right, "cannot tell", or certain and wrong.

    python benchmarks/effort_kinds.py [--seed 1 | --seed new] [--cases 40]

Recordings of real robots whose torques are made into what other drivers report: currents by drawn gains (known to the
robot or not), torques before drawn gears, torques without the load of gravity or without all that the robot's dynamics
need, in drawn units. Gravity and dynamics are those of parameters fitted to the recording with Pinocchio's
regressor, beside the description's, as a driver has them; friction stays in what is gravity-compensated, and half of
it in what is external. What is commanded is that of a controller: what the fitted parameters need on the smoothed
motion, and gains, drawn, times the measured position's and speed's distance from it, rounded to five digits.
"""

from __future__ import annotations

import argparse
import os
import secrets
from collections import Counter
from dataclasses import replace

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import pinocchio as pin
from common import FloatArray, show
from imports import DATA, robot_of
from planted_mistakes import columns_of, read_file, signals_of
from scipy.signal import butter, filtfilt

from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.torque_or_current import CANNOT_TELL
from dynident.robot import Drive, Robot
from dynident.robot.pinocchio_conversion import to_pinocchio

FILES = (
    "ur10e/id_30s_12harm",
    "ur10e/val_ptp10",
    "ur10/exciting_traj",
    "tx40/all",
    "kr300/id_A",
    "airbot_play/id_chirp_unloaded",
    "airbot_play/chirp_loaded",
    "dvrk_psm/base_one",
)
KINDS = ("joint_torque", "motor_current", "motor_torque", "gravity_compensated", "external", "commanded")
ROWS, PRIOR = 20_000, 0.03


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=48)
    options = parser.parse_args()
    seed = secrets.randbelow(10**6) if options.seed == "new" else int(options.seed)
    print(f"seed {seed}", flush=True)
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    read: dict[str, tuple[Robot, FloatArray, FloatArray, FloatArray]] = {}
    for number in range(options.cases):
        rng = np.random.default_rng([seed, number])
        file, kind = FILES[number % len(FILES)], KINDS[(number // len(FILES)) % len(KINDS)]
        if file not in read:
            read[file] = _recorded(file)
        robot, t, q, tau = read[file]
        machine, effort, told = _made(robot, t, q, tau, kind, rng)
        names = ("time", *(f"position_{j + 1}" for j in range(robot.n)), *(f"effort_{j + 1}" for j in range(robot.n)))
        found = propose(Sample(names, np.column_stack([t, q, effort]), {}), machine)
        why = next((one.reason for one in found.guesses if one.field == "effort_kind"), "")
        asked = any(one.field == "effort_kind" and one.choices for one in found.questions)
        outcome = (
            "cannot tell"
            if found.effort_kind == "unknown" or asked or (kind == "commanded" and CANNOT_TELL in why)
            else "right"
            if found.effort_kind == kind
            else "wrong"
        )
        counts[kind][outcome] += 1
        if outcome != "right":
            print(f"{number} {file} {kind} {told}: {outcome}: {found.effort_kind} ({why})", flush=True)
    words = ("right", "cannot tell", "wrong")
    rows = [("what it is", *words), *((kind, *(str(count[word]) for word in words)) for kind, count in counts.items())]
    show("Kinds of effort", rows)


def _recorded(file: str) -> tuple[Robot, FloatArray, FloatArray, FloatArray]:
    """The robot, and t (m,), q and tau (m, n) in SI units on an even grid."""
    robot = robot_of(file.split("/")[0])
    read = read_file(robot, columns_of(DATA / f"{file}.parquet"))
    assert read.recording is not None
    signals = signals_of(read.recording)[:ROWS]
    t = np.arange(len(signals)) * read.recording.period
    return replace(robot, drives=tuple(Drive() for _ in robot.joints)), t, signals[:, : robot.n], signals[:, robot.n :]


def _made(
    robot: Robot, t: FloatArray, q: FloatArray, tau: FloatArray, kind: str, rng: np.random.Generator
) -> tuple[Robot, FloatArray, str]:
    if kind == "joint_torque":
        unit, factor = (("N m", 1.0), ("mN m", 1e3))[rng.integers(2)]
        return robot, tau * factor, unit
    if kind == "motor_current":
        # The largest joint draws 2 to 40 A.
        gains = float(np.abs(tau).max()) / rng.uniform(2.0, 40.0) * rng.uniform(0.5, 1.5, robot.n)
        known = bool(rng.integers(2))
        drives = tuple(Drive(float(gain)) for gain in gains) if known else robot.drives
        unit, factor = (("A", 1.0), ("mA", 1e3))[rng.integers(2)]
        return replace(robot, drives=drives), tau / gains * factor, f"gains {np.round(gains, 1)} known {known} {unit}"
    if kind == "motor_torque":
        ratios = rng.choice([50.0, 80.0, 100.0, 101.0, 120.0, 160.0], robot.n)
        return robot, tau / ratios, f"ratios {ratios}"
    load, whole = _explained(robot, t, q, tau)
    if kind == "commanded":
        return robot, _controlled(t, q, whole, rng), ""
    return robot, tau - (load if kind == "gravity_compensated" else whole), ""


def _controlled(t: FloatArray, q: FloatArray, needed: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(m, n): what a controller with drawn gains commands that is to follow the smoothed positions."""
    rate = 1.0 / (t[1] - t[0])
    low = butter(4, min(10.0, 0.2 * rate) / (0.5 * rate))
    off = filtfilt(*low, q, axis=0) - q
    size = np.abs(needed).max(axis=0)
    stiffness, damping = size * rng.uniform(50.0, 500.0), size * rng.uniform(1.0, 10.0)
    speed = np.diff(off, axis=0, prepend=off[:1]) * rate
    torque = filtfilt(*low, needed, axis=0) + stiffness * off + damping * speed
    step = 1e-5 * np.abs(torque).max()
    return np.asarray(np.round(torque / step) * step)


def _explained(robot: Robot, t: FloatArray, q: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m, n) each: load of gravity, and all that the fitted parameters and half of the friction make."""
    rate = 1.0 / (t[1] - t[0])
    low = butter(4, min(10.0, 0.2 * rate) / (0.5 * rate))
    smooth = filtfilt(*low, q, axis=0)
    dq = np.gradient(smooth, 1.0 / rate, axis=0)
    ddq = np.gradient(dq, 1.0 / rate, axis=0)
    model = to_pinocchio(robot)
    data, still = model.createData(), np.zeros(robot.n)
    every = max(1, len(t) // 1500)
    rows, target = [], []
    for k in range(0, len(t), every):
        own = [np.diag(column[k]) for column in (ddq, np.tanh(dq / 0.01), dq)]
        rows.append(np.hstack([pin.computeJointTorqueRegressor(model, data, smooth[k], dq[k], ddq[k]), *own]))
        target.append(tau[k])
    w, y = np.vstack(rows), np.concatenate(target)
    size = np.linalg.norm(w, axis=0) + 1e-9 * np.linalg.norm(w)
    described = np.array([one.toDynamicParameters() for one in tuple(model.inertias)[1:]]).reshape(-1)
    prior = np.concatenate([described, np.zeros(3 * robot.n)]) * size
    # Short motions do not tell gravity from much else: what they leave open is the description's.
    near = PRIOR * np.eye(w.shape[1])
    values = np.linalg.lstsq(np.vstack([w / size, near]), np.concatenate([y, PRIOR * prior]), rcond=None)[0] / size
    links, own_values = values[: 10 * robot.n], values[10 * robot.n :].reshape(3, robot.n)
    load, whole = np.zeros_like(tau), np.zeros_like(tau)
    for k in range(len(t)):
        load[k] = pin.computeJointTorqueRegressor(model, data, smooth[k], still, still) @ links
        whole[k] = pin.computeJointTorqueRegressor(model, data, smooth[k], dq[k], ddq[k]) @ links
    friction = own_values[1] * np.tanh(dq / 0.01) + own_values[2] * dq
    return load, whole + own_values[0] * ddq + 0.5 * friction


if __name__ == "__main__":
    main()
