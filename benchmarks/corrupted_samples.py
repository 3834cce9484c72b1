"""Which corrupted samples are found, and what is called corrupted in clean recordings.

    PYTHONPATH=tests/recordings python benchmarks/corrupted_samples.py [--seed 1] [--arms 4] [--calibrate]

Arms are drawn, with motions along harmonics and from point to point, at several rates, with noise of several tails. In
each of their recordings samples are spoilt: zeros, the largest value, a stuck one, spikes, single or in bursts.
`invented`: samples of clean recordings that are called corrupted; `named`: share of the spoilt ones that are found.
`--calibrate` shows what the constants of `recordings/conditioning/steps.py` stand on: the swings of noise of several
tails, and the largest of them, in usual steps. Take other seeds for it.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from support.spoilt_recordings import KINDS, NOISES, N, arm_signals, corrupt

from dynident.recordings import JointLimits, RecordedJoints
from dynident.recordings.conditioning.corrupted_sample_detection import measure_usual_steps
from dynident.recordings.recording_import import condition_arrays

RATES = (60.0, 100.0, 200.0, 500.0, 1000.0)
COUNTS = (1e-6, 1e-4, 2e-3)
JOINTS = RecordedJoints([f"joint{k + 1}" for k in range(N)], [JointLimits()] * N)


def found_in(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(m, 2 n): which samples are called corrupted."""
    *_, checks = condition_arrays(t, values[:, :N], values[:, N:], JOINTS)
    found = np.zeros(values.shape, dtype=bool)
    for check in checks:
        if check.name == "corrupted_samples":
            for source, rows in check.rows.items():
                kind, joint = source.split("_joint")
                found[np.array(rows) - 1, int(joint) - 1 + (N if kind == "tau" else 0)] = True
    return found


def invented(seed: int, arms: int) -> None:
    """Look for corrupted samples where there are none."""
    total = samples = 0
    for arm, rate, moves, noise, count in product(range(arms), RATES, (False, True), NOISES, COUNTS):
        t, values = arm_signals(seed + arm, rate, 20.0, point_to_point=moves, noise=noise, count=count)
        found = found_in(t, values)
        samples += found.size
        total += int(found.sum())
        if found.any():
            print(f"  invented: arm {seed + arm}, {rate:g} Hz, moves {moves}, {noise}, {count:g}: {found.sum(axis=0)}")
    print(f"invented: {total} of {samples} samples")


def named(seed: int, arms: int) -> None:
    """Look for those that were planted."""
    print("kind      burst  share   positions   torques   invented")
    for kind, longest, share in product(KINDS, (1, 4), (0.001, 0.01, 0.02)):
        hits, planted_in, false = np.zeros(2), np.zeros(2), 0
        for arm, rate, moves in product(range(arms), (100.0, 200.0, 1000.0), (False, True)):
            t, values = arm_signals(seed + arm, rate, 20.0, point_to_point=moves)
            spoilt, planted = corrupt(values, seed + arm, share, kind, longest)
            found = found_in(t, spoilt)
            for part, columns in enumerate((slice(0, N), slice(N, 2 * N))):
                hits[part] += (found & planted)[:, columns].sum()
                planted_in[part] += planted[:, columns].sum()
            false += int((found & ~planted).sum())
        shares = hits / planted_in
        print(f"{kind:8} {longest:6} {share:6.1%} {shares[0]:11.1%} {shares[1]:9.1%} {false:10}")


def calibrate(seed: int) -> None:
    """Show how many swings noise of several tails makes, and the largest."""
    rng = np.random.default_rng(seed)
    print("noise     order   swings of 2 to 4 usual steps in 10^6   largest")
    for noise, order in product(NOISES, (1, 2)):
        steps = np.diff(NOISES[noise](rng, (1_000_000,)), n=order)
        usual = measure_usual_steps(steps[:, None])[:-1, 0]
        swings = (np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) / usual)[steps[1:] * steps[:-1] < 0.0]
        print(f"{noise:9} {order:5} {np.count_nonzero((swings >= 2.0) & (swings < 4.0)):38} {swings.max():9.1f}")


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--calibrate", action="store_true")
    options = parser.parse_args()
    if options.calibrate:
        calibrate(options.seed)
    invented(options.seed, options.arms)
    named(options.seed, options.arms)


if __name__ == "__main__":
    main()
