"""The search for what is missing: add the best effect that passes the gate, until none does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.diagnosis.candidates import Candidate, Pool
from dynident.diagnosis.gate import (
    SMALLEST_DROP_OF_STICKING,
    SMALLEST_GAIN_AT_REVERSALS,
    SMALLEST_GAIN_OVER_NOISE,
    Judged,
    judge,
    p_value,
    simplest,
)
from dynident.diagnosis.plausible import plausible
from dynident.diagnosis.products import Products
from dynident.diagnosis.scoring import held_out_errors, score_candidates
from dynident.diagnosis.stability import consistencies
from dynident.diagnosis.transients import CONTACT
from dynident.diagnosis.words import Finding
from dynident.effects import Effect, effect_by_id
from dynident.progress import Progress
from dynident.robot.model import FloatArray

_KINDS = ("interleaved", "contiguous")
VISIBLE = 0.02
_PRUNE_DROP, _PRUNE_T = 0.03, 2.5
# What each joint of a group needs for itself.
_JOINT_DROP, _JOINT_T, _JOINT_DROP_OF_STICKING = 0.03, 2.0, 0.2
# So many other names for a finding, and its cause is not certain.
_TOO_MANY_NAMES, _DROP_IN_DOUBT = 2, 0.3
_WORTH_A_LOOK = 0.02
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class State:
    """The search so far: the model's columns, the residual (n,) they leave, sensor noise (n,), what was picked."""

    base: tuple[int, ...]
    noise: FloatArray
    floor: FloatArray
    picks: tuple[Finding, ...]


def judge_all(
    data: Products, pool: Pool, base: tuple[int, ...], candidates: Sequence[Candidate], noise: FloatArray
) -> list[Judged]:
    """Judge every candidate beside the model whose columns are `base`, in both kinds of folds."""
    columns = np.array(base, dtype=np.intp)
    scores = [score_candidates(data, columns, candidates, noise, kind)[1] for kind in _KINDS]
    acting = acted_on(pool)
    judged = [
        judge(pair, _joints(acting, candidate), noise) for candidate, *pair in zip(candidates, *scores, strict=True)
    ]
    # Agreement between stretches costs as much again and matters to those alone that gain something.
    worth = [k for k, item in enumerate(judged) if item.drop >= _WORTH_A_LOOK]
    agreement = consistencies(data, columns, [judged[k].candidate for k in worth], noise)
    for k, value in zip(worth, agreement, strict=True):
        judged[k] = replace(judged[k], consistency=float(value))
    return judged


def acted_on(pool: Pool) -> BoolArray:
    """(columns, joints): whose torque every column contributes to."""
    acts = np.zeros((pool.observation.n_columns, pool.observation.robot.n), dtype=bool)
    acts[pool.observation.entry_columns, pool.observation.entry_rows] = True
    return acts


def _joints(acting: BoolArray, candidate: Candidate) -> tuple[int, ...]:
    return tuple(int(j) for j in np.flatnonzero(acting[list(candidate.columns)].any(axis=0)))


Relearn = Callable[[Sequence[Finding]], Products]
"""Products of the same columns, with the torque predicted by the model with these findings in it."""


def search(
    data: Products, pool: Pool, state: State, first: list[Judged], most: int, relearn: Relearn, progress: Progress
) -> tuple[Finding, ...]:
    """Add the best effect that passes the gate, again and again, until none does; then drop what became superfluous.

    After an effect that is a first-order sensitivity all columns are made anew: those of the plain model are about
    torque that it predicted wrongly for want of this effect, and what they leave would be taken for something else.
    """
    judged = first
    remaining = [item.candidate for item in first]
    while len(state.picks) < most:
        progress(len(state.picks) / most, f"{len(state.picks)} effects found, {len(remaining)} candidates")
        choice = _choose(data, pool, state, judged)
        if choice is None:
            break
        chosen, equal = choice
        chosen = _without_idle_joints(data, pool, state, chosen)
        finding = Finding(chosen, equal, p_value(chosen, len(remaining)), _around(pool, chosen.candidate, state.base))
        base = state.base + finding.columns
        if effect_by_id(chosen.candidate.effect).first_order:
            data = relearn((*state.picks, finding))
        state = State(base, noise_left(data, base), state.floor, (*state.picks, finding))
        reached = [pool.observation.robot.joint_names[j] for j in chosen.joints]
        remaining = [c for c in remaining if not _superseded(c, chosen.candidate, reached)]
        if not remaining:
            break
        judged = judge_all(data, pool, state.base, remaining, state.noise)
    return pruned(data, pool, state).picks


def noise_left(data: Products, base: tuple[int, ...]) -> FloatArray:
    """(n,): held-out residual of every joint for the model so far."""
    columns = np.array(base, dtype=np.intp)
    squares = held_out_errors(data, columns, np.ones(data.n_joints), "interleaved").sum(axis=0)
    sigma = np.sqrt(squares / data.counts.sum())
    return np.asarray(np.maximum(sigma, 1e-9 * max(float(sigma.max()), 1e-12)))


def _superseded(candidate: Candidate, chosen: Candidate, reached: Sequence[str]) -> bool:
    """Whether a candidate is the chosen one in other words: the same family on a joint that it already has.

    `reached` are the joints that the chosen one acts on.
    """
    if candidate.columns == chosen.columns:
        return True
    if candidate.effect in effect_by_id(chosen.effect).covers:
        return set(candidate.joints) <= set(reached)
    if candidate.effect != chosen.effect:
        return False
    if effect_by_id(candidate.effect).proposal != "grid":
        same = candidate.joints == chosen.joints and candidate.shape == chosen.shape
        return same and (not chosen.runs or candidate.runs == chosen.runs)
    return not candidate.joints or bool(set(candidate.joints) & set(chosen.joints))


def _choose(
    data: Products, pool: Pool, state: State, judged: Sequence[Judged]
) -> tuple[Judged, tuple[Judged, ...]] | None:
    """The next effect to add and its equals on this data; None where nothing passes."""
    passing = [item for item in judged if _acceptable(state, data.counts, item, len(judged))]
    while passing:
        chosen, equal = simplest(passing)
        names = {item.candidate.effect for item in equal} - {chosen.candidate.effect}
        certain = len(names) < _TOO_MANY_NAMES or (chosen.passes_by_t and chosen.drop >= _DROP_IN_DOUBT)
        if certain and plausible(data, pool, state.base, state.noise, chosen):
            return chosen, equal
        passing = [item for item in passing if item is not chosen]
    return None


def _acceptable(state: State, counts: FloatArray, item: Judged, n_tried: int) -> bool:
    effect = effect_by_id(item.candidate.effect)
    if item.separability < VISIBLE or not item.passes(effect.scope == "robot", n_tried):
        return False
    resolved = [spec for spec in effect.shapes if spec.resolved_by is not None]
    if max(_gain_over_floor(item, j, state.floor, counts) for j in item.joints) < _least_gain(effect):
        return False
    beside = {
        f.judged.candidate.effect for f in state.picks if set(f.judged.candidate.joints) & set(item.candidate.joints)
    }
    if resolved and beside & set(effect.confused_with) and item.total_drop < SMALLEST_DROP_OF_STICKING:
        return False
    return not hardly_resolved(item.candidate) or item.total_drop >= SMALLEST_DROP_OF_STICKING


def _around(pool: Pool, chosen: Candidate, base: tuple[int, ...]) -> tuple[int, ...]:
    """Columns of the nearest other shape constants, one constant changed at a time."""
    specs = [spec.name for spec in effect_by_id(chosen.effect).shapes if spec.refined is not None]
    mine = dict(chosen.shape)
    kin = [c for c in pool.candidates if c.effect == chosen.effect and set(chosen.joints) <= set(c.joints)]
    found: list[int] = []
    for name in specs:
        rest = {key: value for key, value in mine.items() if key != name}
        others = [(dict(c.shape)[name], c) for c in kin if {k: v for k, v in c.shape if k != name} == rest]
        above = min((value for value, _ in others if value > mine[name]), default=None)
        below = max((value for value, _ in others if value < mine[name]), default=None)
        near = [c for value, c in others if value in (above, below)]
        found += [k for neighbour in near for k in neighbour.columns if _on(pool, k, chosen)]
    return tuple(k for k in dict.fromkeys(found) if k not in base and k not in chosen.columns)


def _on(pool: Pool, column: int, candidate: Candidate) -> bool:
    return not candidate.joints or pool.observation.columns[column].link in candidate.joints


def hardly_resolved(candidate: Candidate) -> bool:
    """Whether a slip distance is so small that a joint which sticks for a moment would look like it."""
    specs = effect_by_id(candidate.effect).shapes
    return any(
        spec.least > 0 and dict(candidate.shape)[spec.name] < 2 * spec.least for spec in specs if spec.resolved_by
    )


def _least_drop(candidate: Candidate) -> float:
    """Share of its own error that a joint of a group has to gain."""
    return _JOINT_DROP_OF_STICKING if hardly_resolved(candidate) else _JOINT_DROP


def _least_gain(effect: Effect) -> float:
    """Share of the sensor noise's power that an effect has to remove."""
    at_reversals = any(spec.resolved_by is not None for spec in effect.shapes)
    return SMALLEST_GAIN_AT_REVERSALS if at_reversals else SMALLEST_GAIN_OVER_NOISE


def _gain_over_floor(item: Judged, joint: int, floor: FloatArray, counts: FloatArray) -> float:
    """Squared error that a candidate removes on a joint, over that of the sensor's noise."""
    removed = float((item.before - item.after)[:, joint].sum() / counts.sum())
    return removed / max(float(floor[joint]) ** 2, np.finfo(float).tiny)


def _without_idle_joints(data: Products, pool: Pool, state: State, chosen: Judged) -> Judged:
    """Take joints out of a group that gain nothing from it."""
    if len(chosen.candidate.joints) < 2:
        return chosen
    effect = effect_by_id(chosen.candidate.effect)
    keep = []
    for name in chosen.candidate.joints:
        j = pool.observation.robot.joint_names.index(name)
        gain = (chosen.before[:, j] - chosen.after[:, j]) / state.noise[j] ** 2
        spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
        share = float(gain.sum()) / max(float((chosen.before[:, j] / state.noise[j] ** 2).sum()), 1e-300)
        large = _gain_over_floor(chosen, j, state.floor, data.counts) >= _least_gain(effect)
        if share >= _least_drop(chosen.candidate) and gain.mean() >= _JOINT_T * spread and large:
            keep.append(name)
    if not keep or len(keep) == len(chosen.candidate.joints):
        return chosen
    columns = tuple(k for k in chosen.candidate.columns if pool.observation.columns[k].link in keep)
    smaller = Candidate(effect.id, tuple(keep), chosen.candidate.shape, columns, chosen.candidate.runs)
    return judge_all(data, pool, state.base, [smaller], state.noise)[0]


def pruned(data: Products, pool: Pool, state: State) -> State:
    """The search without the picks that others have made superfluous, the weakest taken out first."""
    while len(state.picks) > 1:
        judged = [(_again(data, pool, state, finding), finding) for finding in state.picks if _can_be_held_out(finding)]
        weak = [(item, finding) for item, finding in judged if not item.lasts(_PRUNE_DROP, _PRUNE_T)]
        if not weak:
            break
        _, superfluous = min(weak, key=lambda pair: pair[0].total_gain)
        state = replace(
            state,
            picks=tuple(finding for finding in state.picks if finding is not superfluous),
            base=tuple(k for k in state.base if k not in superfluous.columns),
        )
    return state


def _can_be_held_out(finding: Finding) -> bool:
    """Whether stretches that an effect shows in can be left out: a contact happened once."""
    return finding.judged.candidate.effect != CONTACT


def _again(data: Products, pool: Pool, state: State, finding: Finding) -> Judged:
    """A pick, judged beside all others."""
    base = tuple(k for k in state.base if k not in finding.columns)
    return judge_all(data, pool, base, [finding.judged.candidate], state.noise)[0]


def trimmed(data: Products, pool: Pool, state: State) -> list[tuple[str, ...]]:
    """The joints of every pick that still gain from it, each beside all the rest; one of a group at least."""
    base = state.base
    joints = []
    for finding in state.picks:
        candidate = finding.judged.candidate
        kept, gains = list(candidate.joints), {}
        for joint in candidate.joints if len(candidate.joints) > 1 else ():
            own = tuple(k for k in candidate.columns if pool.observation.columns[k].link == joint)
            alone = Candidate(candidate.effect, (joint,), candidate.shape, own, candidate.runs)
            rest = tuple(k for k in base if k not in own)
            item = judge_all(data, pool, rest, [alone], state.noise)[0]
            gains[joint] = item.total_gain
            j = pool.observation.robot.joint_names.index(joint)
            large = _gain_over_floor(item, j, state.floor, data.counts) >= _least_gain(effect_by_id(candidate.effect))
            if not (item.lasts(_least_drop(candidate), _JOINT_T) and large):
                kept.remove(joint)
                base = rest
        best = max(gains, key=lambda name: gains[name], default="")
        joints.append(tuple(kept) or ((best,) if best else ()))
    return joints
