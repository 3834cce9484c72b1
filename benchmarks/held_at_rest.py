"""What holds a joint at rest beyond the model's friction? The constants of `diagnosis/search/sticking.py`.

    python benchmarks/held_at_rest.py [--seed 1 | --seed new] [--cases 60] [--processes 2]

Arms of another engine (`engine/`) with friction, gears, springs or nothing hidden in them are identified, diagnosed
without their halts, and grown by what was recommended. Then the halts of every joint with a dozen or more of them are
looked at, of the joints that have Stribeck friction which the diagnosis did not name apart from all others.

`share`: what is held beyond the model's friction at most, over that friction, in the middle halt; `over noise`: the
middle one over the residual where the joint moves; `above 0.2, 5`: share of the halts in which it is more than 0.2 of
the friction and 5 times that residual; `apart`: how far half of the halts lie apart, over the middle one.
"""

from __future__ import annotations

import argparse
import os
import secrets
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.case import Case
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded

from dynident.diagnosis import compare, diagnose
from dynident.diagnosis.search.sticking import halts_of
from dynident.identification import extend, identify

# The package shows the function of that name, not the module.
DIAGNOSIS = import_module("dynident.diagnosis.diagnose")
HALTS = 12
LIMITS = ((0.2, 3.0), (0.2, 5.0), (0.3, 3.0), (0.3, 5.0))
"""Of the friction, and of the residual where the joint moves: both have to be exceeded."""
FAMILIES = (
    "stribeck", "clean", "stribeck+base_tilt", "presliding", "stribeck", "load_dependent_friction", "joint_elasticity",
    "stribeck+torque_ripple", "backlash", "joint_spring", "transmission_coupling", "torque_delay",
)  # fmt: skip


@dataclass(frozen=True)
class Joint:
    """The halts of one joint."""

    case: str
    joint: str
    hidden: bool
    """Whether it has Stribeck friction that was not named."""
    share: float
    above: tuple[float, ...]
    apart: float
    over_noise: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "hidden-effects")
    arguments = parser.parse_args()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    cases = draw_cases(Wanted(seed, arguments.cases, FAMILIES))
    start = time.perf_counter()
    joints = [one for some in run(cases, arguments.cache, arguments.processes) for one in some]
    seconds = time.perf_counter() - start
    show(f"Halts, seed {seed}, {len(cases)} cases, {seconds:.0f} s", table(joints))


def run(cases: Sequence[Case], folder: Path, processes: int) -> Iterator[list[Joint]]:
    """The joints of every case, as they come."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for job in as_completed([pool.submit(joints_of, case, folder) for case in cases]):
            found = job.result()
            print(*found, sep="\n", flush=True)
            yield found


def joints_of(case: Case, folder: Path) -> list[Joint]:
    """Identify, diagnose and extend a case, and look at its halts."""
    data = recorded(case, folder)
    robot = as_described(arm_by_name(case.arm), case.noise)
    training = data.recordings(held_out=False)
    plain = identify(robot, training)
    with patch.object(DIAGNOSIS, "held_at_rest", lambda grown, recordings, final, asked: (grown, final, ())):
        recommended = diagnose(plain, training).recommended
    grown = extend(plain, recommended, training) if recommended else plain
    named = {joint for choice in recommended for joint in choice.joints if choice.effect == "stribeck"}
    there = {robot.joint_names[j] for placed in case.hidden if placed.effect == "stribeck" for j in placed.joints}
    comparisons = [compare(grown, recording) for recording in training]
    found = []
    for j, joint in enumerate(robot.joint_names):
        halts = halts_of(comparisons, j)
        if len(halts.beyond) < HALTS or joint in there & named:
            continue
        low, middle, high = np.quantile(halts.beyond, (0.25, 0.5, 0.75))
        residual = comparisons[0].noise[j]
        above = tuple(
            round(float(((halts.share >= share) & (halts.beyond >= times * residual)).mean()), 3)
            for share, times in LIMITS
        )
        apart = float((high - low) / middle) if middle > 0 else np.inf
        share, noise = float(np.median(halts.share)), float(middle / residual)
        found.append(Joint(case.name, joint, joint in there, share, above, apart, noise))
    return found


def table(joints: Sequence[Joint]) -> list[tuple[str, ...]]:
    """Quantiles over the joints with and without hidden Stribeck friction."""
    rows = [("joints", "number", "of", "5 %", "median", "95 %", "most")]
    for hidden, words in ((True, "Stribeck, not named"), (False, "all others")):
        own = [one for one in joints if one.hidden == hidden]
        columns = {
            "share": [one.share for one in own],
            **{f"above {share:g}, {times:g}": [one.above[k] for one in own] for k, (share, times) in enumerate(LIMITS)},
            "apart": [one.apart for one in own],
            "over noise": [one.over_noise for one in own],
        }
        for name, values in columns.items():
            if values:
                quantiles = np.quantile(values, (0.05, 0.5, 0.95, 1.0))
                rows.append((words, str(len(own)), name, *(f"{value:.2f}" for value in quantiles)))
    return rows


if __name__ == "__main__":
    main()
