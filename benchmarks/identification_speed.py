"""From arrays to parameters and standard deviations, against a plain Pinocchio and numpy script.

    python benchmarks/identification_speed.py

Both start from arrays of t, q and torque in memory, with the model ready (symbols, base parameters): that part does
not depend on the data and is timed apart. The plain script takes the samples for uniform; where the clock jitters, as
on the recorded arm, that is most of the difference between the two errors: ours resamples first.
"""

from __future__ import annotations

import time

import numpy as np
import pyarrow.parquet as pq
from common import (
    RECORDINGS,
    PlainResult,
    Samples,
    independent_columns,
    median_time,
    plain_identification,
    show,
    simulated_samples,
)
from compared import compared

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.identification import Identification, IdentificationChoices, identify_model
from dynident.progress import ignore_progress
from dynident.recordings import Preprocessing, Recording, choose_preprocessing, recording_from_arrays
from dynident.regressors.model_structure import build_model
from dynident.robot import Robot, robot_from_library, robot_from_urdf, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # N m/A, of the recorded UR10e
REPEATS = 15


def main() -> None:
    robot, samples = arm_and_samples()
    model = to_pinocchio(robot)
    start = time.process_time()
    ours = build_model(robot, EFFECTS)
    building = time.process_time() - start
    start = time.process_time()
    columns = independent_columns(model)
    plain_building = time.process_time() - start

    def recorded() -> Recording:
        return recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names)

    preprocessing = choose_preprocessing([recorded()])
    preprocessing = Preprocessing(preprocessing.position_cutoff, preprocessing.torque_cutoff, preprocessing.decimation)
    cutoff = preprocessing.position_cutoff
    assert cutoff is not None

    def identified() -> Identification:
        choices = IdentificationChoices(effects=EFFECTS, estimator="wls")
        reference = ReferenceParameters.massless(robot)
        found = identify_model(ours, [recorded()], [], choices, preprocessing, reference, ignore_progress)
        assert found.statistics.standard_deviations.shape == (ours.n_parameters,)
        return found

    def plain() -> PlainResult:
        return plain_identification(model, samples, columns, cutoff=cutoff, decimation=preprocessing.decimation)

    ours_time, plain_time = median_time(identified, REPEATS), median_time(plain, REPEATS)
    a, b = identified(), plain()
    print(f"{samples.source}: {len(samples.t)} samples x {robot.n} joints, {samples.rate:.1f} Hz; ", end="")
    print(f"cut-off {cutoff:g} Hz, decimated by {preprocessing.decimation}; median of {REPEATS} runs")
    show(
        "Arrays to parameters and standard deviations",
        [
            ("", "model, once", "identification", "parameters", "relative error"),
            (
                "plain Pinocchio and numpy",
                f"{1e3 * plain_building:.0f} ms",
                f"{1e3 * plain_time:.1f} ms",
                f"{len(b.values)}",
                f"{100 * b.relative_error:.2f} %",
            ),
            (
                "dynident",
                f"{1e3 * building:.0f} ms",
                f"{1e3 * ours_time:.1f} ms",
                f"{ours.n_parameters}",
                f"{100 * a.fit.relative_total:.2f} %",
            ),
        ],
    )
    what = (
        f"arrays to parameters and standard deviations, {samples.source}, {len(samples.t):,} samples x {robot.n} joints"
    )
    compared(what, ours_time, "plain Pinocchio and numpy", plain_time)
    print(f"\n  ratio dynident / plain: {ours_time / plain_time:.2f}")


def arm_and_samples() -> tuple[Robot, Samples]:
    """The recorded UR10e where its files are there, else a simulated UR10 with as many samples."""
    folder = RECORDINGS / "ur10e"
    if not folder.exists():
        robot = robot_from_library("ur10")
        return robot, simulated_samples(to_pinocchio(robot), 2900, 94.0)
    robot = robot_from_urdf("ur10e", (folder / "robot.urdf").read_text())
    table = pq.read_table(folder / "id_30s_12harm.parquet").slice(634, 3510 - 634)
    q = np.column_stack([table[f"q{j}"] for j in range(1, 7)])
    tau = GAINS * np.column_stack([table[f"current{j}"] for j in range(1, 7)])
    return robot, Samples(table["t"].to_numpy(), q, tau, "recorded UR10e")


if __name__ == "__main__":
    main()
