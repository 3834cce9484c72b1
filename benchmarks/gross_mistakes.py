"""Are gross mistakes in a recording noticed, with the right cure, and right recordings left alone?

    python benchmarks/gross_mistakes.py [--seed 1 | --seed new] [--cases 8] [--each 12]

Recordings of arms of the benchmark's engine, hidden effects and all, and of real arms where there are any. Untouched,
each has to pass; then mistakes are planted one by one: torques, positions or both of two joints exchanged, their signs
turned round. `harm` is the mean over the joints of the logarithm by which the share of the torque grows that the
robot's dynamics leave: what harms nothing (a joint about whose sign the data say nothing) cannot be noticed. `cured`:
what was named, or the first thing that cannot be told from it, undoes it.
"""

from __future__ import annotations

import argparse
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded
from placebos.subjects import REAL_ARMS, imported

from dynident.identification.mistakes.search import kinds_alike, left_of, mistakes_of, motion_of
from dynident.identification.mistakes.swaps import Mistake, Motion, mistakes_among
from dynident.recordings import Recording
from dynident.robot import Robot

HARMLESS = 0.1
"""Growth of the same logarithm that is no gross mistake."""


def main() -> None:
    """Run and print the tables."""
    options = _arguments()
    seed = secrets.randbelow(10**6) if options.seed == "new" else int(options.seed)
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    untouched: list[tuple[str, int, float]] = []
    planted: list[tuple[str, float, bool, bool]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, robot, recording in _recordings(seed, options.cases, Path(folder)):
            motion = motion_of(recording)
            if motion is None:
                continue
            told = mistakes_of(robot, motion)
            if told is None:
                continue
            untouched.append((name, len(told[0]), told[1]))
            possible = list(mistakes_among(np.ones(robot.n, dtype=bool), kinds_alike(robot)))
            chosen = [possible[k] for k in rng.permutation(len(possible))[: options.each]]
            planted += [(one.kind, *_tried(robot, motion, one)) for one in chosen]
    show(
        "Untouched recordings",
        [("recording", "mistakes named", "left"), *((n, str(c), f"{left:.1%}") for n, c, left in untouched)],
    )
    rows = [("mistake", "planted", "harmful", "noticed", "cured")]
    for kind in dict.fromkeys(one[0] for one in planted):
        own = [one for one in planted if one[0] == kind]
        harmful = [one for one in own if one[1] >= HARMLESS]
        rows.append(
            (kind, str(len(own)), str(len(harmful)), str(sum(o[2] for o in harmful)), str(sum(o[3] for o in harmful)))
        )
    show("Planted mistakes", rows)


def _tried(robot: Robot, motion: Motion, mistake: Mistake) -> tuple[float, bool, bool]:
    """Harm of a mistake, whether it is noticed, and whether what is named undoes it."""
    wrong = mistake.mended(motion)
    usual, bad = left_of(robot, motion), left_of(robot, wrong)
    told = mistakes_of(robot, wrong)
    found = told[0] if told else ()
    mended = wrong
    for one in found:
        mended = one.mistake.mended(mended)
    named = bool(found) and mistake in (found[0].mistake, *found[0].alike)
    cured = named or (bool(found) and left_of(robot, mended) <= usual * 1.05)
    return float(np.log(bad / usual)), bool(found), cured


def _recordings(seed: int, cases: int, folder: Path) -> Iterator[tuple[str, Robot, Recording]]:
    for case in draw_cases(Wanted(seed, cases)):
        robot = as_described(arm_by_name(case.arm), case.noise)
        yield case.name, robot, recorded(case, None).recordings(held_out=False)[0]
    for arm in REAL_ARMS:
        if arm.is_here and len(arm.files) == 1:
            robot, recordings = imported(arm, folder)
            yield arm.name, robot, recordings[0]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=8, help="simulated recordings")
    parser.add_argument("--each", type=int, default=12, help="mistakes planted in each recording")
    return parser.parse_args()


if __name__ == "__main__":
    main()
