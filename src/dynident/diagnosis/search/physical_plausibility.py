"""Test whether the fitted values of a candidate are physically possible: signs, and friction that takes energy.

What each effect allows is stated in effects/effect.py.

Friction takes energy, a mass or a compliance is above zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import Pool
from dynident.diagnosis.candidates.held_out_scores import compute_deviations
from dynident.diagnosis.candidates.products_of_scored_pairs import find_present
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search.search_state import State
from dynident.effects import Column, Estimate, get_effect, get_spec


def is_physically_possible(state: State, scored: ScoredCandidate) -> bool:
    """Return whether a candidate beside a model is physically possible with the amplitudes that the data ask for."""
    return find_impossibility(state, scored) is None


def find_impossibility(state: State, scored: ScoredCandidate) -> Reason | None:
    """Return what makes a candidate beside a model physically impossible; None where nothing does."""
    rows = state.data.select_for_model(state.base + scored.candidate.columns)
    # Several steps of a round ask for the same candidate beside the same model.
    key = "impossibility", state.base, state.noise.tobytes(), scored.candidate
    return rows.find_cached(key, lambda: _find_impossibility(rows, state, scored))


def find_impossible_parameter(state: State, scored: ScoredCandidate) -> tuple[Reason, tuple[str, ...]] | None:
    """Return which parameter of a candidate itself is physically impossible, and the joints on which one is."""
    rows = state.data.select_for_model(state.base + scored.candidate.columns)
    fit = _fit_columns(rows, state.base, scored.candidate.columns, state.noise)
    reason = _check_parameters(rows, state, scored, fit)
    if reason is None:
        return None
    effect, choice = get_effect(scored.candidate.effect), scored.candidate.choice
    own = _build_estimates(*fit)[len(state.base) :]
    joints = tuple(
        link
        for link, known in _group_by_link(state.pool, scored, own)
        if link in choice.joints and not effect.is_plausible(known, choice.shape_values)
    )
    return reason, joints if joints and not state.pool.is_change(scored.candidate) else choice.joints


def _find_impossibility(rows: Products, state: State, scored: ScoredCandidate) -> Reason | None:
    values, doubts = _fit_columns(rows, state.base, scored.candidate.columns, state.noise)
    is_friction = get_effect(scored.candidate.effect).is_friction
    wrong = _find_wrong_friction(state, _build_estimates(values, doubts), scored) if is_friction else None
    if wrong is not None:
        return _build_impossible(*wrong)
    return _check_parameters(rows, state, scored, (values, doubts))


def _check_parameters(
    rows: Products, state: State, scored: ScoredCandidate, fit: tuple[FloatArray, FloatArray]
) -> Reason | None:
    """Return which of a candidate's own parameters is impossible, from values and doubts of the whole fit."""
    values, doubts = (each[len(state.base) :] for each in fit)
    effect, pool = get_effect(scored.candidate.effect), state.pool
    if pool.is_change(scored.candidate):
        # Filtered rows of two days differ more than those of one: what they tell of a difference says its own doubt.
        own = _build_estimates(values, compute_deviations(rows, state.columns, [scored.candidate], state.noise)[0])
        is_possible = _is_possible_change(state, scored, own)
    else:
        own, shape = _build_estimates(values, doubts), scored.candidate.choice.shape_values
        is_possible = all(effect.is_plausible(known, shape) for _, known in _group_by_link(pool, scored, own))
    pairs = [(pool.observation.columns[k], estimate) for k, estimate in zip(scored.candidate.columns, own, strict=True)]
    for column, estimate in pairs:
        # Feet that would slide say of a joint's zero position what torques can only guess.
        most = pool.largest.get((effect.id, column.link), np.inf)
        if abs(estimate.value) > most + estimate.doubt:
            return _build_impossible(column, estimate, f"larger than standing feet allow ({most:.3g} {column.unit})")
    if is_possible:
        return None
    # The parameter that is most clearly impossible, or where each is possible by itself the largest, stands for all.
    return _build_impossible(*max(pairs, key=lambda pair: (not _is_admitted(*pair), abs(pair[1].value))))


def _is_admitted(column: Column, estimate: Estimate) -> bool:
    spec = get_spec(column)
    return spec is None or spec.admits(estimate)


def _build_impossible(column: Column, estimate: Estimate, why: str = "") -> Reason:
    """Return the reason that a parameter has a sign or size that nature does not allow, or the recordings (`why`)."""
    spec = get_spec(column)
    violates = "not consistent with its other parameters"
    # A parameter that is the only one of its effect is consistent with the others: only its sign can be wrong.
    is_alone = bool(column.effect) and len(get_effect(column.effect).parameters) == 1
    if spec is not None and (spec.positive or is_alone) and estimate.value < 0.0:
        violates = "below zero"
    elif spec is not None and abs(estimate.value) > spec.most:
        violates = f"larger than occurs ({spec.most:.3g} {column.unit})"
    elif spec is not None and abs(estimate.value) < spec.least:
        violates = f"too small to notice ({spec.least:.3g} {column.unit})"
    return Reason.build(
        "impossible", parameter=column.name, value=estimate.value, unit=column.unit, violates=why or violates
    )


def _build_estimates(values: FloatArray, deviations: FloatArray) -> list[Estimate]:
    return [
        Estimate(float(value), float(RULES.clear_t * deviation))
        for value, deviation in zip(values, deviations, strict=True)
    ]


def _group_by_link(
    pool: Pool, scored: ScoredCandidate, own: Sequence[Estimate]
) -> Iterable[tuple[str, Mapping[str, Estimate]]]:
    """Return a candidate's parameters by name, on each joint that it acts on."""
    by_link: dict[str, dict[str, Estimate]] = {}
    for k, estimate in zip(scored.candidate.columns, own, strict=True):
        # An effect on several joints has to be possible on each of them.
        column = pool.observation.columns[k]
        by_link.setdefault(column.link, {})[column.parameter] = estimate
    return by_link.items()


def _is_possible_change(state: State, scored: ScoredCandidate, own: Sequence[Estimate]) -> bool:
    """Return whether the later days may differ in this way: by less, too, where there is something to lose.

    Friction wears in, a mass is taken off; what the other days do not have can only be added.
    """
    effect = get_effect(scored.candidate.effect)
    columns = [state.pool.observation.columns[k] for k in state.base]
    # Where the model has the effect on all days, the later days may have less of it.
    had = {column.link for column in columns if column.effect == effect.id}
    return all(
        effect.is_plausible_change(known)
        and (link in had or effect.is_plausible(known, scored.candidate.choice.shape_values))
        for link, known in _group_by_link(state.pool, scored, own)
    )


def _find_wrong_friction(
    state: State, estimates: Sequence[Estimate], scored: ScoredCandidate
) -> tuple[Column, Estimate] | None:
    """Return friction of the model on a candidate's joints that would have the wrong sign beside it.

    A large power of the velocity less a large multiple of the velocity fits a bend, and says nothing of other speeds.
    """
    observation = state.pool.observation
    joints = {observation.robot.joint_names[j] for j in scored.joints}
    for k, estimate in zip(state.base, estimates, strict=False):
        column = observation.columns[k]
        effect = get_effect(column.effect)
        if effect.is_friction and column.link in joints:
            spec = get_spec(column)
            if spec is not None and not spec.admits(estimate):
                return column, estimate
    return None


def _fit_columns(
    data: Products, base: tuple[int, ...], own: tuple[int, ...], noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters (k,) of a model and a candidate, fitted to all blocks, and their standard deviations (k,).

    The model's own equations are the same beside every candidate: they are inverted once, and by blocks with it. Of
    parameters that the data do not determine these are the smallest, with the pseudo-inverse: no check of signs takes
    offence at zero.
    """
    model = data.find_cached(("model", base, noise.tobytes()), lambda: _ModelFit.from_products(data, base, noise))
    mixed, squares, right = _sum_products(data, base, own, noise)
    scale = _take_sizes(squares)
    mixed, squares, right = mixed / np.outer(model.scale, scale), squares / np.outer(scale, scale), right / scale
    known = model.root @ mixed
    rest = model.root.T @ known
    # What is left of a direction d of the candidate is measured against the whole change of parameters, (-rest d, d):
    # where nearly equal columns of the model make that large, rounding alone leaves something of a direction that they
    # span.
    sizes, directions, failed = lapack.dsygvd(squares - known.T @ known, np.eye(len(own)) + rest.T @ rest)
    if failed:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")
    is_determined = sizes >= model.least
    inverse = (directions[:, is_determined] / sizes[is_determined]) @ directions[:, is_determined].T
    values = inverse @ (right - mixed.T @ model.values)
    values = np.concatenate([model.values - rest @ values, values])
    variances = (model.root**2).sum(axis=0) + np.einsum("bk,kl,bl->b", rest, inverse, rest)
    variances = np.concatenate([variances, np.diag(inverse)])
    if not is_determined.all():
        # What the candidate and the model can say alike, in orthonormal directions (b + k, r), is taken out of the
        # solution, and of the inverse from both sides.
        of_own = directions[:, ~is_determined]
        of_model = -rest @ of_own
        alike = np.concatenate([of_model, of_own])
        shared = inverse @ (of_own - rest.T @ of_model)
        shared = np.concatenate([model.root.T @ (model.root @ of_model) - rest @ shared, shared])
        values -= alike @ (alike.T @ values)
        variances += (alike * (alike @ (alike.T @ shared) - 2.0 * shared)).sum(axis=1)
    units = np.concatenate([model.scale, scale])
    return values / units, np.sqrt(RULES.rows_of_filter * np.maximum(variances, 0.0)) / units


def _take_sizes(squares: FloatArray) -> FloatArray:
    """Return the norms (k,) of columns from their products (k, k)."""
    return np.asarray(np.sqrt(np.maximum(np.diag(squares), np.finfo(float).tiny)))


_RANK = 1e-10
"""Share of the largest eigenvalue of the model's equations, with unit columns, from which on they are determined."""


@dataclass(frozen=True, eq=False)
class _ModelFit:
    """The model's own equations with unit columns, inverted.

    Parameters
    ----------
    root : (r, b)
        Root of the inverse, rootᵀ root: products with the inverse itself lose twice as many digits.
    values : (b,)
        Parameters.
    scale : (b,)
        The columns' sizes.
    least : float
        Least eigenvalue from which on equations are determined.
    """

    root: FloatArray
    values: FloatArray
    scale: FloatArray
    least: float

    @classmethod
    def from_products(cls, data: Products, base: tuple[int, ...], noise: FloatArray) -> _ModelFit:
        _, normal, right = _sum_products(data, base, base, noise)
        scale = _take_sizes(normal)
        sizes, directions = np.linalg.eigh(normal / np.outer(scale, scale))
        least = _RANK * float(sizes.max(initial=1.0))
        root = (directions / np.sqrt(np.maximum(sizes, least))).T[sizes >= least]
        return cls(root, root.T @ (root @ (right / scale)), scale, least)


def _sum_products(
    data: Products, base: tuple[int, ...], own: tuple[int, ...], noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the products of `base` and `own` (b, k), of `own` (k, k), and of `own` with the torque (k,)."""
    b, k = len(base), len(own)
    mixed, squares, right = np.zeros((b, k)), np.zeros((k, k)), np.zeros(k)
    columns, own_columns = np.array(base, dtype=np.intp), np.array(own, dtype=np.intp)
    for joint, (where, sigma) in enumerate(zip(data.position, noise, strict=True)):
        have, places = find_present(where, own_columns)
        if not len(have):
            continue
        known, known_places = find_present(where, columns)
        # Y stands last.
        total = data.sum_products(joint, np.append(known_places, -1), places) / sigma**2
        mixed[known[:, None], have] += total[:-1]
        squares[have[:, None], have] += data.sum_own_products(joint, places) / sigma**2
        right[have] += total[-1]
    if data.known is not None:
        more, more_right = data.known.compute_products(own_columns, np.diag(squares))
        squares, right = squares + more, right + more_right
    return mixed, squares, right
