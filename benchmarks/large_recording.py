"""A large Parquet recording to parameters and standard deviations: time and peak memory, each in a process of its own.

    python benchmarks/large_recording.py [--samples 1000000] [--plain-samples 100000] [--keep FOLDER]

Memory is the peak above that of the imports. The plain script holds W; it is given fewer samples where the whole
would not fit, and its time is scaled up in proportion (its loop and its least squares are linear in the samples).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RATE = 500.0
CUTOFF, DECIMATION = 10.0, 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--plain-samples", type=int, default=100_000)
    parser.add_argument("--keep", type=Path, help="keep the recordings in this folder, and find them there next time")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        kind, path, _ = arguments.child
        print(json.dumps(CHILDREN[kind](Path(path), int(arguments.child[2]))))
        return
    with tempfile.TemporaryDirectory() as scratch:
        compare(arguments.keep or Path(scratch), arguments.samples, arguments.plain_samples)


def compare(folder: Path, n_samples: int, n_plain: int) -> None:
    from common import show
    from compared import compared

    folder.mkdir(parents=True, exist_ok=True)
    counts = (n_samples // 5, n_samples, 2 * n_samples)
    for count in counts:
        if not recording_path(folder, count).exists():
            run("write", folder, count)
    found = {count: run("dynident", folder, count) for count in counts}
    plain = run("plain", folder, n_samples, n_plain)
    scale = n_samples / n_plain
    rows = [("", "samples", "read and checked", "identified", "memory above imports", "parameters")]
    for count, item in found.items():
        rows.append(
            (
                "dynident",
                f"{count:,}",
                f"{item['importing']:.2f} s",
                f"{item['seconds']:.2f} s",
                f"{item['memory']:.0f} MB",
                f"{item['parameters']}",
            )
        )
    rows.append(
        (
            "plain Pinocchio and numpy",
            f"{n_plain:,}",
            "",
            f"{plain['seconds']:.2f} s",
            f"{plain['memory']:.0f} MB",
            f"{plain['parameters']}",
        )
    )
    show(f"6 joints at {RATE:g} Hz, cut-off {CUTOFF:g} Hz, decimated by {DECIMATION}", rows)
    mine = found[n_samples]
    whole = mine["seconds"] + mine["importing"]
    rival, scaled = f"plain Pinocchio and numpy, scaled from {n_plain:,}", scale * plain["seconds"]
    compared(f"{n_samples:,} samples x 6 joints, from the checked recording", mine["seconds"], rival, scaled)
    compared(f"{n_samples:,} samples x 6 joints, from the user's own file", whole, rival, scaled)
    compared(f"memory for {n_samples:,} samples", mine["memory"], rival, scale * plain["memory"], "MB")
    print(f"\n  plain script scaled to {n_samples:,} samples: {scale * plain['seconds']:.1f} s", end="")
    print(f", {scale * plain['memory'] / 1e3:.1f} GB")
    print(f"  ratio dynident / plain, from the checked recording: {mine['seconds'] / (scale * plain['seconds']):.3f}")
    print(f"  ratio dynident / plain, from the user's own file: {whole / (scale * plain['seconds']):.3f}")
    print(f"  memory for {counts[2]:,} samples over {counts[0]:,}: ", end="")
    print(f"{found[counts[2]]['memory'] / found[counts[0]]['memory']:.2f}")


def run(kind: str, folder: Path, count: int, used: int = 0) -> dict[str, float]:
    """Run one measurement in a process of its own."""
    command = [sys.executable, __file__, "--child", kind, str(recording_path(folder, count)), str(used or count)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    result: dict[str, float] = json.loads(answer.stdout.splitlines()[-1])
    return result


def recording_path(folder: Path, count: int) -> Path:
    return folder / f"recording_{count}.parquet"


def write(path: Path, count: int) -> dict[str, float]:
    """Write a simulated recording of a UR10 with friction and noise."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from common import simulated_samples

    from dynident.robot import robot_from_library, to_pinocchio

    samples = simulated_samples(to_pinocchio(robot_from_library("ur10")), count, RATE)
    columns = {"t": samples.t}
    columns |= {f"q{j + 1}": samples.q[:, j] for j in range(samples.q.shape[1])}
    columns |= {f"tau{j + 1}": samples.tau[:, j] for j in range(samples.tau.shape[1])}
    pq.write_table(pa.table(columns), path)
    return {}


def streamed(path: Path, _count: int) -> dict[str, float]:
    """Import, check, filter, reduce, identify."""
    from common import peak_memory

    import dynident.identification
    import dynident.recordings
    from dynident.effects import EffectChoice
    from dynident.identification import IdentificationChoices
    from dynident.robot import robot_from_library

    robot = robot_from_library("ur10")
    before = peak_memory()
    with tempfile.TemporaryDirectory() as scratch:
        start = time.process_time()
        recording, _ = dynident.recordings.import_recording(
            path,
            Path(scratch) / "checked.parquet",
            dynident.recordings.RecordedJoints(robot.joint_names),
            metadata=dynident.recordings.RecordingMetadata(name="large"),
        )
        importing = time.process_time() - start
        start = time.process_time()
        names = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
        choices = IdentificationChoices(
            effects=tuple(EffectChoice(name) for name in names),
            estimator="wls",
            preprocessing=dynident.recordings.Preprocessing(CUTOFF, CUTOFF, DECIMATION),
        )
        found = dynident.identification.identify(robot, [recording], choices=choices)
        assert len(found.parameters) == found.model.n_parameters
        seconds = time.process_time() - start
    return {
        "seconds": seconds,
        "importing": importing,
        "memory": peak_memory() - before,
        "parameters": found.model.n_parameters,
        "error": found.fit.relative_total,
    }


def plain(path: Path, count: int) -> dict[str, float]:
    """Read the columns, then the plain script."""
    import numpy as np
    import pyarrow.parquet as pq
    from common import Samples, independent_columns, peak_memory, plain_identification

    from dynident.robot import robot_from_library, to_pinocchio

    model = to_pinocchio(robot_from_library("ur10"))
    columns = independent_columns(model)
    before = peak_memory()
    start = time.process_time()
    table = pq.read_table(path).slice(0, count)
    q = np.column_stack([table[f"q{j + 1}"] for j in range(model.nv)])
    tau = np.column_stack([table[f"tau{j + 1}"] for j in range(model.nv)])
    samples = Samples(table["t"].to_numpy(), q, tau, "simulated")
    found = plain_identification(model, samples, columns, cutoff=CUTOFF, decimation=DECIMATION)
    seconds = time.process_time() - start
    return {
        "seconds": seconds,
        "memory": peak_memory() - before,
        "parameters": len(found.values),
        "error": found.relative_error,
    }


CHILDREN = {"write": write, "dynident": streamed, "plain": plain}

if __name__ == "__main__":
    main()
