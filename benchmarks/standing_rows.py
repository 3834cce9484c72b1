"""How slow is standing, and how long is sticking? The constants of `dynident.recordings.joint_phases`, calibrated.

    python benchmarks/standing_rows.py [--seed 1 | --seed new] [--arms ur10,six-1] [--rates 1000,60] [--only starts]

Starts: the same clean arms with Stribeck friction in the model, which they have not, for several margins by which halts
are longer in filtered positions (`_SMEARED` of `dynident.regressors.row_phases`, as a share of 1 / cut-off). `rows
beside` is the residual on the rows next to halts over the noise, `Fst` the friction that is found, as a share of
Coulomb friction: nought would be right; `its 2 σ` what it is uncertain by.

Fits: clean arms of the benchmark's engine (rigid dry friction; Fourier motions and moves with pauses, soft and stiff
controllers, several rates) are identified with other slow speeds, and with all rows. `own rows` is the residual on the
rows that a setting keeps, over what the filter leaves of the torque sensor's true noise; `common rows` on those that
every setting keeps, which tells whether the fit is spoiled; `Fc` is the error of Coulomb friction. A joint's slow speed
is the least of SLOW and SLOW_SHARE of its rms speed: both are changed together, then SLOW alone.

Halts: shares of turns that are said to be free, on rigid arms by the time for which the joint really sticks, told from
the engine's exact speed; on arms with the hysteresis of presliding, Fourier motions alone; and on real arms where
`../shared/data` is there, of which nobody knows. Halts at either end of a run are not counted, nor those from which a
joint goes on in the same direction: they always count as standing.
"""

from __future__ import annotations

import argparse
import os
import secrets
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import FloatArray, show
from engine import (
    Arm,
    Hidden,
    Instruments,
    Run,
    fourier_motion,
    point_to_point_motion,
    usual_drives,
)
from engine.closed_loop import measured
from engine.friction import Dahl, MaxwellSlip
from engine.instruments import seen
from engine.physics import Measured, Plan
from engine.robots import arm_by_name, as_described
from hiding.case import Firmness, Manner, MotionKind
from hiding.manners import Manners, draw_manner
from placebos.subjects import REAL_ARMS, imported

from dynident.diagnosis import compare
from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Recording, joint_phases, low_pass, recording_from_arrays
from dynident.regressors import row_phases
from dynident.robot import Robot

MANNERS: tuple[tuple[MotionKind, Firmness], ...] = tuple(
    (motion, firmness) for motion in ("fourier", "point-to-point") for firmness in ("soft", "stiff")
)
RATES = (1000.0, 250.0, 125.0, 60.0)
PACES = (1.0, 0.5, 0.2)
DURATION = 9.0

SPEEDS = (0.0025, 0.005, 0.01, 0.02, 0.04)
LINGERS = (1.2, 1.5, 2.0, 3.0, 5.0)
FASTER = (3.0, 5.0, 8.0)
SMEARED = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)
PEAK = 0.06

STUCK = 1e-4
"""rad/s or m/s below which a joint of the engine sticks; one that turns freely is as slow for half a ms."""
STICKS = (0.0, 0.01, 0.03, 0.1, np.inf)
"""Borders (s) of the times for which joints stick."""
PARTS = (0.5, 0.75, 1.0)
"""The same as shares of the halt, where the rate is high enough for it to have a length."""
ASIDE = 0.05
"""Seconds before and behind a halt that tell whether the joint turns round in it."""

Constants = dict[str, float]
USUAL: Constants = {name: getattr(joint_phases, name) for name in ("SLOW", "SLOW_SHARE", "_FASTER", "_LINGERS")}


@dataclass(frozen=True, eq=False)
class Made:
    """An arm's runs as the engine made them, at one pace each, before any instrument; `seed` is that of the noise."""

    name: str
    manner: Manner
    arm: Arm
    runs: tuple[Measured, ...]
    seed: int

    def seen(self, rate: float) -> tuple[Recording, FloatArray]:
        """The runs as segments of one recording, and the standard deviation of its torque noise (n,)."""
        instruments = Instruments(2**18, 0.006, rate)
        runs: list[Run] = [seen(run, self.arm, instruments, self.seed + k) for k, run in enumerate(self.runs)]
        recording = recording_from_arrays(
            *(np.concatenate([getattr(run, what) for run in runs]) for what in ("t", "q", "tau")),
            joint_names=self.arm.robot.joint_names,
            segment=np.repeat(np.arange(1, len(runs) + 1), [len(run.t) for run in runs]),
            name=self.name,
        )
        return recording, runs[0].noise


@dataclass(frozen=True, eq=False)
class Fit:
    """What one setting makes of one recording: each (n,), NaN at joints without rows."""

    motion: MotionKind
    firmness: Firmness
    rate: float
    own: FloatArray
    common: FloatArray
    kept: FloatArray
    coulomb: FloatArray


def main() -> None:
    arguments = _arguments()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    arms = tuple(_listed(arguments.arms)) or ("ur10", "franka_panda", f"six-{seed}", f"sliding-{seed}")
    rates = tuple(map(float, _listed(arguments.rates))) or RATES
    print(f"seed {seed}: {', '.join(arms)}; {', '.join(f'{rate:g}' for rate in rates)} Hz", flush=True)
    start = time.perf_counter()
    rigid = [made(arm, manner, seed + k) for k, arm in enumerate(arms) for manner in MANNERS]
    print(f"{len(rigid)} rigid arms simulated, {time.perf_counter() - start:.0f} s", flush=True)
    if arguments.only in (None, "fits"):
        _show_fits(rigid, rates)
    if arguments.only in (None, "starts"):
        _show_starts(rigid, rates)
    if arguments.only in (None, "halts"):
        soft = [
            made(arm, ("fourier", firmness), seed + k, presliding=True)
            for k, arm in enumerate(arms)
            for firmness in ("soft", "stiff")
        ]
        _show_halts(rigid, soft, rates)
    print(f"\n{time.perf_counter() - start:.0f} s")


def made(name: str, how: tuple[MotionKind, Firmness], seed: int, *, presliding: bool = False) -> Made:
    """Simulate an arm at every pace; with presliding all of its turning joints have hysteresis."""
    rng = np.random.default_rng([seed, MANNERS.index(how)])
    manner = draw_manner(Manners((how[0],), (how[1],)), rng)
    robot = arm_by_name(name)
    hidden = _hysteresis(robot, rng) if presliding else ()
    arm = Arm(robot, usual_drives(robot), hidden, manner.servo)
    runs = []
    for k, pace in enumerate(PACES):
        if manner.motion == "fourier":
            motion = fourier_motion(robot, DURATION, manner.seed + k, arm.step, slope=manner.slope, rise=2.0, pace=pace)
        else:
            motion = point_to_point_motion(robot, DURATION, manner.seed + k, arm.step, pace)
        runs.append(measured(arm, motion, Plan(k, k * (DURATION + 3.0))))
    return Made(name, manner, arm, tuple(runs), int(rng.integers(2**31)))


def _hysteresis(robot: Robot, rng: np.random.Generator) -> tuple[Hidden, ...]:
    """Dahl's law or Maxwell's springs at every turning joint, as the benchmark of hidden effects draws them."""
    effects: list[Hidden] = []
    for j, joint in enumerate(robot.joints):
        slip, dahl = float(np.exp(rng.uniform(np.log(4e-3), np.log(3e-2)))), rng.random() < 0.5
        if joint.kind == "revolute":
            slips = (0.3 * slip, slip, 2.5 * slip)
            effects.append(Dahl(j, slip) if dahl else MaxwellSlip(j, slips, (0.3, 0.45, 0.25)))
    return tuple(effects)


@contextmanager
def constants(values: Constants) -> Iterator[None]:
    """Other constants of the module for a while; whatever phases are known are forgotten."""
    before = {name: getattr(joint_phases, name) for name in values}
    try:
        _set(values)
        yield
    finally:
        _set(before)


def _set(values: Constants) -> None:
    for name, value in values.items():
        setattr(joint_phases, name, value)
    joint_phases._known.clear()


@contextmanager
def no_phases(recording: Recording) -> Iterator[None]:
    """All rows of a recording move."""
    nothing = joint_phases.Halts(np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool), np.zeros(0, dtype=bool))
    joint_phases._known[recording] = joint_phases.Phases(tuple((nothing,) * recording.n for _ in recording.segments))
    try:
        yield
    finally:
        joint_phases._known.clear()


def _settings() -> dict[str, Constants | None]:
    """By the name in the tables; None: all rows."""
    both = {f"both, {v:g} rad/s": {"SLOW": v, "SLOW_SHARE": USUAL["SLOW_SHARE"] * v / USUAL["SLOW"]} for v in SPEEDS}
    alone = {f"SLOW alone, {v:g}": {"SLOW": v} for v in SPEEDS if v != USUAL["SLOW"]}
    return {**both, **alone, "all rows": None}


def fits(one: Made, rate: float) -> dict[str, Fit]:
    """Identify one recording with every setting."""
    recording, noise = one.seen(rate)
    robot = as_described(one.arm.robot, one.seed)
    found: dict[str, tuple[Identification, FloatArray, FloatArray]] = {}
    for title, values in _settings().items():
        with no_phases(recording) if values is None else constants(values):
            identification = identify(robot, [recording])
            compared = compare(identification, recording)
        found[title] = identification, compared.raw_residual, compared.moving
    common = np.all([moving for _, _, moving in found.values()], axis=0)
    cutoff = {identification.preprocessing.torque_cutoff for identification, _, _ in found.values()}
    floor = noise * float(np.sqrt((low_pass(recording.sampling_rate, *cutoff) ** 2).sum()))
    how = one.manner.motion, one.manner.firmness, rate
    return {
        title: Fit(
            *how,
            own=_rms(residual, moving) / floor,
            common=_rms(residual, common) / floor,
            kept=moving.mean(axis=0),
            coulomb=_coulomb_errors(identification, one.arm),
        )
        for title, (identification, residual, moving) in found.items()
    }


@dataclass(frozen=True, eq=False)
class Starts:
    """What rows next to halts make of Stribeck friction that is not there: each (n,)."""

    beside: FloatArray
    count: FloatArray
    found: FloatArray
    deviation: FloatArray


def starts(one: Made, rate: float, smeared: float) -> Starts:
    """Identify a clean recording with Stribeck friction on every turning joint."""
    recording, noise = one.seen(rate)
    robot = as_described(one.arm.robot, one.seed)
    names = tuple(joint.name for joint in robot.joints if joint.kind == "revolute")
    effects = (*IdentificationChoices().effects, EffectChoice("stribeck", names, (("delta", 2.0), ("vs", PEAK))))
    before = row_phases._SMEARED
    try:
        row_phases._SMEARED = smeared
        found = identify(robot, [recording], (), IdentificationChoices(effects))
    finally:
        row_phases._SMEARED = before
    floor = noise * float(np.sqrt((low_pass(recording.sampling_rate, found.preprocessing.torque_cutoff) ** 2).sum()))
    beside = [equation.separate_rows for equation in found.data.training.equations]
    partial = [(0.0, 0) if b is None else (b.counted.sum_squares(found.values[e.columns]), b.counted.count)
               for b, e in zip(beside, found.data.training.equations, strict=True)]  # fmt: skip
    squares, count = (np.array(column, dtype=np.float64) for column in zip(*partial, strict=True))
    peaks = {p.link: p for p in found.parameters if p.effect == "stribeck"}
    coulomb = one.arm.drives.coulomb
    values, deviations = (
        np.array([getattr(peaks[name], what) if name in peaks else np.nan for name in robot.joint_names]) / coulomb
        for what in ("value", "standard_deviation")
    )
    rms = np.sqrt(np.divide(squares, count, out=np.full(len(count), np.nan), where=count > 0)) / floor
    return Starts(rms, count, np.abs(values), 2.0 * deviations)


def _show_starts(rigid: Sequence[Made], rates: Sequence[float]) -> None:
    rows = []
    for smeared in SMEARED:
        found = [starts(one, rates[(k + k // len(MANNERS)) % len(rates)], smeared) for k, one in enumerate(rigid)]
        beside, count, values, doubt = (
            np.concatenate([getattr(one, what) for one in found]) for what in ("beside", "count", "found", "deviation")
        )
        usual = " (usual)" if smeared == row_phases._SMEARED else ""
        rows.append(
            (
                f"{smeared:g}{usual}",
                f"{np.nanmedian(beside):.2f}",
                f"{np.nanquantile(beside, 0.9):.2f}",
                f"{count.sum():.0f}",
                f"{np.nanmedian(values):.2%}",
                f"{np.nanquantile(values, 0.9):.2%}",
                f"{np.nanmedian(doubt):.2%}",
            )
        )
    head = ("1 / cut-off times", "rows beside", "90 %", "rows", "Fst / Fc", "90 %", "its 2 σ")
    show(f"Stribeck friction at {PEAK:g} rad/s that is not there, on all joints", [head, *rows])


def _rms(residual: FloatArray, rows: np.ndarray) -> FloatArray:
    count = rows.sum(axis=0)
    squares = (residual**2 * rows).sum(axis=0)
    return np.sqrt(np.divide(squares, count, out=np.full(len(count), np.nan), where=count > 0))


def _coulomb_errors(found: Identification, arm: Arm) -> FloatArray:
    """(n,): relative; NaN where it is no parameter."""
    values = {p.link: p.value for p in found.parameters if p.effect == "coulomb"}
    identified = np.array([values.get(name, np.nan) for name in arm.robot.joint_names])
    return np.abs(identified / arm.drives.coulomb - 1.0)


def _show_fits(rigid: Sequence[Made], rates: Sequence[float]) -> None:
    collected: dict[str, list[Fit]] = {title: [] for title in _settings()}
    for k, one in enumerate(rigid):
        # Every manner meets every rate once in so many arms as there are rates.
        rate = rates[(k + k // len(MANNERS)) % len(rates)]
        for title, fit in fits(one, rate).items():
            collected[title].append(fit)
        usual, every = (collected[title][-1] for title in (_USUAL_TITLE, "all rows"))
        print(
            f"  {k + 1:2d}/{len(rigid)} {one.name}, {one.manner.motion}, {one.manner.firmness}, {rate:g} Hz: residual "
            f"over noise {np.nanmedian(usual.own):.2f} on {usual.kept.mean():.0%} of the rows, all rows "
            f"{np.nanmedian(every.own):.2f}",
            flush=True,
        )
    head = ("", "own rows", "worst", "common rows", "worst", "rows kept", "Fc", "90 %")
    show("Residual over noise: median and worst joint", [head, *(_total(t, f) for t, f in collected.items())])
    of: tuple[Callable[[Fit], str], ...] = (
        lambda f: f"{f.motion}, {f.firmness}",
        lambda f: f.motion,
        lambda f: f"{f.rate:g} Hz",
    )
    for part_of in of:
        parts = dict.fromkeys(part_of(fit) for fit in collected["all rows"])
        rows = [
            (title, *(_brief([f for f in found if part_of(f) == part]) for part in parts))
            for title, found in collected.items()
        ]
        show("Median residual over noise on own rows, rows kept", [("", *parts), *rows])
    most = max(len(fit.own) for fit in collected["all rows"])
    rows = [
        (title, *(f"{_by_joint(f, j, 'own'):.2f} {_by_joint(f, j, 'kept'):.0%}" for j in range(most)))
        for title, f in collected.items()
    ]
    show("The same joint by joint", [("", *(f"joint {j + 1}" for j in range(most))), *rows])


_USUAL_TITLE = f"both, {USUAL['SLOW']:g} rad/s"


def _total(title: str, found: Sequence[Fit]) -> tuple[str, ...]:
    own, common, kept, coulomb = (
        np.concatenate([getattr(fit, what) for fit in found]) for what in ("own", "common", "kept", "coulomb")
    )
    return (
        title,
        *(f"{value:.3f}" for x in (own, common) for value in (np.nanmedian(x), np.nanmax(x))),
        f"{kept.mean():.0%}",
        f"{np.nanmedian(coulomb):.2%}",
        f"{np.nanquantile(coulomb, 0.9):.2%}",
    )


def _brief(found: Sequence[Fit]) -> str:
    own, kept = (np.concatenate([getattr(fit, what) for fit in found]) for what in ("own", "kept"))
    return f"{np.nanmedian(own):.2f} {kept.mean():.0%}"


def _by_joint(found: Sequence[Fit], joint: int, what: str) -> float:
    return float(np.nanmedian([getattr(fit, what)[joint] for fit in found if joint < len(fit.own)]))


@dataclass(frozen=True, eq=False)
class Turns:
    """Turns of joints.

    Whether each is said to be free, how long its halt is and for how long of that the joint really sticks, in s (NaN:
    nobody knows).
    """

    free: np.ndarray
    length: FloatArray
    stuck: FloatArray


def turns_of(recording: Recording, exact: Sequence[Measured] | None, joints: Sequence[int]) -> Turns:
    """The turns of some joints; `exact` are the runs behind the recording's segments."""
    free, length, stuck = [], [], []
    known = joint_phases.find_phases(recording)
    for index, segment in enumerate(recording.segments):
        t, q = _path(recording, index) if exact is None else (exact[index].t, exact[index].q)
        # Time of a segment counts from the recording's start, the engine's from the session's.
        t = t - t[0] + segment.start_time
        speed = np.gradient(q, t, axis=0)
        for j in joints:
            halts = known.halts[index][j]
            at = [np.interp(halts.starts - ASIDE, t, q[:, j]), np.interp(halts.starts, t, q[:, j])]
            at += [np.interp(halts.ends, t, q[:, j]), np.interp(halts.ends + ASIDE, t, q[:, j])]
            turns = np.sign(at[1] - at[0]) == -np.sign(at[3] - at[2])
            turns &= (halts.starts > t[0] + ASIDE) & (halts.ends < t[-1] - ASIDE)
            # Sticking is one stretch; the turn of a free joint is within a step or two.
            rest = np.concatenate([[0.0], np.cumsum((np.abs(speed[:-1, j]) < STUCK) * np.diff(t))])
            free.append(~halts.sticks[turns])
            length.append((halts.ends - halts.starts)[turns])
            stuck.append((np.interp(halts.ends, t, rest) - np.interp(halts.starts, t, rest))[turns])
    if exact is None:
        stuck = [np.full(len(part), np.nan) for part in free]
    return Turns(*map(np.concatenate, (free, length, stuck)))


def _path(recording: Recording, index: int) -> tuple[FloatArray, FloatArray]:
    segment = recording.segments[index]
    blocks = [rows.q for rows in recording.source.rows(segment.first_row, segment.length, 2**16)]
    return segment.start_time + np.arange(segment.length) * recording.period, np.concatenate(blocks)


def _show_halts(rigid: Sequence[Made], soft: Sequence[Made], rates: Sequence[float]) -> None:
    settings: dict[str, Constants] = {f"_LINGERS {value:g}": {"_LINGERS": value} for value in LINGERS}
    settings |= {f"_FASTER {value:g}": {"_FASTER": value} for value in FASTER}
    of_rigid = [(one.seen(rate)[0], one, rate) for one in rigid for rate in rates]
    of_soft = [(one.seen(rate)[0], one, rate) for one in soft for rate in rates]
    spans = list(pairwise(STICKS))
    by_span, by_rate = [], []
    for title, values in settings.items():
        with constants(values):
            stiff = [turns_of(recording, one.runs, range(recording.n)) for recording, one, _ in of_rigid]
            bent = [turns_of(recording, one.runs, _turning(one.arm.robot)) for recording, one, _ in of_soft]
        free, length, stuck = (
            np.concatenate([getattr(x, what) for x in stiff]) for what in ("free", "length", "stuck")
        )
        inside = [(stuck >= low) & (stuck < high) for low, high in spans]
        hysteresis = np.concatenate([turns.free for turns in bent])
        fine = np.concatenate(
            [np.full(len(x.free), r == max(rates)) for x, (_, _, r) in zip(stiff, of_rigid, strict=True)]
        )
        part = stuck / np.maximum(length, 1e-9)
        inside += [fine & (part >= low) & (part <= high) for low, high in pairwise(PARTS)]
        by_span.append((title, *(_share(free[rows]) for rows in inside), _share(hysteresis)))
        long = [
            np.concatenate(
                [x.free[x.stuck >= STICKS[-2]] for x, (_, _, r) in zip(stiff, of_rigid, strict=True) if r == rate]
            )
            for rate in rates
        ]
        easy = [
            np.concatenate([x.free for x, (_, _, r) in zip(bent, of_soft, strict=True) if r == rate]) for rate in rates
        ]
        by_rate.append((title, *(_share(x) for x in (*long, *easy))))
    names = [f"stuck {1e3 * low:g}-{1e3 * high:g} ms" for low, high in spans[:-1]]
    names += [f"> {1e3 * spans[-1][0]:g} ms", *(f"{low:.0%}-{high:.0%} of it" for low, high in pairwise(PARTS))]
    show("Share of turns said to be free (turns)", [("", *names, "hysteresis"), *by_span])
    titles = [f"{what} {rate:g} Hz" for what in (f"> {1e3 * STICKS[-2]:g} ms,", "hysteresis,") for rate in rates]
    show("The same by rate", [("", *titles), *by_rate])
    _show_real(settings)


def _turning(robot: Robot) -> list[int]:
    return [j for j, joint in enumerate(robot.joints) if joint.kind == "revolute"]


def _show_real(settings: dict[str, Constants]) -> None:
    arms = [arm for arm in REAL_ARMS if arm.is_here and len(arm.files) == 1]
    if not arms:
        return
    with tempfile.TemporaryDirectory() as folder:
        recordings = [recording for arm in arms for recording in imported(arm, Path(folder))[1]]
        rows = []
        for title, values in settings.items():
            with constants(values):
                found = [turns_of(recording, None, range(recording.n)).free for recording in recordings]
            rows.append((title, *map(_share, found)))
        show("Real arms: share of turns said to be free (turns)", [("", *(arm.folder for arm in arms)), *rows])
        rows = []
        for arm, recording in zip(arms, recordings, strict=True):
            joints = [_share(turns_of(recording, None, [j]).free) for j in range(recording.n)]
            rows.append((f"{arm.folder}, {recording.sampling_rate:.0f} Hz", *joints, *[""] * (7 - len(joints))))
        show("Real arms joint by joint", [("", *(f"joint {j + 1}" for j in range(7))), *rows])


def _share(free: np.ndarray) -> str:
    return f"{free.mean():.0%} ({len(free)})" if len(free) else "-"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--arms", default="", help="franka_panda, ur10, ur5, six-<number>, sliding-<number>, …")
    parser.add_argument("--rates", default="", help="Hz, with commas between")
    parser.add_argument("--only", choices=("fits", "starts", "halts"))
    return parser.parse_args()


def _listed(text: str) -> list[str]:
    return [part for part in text.split(",") if part]


if __name__ == "__main__":
    main()
