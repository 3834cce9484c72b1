"""Gross mistakes planted in whole files of real robots: are they noticed when the file is read, and rightly mended?

    python benchmarks/planted_mistakes.py [--seed 1 | --seed new] [--pairs 5] [--only ur10e] [--kind 'one gain x 10']

Every open recording is read untouched, then with one mistake in its columns: torques, positions or both of two joints
exchanged, a sign turned round, degrees for radians, gains ten times too large (all joints, each joint), torque 20 ms
late or early. `noticed`: a check warns or refuses that did not on the untouched file. `cured`: what the checks propose
(their `apply`), applied one after the other, gives the untouched signals back, or ones that the robot's dynamics
explain as well; of delays, what is said is what was planted and what the untouched file has, to 6 ms. `harmful` are
those that let the unexplained share of the torque grow by a tenth, and those of unit, gain and delay.
"""

from __future__ import annotations

import argparse
import os
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from common import FloatArray, show
from imports import DATA, SETS, robot_of

from dynident.identification.mistakes.search import delay_among, left_of, motion_of, whole_motion_of
from dynident.identification.robot_recordings import import_for_robot
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata
from dynident.recordings.sources import ArraySource
from dynident.robot import Robot

LATE, NEAR = 0.02, 0.006
HARMLESS = 0.1
MOST_CURES = 3

Columns = dict[str, FloatArray]


@dataclass(frozen=True)
class Planted:
    """A mistake by kind and in words; `delay` is by how much the torque was made late."""

    kind: str
    told: str
    columns: Columns
    delay: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """Whether a mistake does harm, was noticed, refused and rightly mended; `said` is what was noticed."""

    planted: Planted
    harmful: bool
    noticed: bool
    refused: bool
    cured: bool
    said: str


@dataclass(frozen=True, eq=False)
class Read:
    """What became of a file: the recording, if it was not refused, and all checks."""

    recording: Recording | None
    checks: tuple[Check, ...]

    @property
    def found(self) -> dict[str, Check]:
        """Checks that found something, by name."""
        return {one.name: one for one in self.checks if one.status != "ok"}


def main() -> None:
    """Run and print the tables."""
    options = _arguments()
    seed = secrets.randbelow(10**6) if options.seed == "new" else int(options.seed)
    print(f"seed {seed}", flush=True)
    rng = np.random.default_rng(seed)
    outcomes: list[Outcome] = []
    untouched = [("recording", "said of the untouched file")]
    for name in SETS if options.only is None else (options.only,):
        robot = robot_of(name)
        for path in sorted((DATA / name).glob("*.parquet")):
            columns = _columns(path)
            right = _read(robot, columns)
            told = ", ".join(f"{one.name} ({one.status})" for one in right.found.values()) or "nothing"
            untouched.append((f"{name}/{path.stem}", told))
            print(*untouched[-1], flush=True)
            if right.recording is None:
                continue
            for planted in _mistakes(columns, robot, rng, options.pairs):
                if options.kind is not None and planted.kind != options.kind:
                    continue
                one = _tried(robot, right, planted)
                outcomes.append(one)
                if one.harmful and not (one.noticed and one.cured):
                    print(f"  {planted.told}: noticed {one.noticed}, cured {one.cured}: {one.said}", flush=True)
    show("Untouched files", untouched)
    show("Planted mistakes", _table(outcomes))


def _table(outcomes: list[Outcome]) -> list[tuple[str, ...]]:
    rows = [("mistake", "planted", "harmful", "noticed", "cured", "refused")]
    kinds = {kind: [one for one in outcomes if one.planted.kind == kind] for kind in _kinds(outcomes)}
    for kind, own in (*kinds.items(), ("all", outcomes)):
        harmful = [one for one in own if one.harmful]
        counts = (sum(getattr(one, word) for one in harmful) for word in ("noticed", "cured", "refused"))
        rows.append((kind, str(len(own)), str(len(harmful)), *map(str, counts)))
    return rows


def _kinds(outcomes: list[Outcome]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(one.planted.kind for one in outcomes))


def _columns(path: Path) -> Columns:
    table = pq.read_table(path)
    return {name: table[name].to_numpy().astype(np.float64) for name in table.column_names}


def _mistakes(columns: Columns, robot: Robot, rng: np.random.Generator, pairs: int) -> Iterator[Planted]:
    n = robot.n
    effort = "tau" if "tau1" in columns else "current"
    q, tau = ("q", "dq", "ddq"), (effort,)
    all_pairs = list(combinations(range(1, n + 1), 2))
    for kind, signals in (("torques swapped", tau), ("positions swapped", q), ("joints swapped", (*q, *tau))):
        for place in rng.permutation(len(all_pairs))[:pairs]:
            a, b = all_pairs[place]
            yield Planted(kind, f"{kind} {a} {b}", _swapped(columns, signals, a, b))
    for kind, signals in (("torque turned", tau), ("position turned", q), ("joint turned", (*q, *tau))):
        for joint in range(1, n + 1):
            yield Planted(kind, f"{kind} {joint}", _times(columns, {f"{one}{joint}": -1.0 for one in signals}))
    turning = [joint for joint in range(1, n + 1) if robot.joints[joint - 1].kind == "revolute"]
    degrees = {f"q{joint}": 180.0 / np.pi for joint in turning}
    yield Planted("degrees", "positions in degrees", _times(columns, degrees))
    yield Planted("degrees", "positions and velocities in degrees", _times(
        columns, degrees | {f"dq{joint}": 180.0 / np.pi for joint in turning}))  # fmt: skip
    yield Planted("all gains x 10", "all gains x 10", _times(columns, {f"{effort}{k}": 10.0 for k in range(1, n + 1)}))
    for joint in range(1, n + 1):
        yield Planted("one gain x 10", f"gain {joint} x 10", _times(columns, {f"{effort}{joint}": 10.0}))
    for seconds in (LATE, -LATE):
        kind = "20 ms late" if seconds > 0 else "20 ms early"
        yield Planted(kind, kind, _late(columns, effort, seconds), seconds)


def _swapped(columns: Columns, signals: tuple[str, ...], a: int, b: int) -> Columns:
    other = {f"{one}{x}": f"{one}{y}" for one in signals for x, y in ((a, b), (b, a))}
    return {name: columns[other.get(name, name)] for name in columns}


def _times(columns: Columns, factors: Mapping[str, float]) -> Columns:
    return {name: values * factors.get(name, 1.0) for name, values in columns.items()}


def _late(columns: Columns, effort: str, seconds: float) -> Columns:
    t = columns["t"]
    return {
        name: np.interp(t - seconds, t, values) if name.rstrip("0123456789") == effort else values
        for name, values in columns.items()
    }


def _read(robot: Robot, columns: Columns, said: RecordingMetadata | None = None) -> Read:
    """Read columns as a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file.parquet"
        pq.write_table(pa.table(columns), path)
        try:
            recording, checks = import_for_robot(robot, path, Path(folder) / "out.parquet", said or RecordingMetadata())
            return Read(_in_memory(recording), checks)
        except RecordingError as error:
            return Read(None, error.checks)


def _in_memory(recording: Recording) -> Recording:
    """The recording, held in memory: its file is gone soon."""
    rows = list(recording.source.rows(0, recording.n_samples, 1 << 16))
    q, tau = (np.concatenate([getattr(one, kind) for one in rows]) for kind in ("q", "tau"))
    return replace(recording, source=ArraySource(q, tau), has_temperature=False, has_command=False, path=None)


def _tried(robot: Robot, right: Read, planted: Planted) -> Outcome:
    said, noticed, refused, words = RecordingMetadata(), False, False, ""
    known = {name for name, one in right.found.items()}
    read = _read(robot, planted.columns)
    for turn in range(MOST_CURES + 1):
        new = [one for name, one in read.found.items() if name not in known]
        # A check that warned already of something else may say more now.
        new += [one for name, one in read.found.items() if name in known and one.detail != right.found[name].detail
                and name in ("torque_alignment", "position_unit", "torque_delay")]  # fmt: skip
        if turn == 0:
            noticed, refused = bool(new), any(one.status == "error" for one in new)
            words = ", ".join(f"{one.name} ({one.status})" for one in new)
        cure = next((one.apply for one in sorted(new, key=lambda one: one.status != "error") if one.apply), None)
        if cure is None or turn == MOST_CURES:
            break
        said = cure.of(said)
        read = _read(robot, planted.columns, said)
    cured = noticed and _is_cured(robot, right, read, planted, said)
    return Outcome(planted, cured or _harm(robot, right, planted), noticed, refused, cured, words)


def _harm(robot: Robot, right: Read, planted: Planted) -> bool:
    if not planted.kind.endswith(("swapped", "turned")):
        return True
    accept = ("torque_order", "joint_order", "torque_sign", "joint_sign", "position_unit", "velocity_unit")
    read = _read(robot, planted.columns, RecordingMetadata(accept=accept))
    if read.recording is None or right.recording is None:
        return True
    usual, bad = (motion_of(one.recording) for one in (right, read) if one.recording is not None)
    if usual is None or bad is None:
        return True
    return float(np.log(left_of(robot, bad) / left_of(robot, usual))) >= HARMLESS


def _is_cured(robot: Robot, right: Read, read: Read, planted: Planted, said: RecordingMetadata) -> bool:
    if planted.delay:
        return abs(said.torque_delay - planted.delay - _natural(robot, right)) <= NEAR
    if right.recording is None or read.recording is None:
        return False
    now, then = (_signals(one.recording) for one in (right, read) if one.recording is not None)
    if now.shape == then.shape and np.allclose(now, then, rtol=1e-3, atol=1e-3 * np.abs(now).max(axis=0)):
        return True
    usual, left = motion_of(right.recording), motion_of(read.recording)
    if planted.kind.endswith("x 10") or usual is None or left is None:
        return False
    return left_of(robot, left) <= 1.05 * left_of(robot, usual)


def _natural(robot: Robot, right: Read) -> float:
    """The delay that the torque of the untouched file has, by the robot's dynamics: drives filter it."""
    whole = None if right.recording is None else whole_motion_of(right.recording)
    found = None if whole is None else delay_among(robot, *whole)
    return 0.0 if found is None else found.seconds


def _signals(recording: Recording) -> FloatArray:
    rows = list(recording.source.rows(0, recording.n_samples, 1 << 16))
    return np.concatenate([np.hstack([one.q, one.tau]) for one in rows])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--pairs", type=int, default=15, help="pairs of joints exchanged in each recording, each way")
    parser.add_argument("--only", default=None, choices=SETS, help="recordings of one robot")
    parser.add_argument("--kind", default=None, help='mistakes of one kind, as "one gain x 10"')
    return parser.parse_args()


if __name__ == "__main__":
    main()
