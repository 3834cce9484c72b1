from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.errors import DynidentError
from dynident.excitation.criteria.criterion_choice import CRITERIA, CriterionChoice
from dynident.excitation.criteria.optimality_criteria import (
    RowStructure,
    build_smooth_criterion,
    compute_true_values,
)

seeds = st.integers(0, 2**32 - 1)
A_PRIORI = np.geomspace(0.5, 2, 6)


def drawn(seed: int, rows: int = 40, columns: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((rows, columns)) * np.geomspace(0.1, 3, columns)


@pytest.mark.parametrize("name", CRITERIA)
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_gradients_agree_with_finite_differences(name, seed):
    w = drawn(seed)
    criterion = build_smooth_criterion(CriterionChoice(name, weight=0.7), A_PRIORI)
    direction = np.random.default_rng(seed + 1).standard_normal(w.shape)
    # One of them divides by the smallest entry: the step stays far below it.
    step = 1e-4 * float(np.abs(w).min()) if name == "equilibrated" else 1e-5
    slope = (criterion(w + step * direction)[0] - criterion(w - step * direction)[0]) / (2 * step)
    parts = criterion(w)[1] * direction
    # What nearly cancels is known no better than what it is the sum of.
    assert np.sum(parts) == pytest.approx(slope, rel=1e-5, abs=1e-7 + 1e-5 * float(np.abs(parts).sum()))


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_the_smooth_condition_number_bounds_the_true_one_closely_from_above(seed):
    w = drawn(seed)
    value, _ = build_smooth_criterion(CriterionChoice(), A_PRIORI)(w)
    true = np.log(np.linalg.cond(w))
    assert true - 1e-12 <= value <= true + np.log(6) / 8


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_reported_values_are_those_of_numpy(seed):
    w = drawn(seed)
    m = w.T @ w / 20
    sizes = np.abs(w)
    for name, expected in (
        ("condition_number", np.linalg.cond(w)),
        ("weighted", np.linalg.cond(w * A_PRIORI)),
        ("d_optimal", -np.linalg.slogdet(m)[1]),
        ("a_optimal", np.trace(np.linalg.inv(m))),
        ("e_optimal", np.linalg.norm(np.linalg.inv(m), 2) ** 0.5),
        ("condition_plus_inverse_sigma", np.linalg.cond(w) + 2 * np.linalg.norm(np.linalg.inv(m), 2) ** 0.5),
        ("equilibrated", np.linalg.cond(w) + 2 * sizes.max() / sizes.min()),
    ):
        values = compute_true_values(CriterionChoice(name, weight=2.0), w, 20, A_PRIORI)
        assert values.criterion == pytest.approx(expected, rel=1e-8)
        assert values.condition_number == pytest.approx(np.linalg.cond(w), rel=1e-8)


def test_neither_the_number_of_samples_nor_their_order_changes_a_value():
    w = drawn(3)
    once = compute_true_values(CriterionChoice("a_optimal"), w, 20, A_PRIORI)
    twice = compute_true_values(CriterionChoice("a_optimal"), np.vstack([w[::-1], w]), 40, A_PRIORI)
    assert once.criterion == pytest.approx(twice.criterion)


def test_units_of_parameters_change_no_scaled_condition_number():
    w = np.random.default_rng(3).standard_normal((80, len(A_PRIORI)))
    in_si, in_grams = (
        compute_true_values(CriterionChoice(), rows, 20, A_PRIORI)
        for rows in (w, w * np.geomspace(1.0, 1e-3, w.shape[1]))
    )
    assert in_grams.condition_number > 100 * in_si.condition_number
    assert in_grams.scaled_condition_number == pytest.approx(in_si.scaled_condition_number)
    normalised = w / np.linalg.norm(w, axis=0)
    assert in_si.scaled_condition_number == pytest.approx(np.linalg.cond(normalised))


def test_a_matrix_without_full_rank_has_an_infinite_condition_number_and_a_finite_gradient():
    w = drawn(0)
    w[:, 5] = w[:, 4]
    assert compute_true_values(CriterionChoice(), w, 20, A_PRIORI).condition_number == np.inf
    for name in CRITERIA:
        value, gradient = build_smooth_criterion(CriterionChoice(name), A_PRIORI)(w)
        assert np.isfinite(value)
        assert np.isfinite(gradient).all()


def test_an_unknown_criterion_is_answered_with_those_there_are():
    with pytest.raises(DynidentError, match=r"'best'; choose from: .*condition_number.*e_optimal"):
        build_smooth_criterion(CriterionChoice("best"), A_PRIORI)


@pytest.mark.parametrize("name", CRITERIA)
def test_the_zeros_of_w_change_no_value_and_no_gradient_of_the_other_entries(name):
    # Two limbs of two joints each: an equation has entries for the joints behind it.
    present = np.kron(np.eye(2, dtype=bool), np.array([[1, 1, 1], [0, 1, 1]], dtype=bool))
    rng = np.random.default_rng(1)
    w = (rng.standard_normal((20, 4, 6)) * present).reshape(-1, 6)
    earlier = 0.3 * rng.standard_normal((8, 6))
    for before in (None, earlier):
        choice = CriterionChoice(name, weight=0.7)
        value, gradient = build_smooth_criterion(choice, A_PRIORI, earlier=before)(w)
        structure = RowStructure.from_entries(present)
        sparse_value, sparse = build_smooth_criterion(choice, A_PRIORI, structure=structure, earlier=before)(w)
        assert sparse_value == pytest.approx(value, rel=1e-12)
        zeros = np.tile(~present, (20, 1))
        np.testing.assert_allclose(np.where(zeros, 0, sparse), np.where(zeros, 0, gradient), rtol=1e-9, atol=1e-13)


def test_earlier_rows_count_as_rows_of_their_own():
    w, earlier = drawn(5), drawn(6)
    value, gradient = build_smooth_criterion(CriterionChoice("d_optimal"), A_PRIORI, earlier=earlier)(w)
    whole, of_all = build_smooth_criterion(CriterionChoice("d_optimal"), A_PRIORI)(np.concatenate([w, earlier]))
    assert value == pytest.approx(whole, rel=1e-12)
    np.testing.assert_allclose(gradient, of_all[: len(w)], rtol=1e-9)


def test_equations_of_many_joints_are_multiplied_one_by_one():
    # A limb of twelve links of four parameters each: a joint carries those behind it.
    chain = np.kron(np.triu(np.ones((12, 12), dtype=bool)), np.ones((1, 4), dtype=bool))
    # Three of them on a common trunk.
    present = np.block([[np.ones((1, 144), dtype=bool)], [np.kron(np.eye(3, dtype=bool), chain)]])
    rng = np.random.default_rng(2)
    w = (rng.standard_normal((7, *present.shape)) * present).reshape(-1, 144)
    structure = RowStructure.from_entries(present)
    read = sum(len(columns) ** 2 for columns in structure.equations)
    assert read < 0.2 * len(present) * 144**2
    np.testing.assert_allclose(structure.compute_information(w), w.T @ w, atol=1e-12)
    slope = rng.standard_normal((144, 144))
    product = (w @ slope).reshape(-1, *present.shape) * present
    np.testing.assert_allclose(structure.multiply(w, slope).reshape(product.shape), product, atol=1e-12)
