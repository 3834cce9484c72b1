"""How often 95 % intervals hold the true parameter, by class of parameter, over simulated recordings.

python benchmarks/interval_coverage.py [recordings [estimator]]

Torque of Pinocchio along another random motion each time, white torque noise of 1 % of the largest torque, encoders of
2^17 counts a turn that are one count unsteady; filters are chosen from the data as for a user. Beside it: intervals
that count every filtered sample as independent.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
import pinocchio
from common import FloatArray

from dynident.effects import Column, EffectChoice
from dynident.identification import IdentificationChoices, identify_model
from dynident.identification.choices import EstimatorName
from dynident.progress import silent
from dynident.recordings import Recording, choose_preprocessing, recording_from_arrays
from dynident.regressors.model import build_model
from dynident.robot import robot_from_library, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
DURATION, RATE = 20.0, 200.0
TORQUE_NOISE, COUNT = 0.01, 2 * np.pi / 2**17


@dataclass(frozen=True)
class Coverage:
    """Share of intervals that hold the truth, for each class of parameters; `naive` with all samples independent."""

    recordings: int
    honest: Mapping[str, float]
    naive: Mapping[str, float]
    largest_bias: Mapping[str, float]


class VirtualArm:
    """An arm with drawn rotors and friction, and what measures it."""

    def __init__(self, name: str = "ur10", seed: int = 0) -> None:
        self.robot = robot_from_library(name)
        self._model = to_pinocchio(self.robot)
        self._data = self._model.createData()
        self.drives = np.random.default_rng(seed).uniform(0.5, 5.0, (4, self.robot.n))

    @property
    def standard(self) -> FloatArray:
        """Standard parameters in the order of the columns of `EFFECTS`."""
        assert self.robot.inertias is not None
        return np.concatenate([self.robot.inertias.reshape(-1), self.drives.ravel()])

    def recorded(self, seed: int) -> Recording:
        """A recording of another motion with another noise for every seed."""
        rng = np.random.default_rng([7, seed])
        q, dq, ddq = self._motion(rng)
        ia, fc, fv, b = self.drives
        rigid = np.array([pinocchio.rnea(self._model, self._data, *rows) for rows in zip(q, dq, ddq, strict=True)])
        tau = rigid + ia * ddq + fc * np.sign(dq) + fv * dq + b
        tau += TORQUE_NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
        counts = np.round(q / COUNT + rng.standard_normal(q.shape))
        t = np.arange(len(q)) / RATE
        return recording_from_arrays(t, COUNT * counts, tau, joint_names=self.robot.joint_names, name=f"run {seed}")

    def _motion(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        t = np.arange(round(DURATION * RATE)) / RATE
        q, dq, ddq = (np.zeros((len(t), self.robot.n)) for _ in range(3))
        for harmonic in range(1, 6):
            w = 2 * np.pi * 0.1 * harmonic
            size = rng.uniform(0.3, 1.0, self.robot.n) / np.sqrt(harmonic)
            wave = w * t[:, None] + rng.uniform(0, 2 * np.pi, self.robot.n)
            q += 0.5 * size * np.sin(wave)
            dq += 0.5 * size * w * np.cos(wave)
            ddq -= 0.5 * size * w**2 * np.sin(wave)
        return q, dq, ddq


def class_of(column: Column) -> str:
    """Inertia (second moments), first moments, or the effect's name."""
    if column.effect != "rigid_body":
        return column.effect
    return "first moments" if column.parameter.startswith("M") else "inertia"


def study(recordings: int, first: int = 0, estimator: EstimatorName = "wls") -> Coverage:
    """Identify so many recordings with an estimator, the first with the seed `first`, and count."""
    arm = VirtualArm()
    model = build_model(arm.robot, EFFECTS)
    truth = model.base.grouping @ arm.standard
    held, naively, errors, deviations = [], [], [], []
    for seed in range(first, first + recordings):
        recording = arm.recorded(seed)
        filters = choose_preprocessing([recording])
        choices = IdentificationChoices(effects=EFFECTS, preprocessing=filters, estimator=estimator)
        found = identify_model(model, [recording], [], choices, filters, np.zeros(14 * arm.robot.n), silent)
        low, high = np.array([parameter.interval for parameter in found.parameters]).T
        held.append((low <= truth) & (truth <= high))
        # [12.6]-[12.9] as they stand: (WᵀW)⁻¹ of rows in units of their noise, every row counted.
        plain = 1.96 * np.sqrt(np.diag(found.solution.normal_inverse))
        naively.append(np.abs(found.values - truth) <= plain)
        errors.append(found.values - truth)
        deviations.append(found.statistics.standard_deviations)
    classes = np.array([class_of(column) for column in model.kept])
    bias = np.abs(np.mean(errors, axis=0) / np.mean(deviations, axis=0))
    named = list(dict.fromkeys(classes.tolist()))
    return Coverage(
        recordings,
        {name: float(np.mean(np.array(held)[:, classes == name])) for name in named},
        {name: float(np.mean(np.array(naively)[:, classes == name])) for name in named},
        {name: float(bias[classes == name].max()) for name in named},
    )


def main() -> None:
    recordings = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    estimator = cast(EstimatorName, sys.argv[2]) if len(sys.argv) > 2 else "wls"
    begun = time.perf_counter()
    found = study(recordings, estimator=estimator)
    print(f"{found.recordings} recordings of {DURATION:g} s in {time.perf_counter() - begun:.0f} s")
    print(f"{'class':16s} {'95 % interval':>14s} {'rows independent':>18s} {'largest bias / sd':>18s}")
    for name, share in found.honest.items():
        print(f"{name:16s} {share:14.1%} {found.naive[name]:18.1%} {found.largest_bias[name]:18.2f}")


if __name__ == "__main__":
    main()
