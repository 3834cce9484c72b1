"""Compute the smallest size of each effect that these recordings would have shown, in units of its usual size.

Holds the largest and the smallest size that is looked for.

An effect of a known size is planted into the products that the search has: its torque beside the model is Z β, with Z
what the model leaves of its columns. What the model leaves of the torque stays as it is, with the signs of whole blocks
drawn anew (a wild bootstrap by clusters): samples of one block may be correlated as they like, and what is left of a
small effect that is really there is broken up. On these draws the rules of the search decide, with the level that
they have among all its candidates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.fold_fit import FoldFit, ProductSums
from dynident.diagnosis.candidates.held_out_scores import compute_block_products
from dynident.diagnosis.candidates.products_of_scored_pairs import JointBlocks
from dynident.diagnosis.candidates.significance import FamilywiseLevels, compute_least_t, standardise_size
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, split_data_folds
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import DetectionLimit, Invisible
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason
from dynident.diagnosis.search.acceptance_rules import find_least_drops, get_least_gain
from dynident.diagnosis.search.candidate_outcomes import FinalScores
from dynident.diagnosis.search.search_state import KINDS, find_acting_columns, may_use_scores
from dynident.effects import EffectChoice, get_effect
from dynident.estimation.residual_errors import compute_evenness

SURE, HALF = 0.95, 0.5
"""Shares of the draws in which an effect of the size of the limit, and of the half limit, is accepted."""

LARGEST = 100.0
"""Times the usual size above which no limit is looked for: no arm has an effect of that size."""
_SMALLEST = 0.003

# Draws of the blocks' signs: a share of 0.95 is then known to within 0.03. The search for the size that each draw
# accepts halves its interval in the logarithm so often: a limit is known to within 4 %.
_DRAWS, _HALVINGS = 50, 8
_SEED = 43


def compute_detection_limits(
    final: FinalScores, pool: Pool, choices: Sequence[EffectChoice]
) -> tuple[DetectionLimit, ...]:
    """Compute the detection limit of each effect on each joint, beside the model with everything that was found.

    Parameters
    ----------
    final : FinalScores
        All candidates beside that model.
    pool : Pool
        Model and candidates.
    choices : sequence of EffectChoice
        What the findings have become: for these, and what the data cannot tell from them, there is no limit.

    Returns
    -------
    tuple of DetectionLimit
        One for each effect and joint that was tried and has a usual size, in the order of the candidates.
    """
    base = set(final.state.base)
    best: dict[tuple[str, tuple[str, ...]], tuple[float, Candidate]] = {}
    for candidate in pool.initial_candidates:
        if len(candidate.joints) > 1 or candidate.runs or base & set(candidate.columns):
            continue
        distance = _compute_distance_from_usual(pool, candidate)
        key = candidate.effect, candidate.joints
        if distance is not None and (key not in best or distance < best[key][0]):
            best[key] = distance, candidate
    sets: dict[tuple[bool, bool], list[Candidate]] = {}
    named = [
        ({choice.effect, *(scored.candidate.effect for scored in finding.equal)}, set(choice.joints))
        for finding, choice in zip(final.state.findings, choices, strict=True)
    ]
    for (effect, joints), (_, candidate) in best.items():
        # What was found, by whichever name, is no longer hidden.
        if not any(effect in names and set(joints) <= places for names, places in named):
            sets.setdefault(final.data.find_row_kinds(candidate.columns), []).append(candidate)
    limits: dict[Candidate, DetectionLimit] = {}
    for kinds, members in sets.items():
        rows = final.data.select_for_candidates(final.state.base, np.array(kinds))
        elsewhere: dict[Candidate, _PlantedEffect] = {}
        if kinds[0]:
            # What is judged on rows at reversals has to help where joints move on, too.
            moving = final.data.select_for_candidates(final.state.base, np.array((False, kinds[1])))
            elsewhere = {planted.candidate: planted for planted in _list_planted(moving, pool, final, members)}
        for planted in _list_planted(rows, pool, final, members):
            whole = replace(planted, moving=elsewhere.get(planted.candidate))
            limits[planted.candidate] = _build_limit(pool, whole)
    return tuple(limits[candidate] for _, candidate in best.values() if candidate in limits)


def _compute_distance_from_usual(pool: Pool, candidate: Candidate) -> float | None:
    """Return how far a candidate's shape constants are from the usual ones; None where no size is usual."""
    values, shape = _get_usual(pool, candidate)
    if not any(values.values()):
        return None
    pairs = [(shape[name], value) for name, value in candidate.shape if name in shape]
    return sum(abs(a - b) / max(abs(a), abs(b), 1e-12) for a, b in pairs)


def _get_usual(pool: Pool, candidate: Candidate) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Return the usual parameters and shape constants of a candidate's effect on its joint, by name."""
    robot = pool.observation.robot.tree
    joint = robot.joint_names.index(candidate.joints[0]) if candidate.joints else 0
    usual = get_effect(candidate.effect).usual(robot, joint)
    return (usual.values, usual.shape) if usual is not None else ({}, {})


_SMALL = ("not_significant", "too_small")
"""Codes of reasons that a larger effect would not have had."""


def add_limits(outcomes: Sequence[CandidateOutcome], limits: Sequence[DetectionLimit]) -> tuple[CandidateOutcome, ...]:
    """Add the detection limit to the reason of every effect that was too small to be accepted.

    Parameters
    ----------
    outcomes : sequence of CandidateOutcome
        What became of every effect on every joint.
    limits : sequence of DetectionLimit
        The detection limits.
    """
    sizes = {(limit.effect, limit.joints): limit for limit in limits if math.isfinite(limit.size)}
    return tuple(
        replace(outcome, reason=_add_limit(outcome.reason, limit))
        if outcome.reason.code in _SMALL and (limit := sizes.get((outcome.choice.effect, outcome.choice.joints)))
        else outcome
        for outcome in outcomes
    )


def _add_limit(reason: Reason, limit: DetectionLimit) -> Reason:
    return Reason.build(reason.code, reason.step, **{**dict(reason.values), "limit": limit.size, "unit": limit.unit})


def list_too_large_limits(limits: Sequence[DetectionLimit], hidden: Sequence[Invisible]) -> tuple[Invisible, ...]:
    """List the effects that would not show even in their usual size.

    Parameters
    ----------
    limits : sequence of DetectionLimit
        The detection limits.
    hidden : sequence of Invisible
        What could not have shown for other reasons, and is not repeated.
    """
    known = {(invisible.effect, invisible.joints) for invisible in hidden}
    return tuple(
        _build_invisible(limit) for limit in limits if limit.share > 1.0 and (limit.effect, limit.joints) not in known
    )


def _build_invisible(limit: DetectionLimit) -> Invisible:
    unit = "" if limit.unit == "-" else f" {limit.unit}"
    usual = f"an arm with this effect has about {limit.usual:.2g}{unit}"
    if not math.isfinite(limit.size):
        return Invisible(limit.effect, limit.joints, f"these data would show it in no size; {usual}", "in no size")
    shown = f"{limit.parameter} would have shown from {limit.size:.2g}{unit} on"
    brief = f"{limit.parameter}: from {limit.size:.2g} on, usual {limit.usual:.2g}{unit}"
    return Invisible(limit.effect, limit.joints, f"{shown}; {usual}", brief)


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Products of one candidate beside the model fitted without the fold of each block, in one kind of folds.

    Parameters
    ----------
    squares : (s, n + 1, k, k)
        ZᵀZ by block and joint.
    scores : (s, n + 1, k)
        Zᵀρ of what the model leaves.
    errors : (s, n + 1)
        Squares of what the model leaves.
    folds : tuple of (f,)
        Numbers of the blocks that are left out together.
    """

    squares: FloatArray
    scores: FloatArray
    errors: FloatArray
    folds: tuple[IndexArray, ...]


class _Comparison(NamedTuple):
    """Errors of each draw without and with a candidate.

    `gains` (d, s) of all joints in units of the noise; `drops`, and squared errors `before` and `removed`, (d, n) each.
    """

    gains: FloatArray
    drops: FloatArray
    before: FloatArray
    removed: FloatArray


def _compute_error_drops(sides: Sequence[_Comparison]) -> FloatArray:
    """Return (d, n): the shares of the error, averaged over the kinds of folds, that a candidate removes."""
    before, removed = (np.mean([getattr(side, name) for side in sides], axis=0) for name in ("before", "removed"))
    return np.asarray(1.0 - np.sqrt(np.maximum(1.0 - removed / before, 0.0)))


@dataclass(frozen=True, eq=False)
class _PlantedEffect:
    """What is needed to judge a candidate as if its effect were there in some size.

    Joints are the n that the candidate is reported on and a last one that stands for all joints together, in units of
    the noise.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    direction : (k,)
        Its parameters at the usual size.
    least_sizes : (k,)
        Sizes of its parameters that nobody would notice; 0 where any size would be.
    held_out : tuple of _HeldOut
        The products beside the model fitted without the fold of each block, for each kind of folds.
    fitted_squares : (s, k, k)
        ZᵀZ over all joints, of the model fitted to all blocks.
    fitted_scores : (s, k)
        The same of Zᵀρ.
    floor : (n,)
        Squares of the sensors' noise in all rows that count.
    unit : (k, k)
        Directions of the parameters in which ZᵀZ is one.
    separability : float
        Share of its columns that is left beside the model.
    levels : FamilywiseLevels
        What the test asks of it.
    least_t : float
        Least t of its gain.
    moving : _PlantedEffect, optional
        The same on the rows where joints move on, for a candidate that is judged on rows at reversals as well.
    """

    candidate: Candidate
    direction: FloatArray
    least_sizes: FloatArray
    held_out: tuple[_HeldOut, ...]
    fitted_squares: FloatArray
    fitted_scores: FloatArray
    floor: FloatArray
    unit: FloatArray
    separability: float
    levels: FamilywiseLevels
    least_t: float
    moving: _PlantedEffect | None = None

    def find_accepted(self, shares: FloatArray) -> BoolArray:
        """Return (d,): in which draws an effect of a share (d,) of the usual size is accepted."""
        sides = [self._compare(number, shares) for number in range(len(self.held_out))]
        t = compute_evenness(np.mean([side.gains for side in sides], axis=0))
        # The smaller of both kinds of folds, as in scoring; errors are averaged.
        drops = np.min([side.drops for side in sides], axis=0)
        removed = np.mean([side.removed for side in sides], axis=0)
        error_drops = _compute_error_drops(sides)
        effect = get_effect(self.candidate.effect)
        # What pulls at two joints has to help both; anything else the joint that it helps most.
        over_joints = np.min if effect.pulls_on_each else np.max
        least_drop = find_least_drops(self.candidate, self.separability, t)
        accepted = (
            ((t >= self.levels.gains) | self._test_scores(shares))
            & (t >= self.least_t)
            & (over_joints(drops, axis=1) >= least_drop)
            & (over_joints(error_drops, axis=1) >= RULES.least_error_drop)
            & (over_joints(removed / self.floor, axis=1) >= get_least_gain(effect))
        )
        if self.least_sizes.any():
            estimates = shares[:, None] * self.direction + self._misses
            is_noticed = (np.abs(estimates) >= self.least_sizes) & (self.least_sizes > 0.0)
            accepted &= is_noticed.any(axis=1)
        if self.moving is not None:
            kinds = range(len(self.moving.held_out))
            where_moving = _compute_error_drops([self.moving._compare(number, shares) for number in kinds])
            accepted &= over_joints(where_moving, axis=1) >= RULES.least_error_drop
        return np.asarray(accepted)

    def find_thresholds(self) -> FloatArray:
        """Return (d,): the smallest share of the usual size that is accepted in each draw; infinite where none is."""
        if self.separability < RULES.least_separability:
            return np.full(_DRAWS, np.inf)
        low, high = np.full(_DRAWS, math.log(_SMALLEST)), np.full(_DRAWS, math.log(LARGEST))
        is_ever = self.find_accepted(np.exp(high))
        if not is_ever.any():
            return np.full(_DRAWS, np.inf)
        # All draws halve their own intervals at once.
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            accepted = self.find_accepted(np.exp(middle))
            low, high = np.where(accepted, low, middle), np.where(accepted, middle, high)
        return np.where(is_ever, np.exp(high), np.inf)

    def _compare(self, number: int, shares: FloatArray) -> _Comparison:
        """Compare the errors without and with the candidate in one kind of folds."""
        held_out = self.held_out[number]
        along, cross = self._products_along[number]
        share = shares[:, None, None]
        before = np.maximum(held_out.errors + share**2 * along + 2.0 * share * cross, np.finfo(float).tiny)
        # As in scoring: no loss counts for more than there was, and no block for more than three usual ones.
        gain = np.maximum(before - self._errors_after[number], -before)
        whole = before[:, :, -1]
        factor = np.minimum(whole, RULES.most_of_block * _compute_medians(whole)) / whole
        own_before, own_gain = before[:, :, :-1], gain[:, :, :-1]
        drops = np.einsum("ds,dsn->dn", factor, own_gain) / np.einsum("ds,dsn->dn", factor, own_before)
        return _Comparison(gain[:, :, -1] * factor, drops, own_before.sum(axis=1), own_gain.sum(axis=1))

    @cached_property
    def _signs(self) -> FloatArray:
        """Random signs (d, s) of the blocks, the same for every candidate."""
        return np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(_DRAWS, len(self.fitted_scores)))

    @cached_property
    def _misses(self) -> FloatArray:
        """By how much the parameters (d, k), fitted to all blocks, miss the planted ones in each draw."""
        inverse = np.linalg.pinv(self.fitted_squares.sum(axis=0), rcond=1e-8, hermitian=True)
        return np.asarray(self._signs @ self.fitted_scores @ inverse)

    @cached_property
    def _products_along(self) -> list[tuple[FloatArray, FloatArray]]:
        """Squares (s, n + 1) of the torque of the usual size, and its products (d, s, n + 1) with what is left."""
        return [
            (kind.squares @ self.direction @ self.direction, self._signs[:, :, None] * (kind.scores @ self.direction))
            for kind in self.held_out
        ]

    @cached_property
    def _errors_after(self) -> list[FloatArray]:
        """Squared errors (d, s, n + 1) with the candidate, fitted without the fold of each block.

        By how much the fitted parameters miss the planted ones does not depend on these.
        """
        return [self._fit_held_out(kind) for kind in self.held_out]

    def _fit_held_out(self, kind: _HeldOut) -> FloatArray:
        whole_squares = self.fitted_squares.sum(axis=0)
        after = np.empty((_DRAWS, *kind.errors.shape))
        # All folds at once: each of these matrices is small.
        others = np.array([whole_squares - self.fitted_squares[fold].sum(axis=0) for fold in kind.folds])
        for fold, inverse in zip(kind.folds, np.linalg.pinv(others, rcond=1e-8, hermitian=True), strict=True):
            left_out = np.ones(len(kind.errors), dtype=bool)
            left_out[fold] = False
            noise = self._signs[:, left_out] @ self.fitted_scores[left_out]
            miss = noise @ inverse
            products = (miss[:, :, None] * miss[:, None, :]).reshape(_DRAWS, -1)
            quadratic = products @ kind.squares[fold].reshape(-1, products.shape[1]).T
            cross = miss @ kind.scores[fold].reshape(-1, miss.shape[1]).T
            shape = (_DRAWS, len(fold), kind.errors.shape[1])
            after[:, fold] = (
                kind.errors[fold] - 2.0 * self._signs[:, fold, None] * cross.reshape(shape) + quadratic.reshape(shape)
            )
        return np.maximum(after, 0.0)

    def _test_scores(self, shares: FloatArray) -> BoolArray:
        """Return (d,): whether the scores are larger than chance makes them, where they may speak."""
        if not may_use_scores(self.candidate):
            return np.zeros(_DRAWS, dtype=bool)
        noise_sum, pushed_sum, noise_squares, pushed_squares, mixed = self._score_sums
        share = shares[:, None, None]
        sums = noise_sum + shares[:, None] * pushed_sum
        spread = noise_squares + share**2 * pushed_squares + share * mixed
        return np.asarray(standardise_size((sums**2).sum(axis=1), spread) >= self.levels.scores)

    @cached_property
    def _score_sums(self) -> tuple[FloatArray, ...]:
        """Sums of the scores over the blocks, and of their squares: of what is left, of the usual size, and mixed."""
        noise, pushed = self.fitted_scores @ self.unit, (self.fitted_squares @ self.direction) @ self.unit
        # The squares of what is left do not depend on the draw's signs.
        mixed = self._signs @ (noise[:, :, None] * pushed[:, None, :]).reshape(len(noise), -1)
        mixed = mixed.reshape(_DRAWS, *self.unit.shape)
        return (
            self._signs @ noise,
            pushed.sum(axis=0),
            noise.T @ noise,
            pushed.T @ pushed,
            mixed + mixed.transpose(0, 2, 1),
        )


def _compute_medians(values: FloatArray) -> FloatArray:
    """Return the medians (d, 1) of values (d, s); several times as fast as numpy's for a few values each."""
    middle = (values.shape[1] - 1) // 2, values.shape[1] // 2
    return np.asarray(np.partition(values, middle, axis=1)[:, middle].mean(axis=1, keepdims=True))


def _list_planted(
    rows: Products, pool: Pool, final: FinalScores, members: Sequence[Candidate]
) -> Iterator[_PlantedEffect]:
    """Yield what is needed to plant each of some candidates that are about the same rows."""
    state = final.state
    blocks = JointBlocks.from_products(rows, np.array(state.base, dtype=np.intp), members)
    total = blocks.sum_products(state.noise)
    fit = FoldFit(total, blocks.portions)
    acting = find_acting_columns(pool)
    fitted_scores = [block.compute_errors(fit).compute_scores() for block in blocks.joints]
    fitted_squares = [compute_block_products(block, fit) for block in blocks.joints]
    kinds = [_hold_out(blocks, total, tuple(split_data_folds(rows, kind)), state.noise) for kind in KINDS]
    weights = 1.0 / state.noise**2
    counts = rows.counts.sum(axis=0)
    for number, portion in enumerate(blocks.portions):
        unit, separability = fit.compute_unit_directions(number), fit.compute_separability(number)
        for place, (member, columns) in enumerate(zip(portion.members, portion.columns, strict=True)):
            candidate = members[member]
            usual, _ = _get_usual(pool, candidate)
            joints = np.flatnonzero(acting[list(candidate.columns)].any(axis=0))
            if len(candidate.joints) == 1 and not get_effect(candidate.effect).pulls_on_each:
                # An effect of one joint that acts on others too: the joint that it moves most, in units of the noise.
                own = [weights[j] * np.trace(fitted_squares[j][number][place].sum(axis=0)) for j in joints]
                joints = joints[[int(np.argmax(own))]]
            every = range(len(weights))
            yield _PlantedEffect(
                candidate,
                np.array([usual.get(pool.observation.columns[k].parameter, 0.0) for k in candidate.columns]),
                _list_least_sizes(pool, candidate),
                tuple(kind.take_candidate(number, place, columns, joints, weights) for kind in kinds),
                np.asarray(sum(weights[j] * fitted_squares[j][number][place] for j in every)),
                np.asarray(sum(weights[j] * fitted_scores[j][:, columns] for j in every)),
                np.maximum(counts[joints] * state.floor[joints] ** 2, np.finfo(float).tiny),
                unit[place],
                float(separability[place]),
                final.levels,
                max(compute_least_t(rows.n_blocks, state.level), RULES.staying_finding_t),
            )


@dataclass(frozen=True, eq=False)
class _HeldOutBlocks:
    """Products of all candidates in one kind of folds: ρᵀρ (s,), Zᵀρ (s, c), ZᵀZ by portion (g, s, k, k) a joint."""

    errors: list[FloatArray]
    scores: list[FloatArray]
    squares: list[list[FloatArray]]
    folds: tuple[IndexArray, ...]

    def take_candidate(
        self, number: int, place: int, columns: IndexArray, joints: IndexArray, weights: FloatArray
    ) -> _HeldOut:
        """Take one candidate of a portion, on some joints and on all together in units of the noise."""

        def stack(each: Sequence[FloatArray]) -> FloatArray:
            whole = np.asarray(sum(weight * own for weight, own in zip(weights, each, strict=True)))
            return np.stack([*(each[j] for j in joints), whole], axis=1)

        squares = stack([own[number][place] for own in self.squares])
        return _HeldOut(squares, stack([own[:, columns] for own in self.scores]), stack(self.errors), self.folds)


def _hold_out(
    blocks: JointBlocks, total: ProductSums, folds: tuple[IndexArray, ...], noise: FloatArray
) -> _HeldOutBlocks:
    """Return the products of each block beside the model fitted without its fold.

    Where the motion hardly determines the model, what it leaves of a column is much larger on blocks that it has not
    seen, and held-out errors show an effect by that.
    """
    s, c, n = blocks.n_blocks, blocks.n_extra, len(blocks.joints)
    errors, scores = [np.zeros(s) for _ in range(n)], [np.zeros((s, c)) for _ in range(n)]
    squares = [
        [np.zeros((len(portion.members), s, portion.width, portion.width)) for portion in blocks.portions]
        for _ in range(n)
    ]
    for fold in folds:
        here = blocks.select_blocks(fold)
        fit = FoldFit(total.subtract(here.sum_products(noise)), blocks.portions)
        for j, block in enumerate(here.joints):
            joint_errors = block.compute_errors(fit)
            errors[j][fold], scores[j][fold] = joint_errors.alone, joint_errors.compute_scores()
            for own, products in zip(squares[j], compute_block_products(block, fit), strict=True):
                own[:, fold] = products
    return _HeldOutBlocks(errors, scores, squares, folds)


def _build_limit(pool: Pool, planted: _PlantedEffect) -> DetectionLimit:
    candidate = planted.candidate
    main = int(np.argmax(np.abs(planted.direction)))
    column = pool.observation.columns[candidate.columns[main]]
    usual = abs(float(planted.direction[main]))
    thresholds = np.sort(planted.find_thresholds())
    sure, half = (float(thresholds[math.ceil(power * _DRAWS) - 1]) for power in (SURE, HALF))
    return DetectionLimit(
        candidate.effect, candidate.joints, column.name, column.unit, sure * usual, half * usual, usual, candidate.shape
    )


def _list_least_sizes(pool: Pool, candidate: Candidate) -> FloatArray:
    """Return the size (k,) of each parameter below which nobody would notice it, by its specification; 0: none."""
    specs = {spec.name: spec.least for spec in get_effect(candidate.effect).parameters}
    return np.array([specs.get(pool.observation.columns[k].parameter, 0.0) for k in candidate.columns])
