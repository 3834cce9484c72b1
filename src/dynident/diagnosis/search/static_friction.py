"""Find static friction above Coulomb friction by the torque that holds joints during halts.

Holds how much a halt must hold beyond the model, over noise and by chance.

A peak of friction that is narrower than the filter hardly shows where a joint moves. But a joint at rest is held by
all of it, and its equations at rest are no part of the fit: what the moving joint's model cannot hold is seen there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import special

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import build_pool_of_choices
from dynident.diagnosis.candidates.significance import ALPHA, ScoredCandidate, compute_single_p
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search.pruning import select_harmless
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all
from dynident.effects import CATALOGUE, Effect, EffectChoice
from dynident.errors import DynidentError
from dynident.estimation.residual_errors import compute_evenness
from dynident.identification import Identification, extend
from dynident.number_format import format_percent
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot

# `benchmarks/held_at_rest.py` calibrates the first five.

_MUCH = 0.2
"""Share of what the model's friction holds that a halt has to hold beyond it."""

_OVER_NOISE = 3.0
"""And times the residual where the joint moves. What moves beside a halt leaves 0.15 and 2.3 times in the median."""

_USUAL = 0.4
"""Share of the halts of a joint without static friction above its Coulomb friction that hold so much more, at most: it
is more on one such joint in twenty."""

_ALIKE = 0.5
"""Half of the halts lie at most so far apart, over the middle one: a joint breaks away at the same torque each time, a
brake holds whatever there is."""

_ALONG = 0.9
"""Or in so many of them the torque is largest towards the motion beside it, as friction has it: where a filter smears
halts of unequal length, what it leaves of the same torque is not alike. A brake holds towards either side."""

_LIKE = 2.0
"""Times what is held, or its part, that the friction is at its width: between widths it is interpolated."""

_LEFT = 0.5
"""Share of what is held beyond the friction that may be left once the effect is in the model."""

_HALF_OCTAVES = 6
"""So many below the grid: a peak an eighth as wide as its narrowest leaves nothing where a joint moves."""

_WORTH_A_LOOK = 0.05
"""How likely the halts may be by chance, one joint alone, for what moves to be asked as well."""


@dataclass(frozen=True, eq=False)
class Halts:
    """The halts of one joint.

    Parameters
    ----------
    beyond : (h,)
        Most that each halt holds beyond the model's friction, N m or N.
    friction : (h,)
        What the model's friction holds.
    squares : (h,)
        Sum of the squares of what is held beyond it.
    measured : (h,)
        Sum of the squared torque.
    along : (h,)
        1 where the most is held towards the joint's motion at that end of the halt, else 0.
    """

    beyond: FloatArray
    friction: FloatArray
    squares: FloatArray
    measured: FloatArray
    along: FloatArray

    @property
    def share(self) -> FloatArray:
        """What is held beyond the friction, over the friction (h,)."""
        return self.beyond / np.maximum(self.friction, np.finfo(float).tiny)

    @property
    def are_alike(self) -> bool:
        """Whether what is held is about the same in most halts."""
        low, middle, high = np.quantile(self.beyond, (0.25, 0.5, 0.75))
        return bool(high - low <= _ALIKE * middle)

    @property
    def are_along_the_motion(self) -> bool:
        """Whether nearly all are held towards the motion beside them, and more than a brake's would be by chance."""
        number = int(self.along.sum())
        return number >= _ALONG * len(self.along) and bool(special.bdtrc(number - 1, len(self.along), 0.5) <= ALPHA)

    @property
    def look_like_friction(self) -> bool:
        """Whether they are alike or along the motion, which what a brake holds is not."""
        return self.are_alike or self.are_along_the_motion

    def count_large(self, noise: float) -> int:
        """Return the number of halts that hold much more than the model's friction, and than its residual."""
        much = (self.share >= _MUCH) & (self.beyond >= _OVER_NOISE * noise) & (self.friction > noise)
        return int(much.sum())

    def compute_p(self, noise: float) -> float:
        """Return how likely as many halts are where static friction is not above Coulomb friction."""
        return float(special.bdtrc(self.count_large(noise) - 1, len(self.beyond), _USUAL)) if len(self.beyond) else 1.0


def find_halts(comparisons: Sequence[Comparison], joint: int) -> Halts:
    """Find the halts of a joint in the comparisons of one model."""
    halts: list[tuple[float, ...]] = []
    for comparison in comparisons:
        standing = comparison.phase[:, joint] == Phase.STANDING
        broken = np.concatenate([[True], np.diff(comparison.segment) != 0, [True]])
        edge = np.diff(np.concatenate([[False], standing, [False]]).astype(int))
        # A segment's border ends a halt even where the joint stands on both sides of it.
        starts = np.flatnonzero(standing & ((edge[:-1] == 1) | broken[:-1]))
        ends = np.flatnonzero(standing & ((edge[1:] == -1) | broken[1:])) + 1
        # Half of the band is what the model's friction holds in either direction.
        rest, hold = comparison.residual[:, joint], 0.5 * (comparison.upper - comparison.lower)[:, joint]
        for a, b in zip(starts, ends, strict=True):
            most = int(a + np.abs(rest[a:b]).argmax())
            # The rows beside a halt move; at either end of a run there are none.
            after = broken[a] or (b - most <= most - a and not broken[b])
            moving_row = min(int(b), len(rest) - 1) if after else int(a) - 1
            along = rest[most] * comparison.dq[moving_row, joint] > 0.0
            measured = (comparison.measured[a:b, joint] ** 2).sum()
            halts.append((abs(rest[most]), hold[a:b].mean(), (rest[a:b] ** 2).sum(), measured, along))
    return Halts(*np.array(halts, dtype=float).reshape(-1, 5).T)


def find_static_friction(
    grown: Identification,
    recordings: Sequence[Recording],
    final: Sequence[Comparison],
    asked: Sequence[str] | None,
    level: float = ALPHA,
) -> tuple[Identification, list[Comparison], tuple[Finding, ...]]:
    """Add the static friction that the halts ask for to a model.

    An effect is found where the friction at low speed that the moving rows ask for is what holds the joint at rest,
    takes most of what was held beyond the model's friction, and makes nothing worse where the joint moves.

    Parameters
    ----------
    grown : Identification
        The model with all that is recommended.
    final : sequence of Comparison
        Its comparisons with the recordings.
    asked : sequence of str or None
        Ids of the effects that may be found; None for all.
    recordings : sequence of Recording
        Recordings that the search learns from.
    level : float
        Largest p-value of a finding.

    Returns
    -------
    tuple of Identification, list of Comparison, tuple of Finding
        The model with static friction, its comparisons, and what was found.
    """
    final, findings = list(final), []
    names = final[0].joint_names
    # The model's rows are the same for all joints.
    inputs = RegressorInputs(recordings, grown.preprocessing, grown.estimate.next_reference(), kept_rows={})
    for joint in range(len(names)):
        halts = find_halts(final, joint)
        noise = float(final[0].noise[joint])
        if halts.compute_p(noise) > _WORTH_A_LOOK or not halts.look_like_friction:
            continue
        candidate = _find_best_friction(grown, inputs, joint, halts, asked)
        if candidate is None:
            continue
        # Bonferroni over the joints.
        p = min(1.0, len(names) * _combine_p_values(halts.compute_p(noise), candidate.p))
        if p > level:
            continue
        try:
            larger = extend(grown, [candidate.candidate.choice], recordings)
        except DynidentError:
            continue
        after = [compare(larger, recording) for recording in recordings]
        held = find_halts(after, joint)
        worse = larger.fit_moving.rms[joint] > RULES.harm * grown.fit_moving.rms[joint]
        # Halts are compared one by one, so that there have to be as many of them.
        if worse or len(held.beyond) != len(halts.beyond) or held.beyond.sum() > _LEFT * halts.beyond.sum():
            continue
        judged = replace(_score_halts(candidate, joint, halts, held, final[0].noise), p=p)
        why = (
            f"These are halts: in {halts.count_large(noise)} of {len(halts.beyond)} the joint held at least "
            f"{format_percent(_MUCH, decimals=0)} more than the model's friction (median "
            f"{format_percent(np.median(halts.share), decimals=0)}). The data hardly resolve the speed at which this "
            "additional friction vanishes."
        )
        findings.append(Finding(judged, tuple(_list_equivalents(judged)), p, why=why))
        grown, final = larger, after
    return grown, final, tuple(findings)


def _combine_p_values(at_rest: float, moving: float) -> float:
    """Return how likely halts and moving rows are by chance: of halts alone and of both the smaller, at half the level.

    Halts are no part of any fit, so the two are independent (Fisher's sum of logarithms): six halts that all hold more
    than the friction are few, but not where the moving rows ask for the same friction.
    """
    with np.errstate(divide="ignore"):
        both = special.chdtrc(4, -2.0 * np.log([at_rest, moving]).sum())
    return 2.0 * float(min(at_rest, both))


def _try_friction(
    grown: Identification, inputs: RegressorInputs, choices: Sequence[EffectChoice]
) -> tuple[State, list[ScoredCandidate]]:
    """Return the model's state, and the choices that have a column of their own beside it, by their widths."""
    inputs = replace(inputs, preprocessing=grown.preprocessing, reference=grown.estimate.next_reference())
    state = gather_state(grown.model, build_pool_of_choices(grown.model, choices), inputs, grown.noise)
    return state, sorted(score_all(state, state.pool.candidates), key=_get_width)


def _get_width(scored: ScoredCandidate) -> float:
    """Return the constant that a filtered position has to resolve."""
    shape = dict(scored.candidate.shape)
    return next(shape[spec.name] for spec in CATALOGUE[scored.candidate.effect].shapes if spec.resolved_by is not None)


def _get_size(scored: ScoredCandidate) -> float:
    """Return what the friction holds at rest."""
    return float(scored.amplitudes[0])


def _find_best_friction(
    grown: Identification, inputs: RegressorInputs, joint: int, halts: Halts, asked: Sequence[str] | None
) -> ScoredCandidate | None:
    """Find the friction whose size, fitted where the joint moves, is what is held at rest.

    The narrower its peak, the larger it has to be.
    """
    robot, name = grown.model.robot, grown.model.robot.joint_names[joint]
    # What the model has on this joint already cannot be missing there.
    known = {choice.effect for choice in grown.choices.effects if not choice.joints or name in choice.joints}
    # A halt need not hold all that friction can: the strongest halts show how much that is.
    needed = float(np.quantile(halts.beyond, 0.9))
    for effect in CATALOGUE.values():
        if not effect.holds_at_rest or effect.id in known or (asked is not None and effect.id not in asked):
            continue
        if is_extrapolated(effect, known):
            continue
        shapes = [tuple(sorted(shape.items())) for shape in _list_narrow_shapes(effect, robot, joint)]
        _, coarse = _try_friction(grown, inputs, [EffectChoice(effect.id, (name,), shape) for shape in shapes])
        shape = _interpolate_width(coarse, needed)
        if shape is None:
            continue
        state, exact = _try_friction(grown, inputs, [EffectChoice(effect.id, (name,), shape)])
        # Interpolating between widths may miss: the fit at the width itself decides.
        for fit in exact:
            if 1 / _LIKE <= _get_size(fit) / needed <= _LIKE and select_harmless(state, [fit.candidate.columns]):
                return replace(fit, p=compute_single_p(fit.gains))
    return None


def is_extrapolated(effect: Effect, known: Collection[str]) -> bool:
    """Return whether the model has a law of the velocity like the effect, whose curve decides what is left at rest.

    Such a law has no width that a position has to resolve. A power of the velocity below one takes much of the Coulomb
    friction with it; what then holds the joint beyond that tells of the power, not of another friction.
    """
    laws = [CATALOGUE[effect_id] for effect_id in known if effect_id in effect.confused_with]
    return any(all(spec.resolved_by is None for spec in law.shapes) for law in laws)


def _interpolate_width(fits: Sequence[ScoredCandidate], needed: float) -> tuple[tuple[str, float], ...] | None:
    """Interpolate the shape constants with which the friction has a size, from fits in the order of their widths."""
    # From the widest on: of several widths that would do, it is the one that the data resolve best.
    for narrow, wide in reversed(list(pairwise(fits))):
        large, small = _get_size(narrow) / needed, _get_size(wide) / needed
        if large >= 1.0 > small > 0.0:
            # Size and width follow a power law closely, so that the logarithms are interpolated.
            share = np.log(large) / (np.log(large) - np.log(small))
            width = _get_width(narrow) * (_get_width(wide) / _get_width(narrow)) ** float(share)
            changed = {spec.name for spec in CATALOGUE[wide.candidate.effect].shapes if spec.resolved_by is not None}
            return tuple((name, width if name in changed else value) for name, value in wide.candidate.shape)
    return None


def _list_equivalents(judged: ScoredCandidate) -> list[ScoredCandidate]:
    """List other friction at the start of a motion that halts alone do not tell from it."""
    mine = judged.candidate.effect
    others = [
        effect
        for effect in CATALOGUE.values()
        if mine in effect.confused_with and effect.is_friction and effect.at_starts(effect.shape_with_defaults({}))
    ]
    return [replace(judged, candidate=replace(judged.candidate, effect=effect.id, shape=())) for effect in others]


def _list_narrow_shapes(effect: Effect, robot: Robot, joint: int) -> list[dict[str, float]]:
    """List the effect's grid, continued in half octaves below what is resolved; other constants have their defaults."""
    usual = [spec for spec in effect.shapes if spec.resolved_by is None]
    grid = [shape for shape in effect.grid(robot, joint) if all(shape[spec.name] == spec.default for spec in usual)]
    shapes = [dict(shape) for shape in grid]
    for spec in effect.shapes:
        if spec.resolved_by is not None:
            least = min(grid, key=lambda shape: shape[spec.name])
            steps = [2.0 ** (-0.5 * k) for k in range(1, _HALF_OCTAVES + 1)]
            shapes += [{**least, spec.name: least[spec.name] * step} for step in steps]
    return shapes


def _score_halts(fit: ScoredCandidate, joint: int, halts: Halts, held: Halts, noise: FloatArray) -> ScoredCandidate:
    """Score the candidate with the joint's halts as the blocks that were left out of the fit."""
    before, after = (np.zeros((len(halts.squares), len(noise))) for _ in range(2))
    before[:, joint], after[:, joint] = halts.squares, held.squares
    measured = np.zeros(len(noise))
    measured[joint] = halts.measured.sum()
    gains = (halts.squares - held.squares) / noise[joint] ** 2
    drop = 1.0 - float(held.squares.sum() / halts.squares.sum())
    return replace(
        fit,
        joints=(joint,),
        before=before,
        after=after,
        drop=drop,
        t=float(compute_evenness(gains[None])[0]),
        gains=gains,
        share_improved=float(np.mean(gains > 0)),
        measured=measured,
        after_weighted=held.squares / noise[joint] ** 2,
    )
