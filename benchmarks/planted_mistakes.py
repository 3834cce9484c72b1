"""Gross mistakes planted in whole files of real robots: are they noticed when the file is read, and rightly mended?

    python benchmarks/planted_mistakes.py [--seed 1 | --seed new] [--arms 12] [--draws 8] [--only ur10] [--kind gravity]

Every open recording and recordings of drawn arms, elastic and poorly excited ones among them, are read untouched, then
with one mistake: torques, positions or both of two joints exchanged, a sign turned round, all signs, degrees for
radians, positions of a joint by another gear ratio, gains ten times too large (all joints, each joint), the torque of
the outer joints in counts, torque 20 ms late or early, gravity in another direction than the description has it, the
load of gravity for a measurement, a joint counted from the one before or not homed, two joints logged at the motors of
a differential, the description in grams, positions in counts of an encoder, torques in registers whose sign was not
read, a joint without torque, torques in the order from the last joint on. `noticed`: a check warns or refuses that did
not on the untouched file. `true first`: the first thing that is said is what was planted. `cured`: what the checks
propose (their `apply`), applied one after the other, gives the untouched signals back, or ones that the robot's
dynamics explain as well; of delays, what is said is what was planted and what the untouched file has, to 6 ms. `wrongly
ordered`: what `--cure` makes of the file is read, and neither. `harmful` are those that let the unexplained share of
the torque grow by a tenth, and those of unit, gain, delay and kind. `not told by the data`: of those that are not
noticed, those that make no prediction of held-out torque surely worse (a likelihood ratio: by 2.5 standard errors among
blocks of time, and by more than the best wrong change of the untouched file makes it better: another delay of an arm
that gives, for one). Predictions are a fit of all parameters with constant torques, the masses of the description with
a free gain, friction and constant of each joint, and, of gains, those at the stated size; each with the same filters on
either side, at the cut-off of an identification and below. So are delays that, with that of the untouched file, are
such as drives have. `share` is noticed of the others; `told, of noticed`: how many of those that are noticed the same
ratio says that the data tell, a test of the ratio itself (`--test-ratio`).
"""

from __future__ import annotations

import argparse
import os
import secrets
from collections.abc import Callable, Iterator, Mapping
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
from planted_arms import drawn_arms

from dynident.api.robot_files import load_robot
from dynident.identification.recording_faults.column_faults import Motion, is_possible_delay, list_possible_faults
from dynident.identification.recording_faults.description_fit import measure_blocks_left_by_description
from dynident.identification.recording_faults.fault_search import ALIKE
from dynident.identification.recording_faults.joint_angle_faults import find_parallel_axes
from dynident.identification.recording_faults.rows_for_fault_search import (
    HeldOutFits,
    filter_motion,
    filter_whole_motion,
    filter_whole_motion_by,
    find_delay,
    thin_out,
)
from dynident.identification.recording_faults.torque_scale import compute_described_load
from dynident.identification.recording_faults.tree_fit import find_moving_joints
from dynident.identification.recording_faults.unexplained_torque import measure_unexplained_share
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata, choose_preprocessing
from dynident.recordings.preprocessing import OVERSAMPLING
from dynident.recordings.row_storage import ArraySource
from dynident.robot import Robot
from dynident.robot.pinocchio_conversion import compute_described_torque

MORE_SETS = (*SETS, "dfki_double_pendulum", "kinova_gen3")
LATE, NEAR = 0.02, 0.006
MOVED = 0.02
"""rad or m that a joint moves at least, for anything to be told of it."""
HARMLESS = 0.1
OFF = 0.1
"""Share of the load of gravity that the torque of a drive varies by at least."""
MOST_CURES = 3

NAMES: dict[str, tuple[str, ...]] = {
    "torques swapped": ("torque_order", "joint_order"),
    "positions swapped": ("torque_order", "joint_order"),
    "joints swapped": ("torque_order", "joint_order"),
    "torque turned": ("torque_sign", "joint_sign"),
    "position turned": ("torque_sign", "joint_sign"),
    "joint turned": ("torque_sign", "joint_sign"),
    "all torques turned": ("torque_sign",),
    # Of an arm in a plane both are one, and both are said.
    "all positions turned": ("joint_sign", "torque_sign"),
    "degrees": ("position_unit", "velocity_unit", "position_scale"),
    "all gains x 10": ("torque_scale", "saturation"),
    "one gain x 10": ("torque_scale", "saturation"),
    "outer gains": ("torque_scale",),
    "20 ms late": ("torque_delay",),
    "20 ms early": ("torque_delay",),
    "gravity": ("gravity_direction",),
    "command": ("commanded_torque", "constant_torque"),
    "coupled": ("joint_coupling",),
    # Of an arm that is turned as a whole both are one.
    "zeros": ("joint_zero", "gravity_direction"),
    "not homed": ("joint_zero", "gravity_direction"),
    "differential": ("joint_coupling",),
    "wraps": ("wrapped_angles", "position_unit"),
    "grams": ("description_units",),
    "counts": ("position_unit",),
    # A limit that a joint leaves is as good a sign of it.
    "position scaled": ("position_scale", "position_unit"),
    "registers": ("registers",),
    "no torque": ("joint_torque",),
    "last joint first": ("torque_order", "joint_order"),
}
"""Checks that name each mistake."""
TOLD_ONLY = (
    "gravity",
    "command",
    "coupled",
    "zeros",
    "not homed",
    "differential",
    "wraps",
    "grams",
    "counts",
    "registers",
    "no torque",
)
"""Mistakes that nothing said of the file puts right, or that are put right unasked."""
FARAWAY = 30.0
"""Factor by which the outer joints' torques are multiplied at least, at most thirty times it."""

Columns = dict[str, FloatArray]


@dataclass(frozen=True)
class Planted:
    """A mistake by kind and in words; `delay` is by how much the torque was made late."""

    kind: str
    told: str
    columns: Columns
    delay: float = 0.0
    robot: Robot | None = None
    """What the description then says, where the mistake is in it; `gravity` is the one before."""
    gravity: FloatArray | None = None


@dataclass(frozen=True)
class Outcome:
    """Whether a mistake does harm, was noticed, refused and rightly mended; `said` is what was noticed."""

    planted: Planted
    harmful: bool
    noticed: bool
    refused: bool
    cured: bool
    first: bool
    wrongly: bool
    said: str
    untold: bool = False
    """Whether the data do not tell it."""


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
    for name, robot, columns in _subjects(rng, options):
        right = read_file(robot, columns)
        told = ", ".join(f"{one.name} ({one.status})" for one in right.found.values()) or "nothing"
        untouched.append((name, told))
        print(*untouched[-1], flush=True)
        if right.recording is None:
            continue
        planted_ones = list(plant_mistakes(columns, robot, rng, options.pairs))
        wanted = [one for one in planted_ones if options.kind in (None, one.kind)]
        for planted in draw_mistakes(wanted, rng, options.draws):
            one = try_mistake(robot, right, planted)
            if one.harmful and (options.test_ratio or not one.noticed):
                one = replace(one, untold=not is_told_by_data(robot, right.recording, planted))
            outcomes.append(one)
            if one.harmful and (one.wrongly or one.untold or not (one.noticed and one.first)):
                words = f"wrongly {one.wrongly}, not told by the data {one.untold}: {one.said}"
                print(f"  {planted.told}: first {one.first}, {words}", flush=True)
    show("Untouched files", untouched)
    if options.test_ratio:
        noticed = [one for one in outcomes if one.harmful and one.noticed]
        print(f"\ntold, of noticed: {sum(not one.untold for one in noticed)} of {len(noticed)}")
        outcomes = [replace(one, untold=one.untold and not one.noticed) for one in outcomes]
    show("Planted mistakes", _table(outcomes))


def _subjects(rng: np.random.Generator, options: argparse.Namespace) -> Iterator[tuple[str, Robot, Columns]]:
    for name in MORE_SETS if options.only is None else (options.only,):
        if name == "drawn" or not (DATA / name).is_dir():
            continue
        robot = recorded_robot(name)
        for path in sorted((DATA / name).glob("*.parquet")):
            yield f"{name}/{path.stem}", robot, columns_of(path)
    if options.only in (None, "drawn"):
        yield from drawn_arms(rng, options.arms)


def recorded_robot(name: str) -> Robot:
    """The robot of a set of recordings."""
    others = {"dfki_double_pendulum": "design_C.urdf", "kinova_gen3": "kinova.urdf"}
    return load_robot(DATA / name / others[name]) if name in others else robot_of(name)


def draw_mistakes(planted: list[Planted], rng: np.random.Generator, draws: int) -> list[Planted]:
    """Draw as many mistakes as are to be tried in a recording, every kind as often as others."""
    order = [planted[k] for k in rng.permutation(len(planted))]
    nth = [sum(other.kind == one.kind for other in order[:k]) for k, one in enumerate(order)]
    turns = sorted(range(len(order)), key=lambda k: nth[k])
    return [order[k] for k in turns[:draws]]


def _table(outcomes: list[Outcome]) -> list[tuple[str, ...]]:
    names = "mistake", "planted", "harmful", "noticed", "true first", "cured", "refused", "wrongly ordered"
    rows: list[tuple[str, ...]] = [(*names, "not told by the data", "share")]
    kinds = {kind: [one for one in outcomes if one.planted.kind == kind] for kind in _kinds(outcomes)}
    for kind, own in (*kinds.items(), ("all", outcomes)):
        harmful = [one for one in own if one.harmful]
        counts = (
            sum(getattr(one, word) for one in harmful) for word in ("noticed", "first", "cured", "refused", "wrongly")
        )
        noticed, untold = (sum(getattr(one, word) for one in harmful) for word in ("noticed", "untold"))
        share = f"{noticed / max(len(harmful) - untold, 1):.1%}"
        rows.append((kind, str(len(own)), str(len(harmful)), *map(str, counts), str(untold), share))
    return rows


def _kinds(outcomes: list[Outcome]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(one.planted.kind for one in outcomes))


def columns_of(path: Path) -> Columns:
    table = pq.read_table(path)
    names = [name for name in table.column_names if not name.startswith("tau_commanded")]
    return {name: table[name].to_numpy().astype(np.float64) for name in names}


def plant_mistakes(columns: Columns, robot: Robot, rng: np.random.Generator, pairs: int) -> Iterator[Planted]:
    n = robot.n
    effort = "tau" if "tau1" in columns else "current"
    drives_on = _find_drives_on(columns, robot, effort)
    q, tau = ("q", "dq", "ddq"), (effort,)
    # Of joints that rest the data say nothing.
    moving = [k for k in range(1, n + 1) if np.ptp(columns[f"q{k}"]) > MOVED and drives_on[k - 1]]
    all_pairs = [pair for pair in combinations(range(1, n + 1), 2) if set(pair) <= set(moving)]
    for kind, signals in (("torques swapped", tau), ("positions swapped", q), ("joints swapped", (*q, *tau))):
        for place in rng.permutation(len(all_pairs))[:pairs]:
            a, b = all_pairs[place]
            yield Planted(kind, f"{kind} {a} {b}", _swapped(columns, signals, a, b))
    for kind, signals in (("torque turned", tau), ("position turned", q), ("joint turned", (*q, *tau))):
        for joint in moving:
            yield Planted(kind, f"{kind} {joint}", _times(columns, {f"{one}{joint}": -1.0 for one in signals}))
    turning = [joint for joint in range(1, n + 1) if robot.joints[joint - 1].kind == "revolute"]
    degrees = {f"q{joint}": 180.0 / np.pi for joint in turning}
    yield Planted("degrees", "positions in degrees", _times(columns, degrees))
    yield Planted("degrees", "positions and velocities in degrees", _times(
        columns, degrees | {f"dq{joint}": 180.0 / np.pi for joint in turning}))  # fmt: skip
    yield Planted("all gains x 10", "all gains x 10", _times(columns, {f"{effort}{k}": 10.0 for k in range(1, n + 1)}))
    for joint in moving:
        factor = float(rng.choice([0.5, 0.8, 1.25, 2.0]))
        scaled = _times(columns, {f"{one}{joint}": factor for one in q})
        yield Planted("position scaled", f"position {joint} x {factor:g}", scaled)
        yield Planted("one gain x 10", f"gain {joint} x 10", _times(columns, {f"{effort}{joint}": 10.0}))
    for seconds in (LATE, -LATE):
        kind = "20 ms late" if seconds > 0 else "20 ms early"
        yield Planted(kind, kind, _late(columns, effort, seconds), seconds)
    for kind, signals in (("all torques turned", tau), ("all positions turned", q)):
        yield Planted(kind, kind, _times(columns, {f"{one}{k}": -1.0 for one in signals for k in range(1, n + 1)}))
    first, factor = int(rng.integers(n // 2, n)) + 1, float(FARAWAY * 30.0 ** rng.uniform())
    told = f"torques of joints {first} to {n} x {factor:.0f}"
    if set(range(first - 1, n + 1)) <= set(moving):
        yield Planted("outer gains", told, _times(columns, {f"{effort}{k}": factor for k in range(first, n + 1)}))
    for joint in (int(one) + 1 for one in np.flatnonzero(find_parallel_axes(robot))):
        if not {joint - 1, joint} <= set(moving):
            continue
        counted = {f"q{joint}": columns[f"q{joint}"] + columns[f"q{joint - 1}"]}
        others = {name: values for name, values in columns.items() if name.rstrip("0123456789") not in ("dq", "ddq")}
        yield Planted("coupled", f"joint {joint} counted from {joint - 1}", others | counted)
    yield from _of_angles(columns, rng, [joint for joint in turning if joint in moving])
    yield from _of_motors(columns, robot, effort, rng, [joint for joint in turning if joint in moving])
    yield from _of_registers(columns, robot, effort, rng, moving)
    yield from _of_description(columns, robot, effort, rng)


def _of_angles(columns: Columns, rng: np.random.Generator, moving: list[int]) -> Iterator[Planted]:
    """Angles from another zero, and angles that wrap; of joints that turn."""
    others = {name: values for name, values in columns.items() if name.rstrip("0123456789") not in ("dq", "ddq")}
    for joint in moving:
        turns = int(rng.integers(1, 4))
        yield Planted(
            "zeros", f"joint {joint} counted from {90 * turns} degrees",
            columns | {f"q{joint}": columns[f"q{joint}"] + 0.5 * np.pi * turns})  # fmt: skip
        off = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.6))
        yield Planted(
            "not homed",
            f"joint {joint} reads {off:.2f} rad too much",
            columns | {f"q{joint}": columns[f"q{joint}"] + off},
        )
    # Angles that stay within a turn wrap where the joint's zero is at an end of it.
    wrapped = {f"q{k}": (columns[f"q{k}"] + np.pi) % (2.0 * np.pi) - np.pi for k in moving}
    if any(np.abs(np.diff(values)).max() > np.pi for values in wrapped.values()):
        yield Planted("wraps", "angles within half a turn", others | wrapped)


def _of_motors(
    columns: Columns, robot: Robot, effort: str, rng: np.random.Generator, moving: list[int]
) -> Iterator[Planted]:
    """Angles and torques of two neighbours as their motors have them, which a differential joins."""
    parallel = find_parallel_axes(robot)
    pairs = [joint for joint in moving if joint - 1 in moving and not parallel[joint - 1]]
    # Most differentials are in wrists.
    for second in pairs[-2:]:
        size, (a, b) = float(rng.choice([0.5, 1.0])), (f"{{}}{second - 1}", f"{{}}{second}")
        signs = np.array([[1.0, 1.0], [1.0, -1.0]])[:, rng.permutation(2)] * rng.choice([-1.0, 1.0], (2, 1))
        to_motors, changed = size * signs, {}
        for signal, matrix in (
            ("q", to_motors),
            ("dq", to_motors),
            ("ddq", to_motors),
            (effort, np.linalg.inv(to_motors).T),
        ):
            if a.format(signal) in columns:
                joints = np.stack([columns[name.format(signal)] for name in (a, b)])
                changed |= dict(zip((a.format(signal), b.format(signal)), matrix @ joints, strict=True))
        yield Planted("differential", f"joints {second - 1} and {second} logged at two motors", columns | changed)


def _find_drives_on(columns: Columns, robot: Robot, effort: str) -> list[bool]:
    """Tell which torques are those of a drive: a motor that is off has next to none of what its joint needs."""
    q, tau = (np.stack([columns[f"{kind}{k + 1}"] for k in range(robot.n)], axis=1) for kind in ("q", effort))
    if effort == "current" or robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return [bool(np.ptp(one) > 0) for one in tau.T]
    load = compute_described_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
    return [
        bool(np.ptp(own) > 0 and own.std() >= OFF * needed.std()) for own, needed in zip(tau.T, load.T, strict=True)
    ]


def _of_registers(
    columns: Columns, robot: Robot, effort: str, rng: np.random.Generator, moving: list[int]
) -> Iterator[Planted]:
    """Numbers as drives have them, and those that they have not."""
    n = robot.n
    counts = float(rng.choice([4096, 20000, 65536, 131072, 1 << 20]))
    turning = [k + 1 for k, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    others = {name: values for name, values in columns.items() if name.rstrip("0123456789") not in ("dq", "ddq")}
    counted = {f"q{k}": np.rint(columns[f"q{k}"] * counts / (2.0 * np.pi)) for k in turning}
    yield Planted("counts", f"{counts:.0f} counts a turn", others | counted)
    bit, is_magnitude = int(rng.choice([10, 11, 15])), bool(rng.integers(2))
    torques = {f"{effort}{k}": columns[f"{effort}{k}"] for k in range(1, n + 1)}
    size = 0.9 * 2.0**bit / max(float(np.abs(values).max()) for values in torques.values())
    whole = {name: np.rint(size * values) for name, values in torques.items()}
    raw = {
        name: np.where(values < 0, 2.0**bit - values if is_magnitude else 2.0 ** (bit + 1) + values, values)
        for name, values in whole.items()
    }
    if any((values < 0).any() for values in whole.values()):
        yield Planted("registers", f"sign in bit {bit}, {'magnitude' if is_magnitude else 'complement'}", columns | raw)
    if n > 1:
        silent = int(rng.integers(1, n + 1))
        yield Planted(
            "no torque", f"no torque {silent}", columns | {f"{effort}{silent}": np.full(len(columns["t"]), np.nan)}
        )
    if len(moving) == n > 3:
        backward = {f"{effort}{k}": columns[f"{effort}{n + 1 - k}"] for k in range(1, n + 1)}
        yield Planted("last joint first", "torques from the last joint on", columns | backward)


def _of_description(columns: Columns, robot: Robot, effort: str, rng: np.random.Generator) -> Iterator[Planted]:
    """Mistakes in the description, and what is computed from it."""
    for _ in range(2):
        turned = DIRECTIONS[int(rng.integers(len(DIRECTIONS)))](robot.gravity)
        leaning = replace(robot, gravity=turned)
        yield Planted("gravity", f"gravity along {np.round(turned, 1)}", columns, robot=leaning, gravity=robot.gravity)
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return
    factors = np.where(np.arange(10) < 6, 1e9, 1e3)
    factors[6:9] = 1e3
    yield Planted("grams", "description in grams", columns, robot=replace(robot, inertias=robot.inertias * factors))
    q = np.stack([columns[f"q{k + 1}"] for k in range(robot.n)], axis=1)
    load = compute_described_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
    if np.ptp(load, axis=0).max() < 1e-3:
        return
    load = load + 2e-3 * np.abs(load).max() * rng.normal(size=load.shape)
    yield Planted("command", "load of gravity", columns | {f"{effort}{k + 1}": load[:, k] for k in range(robot.n)})


DIRECTIONS: tuple[Callable[[FloatArray], FloatArray], ...] = (
    lambda g: np.roll(g, 1),
    lambda g: -np.roll(g, 1),
    lambda g: np.roll(g, 2),
    lambda g: -g,
    lambda g: (g + np.roll(g, 1)) / np.sqrt(2.0),
    lambda g: (g - np.roll(g, 2)) / np.sqrt(2.0),
)
"""Walls, a ceiling and slopes of 45 degrees."""


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


def read_file(robot: Robot, columns: Columns, said: RecordingMetadata | None = None) -> Read:
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


def try_mistake(robot: Robot, right: Read, planted: Planted) -> Outcome:
    said, noticed, refused, words = RecordingMetadata(), False, False, ""
    known, first, ordered, wrongly = {name for name, one in right.found.items()}, False, True, False
    robot = planted.robot or robot
    read = read_file(robot, planted.columns)
    for turn in range(MOST_CURES + 1):
        new = [one for name, one in read.found.items() if name not in known]
        # A check that warned already of something else may say more now.
        new += [one for name, one in read.found.items() if name in known and one.detail != right.found[name].detail
                and name in ("position_unit", "torque_delay")]  # fmt: skip
        if turn == 0:
            noticed, refused = bool(new), any(one.status == "error" for one in new)
            words = ", ".join(f"{one.name} ({one.status})" for one in new)
            first = bool(new) and min(new, key=lambda one: one.status != "error").name in NAMES[planted.kind]
        cure = next((one.apply for one in sorted(new, key=lambda one: one.status != "error") if one.apply), None)
        is_last = cure is None or turn == MOST_CURES
        if ordered and (is_last or not any(one.status == "error" and one.apply for one in new)):
            # So far `--cure` goes: what it has made of the file is read as it is.
            ordered, is_read = False, said != RecordingMetadata() and read.recording is not None
            wrongly = is_read and not _is_cured(robot, right, read, planted, said)
        if cure is None or is_last:
            break
        said = cure.apply_to(said)
        read = read_file(robot, planted.columns, said)
    cured = noticed and planted.kind not in TOLD_ONLY and _is_cured(robot, right, read, planted, said)
    harmful = cured or _harm(robot, right, planted)
    # An arm that moves in a mirror as it does: what is said instead is the same.
    return Outcome(planted, harmful, noticed, refused, cured, first or cured, wrongly, words)


def _harm(robot: Robot, right: Read, planted: Planted) -> bool:
    whole = planted.kind.startswith("all")
    if whole or not planted.kind.endswith(
        ("swapped", "turned", "coupled", "gravity", "zeros", "not homed", "differential", "position scaled")
    ):
        return True
    read = read_file(robot, planted.columns, RecordingMetadata(accept=ACCEPT))
    if read.recording is None or right.recording is None:
        return True
    usual, bad = (filter_motion(one.recording) for one in (right, read) if one.recording is not None)
    if usual is None or bad is None:
        return True
    as_it_was = robot if planted.gravity is None else replace(robot, gravity=planted.gravity)
    return (
        float(np.log(measure_unexplained_share(robot, bad) / measure_unexplained_share(as_it_was, usual))) >= HARMLESS
    )


ACCEPT = (
    "torque_order", "joint_order", "torque_sign", "joint_sign", "position_unit", "velocity_unit", "gravity_direction",
    "joint_coupling", "torque_scale", "position_scale", "joint_zero",
)  # fmt: skip
WRONG_DELAYS = (-0.1, -0.06, -0.04, -0.03, -0.02, -0.01, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1)
"""s: as far as a delay is looked for on both sides. An arm that gives seems to be late or early by up to 0.1 s."""
FEWEST_ROWS = round(10 * 5 * OVERSAMPLING)
"""Ten blocks of five periods of the cut-off: a filter reaches one or two periods across the edges of a block, and in
shorter ones what is left says the same of neighbours."""
_OCTAVES = 4
"""Cut-offs that are tried, each half of the one before."""
SURELY = 2.5
"""Standard errors, among blocks of time, by which more has to be left with a mistake than without."""


def is_told_by_data(robot: Robot, untouched: Recording, planted: Planted) -> bool:
    """Tell whether some prediction of held-out torque is surely worse with a mistake than without.

    A likelihood ratio on held-out data: the mean log share of the torque that is left has to rise by `SURELY` standard
    errors among blocks of time, with the same blocks on either side, and by more than the best wrong change of the
    untouched file takes away. Of what notices mistakes only the delay of the untouched file has a say in it.
    """
    read = read_file(planted.robot or robot, planted.columns, RecordingMetadata(accept=ACCEPT))
    if read.recording is None:
        return True
    if planted.delay and is_possible_delay(planted.delay + _natural(robot, untouched)):
        return False
    # One filter for both: with two of them the noise that each lets through would tell the mistake.
    choice = choose_preprocessing([untouched, read.recording])
    for octaves in range(_OCTAVES):
        whole = [filter_whole_motion_by(choice, one, octaves=octaves) for one in (untouched, read.recording)]
        usual, bad = (None if one is None else thin_out(one[0]) for one in whole)
        if usual is None or bad is None or whole[0] is None or (octaves and len(bad.q) < FEWEST_ROWS):
            break
        by_chance = list(_wrong_changes(robot, *whole[0], planted.kind))
        for predict in _list_predictions(planted):
            left, worse = predict(robot, usual), predict(planted.robot or robot, bad)
            if left is None or worse is None:
                continue
            rise = worse - left
            others = (predict(one, motion) for one, motion in by_chance)
            chance = max((float((left - other).mean()) for other in others if other is not None), default=0.0)
            if rise.mean() > max(chance, SURELY * rise.std(ddof=1) / np.sqrt(len(rise)), ALIKE):
                return True
    return False


Prediction = Callable[[Robot, Motion], FloatArray | None]


def _list_predictions(planted: Planted) -> list[Prediction]:
    """What a block of time is predicted by: mean log share of the torque (blocks,) that each prediction leaves."""
    if planted.delay:
        return [lambda robot, motion: HeldOutFits(robot).offset_fit.measure_unexplained(motion).fine]
    predictions: list[Prediction] = [_measure_left_by_fit, measure_blocks_left_by_description]
    return [*predictions, measure_left_at_stated_size] if "gain" in planted.kind else predictions


def _measure_left_by_fit(robot: Robot, motion: Motion) -> FloatArray:
    """Left by a fit of all parameters, with constant torques, which a robot may have; friction drives no joint."""
    unexplained = HeldOutFits(robot).offset_fit.measure_unexplained(motion)
    return unexplained.blocks + unexplained.score - unexplained.blocks.mean()


def measure_left_at_stated_size(robot: Robot, motion: Motion) -> FloatArray | None:
    """Mean log share of the torque (blocks,) that the description leaves, its load as large as it states it.

    Each block is predicted from the others, with friction, the drive's inertia and a constant that are free.
    """
    load = compute_described_load(robot, motion)
    if load is None:
        return None
    shares = []
    for joint in np.flatnonzero(find_moving_joints(motion)):
        dq, tau = motion.dq[:, joint], motion.tau[:, joint]
        rows = np.column_stack([np.sign(dq), dq, motion.ddq[:, joint], np.ones(len(dq))])
        rest, left = tau - load[:, joint], []
        for number in np.unique(motion.block):
            inside = motion.block == number
            values = np.linalg.lstsq(rows[~inside], rest[~inside], rcond=None)[0]
            left.append(np.sqrt(((rest - rows @ values)[inside] ** 2).mean() / max((tau**2).mean(), 1e-300)))
        shares.append(np.log(np.clip(left, 0.02, 3.0)))
    return np.mean(shares, axis=0)


def _wrong_changes(robot: Robot, whole: Motion, period: float, kind: str) -> Iterator[tuple[Robot, Motion]]:
    """The untouched motion with changes of the kind of a mistake, none of which is right."""
    motion = thin_out(whole)
    if kind == "gravity":
        yield from ((replace(robot, gravity=turn(robot.gravity)), motion) for turn in DIRECTIONS)
    elif kind in ("20 ms late", "20 ms early"):
        rows = np.arange(len(whole.q)) * period
        for seconds in WRONG_DELAYS:
            late = [np.interp(rows + seconds, rows, torque) for torque in whole.tau.T]
            yield robot, thin_out(replace(whole, tau=np.stack(late, axis=1)))
    else:
        moving = find_moving_joints(motion)
        yield from ((robot, one.mend(motion)) for one in list_possible_faults(moving, find_parallel_axes(robot)))


def _is_cured(robot: Robot, right: Read, read: Read, planted: Planted, said: RecordingMetadata) -> bool:
    if planted.delay:
        return abs(said.torque_delay - planted.delay - _natural(robot, right.recording)) <= NEAR
    if right.recording is None or read.recording is None:
        return False
    now, then = (signals_of(one.recording) for one in (right, read) if one.recording is not None)
    if now.shape == then.shape and np.allclose(now, then, rtol=1e-3, atol=1e-3 * np.abs(now).max(axis=0)):
        return True
    usual, left = filter_motion(right.recording), filter_motion(read.recording)
    # A gain is no other one that explains as much.
    if planted.kind.endswith(("x 10", "gains")) or usual is None or left is None:
        return False
    return measure_unexplained_share(robot, left) <= 1.05 * measure_unexplained_share(robot, usual)


def _natural(robot: Robot, untouched: Recording | None) -> float:
    """The delay that the torque of the untouched file has, by the robot's dynamics: drives filter it."""
    whole = None if untouched is None else filter_whole_motion(untouched)
    found = None if whole is None else find_delay(robot, *whole)
    return 0.0 if found is None else found.seconds


def signals_of(recording: Recording) -> FloatArray:
    rows = list(recording.source.rows(0, recording.n_samples, 1 << 16))
    return np.concatenate([np.hstack([one.q, one.tau]) for one in rows])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--pairs", type=int, default=15, help="pairs of joints exchanged in each recording, each way")
    parser.add_argument("--arms", type=int, default=12, help="drawn arms")
    parser.add_argument("--draws", type=int, default=1000, help="mistakes tried in each recording")
    parser.add_argument("--only", default=None, choices=(*MORE_SETS, "drawn"), help="recordings of one robot")
    parser.add_argument("--kind", default=None, help='mistakes of one kind, as "one gain x 10"')
    parser.add_argument("--test-ratio", action="store_true", help="also ask what is noticed whether the data tell it")
    return parser.parse_args()


if __name__ == "__main__":
    main()
