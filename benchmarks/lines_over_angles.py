"""How far does a ripple's line stand out over a joint's angle, and how far what is none?

    python benchmarks/lines_over_angles.py [--seed 1 | --seed new] [--cases 60] [--processes 2]

Calibrates `LINE_RATIO` of `diagnosis/residuals/lines.py`. Arms of `hidden_effects.py`, with a torque ripple on one
joint, with another effect, or with none, are identified, and the spectrum of what is left is taken over each joint's
angle. `ripples`: how many of them have a line that stands out by so many times its surroundings (those of at most two
cycles over the joint's range are not asked: they are found otherwise); `others`: how many joints without a ripple have
any line that does.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.asking import asked, each
from hiding.case import Case
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import compare
from dynident.diagnosis.residuals.spectral_peaks import compute_angle_power, find_peaks
from dynident.identification import identify

LIMITS = (8.0, 12.0, 15.0, 18.0, 21.0, 24.0, 30.0, 50.0)
FAMILIES = ("torque_ripple", "clean", "stribeck", "torque_ripple", "base_tilt", "offset")
LEAST_ROWS, LEAST_ANGLE = 200, 0.2


@dataclass(frozen=True)
class Standing:
    """A joint: how many of the limits its line exceeds, and whether that is a ripple's."""

    case: str
    joint: int
    exceeded: int
    ripple: bool


def main() -> None:
    given = asked(__doc__ or "", 60)
    start, seen = time.perf_counter(), []
    wanted = Wanted(given.seed, given.cases, families=FAMILIES)
    for some in each(partial(standing, folder=given.cache), draw_cases(wanted), given.processes):
        seen += some
        for one in some:
            if one.ripple or one.exceeded > LIMITS.index(15.0):
                print(
                    f"  {'ripple' if one.ripple else 'other'} {one.case} joint {one.joint}: {one.exceeded}", flush=True
                )
    rows = [("times its surroundings", "ripples", "others")]
    for number, limit in enumerate(LIMITS):
        counts = (sum(one.exceeded > number for one in seen if one.ripple == sort) for sort in (True, False))
        rows.append((f"{limit:g}", *map(str, counts)))
    ripples = sum(one.ripple for one in seen)
    rows.append(("of", str(ripples), str(len(seen) - ripples)))
    show(f"Lines over angles, seed {given.seed}, {time.perf_counter() - start:.0f} s", rows)


def standing(case: Case, folder: Path | None) -> list[Standing]:
    """How far the lines of a case's joints stand out."""
    return list(_standing(case, folder))


def _standing(case: Case, folder: Path | None) -> Iterator[Standing]:
    training = recorded(case, folder).recordings(held_out=False)
    robot = as_described(arm_by_name(case.arm), case.noise)
    model = identify(robot, training)
    comparisons = [compare(model, recording) for recording in training]
    hidden = {p.joints[0]: dict(p.shape)["k"] for p in case.hidden if p.effect == "torque_ripple"}
    for joint, description in enumerate(robot.joints):
        q = np.concatenate([c.q[c.counted_rows[:, joint], joint] for c in comparisons])
        residual = np.concatenate([c.residual[c.counted_rows[:, joint], joint] for c in comparisons])
        if description.kind != "revolute" or len(q) < LEAST_ROWS or np.ptp(q) < LEAST_ANGLE:
            continue
        k, power = compute_angle_power(q, residual)
        ripple = hidden.get(joint)
        if ripple is None:
            yield Standing(case.name, joint, sum(bool(find_peaks(k, power, limit)) for limit in LIMITS), ripple=False)
        elif ripple * np.ptp(q) > 4 * np.pi:
            yield Standing(case.name, joint, _exceeded(k, power, ripple, float(np.ptp(q))), ripple=True)


def _exceeded(k: FloatArray, power: FloatArray, ripple: float, span: float) -> int:
    """How many of the limits a line does that is no further from the ripple than lines are wide."""
    return sum(any(abs(line - ripple) < 2 * np.pi / span for line in find_peaks(k, power, limit)) for limit in LIMITS)


if __name__ == "__main__":
    main()
