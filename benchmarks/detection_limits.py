"""Are effects of the size of their detection limit found? Hidden at a half, once and twice the limit, on fresh seeds.

    python benchmarks/detection_limits.py [--seed 1] [--draws 10] [--effects joint_spring stribeck]

A draw is a UR10 of `tests/hidden_physics.py` with a motion and noise of its own. A clean recording gives the limits;
then each effect is added, on a joint of the draw, in sizes around its limit, and the recording is diagnosed. An effect
is found if it, or one that is reported as its equivalent, is recommended on that joint. Sizes are multiples of
`half_size`, which should be found in half of the cases, and `size` itself, which should be found in 95 %.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
from common import show
from support.hidden_effects import NAMES, ROBOT, WITH_OFFSET, experiment, on_joint

from dynident.diagnosis import Diagnosis, diagnose
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.effects import get_effect

SIZES = ("0.5 x half", "1 x half", "1 x size", "2 x half", "2 x size")

Law = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
Numbers = Mapping[str, float]

LAWS: Mapping[str, Callable[[Numbers, Numbers], Law]] = {
    "viscous_asymmetric": lambda p, c: lambda q, v, load: p["Fva"] * np.abs(v),
    "viscous_nonlinear": lambda p, c: lambda q, v, load: p["Fvn"] * np.abs(v) ** c["p"] * np.sign(v),
    "load_dependent_friction": lambda p, c: lambda q, v, load: p["cl"] * np.abs(load) * np.sign(v),
    "joint_spring": lambda p, c: lambda q, v, load: p["ks"] * q + p["bs"],
    "stribeck": lambda p, c: lambda q, v, load: p["Fst"] * np.exp(-((v / c["vs"]) ** 2)) * np.sign(v),
}
"""Torque of each effect, from its parameters and shape constants, as functions of q, q̇ and load."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--effects", nargs="*", default=list(LAWS), choices=list(LAWS))
    given = parser.parse_args()
    start = time.perf_counter()
    found: dict[tuple[str, str], list[bool]] = {(effect, size): [] for effect in given.effects for size in SIZES}
    for seed in range(given.seed, given.seed + given.draws):
        clean = experiment(seed=seed)
        limits = diagnose(clean.identification, [clean.training]).detection_limits
        for number, effect in enumerate(given.effects):
            joint = (seed + number) % len(NAMES)
            limit = next((item for item in limits if (item.effect, item.joints) == (effect, (NAMES[joint],))), None)
            if limit is None or not np.isfinite(limit.size):
                continue
            half, sure = limit.half_size, limit.size
            for name, value in zip(SIZES, (0.5 * half, half, sure, 2.0 * half, 2.0 * sure), strict=True):
                found[effect, name].append(_is_found(limit, value / limit.usual, joint, seed))
                print(effect, NAMES[joint], seed, name, found[effect, name][-1], flush=True)
    rows = [(effect, *_format_shares([found[effect, size] for size in SIZES])) for effect in given.effects]
    every = [[hit for effect in given.effects for hit in found[effect, size]] for size in SIZES]
    show(
        f"Found around the limits, seeds {given.seed} on, {time.perf_counter() - start:.0f} s",
        [("effect", "cases", *SIZES), *rows, ("all", *_format_shares(every))],
    )


def _format_shares(hits: list[list[bool]]) -> tuple[str, ...]:
    return str(len(hits[0])), *(f"{np.mean(own):.0%}" if own else "-" for own in hits)


def _is_found(limit: DetectionLimit, share: float, joint: int, seed: int) -> bool:
    usual = get_effect(limit.effect).usual(ROBOT, joint)
    assert usual is not None
    law = LAWS[limit.effect]({name: share * value for name, value in usual.values.items()}, dict(limit.shape))
    run = experiment(on_joint(joint, law), WITH_OFFSET, seed)
    return _names(diagnose(run.identification, [run.training]), limit.effect, NAMES[joint])


def _names(diagnosis: Diagnosis, effect: str, joint: str) -> bool:
    return any(
        item.significant and joint in item.joints and effect in (item.effect, *item.equivalent)
        for item in diagnosis.candidates
    )


if __name__ == "__main__":
    main()
