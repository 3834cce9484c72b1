"""How often models drawn around an identified one cover the recorded open-loop drift; 90 % is asked.

    python benchmarks/drift_coverage.py [--arms 1]

Three real arms. Each is identified on one recording, its torque disturbance is measured on a second one, and coverage
is counted on a third: from up to 40 recorded states of it, 20 drawn models move under the recorded torque and a drawn
disturbance. A recorded position is covered if it lies within the central 90 % of the drawn ones, taken as normal. The
first row of each arm has draws of the parameters alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common import RECORDINGS, show

import dynident as dy
from dynident.export import TorqueDisturbance, build_distribution, compute_drift_coverage, measure_disturbance
from dynident.recordings import RecordedJoints, RecordingMetadata, import_recording

HORIZONS = (0.1, 0.5, 2.0)
Part = tuple[str, tuple[tuple[float, float], ...]]


@dataclass(frozen=True)
class Arm:
    """A robot, the recording for the fit, that for the disturbance, and that for the judgement, with their windows."""

    folder: str
    fit: Part
    measured: Part
    judged: Part
    gains: tuple[float, ...] | None = None


ARMS = (
    Arm(
        "ur10e",
        ("id_30s_12harm", ()),
        ("id_50s_12harm", ()),
        ("val_ptp10", ()),
        (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
    ),
    Arm(
        "ur10",
        ("exciting_traj", ((0.0, 12.0),)),
        ("exciting_traj", ((12.0, 18.0),)),
        ("exciting_traj", ((18.0, 27.5),)),
    ),
    Arm("kr300", ("id_A", ()), ("val_B", ()), ("val_C", ())),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=len(ARMS), help="how many of the arms")
    chosen = ARMS[: parser.parse_args().arms]
    if not RECORDINGS.is_dir():
        sys.exit(f"no recordings of real robots at {RECORDINGS}")
    for arm in chosen:
        judge_arm(arm)


def judge_arm(arm: Arm) -> None:
    folder = RECORDINGS / arm.folder
    robot = dy.load_robot(folder / "robot.urdf")
    joints = RecordedJoints(robot.joint_names, gains=arm.gains)
    with tempfile.TemporaryDirectory() as scratch:
        fit, measured, judged = (
            import_recording(
                folder / f"{name}.parquet",
                Path(scratch) / f"{place}.parquet",
                joints,
                metadata=RecordingMetadata(name=f"{name}_{place}", windows=windows),
            )[0]
            for place, (name, windows) in enumerate((arm.fit, arm.measured, arm.judged))
        )
        model = dy.identify(robot, [fit], validation=[measured], effects=("default", "offset")).identification
        disturbance = measure_disturbance(model, [measured], nearest=True)
        distribution = build_distribution(model, disturbance, nearest=True)
        nothing = TorqueDisturbance(np.zeros(robot.n), disturbance.time)
        rows = [("", *(f"after {horizon:g} s" for horizon in HORIZONS), "by joint after 0.5 s")]
        for name, torque in (("parameters alone", nothing), ("with the disturbance", disturbance)):
            covered = compute_drift_coverage(
                replace(distribution, disturbance=torque), model, [judged], HORIZONS, nearest=True
            )
            by_joint = " ".join(f"{100 * share:.0f}" for share in covered[1])
            rows.append((name, *(f"{100 * share:.0f} %" for share in covered.mean(axis=1)), by_joint))
    size = ", ".join(f"{value:.2g}" for value in disturbance.deviation)
    time = ", ".join(f"{value:.2g}" for value in disturbance.time)
    show(f"{arm.folder}: recorded drift that is covered (disturbance {size} N m, {time} s)", rows)


if __name__ == "__main__":
    main()
