"""The algebra of scoring against refitting every candidate on every fold; the gate's functions."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from support.scored_candidates import judged, products_from_reduction

from dynident import parallel
from dynident.diagnosis.candidates import held_out_scores
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import (
    FoldedFits,
    JointBlocks,
    Score,
    compute_deviations,
    compute_held_out_errors,
    score_candidates,
    score_folds,
)
from dynident.diagnosis.candidates.significance import (
    ScoredCandidate,
    are_indistinguishable,
    combine_scores,
    draw_scores,
    run_familywise_test,
    select_simplest,
)
from dynident.diagnosis.candidates.time_blocks_and_folds import (
    RowStack,
    split_data_folds,
    split_folds,
)
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search import search_state
from dynident.diagnosis.search.acceptance_rules import check_significance, compute_stability
from dynident.diagnosis.search.next_finding import find_richer_changes
from dynident.diagnosis.search.physical_plausibility import _fit_columns
from dynident.diagnosis.search.search_state import State, score_family
from dynident.estimation import FactorAccumulator
from dynident.estimation.residual_errors import compute_t

# Two equations over ten columns: 0-4 the model, 5-9 candidates; some columns are on one equation alone.
CONTAINS = (np.array([0, 1, 2, 5, 6, 8, 9]), np.array([1, 2, 3, 4, 7, 8, 9]))
BASE = np.arange(5)
CANDIDATES = tuple(
    Candidate(f"c{'_'.join(map(str, columns))}", (), (), columns)
    for columns in ((5,), (6,), (7,), (8,), (5, 9), (6, 7, 8))
)
NOISE = np.array([0.5, 2.0])
PER_STRETCH, STRETCHES = 30, 13


class Rows:
    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        m = PER_STRETCH * STRETCHES
        self.t = np.arange(m) / PER_STRETCH
        truth = rng.normal(size=10)
        self.wide, self.y = [], []
        for columns, sigma in zip(CONTAINS, NOISE, strict=True):
            w = np.zeros((m, 10))
            w[:, columns] = rng.normal(size=(m, len(columns)))
            # Candidates that the model can say in part.
            w[:, columns[3:]] += 0.7 * w[:, columns[:3]] @ rng.normal(size=(3, len(columns) - 3))
            self.wide.append(w)
            self.y.append(w @ truth + sigma * rng.normal(size=m))

    def products(self):
        accumulator = FactorAccumulator(CONTAINS, 10, 1.0)
        accumulator.push(
            self.t,
            [np.column_stack([w[:, c], y]) for w, c, y in zip(self.wide, CONTAINS, self.y, strict=True)],
        )
        return products_from_reduction(accumulator.finish())

    def kept(self):
        """The same with the rows themselves."""
        row_block = np.arange(len(self.t)) // PER_STRETCH
        made = self.products()
        stacks = tuple(
            (RowStack(np.column_stack([w[:, c], y]), row_block, STRETCHES),)
            for w, c, y in zip(self.wide, CONTAINS, self.y, strict=True)
        )
        return replace(made, stacks=stacks)

    def held_out(self, columns, kind: str) -> np.ndarray:
        """(stretches, 2): squared errors of numpy's weighted fit on the other folds' rows."""
        out = np.zeros((STRETCHES, 2))
        for fold in split_folds(STRETCHES, kind):
            test = np.isin(np.arange(len(self.t)) // PER_STRETCH, fold)
            w = np.concatenate([w[~test][:, columns] / s for w, s in zip(self.wide, NOISE, strict=True)])
            y = np.concatenate([y[~test] / s for y, s in zip(self.y, NOISE, strict=True)])
            chi = np.linalg.lstsq(w, y, rcond=None)[0]
            for j in range(2):
                rest = (self.y[j] - self.wide[j][:, columns] @ chi) ** 2
                out[fold, j] = rest.reshape(STRETCHES, PER_STRETCH).sum(axis=1)[fold]
        return out


@pytest.mark.parametrize("form", [Rows.products, Rows.kept])
def test_a_candidates_deviation_is_how_much_its_estimate_scatters_from_data_to_data(form):
    data = Rows(4)
    told, estimates = [], []
    for draw in range(200):
        rng = np.random.default_rng(draw)
        # Samples of a stretch share their noise: as independent ones they would be believed five times too much.
        shared = np.repeat(rng.normal(size=(2, STRETCHES)), PER_STRETCH, axis=1)
        data.y = [sigma * own for sigma, own in zip(NOISE, shared, strict=True)]
        made = form(data)
        _, scores = score_candidates(made, BASE, CANDIDATES, NOISE, "interleaved")
        estimates.append(np.concatenate([score.amplitudes for score in scores]))
        told.append(np.concatenate(compute_deviations(made, BASE, CANDIDATES, NOISE)))
    scatter = np.std(estimates, axis=0)
    # Of 13 stretches: sandwiches of few clusters are somewhat too narrow (MacKinnon and White 1985).
    np.testing.assert_allclose(np.mean(told, axis=0) / scatter, 1.0, atol=0.3)


@pytest.mark.parametrize("kind", ["interleaved", "contiguous"])
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("form", [Rows.products, Rows.kept])
def test_scores_are_those_of_refitting_every_candidate_on_every_fold(kind, seed, form):
    data = Rows(seed)
    before, scores = score_candidates(form(data), BASE, CANDIDATES, NOISE, kind)
    expected = data.held_out(BASE, kind)
    np.testing.assert_allclose(before, expected, rtol=1e-7)
    np.testing.assert_allclose(compute_held_out_errors(form(data), BASE, NOISE, kind), expected, rtol=1e-7)
    for score in scores:
        columns = np.array([*BASE, *score.candidate.columns])
        np.testing.assert_allclose(score.after, data.held_out(columns, kind), rtol=1e-6)
        np.testing.assert_allclose(score.measured, [y @ y for y in data.y], rtol=1e-10)


@pytest.mark.parametrize("column", [0, 5])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("form", [Rows.products, Rows.kept])
def test_what_one_stretch_alone_shows_is_nothing_where_that_is_left_out(column, seed, form):
    # Sums without a fold are differences: of such a column they leave rounding errors, which are no small column.
    data, alone = Rows(seed), 4
    elsewhere = np.arange(len(data.t)) // PER_STRETCH != alone
    for w in data.wide:
        w[elsewhere, column] *= 1e-9
    left_out = next(fold for fold in split_folds(STRETCHES, "interleaved") if alone in fold)
    before, scores = score_candidates(form(data), BASE, CANDIDATES, NOISE, "interleaved")
    without = data.held_out([k for k in BASE if k != column], "interleaved")
    np.testing.assert_allclose(before[left_out], without[left_out], rtol=1e-4)
    for score in scores:
        columns = [k for k in (*BASE, *score.candidate.columns) if k != column]
        np.testing.assert_allclose(score.after[left_out], data.held_out(columns, "interleaved")[left_out], rtol=1e-4)


@pytest.mark.parametrize("form", [Rows.products, Rows.kept])
def test_amplitudes_and_separability_are_those_of_projecting_on_all_rows(form):
    data = Rows(3)
    _, scores = score_candidates(form(data), BASE, CANDIDATES, NOISE, "interleaved")
    w = np.concatenate([w / s for w, s in zip(data.wide, NOISE, strict=True)])
    y = np.concatenate([y / s for y, s in zip(data.y, NOISE, strict=True)])
    for score in scores:
        group = list(score.candidate.columns)
        chi = np.linalg.lstsq(w[:, [*BASE, *group]], y, rcond=None)[0]
        np.testing.assert_allclose(score.amplitudes, chi[len(BASE) :], rtol=1e-6)
        x = w[:, group]
        rest = x - w[:, BASE] @ np.linalg.lstsq(w[:, BASE], x, rcond=None)[0]
        share = np.linalg.norm(rest, axis=0) / np.linalg.norm(x, axis=0)
        assert score.separability == pytest.approx(share.max(), rel=1e-6)


def test_a_run_that_alone_shows_part_of_the_model_is_never_left_out_whole():
    # Three stretches of all joints, then ten of a test that moves one joint: two columns of the model are not in it.
    data, first = Rows(5), 3
    tested = np.arange(len(data.t)) >= first * PER_STRETCH
    for w, y in zip(data.wide, data.y, strict=True):
        y[tested] -= w[tested][:, [0, 4]] @ np.array([3.0, 3.0])
        w[np.ix_(tested, [0, 4])] = 0.0
    made = replace(data.products(), run=np.repeat([0, 1], [first, STRETCHES - first]))
    parts = split_data_folds(made, "contiguous")
    assert sorted(np.concatenate(parts)) == list(range(STRETCHES))
    assert all(len(set(range(first)) - set(part)) for part in parts)
    # Nor, of a long run, nearly all but a stretch that the end of another one's fifth happens to leave.
    long = replace(made, run=np.repeat([0, 1], [STRETCHES - 5, 5]))
    assert all(0 < np.sum(part < STRETCHES - 5) < (STRETCHES - 5) / 2 for part in split_data_folds(long, "contiguous"))
    # One run is left out in a row.
    assert [p.tolist() for p in split_data_folds(Rows(5).products(), "contiguous")] == [
        p.tolist() for p in split_folds(STRETCHES, "contiguous")
    ]
    before, _ = score_candidates(made, BASE, (), NOISE, "contiguous")
    assert np.isfinite(before).all()


def test_a_fit_that_is_not_determined_is_the_smallest_one():
    data = Rows(6)
    for w in data.wide:
        w[:, 4] = w[:, 3]
    before, scores = score_candidates(data.products(), BASE, CANDIDATES, NOISE, "contiguous")
    assert np.isfinite(before).all()
    assert all(np.isfinite(score.after).all() for score in scores)
    np.testing.assert_allclose(before, data.held_out(BASE[:4], "contiguous"), rtol=1e-4)


def test_a_candidate_that_the_model_says_already_changes_nothing():
    data = Rows(4)
    for w in data.wide:
        w[:, 8] = w[:, 1] - 2 * w[:, 2]
    before, scores = score_candidates(data.products(), BASE, CANDIDATES, NOISE, "contiguous")
    twin = next(score for score in scores if score.candidate.columns == (8,))
    assert twin.separability < 1e-4
    np.testing.assert_allclose(twin.after, before, rtol=1e-3)


def test_runs_of_a_stretch_or_two_are_left_out_by_turns_and_not_all_at_once():
    made = replace(Rows(5).products(), run=np.arange(STRETCHES) // 2)
    parts = split_data_folds(made, "contiguous")
    assert sorted(np.concatenate(parts)) == list(range(STRETCHES))
    assert len(parts) == 5
    assert max(map(len, parts)) < STRETCHES / 3


@given(n=st.integers(1, 60), kind=st.sampled_from(["interleaved", "contiguous"]))
def test_folds_are_a_partition_of_the_stretches(n, kind):
    parts = split_folds(n, kind)
    assert sorted(np.concatenate(parts)) == list(range(n))
    assert len(parts) == min(5, n)
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    if kind == "contiguous":
        assert all((np.diff(part) == 1).all() for part in parts)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=40).filter(lambda x: np.std(x) > 1e-6))
def test_t_is_scipys(gains):
    assert compute_t(np.array(gains)) == pytest.approx(stats.ttest_1samp(gains, 0.0).statistic, rel=1e-9, abs=1e-9)


def test_t_of_too_little_or_nothing_is_zero():
    assert compute_t(np.array([5.0])) == 0.0
    assert compute_t(np.zeros(10)) == 0.0


def scored(before: np.ndarray, after: np.ndarray, columns=(5,)) -> Score:
    amplitudes, measured = np.ones(len(columns)), np.ones(before.shape[1])
    return Score(Candidate("c", (), (), columns), before, after, 0.5, amplitudes, measured)


def test_what_says_a_little_more_of_a_change_with_more_parameters_is_told_beside_it():
    since = ("friday",)
    pool = SimpleNamespace(is_change=lambda candidate: bool(candidate.runs))
    state = State(cast(Any, None), cast(Any, pool), (), np.ones(2), np.ones(2))
    gains = np.random.default_rng(5).uniform(9.0, 11.0, 40)
    more = np.where(np.arange(40) == 7, 30.0, 0.0)

    def change(name: str, joints: tuple[int, ...], gains: np.ndarray, runs: tuple[str, ...] = since) -> ScoredCandidate:
        named = ("shoulder",) if len(joints) == 1 else ()
        return judged(gains, joints=joints, candidate=Candidate(name, named, (), (5,), runs))

    offset, tilt = change("offset", (0,), gains), change("base_tilt", (0, 1), gains + more)
    assert find_richer_changes(state, offset, [offset, tilt], ()) == (tilt,)
    assert find_richer_changes(state, offset, [offset, tilt], (tilt,)) == ()
    assert find_richer_changes(state, offset, [offset, change("base_tilt", (0, 1), 2.0 * gains)], ()) == ()
    assert find_richer_changes(state, offset, [offset, change("base_tilt", (1,), gains + more)], ()) == ()
    always = change("offset", (0,), gains, runs=())
    assert find_richer_changes(state, always, [always, change("base_tilt", (0, 1), gains + more, runs=())], ()) == ()


def compute_familywise_p(gains: np.ndarray, scores: Sequence[np.ndarray]) -> np.ndarray:
    return run_familywise_test(gains, draw_scores(scores))[0]


def silent(gains: np.ndarray) -> list[np.ndarray]:
    """Scores that say nothing, one for each of the gains (c, s)."""
    return [np.zeros((gains.shape[1], 1)) for _ in gains]


def test_the_best_of_many_candidates_that_explain_nothing_is_named_as_seldom_as_promised():
    """Placebo: scores without a mean, alike for neighbours, as those of one effect with neighbouring constants are."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(200):
        own, shared = rng.normal(size=(60, 40, 3)), rng.normal(size=(6, 40, 3))
        scores = (own + np.repeat(shared, 10, axis=0)) * rng.lognormal(0.0, 1.0, (40, 1))
        widths = rng.integers(1, 4, 60)
        given = [each[:, :k] for each, k in zip(scores, widths, strict=True)]
        gains = scores[:, :, 0] * np.abs(scores[:, :, 1])
        hits += bool((compute_familywise_p(gains, given) <= 0.05).any())
    assert stats.binomtest(hits, 200, 0.05, alternative="greater").pvalue > 0.01


def test_scores_are_what_numpy_makes_of_the_residual_and_of_what_is_left_of_the_columns():
    data = Rows(4)
    made = data.products()
    fits = FoldedFits.from_blocks(made, JointBlocks.from_products(made, BASE, CANDIDATES), NOISE, ())
    found = score_folds(made, fits, CANDIDATES, NOISE, by_parameters=True)[1]
    w = np.concatenate([w / s for w, s in zip(data.wide, NOISE, strict=True)])
    y = np.concatenate([y / s for y, s in zip(data.y, NOISE, strict=True)])
    rest = y - w[:, BASE] @ np.linalg.lstsq(w[:, BASE], y, rcond=None)[0]
    for candidate, scores in zip(CANDIDATES, found, strict=True):
        x = w[:, list(candidate.columns)]
        z = x - w[:, BASE] @ np.linalg.lstsq(w[:, BASE], x, rcond=None)[0]
        each = (z * rest[:, None]).reshape(2, STRETCHES, PER_STRETCH, -1).sum(axis=(0, 2))
        # In whatever directions: lengths and angles between stretches are those in the metric of (ZᵀZ)⁻¹.
        np.testing.assert_allclose(scores @ scores.T, each @ np.linalg.solve(z.T @ z, each.T), rtol=1e-6, atol=1e-8)
        removed = float(rest @ rest) - np.linalg.lstsq(np.column_stack([w[:, BASE], x]), y, rcond=None)[1][0]
        assert float((scores.sum(axis=0) ** 2).sum()) == pytest.approx(removed, rel=1e-6)


def test_the_p_of_a_single_candidate_is_that_of_turning_signs():
    gains = np.random.default_rng(4).normal(0.4, 1, 12)
    roots = np.sign(gains) * np.sqrt(np.abs(gains))
    signs = np.array(list(itertools.product([1.0, -1.0], repeat=12)))
    t = np.array([stats.ttest_1samp(turned, 0.0).statistic for turned in signs * roots])
    exact = float(np.mean(t >= stats.ttest_1samp(roots, 0.0).statistic - 1e-9))
    # Twice: there are two statistics, and the other one is silent.
    assert compute_familywise_p(gains[None], silent(gains[None]))[0] == pytest.approx(min(1.0, 2 * exact), abs=0.05)


def test_the_p_of_scores_is_that_of_turning_the_signs_of_whole_stretches():
    scores = np.random.default_rng(4).normal(0.35, 1, (12, 2))
    signs = np.array(list(itertools.product([1.0, -1.0], repeat=12)))
    sums = ((signs @ scores) ** 2).sum(axis=1)
    exact = float(np.mean(sums >= sums[0] - 1e-9))
    assert 0.005 < exact < 0.5
    assert compute_familywise_p(np.zeros((1, 12)), [scores])[0] == pytest.approx(min(1.0, 2 * exact), abs=0.05)


def test_more_candidates_make_the_same_gain_less_sure():
    rng = np.random.default_rng(5)
    good, noise = rng.normal(0.55, 1, (1, 40)), rng.normal(size=(300, 40))
    many = np.vstack([good, noise])
    assert compute_familywise_p(good, silent(good))[0] < compute_familywise_p(many, silent(many))[0]
    own, others = good.T + 0.2, [each[:, None] for each in noise]
    quiet = np.zeros_like(many)
    assert compute_familywise_p(quiet[:1], [own])[0] < compute_familywise_p(quiet, [own, *others])[0]


def test_small_effects_that_gains_do_not_show_are_seen_in_the_scores():
    """A gain is what is explained less what the fit of it costs; its size is an uneven thing, its direction is not."""
    rng = np.random.default_rng(8)
    said = []
    for _ in range(20):
        x = rng.normal(size=(40, 60))
        score = (x * (0.1 * x + rng.normal(size=x.shape))).sum(axis=1)
        gains = 2 * 0.1 * score - 0.1**2 * (x**2).sum(axis=1)
        p = [compute_familywise_p(g[None], [s[:, None]])[0] for g, s in ((gains, 0 * score), (0 * gains, score))]
        said.append(np.array(p) <= 0.01)
    by_gains, by_scores = np.mean(said, axis=0)
    assert by_scores > by_gains + 0.3


def judged_alone(before: np.ndarray, after: np.ndarray, joints=(0,)) -> ScoredCandidate:
    item = combine_scores([[scored(before, after)]] * 2, [joints], np.ones(before.shape[1]))[0]
    return replace(item, p=float(compute_familywise_p(item.gains[None], silent(item.gains[None]))[0]))


def is_significant(item: ScoredCandidate) -> bool:
    state = cast(State, SimpleNamespace(rules=RULES, level=RULES.significance))
    return check_significance(state, item) is None


def test_a_large_even_gain_passes_and_a_small_or_uneven_one_does_not():
    rng = np.random.default_rng(1)
    before = rng.uniform(0.9, 1.1, (40, 2))
    even = judged_alone(before, 0.9 * before, (0, 1))
    assert even.drop == pytest.approx(0.1)
    assert is_significant(even)
    assert even.share_improved == 1.0
    small = judged_alone(before, 0.98 * before, (0, 1))
    assert small.p < 0.01
    assert not is_significant(small)
    assert not is_significant(
        judged_alone(before, before * np.where(rng.uniform(size=(40, 1)) < 0.5, 1.4, 0.5), (0, 1))
    )


def test_a_loss_counts_for_no_more_than_there_was():
    """A fold that leaves out what decides a parameter says nothing about the candidate."""
    before = np.random.default_rng(2).uniform(0.9, 1.1, (40, 1))
    after = 0.3 * before
    after[7] = 1e6
    item = judged_alone(before, after)
    assert is_significant(item)
    assert item.gains.min() == pytest.approx(-before[7, 0], rel=1e-6)


def test_a_gain_in_one_kind_of_folds_alone_does_not_pass():
    before = np.random.default_rng(2).uniform(0.9, 1.1, (40, 2))
    item = combine_scores([[scored(before, 0.5 * before)], [scored(before, 1.01 * before)]], [(0, 1)], np.ones(2))[0]
    assert item.drop < 0
    assert not is_significant(replace(item, p=0.0))


def test_one_stretch_with_most_of_the_error_does_not_decide():
    before = np.ones((40, 1))
    before[0] = 100.0
    after = before.copy()
    after[0] = 0.0
    item = judged_alone(before, after)
    assert item.drop < 0.1
    assert not is_significant(item)


def test_a_gain_counts_though_most_stretches_have_no_rows():
    """Where passive joints with friction turn all the time, few stretches are equations."""
    before = np.zeros((80, 2))
    before[::4] = np.random.default_rng(3).uniform(0.9, 1.1, (20, 2))
    item = judged_alone(before, 0.2 * before, (0, 1))
    assert item.drop == pytest.approx(0.8)
    assert item.total_gain == pytest.approx(0.8 * before.sum())
    assert is_significant(item)
    loud = before.copy()
    loud[0] = 100.0
    assert judged_alone(loud, np.where(loud > 10.0, 0.0, loud), (0, 1)).drop < 0.2


def test_a_name_is_found_again_in_resampled_data_unless_a_rival_gains_as_much():
    rng = np.random.default_rng(6)
    gains = rng.uniform(0.8, 1.2, 40)
    chosen, run = judged(gains, name="offset"), np.zeros(40, dtype=int)
    assert compute_stability([chosen], [judged(0.7 * gains, name="viscous_asymmetric")], run) == 1.0
    noise = rng.normal(0, 0.5, 40)
    twin = judged(gains + noise - noise.mean(), name="viscous_asymmetric")
    assert compute_stability([chosen], [twin], run) < 0.9


def test_two_names_for_one_finding_are_found_again_together_and_neither_alone():
    rng = np.random.default_rng(6)
    gains, run = rng.uniform(0.8, 1.2, 40), np.zeros(40, dtype=int)
    noise = rng.normal(0, 0.5, 40)
    chosen = judged(gains, name="offset")
    twin = judged(gains + noise - noise.mean(), name="viscous_asymmetric")
    lesser = judged(0.7 * gains, name="stribeck")
    assert compute_stability([chosen], [twin, lesser], run) < 0.9
    assert compute_stability([twin], [chosen, lesser], run) < 0.9
    assert compute_stability([chosen, twin], [lesser], run) == 1.0


def test_a_name_that_one_run_alone_speaks_for_is_not_found_again_without_it():
    gains = np.concatenate([np.full(20, 5.0), np.full(20, 0.1)])
    rival = judged(np.full(40, 1.0), name="viscous_asymmetric")
    run = np.repeat([0, 1], 20)
    assert compute_stability([judged(gains, name="offset")], [rival], np.zeros(40, dtype=int)) > 0.9
    assert compute_stability([judged(gains, name="offset")], [rival], run) == 0.5


def test_errors_are_counted_in_units_of_each_joints_noise():
    before = np.ones((40, 2)) * [1.0, 100.0]
    after = before * [0.5, 1.0]
    item = combine_scores([[scored(before, after)]] * 2, [(0,)], np.array([1.0, 10.0]))[0]
    np.testing.assert_allclose(item.gains, 0.5)
    assert item.drop == pytest.approx(0.5)
    np.testing.assert_allclose(item.after_weighted, 0.5)


def test_of_explanations_that_no_stretch_tells_apart_the_simplest_is_taken():
    rng = np.random.default_rng(3)
    gains = rng.uniform(1, 2, 40)
    wide = judged(gains + rng.normal(0, 0.5, 40) + 0.02, (5, 6), "wide")
    slim = judged(gains, (7,), "slim")
    poor = judged(gains - 0.8 + rng.normal(0, 0.1, 40), (8,), "poor")
    assert are_indistinguishable(wide, slim)
    assert not are_indistinguishable(slim, poor)
    chosen, equal = select_simplest([poor, wide, slim])
    assert chosen is slim
    assert equal == (wide,)


def test_a_richer_explanation_is_taken_where_it_gains_enough_more():
    gains = np.random.default_rng(3).uniform(1, 2, 40)
    wide, slim = judged(gains + 0.5, (5, 6), "wide"), judged(gains, (7,), "slim")
    assert select_simplest([slim, wide])[0] is wide


def test_a_single_explanation_has_no_equals():
    only = judged(np.ones(10))
    assert select_simplest([only]) == (only, ())


def test_what_was_scored_beside_the_same_model_is_not_scored_again(monkeypatch):
    rows, scored = Rows(6).kept(), list[int]()
    data = SimpleNamespace(
        find_row_kinds=lambda columns: (False, False), select_for_candidates=lambda *_: rows, identity=object()
    )
    acts = {
        candidate.columns: tuple(j for j in range(2) if set(candidate.columns) & set(CONTAINS[j]))
        for candidate in CANDIDATES
    }
    pool = SimpleNamespace(find_joints=acts.get, is_change=lambda candidate: True)
    state = State(cast(Any, data), cast(Any, pool), tuple(BASE.tolist()), NOISE, NOISE)
    score = search_state._score_same_rows

    def count(common, *arguments, **named):
        scored.append(len(common.candidates))
        return score(common, *arguments, **named)

    monkeypatch.setattr(search_state, "_score_same_rows", count)
    family = score_family(state, CANDIDATES)
    again = score_family(state, CANDIDATES, family)
    assert scored == [len(CANDIDATES)]
    assert again.is_fresh
    assert all(item.after is known.after for item, known in zip(again.scored, family.scored, strict=True))
    # The same model on products of another pool is the same, with noise that is rounded otherwise, too; one with other
    # columns is not, though nobody says where it differs.
    data.identity = object()
    assert score_family(replace(state, noise=NOISE * (1.0 + 1e-14)), CANDIDATES, family, ()).is_fresh
    assert len(scored) == 1
    score_family(replace(state, base=state.base[1:]), CANDIDATES, family, ())
    assert scored.pop() == len(CANDIDATES)
    # Beside a model that differs on a joint, what acts there is scored, and the rest once it is asked for.
    other = replace(state, noise=2.0 * NOISE)
    partly = score_family(other, CANDIDATES, family, (0,))
    here = sum(0 in item.joints for item in family.scored)
    assert 0 < here < len(CANDIDATES)
    assert not partly.is_fresh
    whole = score_family(other, CANDIDATES, partly)
    assert whole.is_fresh
    assert scored[1:] == [here, len(CANDIDATES) - here]
    assert [item.p for item in whole.scored] == [item.p for item in score_family(other, CANDIDATES).scored]


def test_joints_that_are_scored_on_several_threads_have_the_same_scores(monkeypatch):
    data = Rows(5).kept()
    before, alone = score_candidates(data, BASE, CANDIDATES, NOISE, "contiguous")
    monkeypatch.setattr(parallel, "MIN_PARALLEL_SIZE", 1)
    monkeypatch.setattr(parallel, "count_processors", lambda: 2)
    again, together = score_candidates(data, BASE, CANDIDATES, NOISE, "contiguous")
    assert np.array_equal(before, again)
    assert all(np.array_equal(one.after, two.after) for one, two in zip(alone, together, strict=True))


def test_joints_that_are_scored_at_a_time_are_few_on_any_machine(monkeypatch):
    data, threads, read = Rows(5).kept(), list[threading.Thread](), FoldedFits.read_errors

    def note(fits, joint):
        threads.append(threading.current_thread())
        return read(fits, joint)

    monkeypatch.setattr(FoldedFits, "read_errors", note)
    monkeypatch.setattr(parallel, "MIN_PARALLEL_SIZE", 1)
    monkeypatch.setattr(parallel, "count_processors", lambda: 64)
    monkeypatch.setattr(held_out_scores, "_MOST_JOINTS", 1)
    score_candidates(data, BASE, CANDIDATES, NOISE, "contiguous")
    assert threads == 2 * [threading.current_thread()]


def _let_candidate_and_model_share(w):
    # What column 8 says where there is one, columns of the model and column 9 say together.
    w[:, 8] = w[:, 9] - 2.0 * w[:, 1]


def _let_candidate_be_what_tells_two_columns_apart(w):
    w[:, 2] = w[:, 1] + 3e-5 * w[:, 8]


def _let_candidate_be_shared_beside_two_equal_columns(w):
    w[:, 2] = w[:, 1] + 3e-5 * w[:, 7]
    w[:, 8] = w[:, 0] + w[:, 1]


@pytest.mark.parametrize(
    "entangle",
    [
        _let_candidate_and_model_share,
        _let_candidate_be_what_tells_two_columns_apart,
        _let_candidate_be_shared_beside_two_equal_columns,
    ],
)
@pytest.mark.parametrize("seed", range(10))
def test_parameters_that_a_model_and_a_candidate_share_are_the_smallest_that_fit(entangle, seed):
    """The same as with the pseudo-inverse of all equations at once, with unit columns."""
    data = Rows(seed)
    for w in data.wide:
        entangle(w)
    products = data.kept()
    w = np.concatenate([w / s for w, s in zip(data.wide, NOISE, strict=True)])[:, [*BASE, 8, 9]]
    y = np.concatenate([y / s for y, s in zip(data.y, NOISE, strict=True)])
    scale = np.linalg.norm(w, axis=0)
    inverse = np.linalg.pinv((w / scale).T @ (w / scale), rcond=1e-10, hermitian=True)
    expected = np.sqrt(RULES.rows_of_filter * np.diag(inverse)) / scale
    values, deviations = _fit_columns(products, tuple(BASE.tolist()), (8, 9), NOISE)
    assert deviations == pytest.approx(expected, rel=1e-4)
    # Of parameters that hardly show in the data, rounding shows in the values; far below what they are known to.
    assert np.all(np.abs(values - inverse @ (w / scale).T @ y / scale) <= 1e-4 * expected)
