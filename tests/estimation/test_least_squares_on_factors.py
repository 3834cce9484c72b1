"""Solutions and statistics from triangular factors against numpy and statsmodels on all rows."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import lapack

from dynident.estimation import (
    EstimationError,
    FactorAccumulator,
    Reduction,
    build_prior,
    build_weighted_factor,
    compute_condition_number,
    compute_errors,
    compute_noise_levels,
    concatenate_reductions,
    qr_decomposition,
    solve,
    solve_ordinary,
    solve_weighted,
    statistics,
)
from dynident.estimation.parameter_covariance import estimate_cluster_covariance
from dynident.estimation.qr_decomposition import compute_r_factor

N_PARAMETERS = 7
# Which parameters each of three equations contains.
CONTAINS = (np.array([0, 1, 2, 3]), np.array([2, 3, 4]), np.array([0, 4, 5, 6]))
SIGMA = np.array([0.5, 3.0, 0.05])


class Rows:
    """Rows of three equations, kept whole, and what made them."""

    def __init__(self, seed: int = 0, m: int = 400, sigma: np.ndarray = SIGMA, rate: float = 50.0) -> None:
        rng = np.random.default_rng(seed)
        self.t = np.arange(m) / rate
        self.truth = rng.normal(size=N_PARAMETERS)
        self.w = [rng.normal(size=(m, len(columns))) * rng.uniform(0.1, 10, len(columns)) for columns in CONTAINS]
        self.y = [
            w @ self.truth[columns] + s * rng.normal(size=m)
            for w, columns, s in zip(self.w, CONTAINS, sigma, strict=True)
        ]

    def reduction(self, stretch: float = 0.5, rows: slice = slice(None), block: int = 137) -> Reduction:
        accumulator = FactorAccumulator(CONTAINS, N_PARAMETERS, stretch)
        t = self.t[rows]
        stacked = [np.column_stack([w, y])[rows] for w, y in zip(self.w, self.y, strict=True)]
        for first in range(0, len(t), block):
            part = slice(first, first + block)
            accumulator.push(t[part], [item[part] for item in stacked])
        return accumulator.finish()

    def dense(self, noise=(1.0, 1.0, 1.0), rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        wide = []
        for w, columns, s in zip(self.w, CONTAINS, noise, strict=True):
            one = np.zeros((len(self.t), N_PARAMETERS))
            one[:, columns] = w / s
            wide.append(one[rows])
        return np.concatenate(wide), np.concatenate([y[rows] / s for y, s in zip(self.y, noise, strict=True)])


@pytest.mark.parametrize(("m", "k"), [(40, 60), (60, 20), (500, 12), (300, 40), (900, 70), (200, 300)])
def test_the_factor_of_few_and_of_many_rows_is_numpys(m, k):
    rows = np.random.default_rng(m).normal(size=(m, k))
    np.testing.assert_allclose(abs(compute_r_factor(rows)), abs(np.linalg.qr(rows, mode="r")), atol=1e-11)


def test_many_rows_are_factorised_by_the_recursive_algorithm(monkeypatch):
    used = []
    monkeypatch.setattr(lapack, "dgeqrt", lambda nb, rows: used.append(rows.shape) or (rows, None, 0))
    compute_r_factor(np.ones((300, 40)))
    compute_r_factor(np.ones((60, 40)))
    assert used == [(300, 40)]


def test_only_blocks_with_further_rows_are_factorised_again(monkeypatch):
    rng = np.random.default_rng(1)
    factors, rows = np.triu(rng.normal(size=(6, 5, 5))), np.zeros((6, 3, 5))
    rows[[1, 4]] = rng.normal(size=(2, 3, 5))
    read = []
    factor = qr_decomposition.compute_r_factor
    monkeypatch.setattr(qr_decomposition, "compute_r_factor", lambda rows: read.append(len(rows)) or factor(rows))
    joined = qr_decomposition.add_rows_to_factors(factors, rows)
    expected = factors.transpose(0, 2, 1) @ factors + rows.transpose(0, 2, 1) @ rows
    np.testing.assert_allclose(joined.transpose(0, 2, 1) @ joined, expected, atol=1e-12)
    assert read == [2]
    assert qr_decomposition.add_rows_to_factors(factors, 0.0 * rows) is factors


def test_rows_of_zeros_are_left_out_where_factors_are_joined(monkeypatch):
    factors = np.zeros((6, 5, 5))
    factors[:, :2] = np.random.default_rng(0).normal(size=(6, 2, 5))
    read = []
    factor = qr_decomposition.compute_r_factor
    monkeypatch.setattr(qr_decomposition, "compute_r_factor", lambda rows: read.append(len(rows)) or factor(rows))
    joined = qr_decomposition.join_factors(factors)
    np.testing.assert_allclose(joined.T @ joined, np.einsum("sij,sik->jk", factors, factors), atol=1e-12)
    assert read == [12]


def test_factors_have_no_more_rows_than_the_fullest_block():
    """Of a robot with many joints a block has far fewer rows than columns, and nothing is kept for those that lack."""
    rng = np.random.default_rng(3)
    columns, rows = np.arange(60), rng.normal(size=(47, 61))
    parts = []
    for length in (10, 16):
        accumulator = FactorAccumulator([columns], 60, length)
        accumulator.push(np.arange(47.0), [rows])
        parts.append(accumulator.finish())
    both = concatenate_reductions(parts)
    assert [part.equations[0].factors.shape for part in (*parts, both)] == [(5, 10, 61), (3, 16, 61), (8, 16, 61)]
    chosen, weights = [3, 0, 59], rng.normal(size=(60, 4))
    for changed, expected in (
        (both, rows),
        (both.merge_block_pairs(), rows),
        (both.select_columns(chosen), rows[:, [*chosen, 60]]),
        (both.combine_columns(weights), np.column_stack([rows[:, :60] @ weights, rows[:, 60]])),
    ):
        factor = changed.equations[0].whole_factor
        np.testing.assert_allclose(factor.T @ factor, 2 * expected.T @ expected, atol=1e-10)
    assert both.merge_block_pairs().equations[0].factors.shape[1] <= 32
    empty = FactorAccumulator([columns], 60, 10)
    empty.push(np.arange(47.0), [rows], np.zeros((47, 1), dtype=bool))
    assert empty.finish().merge_block_pairs().equations[0].factors.shape == (3, 0, 61)
    assert both.select_columns(chosen).equations[0].factors.shape == (8, 4, 4)


def test_ordinary_least_squares_is_numpys():
    data = Rows()
    w, y = data.dense()
    expected = np.linalg.lstsq(w, y, rcond=None)[0]
    solution = solve_ordinary(data.reduction())
    np.testing.assert_allclose(solution.values, expected, rtol=1e-10)
    np.testing.assert_allclose(solution.normal_inverse, np.linalg.inv(w.T @ w), rtol=1e-8)
    np.testing.assert_allclose(solution.scales, np.linalg.norm(w, axis=0), rtol=1e-12)
    assert compute_condition_number(data.reduction()) == pytest.approx(np.linalg.cond(w), rel=1e-10)


def test_what_is_known_beforehand_counts_as_rows_of_its_own():
    data = Rows()
    rng = np.random.default_rng(5)
    root = rng.normal(size=(2, 2))
    covariance, values = root @ root.T + 0.1 * np.eye(2), np.array([0.3, -2.0])
    known = build_prior(values, covariance, np.array([1, 4]), N_PARAMETERS)
    w, y = data.dense(noise=SIGMA)
    picked = np.zeros((2, N_PARAMETERS))
    picked[[0, 1], [1, 4]] = 1.0
    precision = np.linalg.inv(covariance)
    expected = np.linalg.solve(w.T @ w + picked.T @ precision @ picked, w.T @ y + picked.T @ precision @ values)
    np.testing.assert_allclose(solve(data.reduction(), SIGMA, known).values, expected, rtol=1e-8)


def test_a_value_known_for_certain_stays_what_it_is_and_a_vague_one_changes_nothing():
    reduction = Rows().reduction()
    certain = build_prior(np.array([3.0]), np.zeros((1, 1)), np.array([2]), N_PARAMETERS)
    assert solve_weighted(reduction, certain).values[2] == pytest.approx(3.0, abs=1e-6)
    vague = build_prior(np.array([3.0]), np.full((1, 1), 1e16), np.array([2]), N_PARAMETERS)
    for estimator in (solve_ordinary, solve_weighted):
        np.testing.assert_allclose(
            estimator(reduction, vague).values, estimator(reduction).values, rtol=0.02, atol=0.02
        )


def test_the_covariance_counts_what_was_known_once():
    data = Rows(sigma=np.array([1.0, 1.0, 1.0]), m=4000)
    reduction = data.reduction(stretch=2.0)
    known = build_prior(data.truth[:1], np.full((1, 1), 1e-8), np.array([0]), N_PARAMETERS)
    solution = solve_weighted(reduction, known)
    found = statistics(reduction, solution)
    assert found.standard_deviations[0] == pytest.approx(1e-4, rel=0.05)
    assert np.all(
        found.standard_deviations <= 1.1 * statistics(reduction, solve_weighted(reduction)).standard_deviations
    )


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), stretch=st.floats(0.05, 20.0), block=st.integers(1, 500))
def test_neither_stretches_nor_blocks_change_the_solution(seed, stretch, block):
    data = Rows(seed)
    w, y = data.dense()
    reduction = data.reduction(stretch, block=block)
    np.testing.assert_allclose(solve_ordinary(reduction).values, np.linalg.lstsq(w, y, rcond=None)[0], rtol=1e-9)
    assert reduction.n_rows == len(y)
    assert sum(reduction.equations[0].counts) == len(data.t)
    assert (np.diff(reduction.spans, axis=1) < stretch + 1e-9).all()


def test_weighted_least_squares_is_that_of_statsmodels_with_the_noise_of_each_equation():
    data = Rows(1)
    solution = solve_weighted(data.reduction())
    w, y = data.dense()
    weights = np.repeat(1 / solution.noise**2, len(data.t))
    expected = sm.WLS(y, w, weights=weights).fit()
    np.testing.assert_allclose(solution.values, expected.params, rtol=1e-9)
    np.testing.assert_allclose(solution.noise, SIGMA, rtol=0.15)
    np.testing.assert_allclose(solution.normal_inverse, expected.normalized_cov_params, rtol=1e-7)


def test_weights_make_the_estimate_better_where_noise_differs():
    def miss(estimator, seed):
        data = Rows(seed)
        return np.linalg.norm(estimator(data.reduction()).values - data.truth)

    assert np.median([miss(solve_weighted, k) / miss(solve_ordinary, k) for k in range(20)]) < 0.7


def test_the_noise_of_an_equation_is_that_of_its_residual():
    data = Rows(2)
    reduction = data.reduction()
    chi = solve_ordinary(reduction).values
    share = 1 - N_PARAMETERS / reduction.n_rows
    expected = [
        np.sqrt(np.sum((y - w @ chi[c]) ** 2) / (len(y) * share))
        for w, y, c in zip(data.w, data.y, CONTAINS, strict=True)
    ]
    np.testing.assert_allclose(compute_noise_levels(reduction, chi), expected, rtol=1e-10)


def test_the_covariance_of_one_equation_with_independent_residuals_is_statsmodels():
    rng = np.random.default_rng(3)
    m = 500
    w = rng.normal(size=(m, 4)) * [1, 10, 0.1, 3]
    y = w @ [1.0, 2, 3, 4] + rng.normal(size=m)
    accumulator = FactorAccumulator([np.arange(4)], 4, 1e9)  # one stretch: no correlation can be seen
    accumulator.push(np.arange(m) / 100, [np.column_stack([w, y])])
    reduction = accumulator.finish()
    found = statistics(reduction, solve_ordinary(reduction))
    expected = sm.OLS(y, w).fit()
    np.testing.assert_allclose(found.covariance, expected.cov_params(), rtol=1e-9)
    np.testing.assert_allclose(found.standard_deviations, expected.bse, rtol=1e-9)
    np.testing.assert_allclose(found.noise, [np.sqrt(expected.scale)], rtol=1e-10)
    np.testing.assert_allclose(found.effective_rows, [m])


def test_the_covariance_of_ordinary_least_squares_knows_that_equations_differ_in_noise():
    data = Rows(4)
    reduction = data.reduction(stretch=1e9)
    solution = solve_ordinary(reduction)
    w, y = data.dense()
    rest = (y - w @ solution.values).reshape(3, -1)
    share = 1 - N_PARAMETERS / len(y)
    variance = np.repeat((rest**2).mean(axis=1) / share, len(data.t))
    bread = np.linalg.inv(w.T @ w)
    expected = bread @ (w.T * variance) @ w @ bread
    np.testing.assert_allclose(statistics(reduction, solution).covariance, expected, rtol=1e-8)


def test_standard_deviations_are_the_spread_of_the_estimates():
    found, promised = [], []
    for seed in range(100):
        data = Rows(0)
        rng = np.random.default_rng(1000 + seed)
        data.y = [
            w @ data.truth[c] + s * rng.normal(size=len(data.t))
            for w, c, s in zip(data.w, CONTAINS, SIGMA, strict=True)
        ]
        reduction = data.reduction()
        solution = solve_weighted(reduction)
        found.append(solution.values)
        promised.append(statistics(reduction, solution).standard_deviations)
    spread = np.std(found, axis=0)
    np.testing.assert_allclose(np.mean(promised, axis=0), spread, rtol=0.25)


def test_relative_deviations_are_fractions_and_infinite_at_zero():
    data = Rows(5)
    reduction = data.reduction()
    found = statistics(reduction, solve_weighted(reduction))
    relative = found.relative_standard_deviations(np.array([2.0, 0, -1, 1, 1, 1, 1]))
    assert relative[0] == pytest.approx(found.standard_deviations[0] / 2)
    assert relative[1] == np.inf
    assert relative[2] > 0


def test_errors_are_those_of_all_rows():
    data = Rows(6)
    chi = data.truth * 1.1
    found = compute_errors(data.reduction(), chi)
    rest = [y - w @ chi[c] for w, y, c in zip(data.w, data.y, CONTAINS, strict=True)]
    np.testing.assert_allclose(found.squares, [r @ r for r in rest], rtol=1e-10)
    np.testing.assert_allclose(found.rms, [np.sqrt(np.mean(r**2)) for r in rest], rtol=1e-10)
    norms = [np.linalg.norm(r) / np.linalg.norm(y) for r, y in zip(rest, data.y, strict=True)]
    np.testing.assert_allclose(found.relative, norms, rtol=1e-10)
    both = np.linalg.norm(np.concatenate(rest)) / np.linalg.norm(np.concatenate(data.y))
    assert found.relative_total == pytest.approx(both)
    assert found.rms_total == pytest.approx(np.sqrt(np.mean(np.concatenate(rest) ** 2)))


def test_an_equation_without_torque_has_no_relative_error_but_one_where_torque_is_predicted():
    data = Rows(7)
    data.y[1] = np.zeros(len(data.t))
    reduction = data.reduction()
    assert compute_errors(reduction, np.zeros(N_PARAMETERS)).relative[1] == 0.0
    assert compute_errors(reduction, np.ones(N_PARAMETERS)).relative[1] == 1.0


def test_choosing_columns_is_the_fit_with_those_columns():
    data = Rows(8)
    w, y = data.dense()
    picked = [5, 0, 4, 3]
    reduction = data.reduction().select_columns(picked)
    np.testing.assert_allclose(
        solve_ordinary(reduction).values, np.linalg.lstsq(w[:, picked], y, rcond=None)[0], rtol=1e-9
    )
    np.testing.assert_allclose(compute_errors(reduction, np.zeros(4)).measured, [v @ v for v in data.y], rtol=1e-10)


def test_choosing_stretches_is_the_fit_on_those_rows():
    data = Rows(9)
    reduction = data.reduction(stretch=2.0)  # four of 100 rows
    assert reduction.n_blocks == 4
    w, y = data.dense(rows=slice(100, 300))
    np.testing.assert_allclose(
        solve_ordinary(reduction.select_blocks([1, 2])).values, np.linalg.lstsq(w, y, rcond=None)[0], rtol=1e-9
    )
    without = reduction.equations[0].factor_without_blocks([0, 3])
    chosen = reduction.select_blocks([1, 2]).equations[0].whole_factor
    np.testing.assert_allclose(without.T @ without, chosen.T @ chosen, rtol=1e-9, atol=1e-9)


def test_leaving_all_out_leaves_nothing():
    reduction = Rows(9).reduction(stretch=2.0)
    assert not reduction.equations[0].factor_without_blocks(range(4)).any()


def test_data_sets_behind_one_another_are_one_data_set():
    data = Rows(10)
    parts = [data.reduction(rows=slice(0, 130)), data.reduction(rows=slice(130, 400))]
    whole = concatenate_reductions(parts)
    assert whole.n_rows == 1200
    assert whole.n_blocks == parts[0].n_blocks + parts[1].n_blocks
    w, y = data.dense()
    np.testing.assert_allclose(solve_ordinary(whole).values, np.linalg.lstsq(w, y, rcond=None)[0], rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), order=st.permutations(range(16)))
def test_the_order_of_stretches_changes_neither_estimates_nor_deviations(seed, order):
    reduction = Rows(seed).reduction(stretch=0.5)
    mixed = reduction.select_blocks(order)
    one, other = solve_weighted(reduction), solve_weighted(mixed)
    np.testing.assert_allclose(one.values, other.values, rtol=1e-9)
    np.testing.assert_allclose(
        estimate_cluster_covariance(reduction, one).covariance,
        estimate_cluster_covariance(mixed, other).covariance,
        rtol=1e-7,
        atol=1e-18,
    )


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), scales=st.lists(st.floats(1e-3, 1e3), min_size=7, max_size=7))
def test_units_of_the_parameters_change_only_the_parameters_units(seed, scales):
    data = Rows(seed)
    reduction = data.reduction()
    s = np.array(scales)
    data.w = [w * s[c] for w, c in zip(data.w, CONTAINS, strict=True)]
    scaled = data.reduction()
    one, other = solve_weighted(reduction), solve_weighted(scaled)
    np.testing.assert_allclose(other.values * s, one.values, rtol=1e-7)
    np.testing.assert_allclose(other.noise, one.noise, rtol=1e-7)
    deviations = statistics(scaled, other).standard_deviations * s
    np.testing.assert_allclose(deviations, statistics(reduction, one).standard_deviations, rtol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), gain=st.floats(1e-3, 1e3))
def test_units_of_torque_scale_everything_alike(seed, gain):
    data = Rows(seed)
    reduction = data.reduction()
    data.y = [gain * y for y in data.y]
    scaled = data.reduction()
    one, other = solve_weighted(reduction), solve_weighted(scaled)
    np.testing.assert_allclose(other.values, gain * one.values, rtol=1e-8)
    np.testing.assert_allclose(
        statistics(scaled, other).standard_deviations, gain * statistics(reduction, one).standard_deviations, rtol=1e-7
    )


def test_fewer_rows_than_parameters_are_refused_with_both_numbers():
    reduction = Rows(11).reduction(rows=slice(0, 2))
    with pytest.raises(EstimationError, match="6 equations cannot determine 7 parameters") as caught:
        solve_ordinary(reduction)
    assert caught.value.title == "Too few samples"


def test_columns_that_depend_on_one_another_are_refused():
    data = Rows(12)
    data.w[0][:, 1] = 2 * data.w[0][:, 0]
    data.w[2][:, 0] = 0
    with pytest.raises(EstimationError, match="full rank"):
        solve_weighted(data.reduction())


def test_a_column_of_zeros_is_refused():
    data = Rows(13)
    data.w[2][:, 2] = 0
    with pytest.raises(EstimationError, match="full rank"):
        solve_ordinary(data.reduction())


def test_an_equation_that_fits_perfectly_gets_no_infinite_weight():
    data = Rows(14, sigma=np.array([0.5, 0.0, 0.0]))
    solution = solve_weighted(data.reduction())
    assert np.isfinite(solution.values).all()
    assert np.isfinite(solution.noise).all()
    np.testing.assert_allclose(solution.values[4:], data.truth[4:], rtol=1e-6)


def test_no_torque_at_all_gives_zeros_and_finite_deviations():
    data = Rows(15)
    data.y = [np.zeros(len(data.t))] * 3
    reduction = data.reduction()
    solution = solve_weighted(reduction)
    assert not solution.values.any()
    assert np.isfinite(statistics(reduction, solution).covariance).all()


def test_given_noise_weights_the_rows():
    data = Rows(16)
    noise = np.array([2.0, 0.1, 1.0])
    w, y = data.dense(noise)
    np.testing.assert_allclose(solve(data.reduction(), noise).values, np.linalg.lstsq(w, y, rcond=None)[0], rtol=1e-9)
    r = build_weighted_factor(data.reduction(), noise)
    both = np.column_stack([w, y])
    np.testing.assert_allclose(r.T @ r, both.T @ both, rtol=1e-9, atol=1e-7)


def test_rows_in_one_long_push_are_cut_where_time_jumps():
    data = Rows(17)
    data.t = data.t + np.where(np.arange(400) >= 200, 100.0, 0.0)
    reduction = data.reduction(stretch=3.0, block=1000)
    assert not ((reduction.spans[:, 0] < 50) & (reduction.spans[:, 1] > 50)).any()
    assert sum(reduction.equations[0].counts) == 400


def reweighted_by_numpy(data: Rows, most_rounds: int = 100) -> np.ndarray:
    """Weighted least squares of all rows, each equation divided by the size of its residual, until it settles."""
    noise = np.ones(len(CONTAINS))
    for _ in range(most_rounds):
        w, y = data.dense(noise)
        values = np.linalg.lstsq(w, y, rcond=None)[0]
        rests = [y - w @ values[columns] for w, y, columns in zip(data.w, data.y, CONTAINS, strict=True)]
        noise = np.sqrt([float((rest**2).mean()) for rest in rests])
    return values


@pytest.mark.parametrize("sigma", [SIGMA, np.array([0.5, 3.0, 1e-7]), np.array([1e3, 3.0, 1e-5])])
def test_weighted_least_squares_is_that_of_all_rows_however_much_the_noise_differs(sigma: np.ndarray) -> None:
    """Noise that differs much is weighed by another factorisation, since normal equations would lose the digits."""
    data = Rows(seed=4, sigma=sigma)
    np.testing.assert_allclose(solve_weighted(data.reduction()).values, reweighted_by_numpy(data), rtol=1e-7)


def test_weighted_least_squares_with_columns_that_nearly_depend_on_one_another_is_that_of_all_rows() -> None:
    data = Rows(seed=5)
    data.w[0][:, 1] = data.w[0][:, 0] + 1e-6 * data.w[0][:, 1]
    data.y[0] = data.w[0] @ data.truth[CONTAINS[0]] + SIGMA[0] * np.random.default_rng(1).normal(size=len(data.t))
    found = solve_weighted(data.reduction()).values
    w, _ = data.dense()
    np.testing.assert_allclose(w @ found, w @ reweighted_by_numpy(data), atol=1e-7 * np.abs(w @ found).max())


def test_weights_settle_beside_an_equation_without_noise_that_shows_few_directions() -> None:
    """Normal equations would lose what the noisy equation says of the other directions."""
    rng, size = np.random.default_rng(1), 7
    truth, few = rng.normal(size=size), rng.normal(size=(400, 3)) @ rng.normal(size=(3, size))
    rows = [
        np.column_stack([w, w @ truth + sigma * rng.normal(size=400)])
        for w, sigma in ((few, 1e-8), (rng.normal(size=(400, size)), 1.0))
    ]
    accumulator = FactorAccumulator([np.arange(size)] * 2, size, 0.5)
    accumulator.push(np.arange(400) / 50.0, rows)
    solution = solve_weighted(accumulator.finish())
    assert solution.converged
    shown = np.linalg.lstsq(few, rows[0][:, -1], rcond=1e-9)[0]
    np.testing.assert_allclose(few @ solution.values, few @ shown, atol=1e-6)
