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
from dynident.diagnosis.candidates.held_out_scores import FoldedFits, JointBlocks
from dynident.diagnosis.candidates.products_of_scored_pairs import JointErrors
from dynident.diagnosis.candidates.significance import FamilywiseLevels, compute_least_t, standardise_size
from dynident.diagnosis.candidates.time_blocks_and_folds import KINDS, Products, split_data_folds
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.diagnosis.search.acceptance_rules import find_least_drops, get_least_gain
from dynident.diagnosis.search.candidate_outcomes import FinalScores
from dynident.diagnosis.search.search_state import may_use_scores
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
# Stands for all joints together, behind those of the robot.
_ALL = -1
# Effects that are judged at once: what they take of memory stays in the cache.
_TOGETHER = 8


def compute_detection_limits(
    final: FinalScores, choices: Sequence[EffectChoice], *, only_common: bool = False
) -> tuple[DetectionLimit, ...]:
    """Compute the detection limit of each effect on each joint, beside the model with everything that was found.

    Parameters
    ----------
    final : FinalScores
        All candidates beside that model.
    choices : sequence of EffectChoice
        What the findings have become: for these, and what the data cannot tell from them, there is no limit.
    only_common : bool
        Whether effects that arms seldom have are left out: they take most of the time.

    Returns
    -------
    tuple of DetectionLimit
        One for each effect and joint that was tried and has a usual size, in the order of the candidates.
    """
    state, pool = final.state, final.state.pool
    base = set(state.base)
    best: dict[tuple[str, tuple[str, ...]], tuple[float, Candidate]] = {}
    for candidate in pool.initial_candidates:
        if len(candidate.joints) > 1 or candidate.runs or base & set(candidate.columns):
            continue
        if only_common and get_effect(candidate.effect).often_missed is None:
            continue
        distance = _compute_distance_from_usual(pool, candidate)
        key = candidate.effect, candidate.joints
        if distance is not None and (key not in best or distance < best[key][0]):
            best[key] = distance, candidate
    sets: dict[tuple[bool, bool], list[Candidate]] = {}
    named = [
        ({choice.effect, *(scored.candidate.effect for scored in finding.equal)}, set(choice.joints))
        for finding, choice in zip(state.findings, choices, strict=True)
    ]
    for (effect, joints), (_, candidate) in best.items():
        # What was found, by whichever name, is no longer hidden.
        if not any(effect in names and set(joints) <= places for names, places in named):
            sets.setdefault(state.data.find_row_kinds(candidate.columns), []).append(candidate)
    limits: dict[Candidate, DetectionLimit] = {}
    for kinds, members in sets.items():
        rows = state.data.select_for_candidates(state.base, np.array(kinds))
        elsewhere: dict[Candidate, _PlantedEffect] = {}
        if kinds[0]:
            # What is judged on rows at reversals has to help where joints move on, too.
            moving = state.data.select_for_candidates(state.base, np.array((False, kinds[1])))
            elsewhere = {planted.candidate: planted for planted in _list_planted(moving, final, members)}
        planted = [replace(each, moving=elsewhere.get(each.candidate)) for each in _list_planted(rows, final, members)]
        limits.update((each.candidate, _build_limit(pool, each, own)) for each, own in _find_thresholds(planted))
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
    """Errors of each draw without and with candidates.

    `gains` (c, d, s) of all joints in units of the noise; `drops`, squared errors `before` and `removed` (c, n, d).
    """

    gains: FloatArray
    drops: FloatArray
    before: FloatArray
    removed: FloatArray


def _compute_error_drops(sides: Sequence[_Comparison]) -> FloatArray:
    """Return (c, n, d): the shares of the error, averaged over the kinds of folds, that a candidate removes."""
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

    @cached_property
    def _signs(self) -> FloatArray:
        """Random signs (d, s) of the blocks, the same for every candidate."""
        return np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(_DRAWS, len(self.fitted_scores)))

    @cached_property
    def _misses(self) -> FloatArray:
        """By how much the parameters (d, k), fitted to all blocks, miss the planted ones in each draw."""
        inverse = np.linalg.pinv(self.fitted_squares.sum(axis=0), rcond=1e-8, hermitian=True)
        return np.asarray(self._signs @ self.fitted_scores @ inverse)

    def list_terms(self) -> list[tuple[FloatArray, ...]]:
        """Return, for each kind of folds, the terms of the squared errors without and with the candidate.

        Squares of what is left and of the torque of the usual size, (n + 1, 1, s), twice their product (n + 1, d, s),
        and the errors with the candidate (n + 1, d, s): by how much the fitted parameters miss the planted ones does
        not depend on these. Blocks come last, since they are what is summed over.
        """
        return [
            (
                kind.errors.T[:, None],
                (kind.squares @ self.direction @ self.direction).T[:, None],
                2.0 * self._signs * (kind.scores @ self.direction).T[:, None],
                self._fit_held_out(kind),
            )
            for kind in self.held_out
        ]

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
        return np.maximum(after, 0.0).transpose(2, 0, 1)

    def is_noticed(self, shares: FloatArray) -> BoolArray:
        """Return (d,): whether any parameter has a size that somebody would notice."""
        if not self.least_sizes.any():
            return np.ones(_DRAWS, dtype=bool)
        estimates = shares[:, None] * self.direction + self._misses
        return np.asarray(((np.abs(estimates) >= self.least_sizes) & (self.least_sizes > 0.0)).any(axis=1))

    def test_scores(self, shares: FloatArray) -> BoolArray:
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


@dataclass(frozen=True, eq=False)
class _Batch:
    """Effects (c) that are reported on equally many joints n, and judged at once.

    Parameters
    ----------
    planted : sequence of _PlantedEffect
        The effects.
    terms, moving_terms : list of tuple of (c, n + 1, ...)
        Their terms for each kind of folds; of the rows where joints move on, none where these are all rows.
    """

    planted: Sequence[_PlantedEffect]
    terms: list[tuple[FloatArray, ...]]
    moving_terms: list[tuple[FloatArray, ...]]

    @classmethod
    def from_planted(cls, planted: Sequence[_PlantedEffect]) -> _Batch:
        """Stack the terms of effects that are reported on equally many joints."""
        moving = [each.moving for each in planted if each.moving is not None]
        return cls(planted, _stack_terms(planted), _stack_terms(moving))

    def find_accepted(self, shares: FloatArray) -> BoolArray:
        """Return (c, d): in which draws effects of shares (c, d) of the usual size are accepted."""
        sides = [_compare(terms, shares) for terms in self.terms]
        t = compute_evenness(np.mean([side.gains for side in sides], axis=0))
        # The smaller of both kinds of folds, as in scoring; errors are averaged.
        drops = np.min([side.drops for side in sides], axis=0)
        removed = np.mean([side.removed for side in sides], axis=0)
        accepted = self._reduce_joints(_compute_error_drops(sides)) >= RULES.least_error_drop
        floor = np.maximum(np.array([each.floor for each in self.planted])[:, :, None], np.finfo(float).eps)
        own_drops, own_removed = self._reduce_joints(drops), self._reduce_joints(removed / floor)
        for k, each in enumerate(self.planted):
            least_drop = find_least_drops(each.separability, t[k])
            least_gain = get_least_gain(get_effect(each.candidate.effect))
            accepted[k] &= (t[k] >= each.levels.gains) | each.test_scores(shares[k])
            accepted[k] &= (t[k] >= each.least_t) & (own_drops[k] >= least_drop) & (own_removed[k] >= least_gain)
            accepted[k] &= each.is_noticed(shares[k])
        if self.moving_terms:
            moving = _compute_error_drops([_compare(terms, shares) for terms in self.moving_terms])
            accepted &= self._reduce_joints(moving) >= RULES.least_error_drop
        return accepted

    def find_thresholds(self) -> FloatArray:
        """Return (c, d): the smallest share of the usual size that each draw accepts; infinite where none is."""
        low, high = (np.full((len(self.planted), _DRAWS), math.log(end)) for end in (_SMALLEST, LARGEST))
        is_ever = self.find_accepted(np.exp(high))
        # All draws halve their own intervals at once.
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            accepted = self.find_accepted(np.exp(middle))
            low, high = np.where(accepted, low, middle), np.where(accepted, middle, high)
        return np.where(is_ever, np.exp(high), np.inf)

    def _reduce_joints(self, values: FloatArray) -> FloatArray:
        """Return what counts (c, d) of values by joint (c, n, d).

        What pulls at two joints has to help both; anything else the joint that it helps most.
        """
        pulls = np.array([get_effect(each.candidate.effect).pulls_on_each for each in self.planted])
        return np.asarray(np.where(pulls[:, None], values.min(axis=1), values.max(axis=1)))


def _stack_terms(planted: Sequence[_PlantedEffect]) -> list[tuple[FloatArray, ...]]:
    """Return the terms of several effects, stacked, for each kind of folds."""
    kinds = zip(*(each.list_terms() for each in planted), strict=True)
    return [tuple(np.stack(term) for term in zip(*kind, strict=True)) for kind in kinds]


def _compare(terms: tuple[FloatArray, ...], shares: FloatArray) -> _Comparison:
    """Compare the errors without and with effects of shares (c, d) of the usual size, in one kind of folds."""
    errors, along, cross, after = terms
    share = shares[:, None, :, None]
    before = errors + share**2 * along
    before += share * cross
    np.maximum(before, np.finfo(float).tiny, out=before)
    # As in scoring: no loss counts for more than there was, and no block for more than three usual ones.
    gain = np.maximum(before - after, -before)
    whole = before[:, -1]
    factor = np.minimum(whole, RULES.most_of_block * _compute_medians(whole)) / whole
    own_before, own_gain = before[:, :-1], gain[:, :-1]
    drops = (factor[:, None] * own_gain).sum(axis=3) / (factor[:, None] * own_before).sum(axis=3)
    return _Comparison(gain[:, -1] * factor, drops, own_before.sum(axis=3), own_gain.sum(axis=3))


def _compute_medians(values: FloatArray) -> FloatArray:
    """Return the medians (…, 1) of values (…, s); several times as fast as numpy's for a few values each."""
    middle = (values.shape[-1] - 1) // 2, values.shape[-1] // 2
    return np.asarray(np.partition(values, middle, axis=-1)[..., middle].mean(axis=-1, keepdims=True))


def _list_planted(rows: Products, final: FinalScores, members: Sequence[Candidate]) -> Iterator[_PlantedEffect]:
    """Yield what is needed to plant each of some candidates that are about the same rows."""
    state, pool = final.state, final.state.pool
    blocks = JointBlocks.from_products(rows, state.columns, members)
    fits = FoldedFits.from_blocks(rows, blocks, state.noise, KINDS)
    acts = [np.zeros((len(each.members), rows.n_joints), dtype=bool) for each in blocks.portions]
    for own, each in zip(acts, blocks.portions, strict=True):
        for own_acts, member in zip(own, each.members, strict=True):
            own_acts[list(pool.find_joints(members[member].columns))] = True
    fitted, *kinds = (_BlockSums.from_portions(blocks, acts) for _ in range(len(KINDS) + 1))
    # Where the motion hardly determines the model, what it leaves of a column is much larger on blocks that it has not
    # seen, and held-out errors show an effect by that.
    for j, sigma in enumerate(state.noise):
        for errors in fits.read_errors(j):
            for sums, own_errors in zip((fitted, *kinds), errors, strict=True):
                sums.add_joint(j, own_errors, 1.0 / sigma**2)
    folds = [tuple(split_data_folds(rows, kind)) for kind in KINDS]
    counts = rows.counts.sum(axis=0)
    for number, portion in enumerate(blocks.portions):
        unit, separability = fits.fits.compute_unit_directions(number), fits.fits.compute_separability(number)
        for place, (member, columns) in enumerate(zip(portion.members, portion.columns, strict=True)):
            candidate = members[member]
            usual, _ = _get_usual(pool, candidate)
            joints = np.flatnonzero(acts[number][place])
            if len(candidate.joints) == 1 and not get_effect(candidate.effect).pulls_on_each:
                # An effect of one joint that acts on others too: the joint that it moves most, in units of the noise.
                moved = [
                    np.einsum("skk->", fitted.squares[number, place, int(j)]) / state.noise[j] ** 2 for j in joints
                ]
                joints = joints[[int(np.argmax(moved))]]
            yield _PlantedEffect(
                candidate,
                np.array([usual.get(pool.observation.columns[k].parameter, 0.0) for k in candidate.columns]),
                _list_least_sizes(pool, candidate),
                tuple(k.take_candidate(number, place, columns, joints, f) for k, f in zip(kinds, folds, strict=True)),
                fitted.squares[number, place, _ALL],
                fitted.scores[-1][:, columns],
                np.maximum(counts[joints] * state.floor[joints] ** 2, np.finfo(float).tiny),
                unit[place],
                float(separability[place]),
                final.levels,
                max(compute_least_t(rows.n_blocks, state.level), RULES.sure_t),
            )


@dataclass(frozen=True, eq=False)
class _BlockSums:
    """Products of all candidates beside one kind of fits, by block; behind the joints all together, in units of noise.

    ρᵀρ (n + 1, s), Zᵀρ (n + 1, s, c), and ZᵀZ (s, k, k) by portion, place in it, and joint: those that the candidate
    acts on (g, n), and all together, which are parts of one array a portion.
    """

    errors: FloatArray
    scores: FloatArray
    squares: dict[tuple[int, int, int], FloatArray]
    acts: Sequence[BoolArray]
    together: Sequence[FloatArray]

    @classmethod
    def from_portions(cls, blocks: JointBlocks, acts: Sequence[BoolArray]) -> _BlockSums:
        """Return zeros for candidates that act on some joints (g, n), by portion."""
        s, joints = blocks.n_blocks, len(blocks.joints) + 1
        together = [np.zeros((len(own.members), s, own.width, own.width)) for own in blocks.portions]
        squares: dict[tuple[int, int, int], FloatArray] = {}
        for number, (own, whole) in enumerate(zip(acts, together, strict=True)):
            squares |= {(number, place, j): np.zeros_like(whole[0]) for place, j in np.argwhere(own).tolist()}
            squares |= {(number, place, _ALL): mine for place, mine in enumerate(whole)}
        return cls(np.zeros((joints, s)), np.zeros((joints, s, blocks.n_extra)), squares, acts, together)

    def add_joint(self, joint: int, errors: JointErrors, weight: float) -> None:
        """Add what some of a joint's rows have."""
        for sums, own in ((self.errors, errors.alone), (self.scores, errors.compute_scores())):
            sums[joint] += own
            sums[_ALL] += weight * own
        for number, products in enumerate(errors.compute_squares()):
            self.together[number][:] += weight * products
            for place in np.flatnonzero(self.acts[number][:, joint]).tolist():
                self.squares[number, place, joint][:] += products[place]

    def take_candidate(
        self, number: int, place: int, columns: IndexArray, joints: IndexArray, folds: tuple[IndexArray, ...]
    ) -> _HeldOut:
        """Take one candidate of a portion, on some joints and on all together."""
        index = [*joints.tolist(), _ALL]
        squares = np.stack([self.squares[number, place, j] for j in index], axis=1)
        scores = self.scores[index][:, :, columns].transpose(1, 0, 2)
        return _HeldOut(squares, scores, self.errors[index].T, folds)


def _find_thresholds(planted: Sequence[_PlantedEffect]) -> Iterator[tuple[_PlantedEffect, FloatArray]]:
    """Yield effects with the smallest share (d,) of the usual size that each draw accepts."""
    alike: dict[int, list[_PlantedEffect]] = {}
    for each in planted:
        if each.separability < RULES.least_separability:
            yield each, np.full(_DRAWS, np.inf)
        else:
            alike.setdefault(len(each.floor), []).append(each)
    for several in alike.values():
        for first in range(0, len(several), _TOGETHER):
            batch = several[first : first + _TOGETHER]
            yield from zip(batch, _Batch.from_planted(batch).find_thresholds(), strict=True)


def _build_limit(pool: Pool, planted: _PlantedEffect, thresholds: FloatArray) -> DetectionLimit:
    candidate, main = planted.candidate, int(np.argmax(np.abs(planted.direction)))
    column = pool.observation.columns[candidate.columns[main]]
    usual = abs(float(planted.direction[main]))
    thresholds = np.sort(thresholds)
    sure, half = (float(thresholds[math.ceil(power * _DRAWS) - 1]) for power in (SURE, HALF))
    return DetectionLimit(
        candidate.effect, candidate.joints, column.name, column.unit, sure * usual, half * usual, usual, candidate.shape
    )


def _list_least_sizes(pool: Pool, candidate: Candidate) -> FloatArray:
    """Return the size (k,) of each parameter below which nobody would notice it, by its specification; 0: none."""
    specs = {spec.name: spec.least for spec in get_effect(candidate.effect).parameters}
    return np.array([specs.get(pool.observation.columns[k].parameter, 0.0) for k in candidate.columns])
