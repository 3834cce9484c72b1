"""Scores are the same read from the rows of a short recording and from the products of a long one."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.diagnosis.candidates import (
    inner_product_accumulation,
    products_of_scored_pairs,
    time_blocks_and_folds,
)
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import (
    FoldedFits,
    JointBlocks,
    compute_held_out_errors,
    score_candidates,
    score_folds,
)
from dynident.diagnosis.candidates.inner_product_accumulation import RowAccumulator
from dynident.diagnosis.candidates.products_of_scored_pairs import RowErrors
from dynident.diagnosis.candidates.time_blocks_and_folds import KINDS, Products, ProductStack, RowRuns, RowStack
from dynident.estimation import PriorInformation

JOINTS, COLUMNS, STRETCHES, PIECES = 3, 9, 12, 5
BASE, NOISE = np.arange(4), np.array([1.0, 0.5, 2.0])
CANDIDATES = [
    Candidate("offset", (), (), (4,)),
    Candidate("joint_spring", (), (), (5, 6)),
    Candidate("torque_ripple", (), (), (6, 7, 8)),
]


def gathered(expected: int) -> Products:
    """Rows pushed in pieces that begin in the middle of stretches; the second joint lacks some of the columns."""
    random = np.random.default_rng(0)
    having = [np.arange(COLUMNS), np.array([0, 2, 3, 5, 8]), np.arange(COLUMNS)]
    collected = RowAccumulator([len(columns) for columns in having], 2, expected)
    for piece in range(PIECES):
        row_block = np.sort(random.integers(0, STRETCHES, 70)) if piece else np.arange(70) % STRETCHES
        rows = [random.normal(size=(70, len(columns) + 1)) for columns in having]
        moving = random.random((70, JOINTS)) < 0.7
        collected.push(row_block, [own.T for own in rows], (moving, ~moving))
    (moving_stacks, counts), (others, _) = collected.finish(np.arange(STRETCHES))
    position = []
    for columns in having:
        where = np.full(COLUMNS, -1)
        where[columns] = np.arange(len(columns))
        position.append(where)
    stacks = tuple(zip(moving_stacks, others, strict=True))
    return Products(stacks, tuple(position), counts, np.zeros(STRETCHES, dtype=np.intp))


@pytest.mark.parametrize("kind", ["interleaved", "contiguous"])
def test_scores_from_rows_are_those_from_products(kind):
    few, many = gathered(1000), gathered(1)
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


def contribute(data: Products) -> list[np.ndarray]:
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, BASE, CANDIDATES), NOISE, ())
    return score_folds(data, fits, CANDIDATES, NOISE, by_parameters=True)[1]


def test_what_stretches_add_to_the_scores_is_the_same_from_rows_and_from_products():
    few, many = gathered(1000), gathered(1)
    pairs = zip(*(contribute(data) for data in (few, many)), strict=True)
    for mine, other in pairs:
        np.testing.assert_allclose(np.abs(mine), np.abs(other), atol=1e-8)


@pytest.mark.parametrize("expected", [1000, 1])
def test_several_kinds_of_folds_at_once_give_what_each_gives_by_itself(expected, monkeypatch):
    data, kinds, read = gathered(expected), ("interleaved", "contiguous"), []
    read_columns = RowStack.read_columns
    monkeypatch.setattr(
        RowStack, "read_columns", lambda stack, *asked: read.append(asked[1].stop) or read_columns(stack, *asked)
    )
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, BASE, CANDIDATES), NOISE, kinds)
    scores, contributions = score_folds(data, fits, CANDIDATES, NOISE, by_parameters=True)
    # Every row of a joint is read once, to fit and to score, however many kinds of folds ask.
    assert sum(read) == (PIECES * 70 * JOINTS if expected > 1 else 0)
    for (before, each), kind in zip(scores, kinds, strict=True):
        alone, theirs = score_candidates(data, BASE, CANDIDATES, NOISE, kind)
        np.testing.assert_allclose(before, alone, rtol=1e-9)
        for mine, other in zip(each, theirs, strict=True):
            np.testing.assert_allclose(mine.after, other.after, rtol=1e-9)
    for mine, other in zip(contributions, contribute(data), strict=True):
        np.testing.assert_allclose(np.abs(mine), np.abs(other), atol=1e-9)


def test_rows_of_many_joints_take_half_the_memory_and_give_the_same_scores(monkeypatch):
    exact = gathered(1000)
    monkeypatch.setattr(inner_product_accumulation, "MOST_PRODUCTS", 0)
    monkeypatch.setattr(time_blocks_and_folds, "MOST_PRODUCTS", 0)
    data = gathered(1000)
    stacks = [stack for own in data.stacks for stack in own if isinstance(stack, RowStack)]
    assert {stack.columns.dtype for stack in stacks} == {np.dtype(np.float32)}
    ours, theirs = (score_candidates(own, BASE, CANDIDATES, NOISE, "interleaved") for own in (data, exact))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-5)
    for mine, other in zip(ours[1], theirs[1], strict=True):
        np.testing.assert_allclose(mine.after, other.after, rtol=1e-5)
        np.testing.assert_allclose(mine.measured, other.measured, rtol=1e-6)
    places = np.arange(5)
    mine_of_all, theirs_of_all = (
        [own.take_products(0, places[:, None], places), own.sum_products(0, places, places)] for own in (data, exact)
    )
    for single, double in zip(mine_of_all, theirs_of_all, strict=True):
        assert single.dtype == np.float64
        np.testing.assert_allclose(single, double, atol=1e-5)


def test_single_products_are_the_same_of_both():
    few, many = gathered(1000), gathered(1)
    places = np.arange(5)
    for joint in range(JOINTS):
        np.testing.assert_allclose(
            few.take_products(joint, places[:, None], places),
            many.take_products(joint, places[:, None], places),
            atol=1e-10,
        )
        np.testing.assert_allclose(*(own.sum_products(joint, places, places) for own in (few, many)), atol=1e-10)


def test_rows_of_many_joints_are_kept_as_long_as_they_are_fewer_than_their_products(monkeypatch):
    monkeypatch.setattr(inner_product_accumulation, "_MOST_ROWS", 4)
    random, width, blocks = np.random.default_rng(1), 30, 10

    def collect(n_joints: int, n_rows: int) -> set[type]:
        collected = RowAccumulator([width] * n_joints, 1, blocks)
        row_block = np.repeat(np.arange(blocks), n_rows)
        rows = [random.normal(size=(len(row_block), width + 1)) for _ in range(n_joints)]
        collected.push(row_block, [own.T for own in rows], [np.ones((len(row_block), n_joints), dtype=bool)])
        ((stacks, _),) = collected.finish(np.arange(blocks))
        return {type(stack) for stack in stacks}

    monkeypatch.setattr(inner_product_accumulation, "MOST_PRODUCTS", 5 * (width + 1) ** 2 * blocks)
    # Twenty rows a block are fewer numbers than the products of thirty columns.
    assert collect(5, 20) == {ProductStack}
    assert collect(12, 20) == {RowStack}
    assert collect(12, 40) == {ProductStack}


def test_rows_are_read_some_blocks_at_a_time_and_joints_that_a_candidate_leaves_alone_not_at_all(monkeypatch):
    random = np.random.default_rng(2)
    # Two limbs of one joint each: nothing joins their parameters.
    row_block = np.repeat(np.arange(STRETCHES), 20)
    stacks = [RowStack(random.normal(size=(len(row_block), 5)), row_block, STRETCHES) for _ in range(2)]
    position = [np.full(8, -1) for _ in range(2)]
    for joint, columns in enumerate(([0, 1, 4, 5], [2, 3, 6, 7])):
        position[joint][columns] = np.arange(4)
    counts, run = np.full((STRETCHES, 2), 20.0), np.zeros(STRETCHES, dtype=np.intp)
    data = Products(tuple((stack,) for stack in stacks), tuple(position), counts, run)
    candidates = [Candidate("offset", (), (), (k,)) for k in range(4, 8)]
    whole = score_candidates(data, BASE, candidates, np.ones(2), "interleaved")
    read, leave_rest = [], RowErrors._leave_rest
    monkeypatch.setattr(products_of_scored_pairs, "_MOST_VALUES", 100)
    monkeypatch.setattr(
        RowErrors, "_leave_rest", lambda errors, *asked: read.append(asked[0]) or leave_rest(errors, *asked)
    )
    pieces = score_candidates(data, BASE, candidates, np.ones(2), "interleaved")
    assert len(read) > 2
    assert {tuple(changed) for changed in read} == {(0, 1), (2, 3)}
    np.testing.assert_allclose(pieces[0], whole[0], rtol=1e-12)
    for mine, other, joint in zip(pieces[1], whole[1], (0, 0, 1, 1), strict=True):
        np.testing.assert_allclose(mine.after, other.after, rtol=1e-9)
        np.testing.assert_array_equal(mine.after[:, 1 - joint], mine.before[:, 1 - joint])


def test_sums_over_all_blocks_keep_no_products_of_columns_that_nobody_asks_for():
    """A joint of a robot on its feet has over a thousand columns: all their products are more numbers than its rows."""
    random = np.random.default_rng(4)
    rows, row_block = random.normal(size=(30, 200)), np.repeat(np.arange(3), 10)
    stack = RowStack(rows, row_block, 3)
    first, second = np.array([7, 0, 199]), np.array([5, 199])
    expected = (rows.T @ rows)[np.ix_(first, second)]
    np.testing.assert_allclose(stack.sum_products(first, second), expected, atol=1e-12)
    grams = np.array([rows[row_block == k].T @ rows[row_block == k] for k in range(3)])
    np.testing.assert_allclose(ProductStack(grams).sum_products(first, second), expected, atol=1e-12)
    assert sum(value.size for value in vars(stack).values() if isinstance(value, np.ndarray)) == rows.size


def test_a_joint_that_stands_in_all_blocks_changes_no_score():
    random, row_block = np.random.default_rng(3), np.repeat(np.arange(STRETCHES), 20)
    moving = RowStack(random.normal(size=(len(row_block), 6)), row_block, STRETCHES)
    standing = RowStack(np.zeros((0, 6)), row_block[:0], STRETCHES)
    position, run = np.arange(5), np.zeros(STRETCHES, dtype=np.intp)
    candidates = [Candidate("offset", (), (), (4,))]
    alone, both = (
        score_candidates(
            Products(
                tuple((stack,) for stack in stacks),
                (position,) * len(stacks),
                np.full((STRETCHES, len(stacks)), 20.0),
                run,
            ),
            BASE,
            candidates,
            np.ones(len(stacks)),
            "interleaved",
        )
        for stacks in ((moving,), (moving, standing))
    )
    np.testing.assert_array_equal(both[0][:, 0], alone[0][:, 0])
    np.testing.assert_array_equal(both[1][0].after[:, 0], alone[1][0].after[:, 0])
    assert not both[1][0].after[:, 1].any()


@pytest.mark.parametrize("kind", ["interleaved", "contiguous"])
def test_a_value_that_is_held_counts_in_folds_whose_other_blocks_lack_its_column(kind: str) -> None:
    random = np.random.default_rng(0)
    block = np.repeat(np.arange(10), 20)
    columns = random.normal(size=(200, 2))
    columns[block != 4, 0] = 0.0
    rows = np.column_stack([columns, columns @ [3.0, 1.0] + 0.01 * random.normal(size=200)])
    held = PriorInformation(np.zeros((0, 2)), np.zeros(0), np.array([3.0, np.nan]))
    stacks, places = ((RowStack(rows, block, 10),),), (np.arange(2),)
    data = Products(stacks, places, np.full((10, 1), 20.0), np.zeros(10, dtype=np.intp), held)
    errors = compute_held_out_errors(data, np.arange(2), np.array([0.01]), kind)[:, 0]
    # Twenty rows of noise a block.
    assert (errors < 4.0 * 20 * 0.01**2).all()


@pytest.mark.parametrize("kinds", [KINDS, ("runs",)])
def test_sums_over_folds_are_those_of_their_blocks(kinds):
    data = gathered(1000)
    sets = data.sets if kinds == KINDS else data.number_sets(kinds)
    places = np.arange(3)
    each = data.take_products(0, places[:, None], places)
    found = data.sum_sets(0, sets, places, places)
    np.testing.assert_allclose(found[0], each.sum(axis=0), atol=1e-10)
    np.testing.assert_allclose(data.sum_pairs(0, sets, places, places[::-1]), found[:, places, places[::-1]])
    for kind, folds in zip(kinds, sets.folds, strict=True):
        for fold, number in enumerate(sets.list_folds(kind)):
            np.testing.assert_allclose(found[number], each[folds == fold].sum(axis=0), atol=1e-10)


def test_rows_are_multiplied_once_for_all_scores_of_the_same_rows(monkeypatch):
    data, added = gathered(1000), []
    add_sums = RowStack.add_sums
    monkeypatch.setattr(RowStack, "add_sums", lambda *asked: added.append(asked) or add_sums(*asked))
    for base in (BASE, BASE[:3]):
        score_candidates(data, base, CANDIDATES, NOISE, "contiguous")
    # Two kinds of rows a joint.
    assert len(added) == 2 * JOINTS
    moving_alone = Products(tuple((first,) for first, _ in data.stacks), data.position, data.counts, data.run)
    score_candidates(moving_alone, BASE, CANDIDATES, NOISE, "contiguous")
    # Nor are those of one kind again where they are combined with others, nor for sums over all blocks.
    assert len(added) == 2 * JOINTS
    monkeypatch.setattr(RowStack, "sum_products", None)
    data.sum_products(0, np.arange(3), np.arange(3))


def test_products_of_many_pairs_take_little_memory(monkeypatch):
    random, row_block = np.random.default_rng(5), np.repeat(np.arange(STRETCHES), 50)
    stack = RowStack(random.normal(size=(len(row_block), 30)), row_block, STRETCHES)
    places, sizes = np.arange(30), []
    sum_by_block = RowRuns.sum_by_block
    monkeypatch.setattr(time_blocks_and_folds, "_MOST_VALUES", 4000)
    monkeypatch.setattr(
        RowRuns, "sum_by_block", lambda runs, values: sizes.append(values.size) or sum_by_block(runs, values)
    )
    products = stack.take_products(places[:, None], places)
    assert max(sizes) <= 4000
    own = stack.columns.T.reshape(STRETCHES, 50, 30)
    np.testing.assert_allclose(products, own.transpose(0, 2, 1) @ own, atol=1e-12)


def test_candidates_are_multiplied_with_the_model_and_their_own_columns_alone(monkeypatch):
    data, rows, pairs = gathered(1000), [], []
    add_sums, take_products = RowStack.add_sums, RowStack.take_products
    monkeypatch.setattr(RowStack, "add_sums", lambda *asked: rows.append(len(asked[2])) or add_sums(*asked))
    monkeypatch.setattr(RowStack, "take_products", lambda *asked: pairs.append(len(asked[1])) or take_products(*asked))
    own = np.array(CANDIDATES[-1].columns)
    for _ in range(2):
        score_candidates(data, BASE, CANDIDATES, NOISE, "interleaved")
        squares = data.sum_own_products(0, own)
    # Once for the two kinds of rows: the columns of the model that each joint has, and Y.
    assert sorted(rows) == [4, 4, 5, 5, 5, 5]
    # One, three and six pairs of columns, of which one is the same; of the second joint two columns by themselves.
    assert sum(pairs) == 2 * (9 + 2 + 9)
    np.testing.assert_allclose(squares, gathered(1).sum_products(0, own, own))
