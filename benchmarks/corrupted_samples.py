"""Which corrupted samples are found, and what is called corrupted in clean recordings.

    PYTHONPATH=tests python benchmarks/corrupted_samples.py [--seed 1] [--arms 4] [--calibrate] [--held-out 5] [--sizes]
        [--clocks 60]

Arms are drawn, with motions along harmonics and from point to point, at several rates, with noise of several tails. In
each of their recordings samples are spoilt: zeros, the largest value, a stuck one, spikes, single or in bursts.
`invented`: samples of clean recordings that are called corrupted; `named`: share of the spoilt ones that are found.
Both have a line with the sum, and `untouched` one of all recordings of real robots as they are.
`--held-out` spoils so many times each of the recordings of real robots that have a second one (or half), fits links and
friction, and compares what is left of the second one with what a fit to the clean recording leaves: how often it is at
most 1.2 times that, of samples of any size, and of small ones; and which share of them is named.
`--sizes` makes samples of all positions, or all torques, of these recordings wrong by a share of the signal range: how
many are named, and how many times what the clean recording leaves is left of the second one with the step, and without.
`--calibrate` shows what the constants of `recordings/conditioning/corrupted_sample_detection.py` stand on: the swings
of noise of several tails, and the largest of them, in usual steps. Take other seeds for it.
`--clocks` draws so many recordings with a right clock, and with a wrong one, whose velocities are filtered and noisy.
It shows what `_SAME`, `_OFF` and `_DELAYED` of `recordings/units.py` stand on, and how often one is named.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from common import FloatArray
from planted_mistakes import ACCEPT, DATA, Columns, columns_of, recorded_robot
from scipy.signal import butter, sosfilt
from support.spoilt_recordings import KINDS, NOISES, N, arm_signals, corrupt

from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.rows_for_fault_search import filter_whole_motion, thin_out
from dynident.identification.recording_faults.tree_fit import TreeFit
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.recordings import (
    Check,
    JointLimits,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    import_recording,
    position_checks,
)
from dynident.recordings.conditioning.corrupted_sample_detection import measure_usual_steps
from dynident.recordings.recording_import import condition_arrays
from dynident.recordings.units import find_common_ratio
from dynident.robot import Robot

RATES = (60.0, 100.0, 200.0, 500.0, 1000.0)
COUNTS = (1e-6, 1e-4, 2e-3)
JOINTS = RecordedJoints([f"joint{k + 1}" for k in range(N)], [JointLimits()] * N)


def found_in(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(m, 2 n): which samples are called corrupted."""
    *_, checks = condition_arrays(t, values[:, :N], values[:, N:], JOINTS)
    found = np.zeros(values.shape, dtype=bool)
    for check in checks:
        if check.name == "corrupted_samples":
            for source, rows in check.rows.items():
                kind, joint = source.split("_joint")
                found[np.array(rows) - 1, int(joint) - 1 + (N if kind == "tau" else 0)] = True
    return found


def invented(seed: int, arms: int) -> None:
    """Look for corrupted samples where there are none."""
    total = samples = 0
    for arm, rate, moves, noise, count in product(range(arms), RATES, (False, True), NOISES, COUNTS):
        t, values = arm_signals(seed + arm, rate, 20.0, point_to_point=moves, noise=noise, count=count)
        found = found_in(t, values)
        samples += found.size
        total += int(found.sum())
        if found.any():
            print(f"  invented: arm {seed + arm}, {rate:g} Hz, moves {moves}, {noise}, {count:g}: {found.sum(axis=0)}")
    print(f"invented: {total} of {samples} samples")


def named(seed: int, arms: int) -> None:
    """Look for those that were planted."""
    print("kind      burst  share   positions   torques   invented")
    all_hits, all_planted, all_false = np.zeros(2), np.zeros(2), 0
    for kind, longest, share in product(KINDS, (1, 4), (0.001, 0.01, 0.02)):
        hits, planted_in, false = np.zeros(2), np.zeros(2), 0
        for arm, rate, moves in product(range(arms), (100.0, 200.0, 1000.0), (False, True)):
            t, values = arm_signals(seed + arm, rate, 20.0, point_to_point=moves)
            spoilt, planted = corrupt(values, seed + arm, share, kind, longest)
            found = found_in(t, spoilt)
            for part, columns in enumerate((slice(0, N), slice(N, 2 * N))):
                hits[part] += (found & planted)[:, columns].sum()
                planted_in[part] += planted[:, columns].sum()
            false += int((found & ~planted).sum())
        shares = hits / planted_in
        print(f"{kind:8} {longest:6} {share:6.1%} {shares[0]:11.1%} {shares[1]:9.1%} {false:10}", flush=True)
        all_hits, all_planted, all_false = all_hits + hits, all_planted + planted_in, all_false + false
    shares = all_hits / all_planted
    print(
        f"named: {all_hits.sum() / all_planted.sum():.1%} (positions {shares[0]:.1%}, torques {shares[1]:.1%}), ",
        end="",
    )
    print(f"beside them invented: {all_false} samples")


def untouched() -> None:
    """Look for corrupted samples in the recordings of real robots."""
    n_files = n_samples = 0
    for path in sorted(DATA.glob("*/**/*.parquet")):
        folder = DATA / path.relative_to(DATA).parts[0]
        if not any(folder.glob("*.urdf")) and not (folder / "robot.json").exists():
            continue
        columns = columns_of(path)
        _, calls = _import(recorded_robot(folder.name), columns)
        n_files, n_samples = n_files + 1, n_samples + sum(map(len, calls.values()))
        for name, rows in calls.items():
            print(f"  untouched {path.relative_to(DATA)}: {name}, {len(rows)} of {len(columns['t'])}", flush=True)
    print(f"untouched: {n_samples} samples are called corrupted in {n_files} recordings of real robots")


REAL = (
    ("ur10e", "id_30s_12harm", "id_40s_12harm"),
    ("kr300", "id_A", "val_B"),
    ("kinova_gen3", "run1", "run2"),
    ("airbot_play", "id_chirp_unloaded", None),
    ("tx40", "all", None),
    ("dvrk_psm", "base_one", None),
)
"""Recordings that are spoilt, and what they are held against: None for their second half."""
ALLOWED = 1.2


def held_out(seed: int, cases: int) -> None:
    """Compare models of spoilt recordings with models of the clean ones, on recordings that were not spoilt."""
    rng = np.random.default_rng(seed)
    for small in (False, True):
        ratios: list[float] = []
        n_planted = n_named = n_beside = 0
        for name, stem, other in REAL:
            robot, first = recorded_robot(name), columns_of(DATA / name / f"{stem}.parquet")
            half = len(first["t"]) // 2
            second = columns_of(DATA / name / f"{other}.parquet") if other else _cut(first, slice(half, None))
            first = first if other else _cut(first, slice(0, half))
            clean, tried = _fit(robot, first), _rows(robot, second)
            names = [name for name in first if name.rstrip("0123456789") in ("q", "tau", "current")]
            values = np.stack([first[name] for name in names], axis=1)
            for _ in range(cases):
                kind, longest = str(rng.choice(KINDS)), int(rng.choice([1, 1, 4]))
                share, of = float(rng.choice([0.001, 0.01, 0.02])), int(rng.integers(3))
                columns = tuple(k for k, name in enumerate(names) if of == 2 or (name[0] == "q") == (of == 0))
                spoilt, planted = corrupt(values, int(rng.integers(10**6)), share, kind, longest, columns)
                if small:
                    factor = 10.0 ** rng.uniform(-1.5, 0.0, planted.shape)
                    spoilt = np.where(planted, values + factor * (spoilt - values), values)
                # Velocities of the file would contradict spoilt positions.
                others = {key: first[key] for key in first if key.rstrip("0123456789") not in ("dq", "ddq")}
                spoilt_file = others | {name: spoilt[:, k] for k, name in enumerate(names)}
                fit, calls = _fit_and_call(robot, spoilt_file)
                called = np.zeros(planted.shape, dtype=bool)
                for name, rows in calls.items():
                    called[np.array(rows) - 1, names.index(name)] = True
                n_planted, n_named = n_planted + int(planted.sum()), n_named + int((called & planted).sum())
                n_beside += int((called & ~planted).sum())
                left = [_left(fit, tried) for fit in (fit, clean)]
                ratios.append(float(np.sqrt((left[0] ** 2).mean() / (left[1] ** 2).mean())))
                if ratios[-1] > ALLOWED:
                    words = f"{kind}, {share:.1%}, bursts {longest}, signals {of}"
                    print(f"  {name}: {words}: {ratios[-1]:.2f}", flush=True)
        within = sum(ratio <= ALLOWED for ratio in ratios)
        print(
            f"{'small' if small else 'any size'}: {within} of {len(ratios)} within {ALLOWED}, worst {max(ratios):.2f}; "
            f"named {n_named} of {n_planted} samples ({n_named / n_planted:.1%}), beside them {n_beside}"
        )


SIZES = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
"""Shares of a signal's range (1 % to 99 % quantile) that samples are wrong by."""


def sizes(seed: int, share: float = 0.02) -> None:
    """Show from which size on corrupted samples are found, and from which on they do harm."""
    rng = np.random.default_rng(seed)
    print("recording     signals      size   named   left with the step   left without")
    for name, stem, other in REAL:
        robot, first = recorded_robot(name), columns_of(DATA / name / f"{stem}.parquet")
        half = len(first["t"]) // 2
        second = columns_of(DATA / name / f"{other}.parquet") if other else _cut(first, slice(half, None))
        first = first if other else _cut(first, slice(0, half))
        # Velocities of the file would contradict spoilt positions.
        first = {key: first[key] for key in first if key.rstrip("0123456789") not in ("dq", "ddq")}
        tried = _rows(robot, second)
        usual = float((_left(_fit(robot, first), tried) ** 2).mean())
        for kinds, size in product((("q",), ("tau", "current")), SIZES):
            own = [key for key in first if key.rstrip("0123456789") in kinds]
            spoilt, planted = dict(first), {}
            for key in own:
                values = first[key]
                rows = rng.choice(np.arange(10, len(values) - 10), max(1, round(share * len(values))), replace=False)
                wrong = size * np.subtract(*np.quantile(values, (0.99, 0.01))) * rng.choice([-1, 1], len(rows))
                spoilt[key] = values.copy()
                spoilt[key][rows] += wrong
                planted[key] = set((rows + 1).tolist())
            left, named = [], 0
            for skip in ((), ("corrupted_samples",)):
                fit, calls = _fit_and_call(robot, spoilt, skip)
                left.append(float(np.sqrt((_left(fit, tried) ** 2).mean() / usual)))
                named += sum(len(planted[key] & set(calls.get(key, ()))) for key in own)
            n = sum(map(len, planted.values()))
            print(f"{name:12} {kinds[0]:>8} {size:9.2%} {named / n:7.1%} {left[0]:20.3f} {left[1]:14.3f}", flush=True)


def _cut(columns: Columns, rows: slice) -> Columns:
    return {name: values[rows] for name, values in columns.items()}


def _import(robot: Robot, columns: Columns, skip: tuple[str, ...] = ()) -> tuple[Motion, dict[str, tuple[int, ...]]]:
    """Import columns: the rows of the motion, and the rows (from 1) that are called corrupted, by column."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file.parquet"
        pq.write_table(pa.table(columns), path)
        joints, metadata = build_recorded_joints(robot), RecordingMetadata(accept=ACCEPT, skip=skip)
        recording, checks = import_recording(path, Path(folder) / "out.parquet", joints, metadata=metadata)
        whole = filter_whole_motion(recording)
    assert whole is not None
    calls = {name: rows for check in checks if check.name == "corrupted_samples" for name, rows in check.rows.items()}
    numbers = {joint: number + 1 for number, joint in enumerate(robot.joint_names)}
    named = {f"{kind}_{joint}": f"{kind}{numbers[joint]}" for kind in ("q", "tau", "current") for joint in numbers}
    return thin_out(whole[0]), {named.get(name, name): rows for name, rows in calls.items()}


def _rows(robot: Robot, columns: Columns) -> Motion:
    return _import(robot, columns)[0]


def _fit(robot: Robot, columns: Columns) -> list[tuple[TreeFit, FloatArray]]:
    return _fit_and_call(robot, columns)[0]


def _fit_and_call(
    robot: Robot, columns: Columns, skip: tuple[str, ...] = ()
) -> tuple[list[tuple[TreeFit, FloatArray]], dict[str, tuple[int, ...]]]:
    """The trees of a robot with the parameters (blocks + 1, c) that explain most of a recording; what is corrupted."""
    motion, calls = _import(robot, columns, skip)
    fits = []
    for tree in HeldOutFit(robot)._trees:
        own = tree._select(motion)
        values, _ = tree._solve_weighted(tree._compute_grams(own, tree._get_rows(motion, own)), tree._fit_all)
        fits.append((tree, values))
    return fits, calls


def _left(fits: list[tuple[TreeFit, FloatArray]], motion: Motion) -> FloatArray:
    """The share of each joint's torque that parameters leave of a motion."""
    shares = []
    for tree, values in fits:
        own = tree._select(motion)
        grams = tree._compute_grams(own, tree._get_rows(motion, own))
        shares.append(np.sqrt(grams.compute_squares(values)[-1] / np.maximum(grams.measured[-1], 1e-300)))
    return np.concatenate(shares)


def clocks(seed: int, cases: int) -> None:
    """Name wrong clocks in drawn recordings, and show how far right and wrong ones are apart."""
    rng = np.random.default_rng(seed)
    print("clock   motion    cases   named   spread of ratios (median, 90 %)   missed likeness / off (median, 90 %)")
    for is_wrong, moves in product((False, True), (False, True)):
        n_named, measured = 0, list[tuple[float, float]]()
        for _ in range(cases):
            rate, cutoff = float(rng.choice(RATES[1:])), 10.0 ** rng.uniform(0.0, 1.7)
            t, values = arm_signals(int(rng.integers(10**6)), rate, 20.0, point_to_point=moves, level=0.005, count=1e-6)
            dq = np.gradient(values[:, :N], t, axis=0)
            # What drives report is filtered, and in steps of an encoder's count within some rows.
            dq = sosfilt(butter(1, min(cutoff, 0.4 * rate), fs=rate, output="sos"), dq, axis=0)
            dq += 10.0 ** rng.uniform(-4.0, -2.0) * dq.std(axis=0) * rng.normal(size=dq.shape)
            step = 10.0 ** rng.uniform(-4.0, -2.0) * dq.std()
            dq = step * np.round(dq / step)
            factor = float(rng.uniform(1.07, 1.9) ** rng.choice([-1.0, 1.0])) if is_wrong else 1.0
            names = [f"{kind}{k + 1}" for kind in ("q", "tau", "dq") for k in range(N)]
            columns = {"t": factor * t} | dict(zip(names, np.column_stack([values, dq]).T, strict=True))
            checks, (ratios, likeness) = _check_clock(columns)
            n_named += any(check.name == "clock_rate" for check in checks)
            if len(ratios) > 1:
                off = max(abs(max(ratios) - 1.0), 1e-9)
                measured.append(((max(ratios) - min(ratios)) / max(ratios), (1.0 - likeness) / off))
        (same, delayed), (most_same, most_delayed) = np.quantile(np.array(measured), (0.5, 0.9), axis=0)
        kind, of = "wrong" if is_wrong else "right", "moves" if moves else "harmonic"
        print(
            f"{kind:7} {of:9} {cases:5} {n_named / cases:7.1%} "
            f"{same:15.2%} {most_same:12.2%} {delayed:18.3f} {most_delayed:12.3f}",
            flush=True,
        )


def _check_clock(columns: Columns) -> tuple[tuple[Check, ...], tuple[list[float], float]]:
    """Return the checks of a recording, and what the clock is told by: ratios of velocities, and their likeness."""
    asked: list[tuple[list[float], float]] = []

    def look(ratios: list[float], likeness: float) -> float:
        asked.append((ratios, likeness))
        return find_common_ratio(ratios, likeness)

    with TemporaryDirectory() as folder, patch.object(position_checks, "find_common_ratio", look):
        path = Path(folder) / "run.parquet"
        pq.write_table(pa.table(columns), path)
        try:
            _, checks = import_recording(path, Path(folder) / "rows.parquet", JOINTS)
        except RecordingError as error:
            checks = error.checks
    return checks, asked[-1] if asked else ([], 1.0)


def calibrate(seed: int) -> None:
    """Show how many swings noise of several tails makes, and the largest."""
    rng = np.random.default_rng(seed)
    print("noise     order   swings of 2 to 4 usual steps in 10^6   largest")
    for noise, order in product(NOISES, (1, 2)):
        steps = np.diff(NOISES[noise](rng, (1_000_000,)), n=order)
        usual = measure_usual_steps(steps[:, None], np.array([order == 2]))[:-1, 0]
        swings = (np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) / usual)[steps[1:] * steps[:-1] < 0.0]
        print(f"{noise:9} {order:5} {np.count_nonzero((swings >= 2.0) & (swings < 4.0)):38} {swings.max():9.1f}")


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--held-out", type=int, default=0)
    parser.add_argument("--sizes", action="store_true")
    parser.add_argument("--clocks", type=int, default=0)
    options = parser.parse_args()
    if options.clocks:
        clocks(options.seed, options.clocks)
        return
    if options.sizes:
        sizes(options.seed)
        return
    if options.held_out:
        held_out(options.seed, options.held_out)
        return
    if options.calibrate:
        calibrate(options.seed)
    untouched()
    invented(options.seed, options.arms)
    named(options.seed, options.arms)


if __name__ == "__main__":
    main()
