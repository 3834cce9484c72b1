"""How often does the decision rule see something where there is nothing? Filtered noise instead of a residual.

    python benchmarks/decision_level.py [--seed 1 | --seed new] [--draws 200]

Three joints with ten columns of a model and a hundred candidates of one to seven columns, all smooth noise; the torque
is white noise after a low-pass filter. Stretches of time are two or four times as long as the filter smears (its width
is the inverse of its cut-off). `p <= 0.01` and `p <= 0.05` are the shares of draws in which the family-wise test says
so of any candidate, and should be no more; `named`: in which one of them would predict what was left out, too.
"""

from __future__ import annotations

import argparse
import os
import secrets

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import FloatArray, show
from scipy import signal

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import FoldedFits, JointBlocks, score_candidates, score_folds
from dynident.diagnosis.candidates.significance import ALPHA, combine_scores, draw_scores, run_familywise_test
from dynident.diagnosis.candidates.time_blocks_and_folds import Products

JOINTS, MODEL = 3, 10
WIDTHS = (1,) * 60 + (2,) * 20 + (3,) * 10 + (7,) * 10
# Rows in a width of the filter, as the decimation leaves at least half of.
ROWS = 8
CASES = ((13, 4), (26, 2), (40, 4), (40, 2), (80, 4), (80, 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", default="1")
    parser.add_argument("--draws", type=int, default=200)
    arguments = parser.parse_args()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    lines = [("stretches", "long, widths", "p <= 0.01", "p <= 0.05", "named")]
    for n_blocks, long in CASES:
        rng = np.random.default_rng([seed, n_blocks, long])
        smallest, named = np.array([drawn(rng, n_blocks, long) for _ in range(arguments.draws)]).T
        shares = [f"{100 * np.mean(smallest <= level):.1f} %" for level in (0.01, 0.05)]
        lines.append((str(n_blocks), str(long), *shares, f"{100 * named.mean():.1f} %"))
    show(f"Candidates that explain nothing, seed {seed}, {arguments.draws} draws", lines)


def drawn(rng: np.random.Generator, n_blocks: int, long: int) -> tuple[float, bool]:
    """The smallest p of all candidates, and whether any of them would pass."""
    first = np.cumsum((MODEL, *WIDTHS))
    candidates = [
        Candidate("offset", (), (), tuple(range(end - width, end)))
        for end, width in zip(first[1:], WIDTHS, strict=True)
    ]
    columns = int(first[-1])
    rows = n_blocks * long * ROWS
    grams = tuple(_gram(rng, rows, columns, n_blocks) for _ in range(JOINTS))
    position = tuple(np.arange(columns) for _ in range(JOINTS))
    counts = np.full((n_blocks, JOINTS), float(long * ROWS))
    data = Products.from_grams(grams, position, counts, np.zeros(n_blocks, dtype=np.intp))
    base, noise, joints = np.arange(MODEL), np.ones(JOINTS), tuple(range(JOINTS))
    scores = [score_candidates(data, base, candidates, noise, kind)[1] for kind in ("interleaved", "contiguous")]
    judged = combine_scores(scores, [joints] * len(candidates), noise)
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, base, candidates), noise, ())
    _, contributions = score_folds(data, fits, candidates, noise, by_parameters=True)
    p = run_familywise_test(np.array([item.gains for item in judged]), draw_scores(contributions))[0]
    named = any(item.t > 0 and item.drop > 0 and value <= ALPHA for item, value in zip(judged, p, strict=True))
    return float(p.min()), named


def _gram(rng: np.random.Generator, rows: int, columns: int, n_blocks: int) -> FloatArray:
    """(s, columns + 1, columns + 1): of columns of half the filter's band, and of noise in all of it."""
    slow, band = (signal.butter(4, share / ROWS, output="sos") for share in (1.0, 2.0))
    w = _unit(signal.sosfiltfilt(slow, rng.normal(size=(rows + 20 * ROWS, columns)), axis=0))
    y = _unit(signal.sosfiltfilt(band, rng.normal(size=(rows + 20 * ROWS, 1)), axis=0))
    both = np.column_stack([w, y])[10 * ROWS : -10 * ROWS].reshape(n_blocks, -1, columns + 1)
    return np.asarray(both.transpose(0, 2, 1) @ both)


def _unit(values: FloatArray) -> FloatArray:
    return np.asarray(values / values.std(axis=0))


if __name__ == "__main__":
    main()
