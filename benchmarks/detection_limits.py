"""Are effects of the size of their detection limit found? Hidden at a half, once and twice the limit, on fresh seeds.

    python benchmarks/detection_limits.py [--seed 1] [--draws 10] [--of half]

A draw is a UR10 of `tests/hidden_physics.py` with a motion and noise of its own. A clean recording gives the limits;
then each effect is added, on a joint of the draw, in sizes around its limit, and the recording is diagnosed. An effect
is found if it, or one that is reported as its equivalent, is recommended on that joint. `--of half` takes the size that
is found in half of the cases for the limit, `--of sure` that of 95 %.
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
from hidden_physics import NAMES, ROBOT, WITH_OFFSET, experiment, on_joint

from dynident.diagnosis import Diagnosis, diagnose
from dynident.diagnosis.result import DetectionLimit
from dynident.effects import get_effect

FACTORS = (0.5, 1.0, 2.0)

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
    parser.add_argument("--of", choices=("sure", "half"), default="sure")
    given = parser.parse_args()
    start = time.perf_counter()
    found: dict[tuple[str, float], list[bool]] = {(effect, factor): [] for effect in LAWS for factor in FACTORS}
    for seed in range(given.seed, given.seed + given.draws):
        clean = experiment(seed=seed)
        limits = diagnose(clean.identification, [clean.training]).detection_limits
        for number, effect in enumerate(LAWS):
            joint = (seed + number) % len(NAMES)
            limit = next((item for item in limits if (item.effect, item.joints) == (effect, (NAMES[joint],))), None)
            size = limit and (limit.size if given.of == "sure" else limit.half_size)
            if limit is None or not size or not np.isfinite(size):
                continue
            for factor in FACTORS:
                found[effect, factor].append(_is_found(limit, factor * size / limit.usual, joint, seed))
                print(effect, NAMES[joint], seed, factor, found[effect, factor][-1], flush=True)
    rows: list[tuple[str, ...]] = [("effect", "cases", *(f"{factor:g} x limit" for factor in FACTORS))]
    for effect in LAWS:
        shares = [np.mean(found[effect, factor]) for factor in FACTORS]
        rows.append((effect, str(len(found[effect, 1.0])), *(f"{share:.0%}" for share in shares)))
    all_shares = [np.mean([hit for effect in LAWS for hit in found[effect, factor]]) for factor in FACTORS]
    rows.append(
        ("all", str(sum(len(found[effect, 1.0]) for effect in LAWS)), *(f"{share:.0%}" for share in all_shares))
    )
    show(f"Found around the {given.of} limit, {given.draws} draws, {time.perf_counter() - start:.0f} s", rows)


def _is_found(limit: DetectionLimit, share: float, joint: int, seed: int) -> bool:
    usual = get_effect(limit.effect).usual(ROBOT, joint)
    assert usual is not None
    law = LAWS[limit.effect]({name: share * value for name, value in usual.values.items()}, usual.shape)
    run = experiment(on_joint(joint, law), WITH_OFFSET, seed)
    return _names(diagnose(run.identification, [run.training]), limit.effect, NAMES[joint])


def _names(diagnosis: Diagnosis, effect: str, joint: str) -> bool:
    return any(
        item.significant and joint in item.joints and effect in (item.effect, *item.equivalent)
        for item in diagnosis.candidates
    )


if __name__ == "__main__":
    main()
