"""Several large recordings reduced one after the other, and on all processors at once: how many times faster.

    python benchmarks/recordings_side_by_side.py [--recordings 8] [--samples 1000000] [--keep FOLDER]

The answers have to be the same to the last bit; the exit code is 1 where they are not.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
from common import show
from engine.robots import arm_by_name

from dynident import parallel
from dynident.effects import DEFAULT_EFFECTS
from dynident.estimation import Reduction
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import Preprocessing, Recording, RecordingMetadata
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot
from dynident.robot.pinocchio_conversion import compute_described_torque

RATE = 500.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--keep", type=Path, help="keep the recordings in this folder, and find them there next time")
    asked = parser.parse_args()
    robot = arm_by_name("ur5")
    model = build_model(robot, DEFAULT_EFFECTS)
    reference = model.build_reference(np.zeros(model.n_parameters))
    with tempfile.TemporaryDirectory() as name:
        folder = asked.keep or Path(name)
        runs = [recorded(robot, folder, asked.samples, seed) for seed in range(asked.recordings)]

        def reduced(at_once: int) -> tuple[float, Reduction]:
            parallel.count_processors = lambda: at_once
            began = time.monotonic()
            found = reduce_recordings(
                model.observation, RegressorInputs(runs, Preprocessing(10.0, 10.0, 10), reference)
            )
            return time.monotonic() - began, found

        several = parallel.count_processors()
        (_, _), (alone, one), (together, other) = reduced(1), reduced(1), reduced(several)
    same = all(np.array_equal(a.factors, b.factors) for a, b in zip(one.equations, other.equations, strict=True))
    rows = [
        ("one at a time", f"{alone:.1f} s", ""),
        (f"{several} at a time", f"{together:.1f} s", f"{alone / together:.2f}"),
    ]
    memory = psutil.Process().memory_info().rss / 1e6
    show("Reduced", [("recordings", "time", "times faster"), *rows, ("memory at the end", f"{memory:.0f} MB", "")])
    sys.exit(0 if same else 1)


def recorded(robot: Robot, folder: Path, samples: int, seed: int) -> Recording:
    """A recording of a random Fourier motion, with friction and noise."""
    source = written(robot, folder, samples, seed)
    return import_for_robot(robot, source, folder / f"kept-{source.name}", RecordingMetadata())[0]


def written(robot: Robot, folder: Path, samples: int, seed: int) -> Path:
    """The file of such a recording, where it was not written before."""
    folder.mkdir(exist_ok=True)
    source = folder / f"run-{seed}-{samples}.parquet"
    if not source.exists():
        rng, t = np.random.default_rng(seed), np.arange(samples) / RATE
        q = np.zeros((samples, robot.n))
        for harmonic in range(1, 6):
            size, phase = 0.15 * rng.normal(size=robot.n), rng.uniform(0.0, 2 * np.pi, robot.n)
            q += size * np.sin(2 * np.pi / 10.0 * harmonic * t[:, None] + phase)
        dq = np.gradient(q, 1 / RATE, axis=0)
        tau = compute_described_torque(robot, q, dq, np.gradient(dq, 1 / RATE, axis=0)) + np.sign(dq)
        tau += 0.1 * rng.normal(size=tau.shape)
        columns = {f"{kind}{j + 1}": of[:, j] for kind, of in (("q", q), ("tau", tau)) for j in range(robot.n)}
        pq.write_table(pa.table({"t": t, **columns}), source)
    return source


if __name__ == "__main__":
    main()
