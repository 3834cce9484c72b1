"""A case's recordings: simulated, or kept from an earlier time."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import engine
import numpy as np
from engine import Arm, Instruments, Motion, Plan, Run, fourier_motion, point_to_point_motion, record, usual_drives
from engine.drives import effort_limits
from engine.robots import arm_by_name

from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import Robot
from hiding.case import Case, Manner, Take


@dataclass(frozen=True, eq=False)
class Recorded:
    """The runs of a case in the order of its session."""

    case: Case
    runs: tuple[Run, ...]

    @property
    def training(self) -> tuple[Run, ...]:
        """The runs to identify from."""
        return tuple(run for run, take in zip(self.runs, self.case.session, strict=True) if not take.held_out)

    @property
    def held_out(self) -> tuple[Run, ...]:
        """The runs that no parameter sees."""
        return tuple(run for run, take in zip(self.runs, self.case.session, strict=True) if take.held_out)

    def files(self, *, held_out: bool) -> list[list[int]]:
        """Numbers of the runs that share a file, file by file."""
        files: list[list[int]] = []
        for number, take in enumerate(self.case.session):
            if take.held_out == held_out:
                if take.joined and files:
                    files[-1].append(number)
                else:
                    files.append([number])
        return files

    def recordings(self, *, held_out: bool) -> list[Recording]:
        """As recordings named "run 1", …; runs that share a file are segments of it, with its name."""
        names = arm_by_name(self.case.arm).joint_names
        made = []
        for numbers in self.files(held_out=held_out):
            runs = [self.runs[number] for number in numbers]
            heat = None if runs[0].temperature is None else np.concatenate([_heat(run) for run in runs])
            labels = np.repeat([number + 1 for number in numbers], [len(run.t) for run in runs])
            made.append(
                recording_from_arrays(
                    np.concatenate([run.t for run in runs]),
                    np.concatenate([run.q for run in runs]),
                    np.concatenate([run.tau for run in runs]),
                    joint_names=names,
                    further=FurtherColumns(temperature=heat),
                    segment=labels if len(numbers) > 1 else None,
                    name=f"run {numbers[0] + 1}",
                )
            )
        return made


def label_of(case: Case, index: int) -> str:
    """The name of a run as the product says it: that of its file, and of its segment where a file has several."""
    first = index
    while case.session[first].joined:
        first -= 1
    last = index
    while last + 1 < len(case.session) and case.session[last + 1].joined:
        last += 1
    return f"run {first + 1}" if first == last else f"run {first + 1}#{index + 1}"


def recorded(case: Case, folder: Path | None = None) -> Recorded:
    """The recordings of a case; `folder` keeps what was simulated without noise."""
    robot = arm_by_name(case.arm)
    kept = folder / f"{case.key}-{_engine_version()}.npz" if folder else None
    if kept and kept.exists():
        with np.load(kept) as stored:
            return Recorded(case, tuple(_stored(case, stored, k) for k in range(len(case.session))))
    arm = Arm(robot, usual_drives(robot), tuple(placed.physics for placed in case.hidden), case.manner.servo)
    exact = Instruments(case.instruments.counts, 0.0, case.instruments.rate)
    runs = []
    for k, take in enumerate(case.session):
        motion = _motion(robot, case.manner, take, case.manner.seed + k, arm.step)
        runs.append(record(arm, motion, exact, plan=Plan(k, take.start)))
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        arrays = {f"{name}{k}": getattr(run, name) for k, run in enumerate(runs) for name in ("t", "q", "exact_tau")}
        arrays |= {f"temperature{k}": _heat(run) for k, run in enumerate(runs) if run.temperature is not None}
        part = kept.with_suffix(".part.npz")
        np.savez(part, **arrays)
        part.replace(kept)
    return Recorded(
        case, tuple(_noisy(case, k, run.t, run.q, run.exact_tau, run.temperature) for k, run in enumerate(runs))
    )


def _motion(robot: Robot, manner: Manner, take: Take, seed: int, step: float) -> Motion:
    if manner.motion == "point-to-point":
        return point_to_point_motion(robot, take.duration, seed, step, take.pace)
    return fourier_motion(robot, take.duration, seed, step, slope=manner.slope, rise=2.0, pace=take.pace)


def _stored(case: Case, stored: np.lib.npyio.NpzFile, k: int) -> Run:
    heat = stored.get(f"temperature{k}")
    return _noisy(case, k, stored[f"t{k}"], stored[f"q{k}"], stored[f"exact_tau{k}"], heat)


def _noisy(
    case: Case,
    k: int,
    t: engine.FloatArray,
    q: engine.FloatArray,
    tau: engine.FloatArray,
    temperature: engine.FloatArray | None,
) -> Run:
    noise = case.instruments.noise * effort_limits(arm_by_name(case.arm))
    rng = np.random.default_rng([case.noise, k])
    return Run(t, q, tau + noise * rng.standard_normal(tau.shape), tau, noise, temperature)


def _heat(run: Run) -> engine.FloatArray:
    assert run.temperature is not None
    return run.temperature


@cache
def _engine_version() -> str:
    """Changes with the engine's code: what another one simulated is not used."""
    digest = hashlib.sha256()
    for path in sorted(Path(engine.__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]
