"""Scores are the same read from the rows of a short recording and from the products of a long one."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.diagnosis.candidates import inner_product_accumulation
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import compute_contributions, score_candidates
from dynident.diagnosis.candidates.inner_product_accumulation import RowAccumulator
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, ProductStack, RowStack

JOINTS, COLUMNS, STRETCHES, PIECES = 3, 9, 12, 5
BASE, NOISE = np.arange(4), np.array([1.0, 0.5, 2.0])
CANDIDATES = [
    Candidate("offset", (), (), (4,)),
    Candidate("joint_spring", (), (), (5, 6)),
    Candidate("torque_ripple", (), (), (6, 7, 8)),
]


def gathered(most_rows: int, monkeypatch: pytest.MonkeyPatch) -> Products:
    """Rows pushed in pieces that begin in the middle of stretches; the second joint lacks some of the columns."""
    monkeypatch.setattr(inner_product_accumulation, "_MOST_ROWS", most_rows)
    random = np.random.default_rng(0)
    having = [np.arange(COLUMNS), np.array([0, 2, 3, 5, 8]), np.arange(COLUMNS)]
    collected = RowAccumulator([len(columns) for columns in having], 2, STRETCHES)
    for piece in range(PIECES):
        row_block = np.sort(random.integers(0, STRETCHES, 70)) if piece else np.arange(70) % STRETCHES
        rows = [random.normal(size=(70, len(columns) + 1)) for columns in having]
        moving = random.random((70, JOINTS)) < 0.7
        collected.push(row_block, rows, (moving, ~moving))
    (moving_stacks, counts), (others, _) = collected.finish(STRETCHES)
    position = []
    for columns in having:
        where = np.full(COLUMNS, -1)
        where[columns] = np.arange(len(columns))
        position.append(where)
    stacks = tuple(zip(moving_stacks, others, strict=True))
    return Products(stacks, tuple(position), counts, np.zeros(STRETCHES, dtype=np.intp))


@pytest.mark.parametrize("kind", ["interleaved", "contiguous"])
def test_scores_from_rows_are_those_from_products(kind, monkeypatch):
    few, many = gathered(1000, monkeypatch), gathered(1, monkeypatch)
    assert isinstance(few.stacks[0][0], RowStack)
    assert isinstance(many.stacks[0][0], ProductStack)
    np.testing.assert_array_equal(few.counts, many.counts)
    ours, theirs = (score_candidates(data, BASE, CANDIDATES, NOISE, kind) for data in (few, many))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-7)
    for mine, other in zip(ours[1], theirs[1], strict=True):
        np.testing.assert_allclose(mine.after, other.after, rtol=1e-7)
        np.testing.assert_allclose(mine.amplitudes, other.amplitudes, rtol=1e-6)
        np.testing.assert_allclose(mine.separability, other.separability)
        np.testing.assert_allclose(mine.measured, other.measured)


def test_what_stretches_add_to_the_scores_is_the_same_from_rows_and_from_products(monkeypatch):
    few, many = gathered(1000, monkeypatch), gathered(1, monkeypatch)
    pairs = zip(*(compute_contributions(data, BASE, CANDIDATES, NOISE) for data in (few, many)), strict=True)
    for mine, other in pairs:
        np.testing.assert_allclose(np.abs(mine), np.abs(other), atol=1e-8)


def test_single_products_are_the_same_of_both(monkeypatch):
    few, many = gathered(1000, monkeypatch), gathered(1, monkeypatch)
    places = np.arange(5)
    for joint in range(JOINTS):
        np.testing.assert_allclose(
            few.take_products(joint, places[:, None], places),
            many.take_products(joint, places[:, None], places),
            atol=1e-10,
        )
        np.testing.assert_allclose(*(own.sum_products(joint, places, places) for own in (few, many)), atol=1e-10)
