"""How often models drawn around an identified one cover the recorded open-loop drift; 90 % is asked.

    python benchmarks/drift_coverage.py [--arms NAME ...]

Three real arms. Each recording of an arm (or part of the only one) is once the one that a model is identified on; the
torque disturbance is measured on the next one, and coverage is counted on the one after that: from up to 40 recorded
states, 20 drawn models move under the recorded torque and a drawn disturbance. A position is covered if it lies
within the central 90 % of the drawn ones, taken as normal. The last rows are means over all roles.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common import RECORDINGS, FloatArray, show

import dynident as dy
from dynident.export import TorqueDisturbance, build_distribution, compute_drift_coverage, measure_disturbance
from dynident.recordings import RecordedJoints, RecordingMetadata, import_recording

HORIZONS = (0.1, 0.5, 2.0)
Part = tuple[str, tuple[tuple[float, float], ...]]


@dataclass(frozen=True)
class Arm:
    """A robot, its recordings with their windows, and its drive gains.

    Each recording is once that of the fit; the next one is that of the disturbance, the one after that is judged.
    """

    folder: str
    parts: tuple[Part, ...]
    gains: tuple[float, ...] | None = None


RUNS_UR10E = ("id_30s_12harm", "id_50s_12harm", "val_ptp10", "id_40s_12harm", "pair14_unloaded")
ARMS = (
    Arm(
        "ur10e",
        tuple(
            (name, ()) for name in ("id_30s_12harm", "id_50s_12harm", "val_ptp10", "id_40s_12harm", "pair14_unloaded")
        ),
        (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
    ),
    Arm("ur10", tuple(("exciting_traj", (window,)) for window in ((0.0, 9.0), (9.0, 18.0), (18.0, 27.5)))),
    Arm("kr300", tuple((name, ()) for name in ("id_A", "val_B", "val_C"))),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    names = [arm.folder for arm in ARMS]
    parser.add_argument("--arms", nargs="*", default=names, choices=names)
    chosen = parser.parse_args().arms
    if not RECORDINGS.is_dir():
        sys.exit(f"no recordings of real robots at {RECORDINGS}")
    for arm in ARMS:
        if arm.folder in chosen:
            judge_arm(arm)


def judge_arm(arm: Arm) -> None:
    folder = RECORDINGS / arm.folder
    robot = dy.load_robot(folder / "robot.urdf")
    joints = RecordedJoints(robot.joint_names, gains=arm.gains)
    rows = [("", *(f"after {horizon:g} s" for horizon in HORIZONS), "by joint after 0.5 s")]
    with tempfile.TemporaryDirectory() as scratch:
        recordings = [
            import_recording(
                folder / f"{name}.parquet",
                Path(scratch) / f"{place}.parquet",
                joints,
                metadata=RecordingMetadata(name=f"{name}_{place}", windows=windows),
            )[0]
            for place, (name, windows) in enumerate(arm.parts)
        ]
        covered: dict[str, list[FloatArray]] = {"parameters alone": [], "with the disturbance": []}
        for k in range(len(recordings)):
            fit, measured, judged = (recordings[(k + step) % len(recordings)] for step in range(3))
            model = dy.identify(robot, [fit], validation=[measured], effects=("default", "offset")).identification
            disturbance = measure_disturbance(model, [measured], nearest=True)
            distribution = build_distribution(model, disturbance, nearest=True)
            nothing = TorqueDisturbance(np.zeros(robot.n), disturbance.time)
            for torque, of_name in zip((nothing, disturbance), covered.values(), strict=True):
                drawn = replace(distribution, disturbance=torque)
                of_name.append(compute_drift_coverage(drawn, model, [judged], HORIZONS, nearest=True))
            rows.append(describe_coverage(f"fit {fit.name}, judged {judged.name}", covered["with the disturbance"][-1]))
    rows += [describe_coverage(f"all, {name}", np.mean(each, axis=0)) for name, each in covered.items()]
    show(f"{arm.folder}: recorded drift that is covered", rows)


def describe_coverage(name: str, covered: FloatArray) -> tuple[str, ...]:
    by_joint = " ".join(f"{100 * share:.0f}" for share in covered[1])
    return (name, *(f"{100 * share:.0f} %" for share in covered.mean(axis=1)), by_joint)


if __name__ == "__main__":
    main()
