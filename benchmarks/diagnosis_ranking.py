"""Ranking every candidate of the catalogue by held-out error, against refitting the model with each of them.

    python benchmarks/diagnosis_ranking.py [--samples 60000]

A 7-joint arm. Ours makes one pass over the data and then does small algebra; refitting solves, for each candidate and
each of the five folds, the least squares of all rows of the other folds. Refitting is timed on some candidates and
scaled up; it is given the filtered rows of W and Y for nothing.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from common import FloatArray, show, simulated_samples
from compared import compared
from numpy.typing import NDArray

from dynident.diagnosis import diagnose
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool, build_pool
from dynident.diagnosis.candidates.held_out_scores import score_candidates
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, split_folds
from dynident.effects import EffectChoice
from dynident.estimation import Reduction
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording, recording_from_arrays
from dynident.regressors.dynamic_model_rows import reduce_recordings, stream_filtered_samples
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import robot_from_library, to_pinocchio

IndexArray = NDArray[np.intp]
RATE, N_REFITTED = 200.0, 4
PREPROCESSING = Preprocessing(10.0, 10.0, 4)
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=60_000)
    n_samples = parser.parse_args().samples
    robot = robot_from_library("franka_panda")
    samples = simulated_samples(to_pinocchio(robot), n_samples, RATE)
    recording = recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names)
    model = identify(robot, [recording], choices=IdentificationChoices(EFFECTS, preprocessing=PREPROCESSING))

    start = time.process_time()
    pool = build_pool(model.model)
    building = time.process_time() - start
    start = time.process_time()
    inputs = RegressorInputs([recording], PREPROCESSING, model.estimate.next_reference())
    data = products_of(reduce_recordings(pool.observation, inputs))
    reducing = time.process_time() - start
    base = np.arange(pool.n_base, dtype=np.intp)
    start = time.process_time()
    before, scores = score_candidates(data, base, pool.candidates, model.noise, "interleaved")
    scoring = time.process_time() - start
    ours = {score.candidate: float(score.after.sum()) / float(before.sum()) for score in scores}

    selected = pool.candidates[:: max(1, len(pool.candidates) // N_REFITTED)][:N_REFITTED]
    each, worst = refitted(pool, selected, recording, model, ours)
    start = time.process_time()
    diagnose(model, [recording])
    whole = time.process_time() - start

    n = len(pool.candidates)
    show(
        f"{robot.n} joints, {len(samples.t):,} samples, {n} candidates of {pool.observation.n_columns - pool.n_base} "
        "columns",
        [
            ("", "time", "candidates/s"),
            ("columns of all candidates, symbolic, once a robot", f"{building:.2f} s", ""),
            ("one pass over the data", f"{reducing:.2f} s", ""),
            ("ranking: held-out error of every candidate", f"{scoring:.2f} s", f"{n / scoring:.0f}"),
            (f"refitting with numpy's lstsq (scaled from {len(selected)})", f"{each * n:.1f} s", f"{1 / each:.1f}"),
            ("a whole diagnosis: pass, both kinds of folds, search, spectra", f"{whole:.2f} s", ""),
        ],
    )
    what, rival = (
        f"ranking {n} candidates, {robot.n} joints, {len(samples.t):,} samples",
        "refitting each with numpy's lstsq",
    )
    compared(what, scoring, rival, each * n)
    compared(f"{what}, with the pass over the data", scoring + reducing, rival, each * n)
    print(f"\n  ranking / refitting: {scoring / (each * n):.4f}", end="")
    print(f"; with the pass: {(scoring + reducing) / (each * n):.4f}")
    print(f"  largest difference between the held-out errors of the two: {worst:.1e} of the error")


def products_of(reduction: Reduction) -> Products:
    """Inner products of the rows of one run, from their triangular factors."""
    grams = [equation.factors.transpose(0, 2, 1) @ equation.factors for equation in reduction.equations]
    position = []
    for equation in reduction.equations:
        where = np.full(reduction.n_columns, -1, dtype=np.intp)
        where[equation.columns] = np.arange(len(equation.columns))
        position.append(where)
    counts = np.array([equation.counts for equation in reduction.equations]).T.astype(np.float64)
    return Products.from_grams(grams, position, counts, np.zeros(len(counts), dtype=np.intp))


def refitted(
    pool: Pool,
    selected: tuple[Candidate, ...],
    recording: Recording,
    model: Identification,
    ours: dict[Candidate, float],
) -> tuple[float, float]:
    """Seconds a candidate, and how far the held-out errors are from ours, relative to the error."""
    w, y, row_block = rows_of(pool, recording, model)
    noise = model.noise
    base = tuple(range(pool.n_base))
    plain = held_out(w[:, :, base] / noise[:, None], y / noise, row_block) * noise
    seconds, worst = 0.0, 0.0
    for candidate in selected:
        start = time.process_time()
        left = held_out(w[:, :, base + candidate.columns] / noise[:, None], y / noise, row_block) * noise
        seconds += time.process_time() - start
        ratio = float((left**2).sum() / (plain**2).sum())
        worst = max(worst, abs(ratio - ours[candidate]))
    return seconds / len(selected), worst


def rows_of(pool: Pool, recording: Recording, model: Identification) -> tuple[FloatArray, FloatArray, IndexArray]:
    """W (m, n, c) and Y (m, n) after the parallel filter, and the number of the stretch that each row is in."""
    observation = pool.observation
    w, y, t = [], [], []
    for part in stream_filtered_samples(observation, recording, PREPROCESSING, model.estimate.next_reference()):
        dense = np.zeros((len(part.t), observation.robot.n, observation.n_columns))
        dense[:, observation.entry_rows, observation.entry_columns] = part.values
        w.append(dense)
        y.append(part.tau)
        t.append(part.t)
    starts = model.data.training.spans[:, 0]
    return np.concatenate(w), np.concatenate(y), np.searchsorted(starts, np.concatenate(t), side="right") - 1


def held_out(w: FloatArray, y: FloatArray, row_block: IndexArray) -> FloatArray:
    """Residual (m, n) of every row, predicted by a fit to the other folds."""
    rest = np.empty_like(y)
    for left_out in split_folds(int(row_block.max()) + 1, "interleaved"):
        test = np.isin(row_block, left_out)
        fitted = np.linalg.lstsq(w[~test].reshape(-1, w.shape[2]), y[~test].reshape(-1), rcond=None)[0]
        rest[test] = y[test] - w[test] @ fitted
    return rest


if __name__ == "__main__":
    main()
