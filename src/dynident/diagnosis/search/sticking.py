"""Static friction above Coulomb friction, told by what holds joints at rest.

A peak of friction that is narrower than the filter hardly shows where a joint moves. But a joint at rest is held by
all of it, and its equations at rest are no part of the fit: what the moving joint's model cannot hold is seen there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from dynident.arrays import FloatArray
from dynident.diagnosis.candidates.gate import ALPHA, JudgedCandidate
from dynident.diagnosis.candidates.gathering import gather
from dynident.diagnosis.candidates.pool import Candidate, pool_of
from dynident.diagnosis.candidates.scoring import fitted_errors
from dynident.diagnosis.comparing.compare import Comparison, compare
from dynident.diagnosis.residuals.stretches import t_of
from dynident.diagnosis.search.rungs import helpful
from dynident.diagnosis.search.state import Finding
from dynident.effects import CATALOGUE, Effect, EffectChoice
from dynident.errors import DynidentError
from dynident.identification import Identification, extend
from dynident.recordings import Recording
from dynident.recordings.phases import Phase
from dynident.robot import Robot

_MUCH = 0.3
"""Share of what the model's friction holds from which on more is held: what moves beside a halt leaves 0.1 to 0.2."""

_USUAL = 0.25
"""Share of the halts of a joint without static friction above its Coulomb friction that hold so much more, at most."""

_ALIKE = 0.5
"""Half of the halts lie at most so far apart, over the middle one: a joint breaks away at the same torque each time, a
brake holds whatever there is."""

_OVER_NOISE = 3.0
"""Times the residual where the joint moves that is held beyond the model's friction in the middle halt, at least."""

_LIKE = (0.5, 3.0)
"""What friction at low speed the moving rows ask for, over what is held: the filter takes some of the latter."""

_LEFT = 0.5
"""Share of what is held beyond the friction that may be left once the effect is in the model."""

_HALF_OCTAVES = 6
"""So many below the grid: a peak an eighth as wide as its narrowest leaves nothing where a joint moves."""

_NOTICED = 1.005
"""Times the error where the joint moves from which on anybody would notice that it grew."""


@dataclass(frozen=True, eq=False)
class Halts:
    """The halts (h,) of one joint: what is held beyond the model's friction, at most, in N m or N, and as squares.

    `friction` is what the model's friction holds, `measured` the squared torque.
    """

    beyond: FloatArray
    friction: FloatArray
    squares: FloatArray
    measured: FloatArray

    @property
    def share(self) -> FloatArray:
        """(h,): what is held beyond the friction, over the friction."""
        return self.beyond / np.maximum(self.friction, np.finfo(float).tiny)

    @property
    def are_alike(self) -> bool:
        """Whether what is held is about the same in most halts."""
        low, middle, high = np.quantile(self.beyond, (0.25, 0.5, 0.75))
        return bool(high - low <= _ALIKE * middle)

    @property
    def p(self) -> float:
        """How likely as many halts hold `_MUCH` more where static friction is not above Coulomb friction."""
        n, many = len(self.beyond), int((self.share >= _MUCH).sum())
        return float(stats.binom.sf(many - 1, n, _USUAL)) if n else 1.0


def halts_of(comparisons: Sequence[Comparison], joint: int) -> Halts:
    """The halts of a joint in the comparisons of one model."""
    found: list[tuple[float, float, float, float]] = []
    for one in comparisons:
        standing = one.phase[:, joint] == Phase.STANDING
        broken = np.concatenate([[True], np.diff(one.segment) != 0, [True]])
        edge = np.diff(np.concatenate([[False], standing, [False]]).astype(int))
        starts = np.flatnonzero(standing & ((edge[:-1] == 1) | broken[:-1]))
        ends = np.flatnonzero(standing & ((edge[1:] == -1) | broken[1:])) + 1
        beyond, hold = np.abs(one.residual[:, joint]), 0.5 * (one.upper - one.lower)[:, joint]
        found += [
            (beyond[a:b].max(), hold[a:b].mean(), (beyond[a:b] ** 2).sum(), (one.measured[a:b, joint] ** 2).sum())
            for a, b in zip(starts, ends, strict=True)
        ]
    return Halts(*np.array(found).reshape(-1, 4).T)


def held_at_rest(
    grown: Identification, recordings: Sequence[Recording], final: Sequence[Comparison], asked: Sequence[str] | None
) -> tuple[Identification, list[Comparison], tuple[Finding, ...]]:
    """The model with the static friction that its halts ask for, its comparisons, and what was found.

    An effect is found where the friction at low speed that the moving rows ask for is what holds the joint at rest,
    takes most of what was held beyond the model's friction, and makes nothing worse where the joint moves.

    Parameters
    ----------
    grown : Identification
        With all in it that is recommended.
    final : its comparisons with the recordings
    asked : ids of the effects that may be found; None for all
    """
    final, found = list(final), []
    names = final[0].joint_names
    for joint in range(len(names)):
        halts = halts_of(final, joint)
        p = halts.p * len(names)
        if p > ALPHA or not _much_is_held(halts, final[0].noise[joint]):
            continue
        tried = _best(grown, recordings, joint, halts, asked)
        if tried is None:
            continue
        candidate, separability, amplitudes = tried
        try:
            larger = extend(grown, [candidate.choice], recordings)
        except DynidentError:
            continue
        after = [compare(larger, recording) for recording in recordings]
        held = halts_of(after, joint)
        worse = larger.fit_moving.rms[joint] > _NOTICED * grown.fit_moving.rms[joint]
        if worse or len(held.beyond) != len(halts.beyond) or held.beyond.sum() > _LEFT * halts.beyond.sum():
            continue
        judged = _judged(candidate, joint, halts, held, final[0].noise)
        judged = replace(judged, p=p, separability=separability, amplitudes=amplitudes)
        many = int((halts.share >= _MUCH).sum())
        why = (
            f"These are halts: in {many} of {len(halts.beyond)} the joint held {_MUCH:.0%} or more beyond what the "
            f"model's friction does, {np.median(halts.share):.0%} in the middle one. At which speed that falls off is "
            "hardly resolved."
        )
        found.append(Finding(judged, tuple(_alike(judged)), p, why=why))
        grown, final = larger, after
    return grown, final, tuple(found)


def _much_is_held(halts: Halts, noise: float) -> bool:
    """Whether joints are held alike, by clearly more than a friction that the model has."""
    has_friction = np.median(halts.friction) > noise
    return bool(has_friction and halts.are_alike and np.median(halts.beyond) >= _OVER_NOISE * noise)


def _best(
    grown: Identification, recordings: Sequence[Recording], joint: int, halts: Halts, asked: Sequence[str] | None
) -> tuple[Candidate, float, FloatArray] | None:
    """The candidate whose size, from where the joint moves, is nearest to what is held; separability, amplitudes."""
    model, name = grown.model, grown.model.robot.joint_names[joint]
    known = {one.effect for one in grown.choices.effects if not one.joints or name in one.joints}
    holding = [one for one in CATALOGUE.values() if one.holds_at_rest and one.id not in known]
    choices = [
        EffectChoice(one.id, (name,), tuple(sorted(shape.items())))
        for one in holding
        if asked is None or one.id in asked
        for shape in _narrow(one, model.robot, joint)
    ]
    pool = pool_of(model, choices)
    if not pool.candidates:
        return None
    reference = grown.next_reference()
    data = gather(pool.observation, model.signals, recordings, grown.preprocessing, reference, model.n_parameters)
    base = tuple(range(pool.n_base))
    needed = float(np.quantile(halts.beyond, 0.9))
    best: tuple[float, Candidate, float, FloatArray] | None = None
    for candidate in pool.candidates:
        rows = data.beside(base, np.array(data.kinds(candidate.columns)))
        *_, separability, own = fitted_errors(rows, np.array(base, dtype=np.intp), candidate, grown.noise)
        size = float(own[0]) / needed
        if not _LIKE[0] <= size <= _LIKE[1] or not helpful(data, base, [candidate.columns], grown.noise):
            continue
        if best is None or abs(np.log(size)) < best[0]:
            best = abs(float(np.log(size))), candidate, separability, own
    return None if best is None else best[1:]


def _alike(judged: JudgedCandidate) -> list[JudgedCandidate]:
    """Other friction at the start of a motion that halts alone do not tell from it."""
    mine = judged.candidate.effect
    others = [
        one
        for one in CATALOGUE.values()
        if mine in one.confused_with and one.is_friction and one.at_starts(one.shape_with_defaults({}))
    ]
    return [replace(judged, candidate=replace(judged.candidate, effect=one.id, shape=())) for one in others]


def _narrow(effect: Effect, robot: Robot, joint: int) -> list[dict[str, float]]:
    """The effect's grid, and on below what is resolved, in half octaves; constants that nothing resolves as usual."""
    usual = [spec for spec in effect.shapes if spec.resolved_by is None]
    grid = [shape for shape in effect.grid(robot, joint) if all(shape[one.name] == one.default for one in usual)]
    found = [dict(shape) for shape in grid]
    for spec in effect.shapes:
        if spec.resolved_by is not None:
            least = min(grid, key=lambda shape: shape[spec.name])
            steps = [2.0 ** (-0.5 * k) for k in range(1, _HALF_OCTAVES + 1)]
            found += [{**least, spec.name: least[spec.name] * step} for step in steps]
    return found


def _judged(candidate: Candidate, joint: int, halts: Halts, held: Halts, noise: FloatArray) -> JudgedCandidate:
    """The candidate with its halts as the stretches that were left out of the fit."""
    before, after = (np.zeros((len(halts.squares), len(noise))) for _ in range(2))
    before[:, joint], after[:, joint] = halts.squares, held.squares
    measured = np.zeros(len(noise))
    measured[joint] = halts.measured.sum()
    gains = (halts.squares - held.squares) / noise[joint] ** 2
    drop = 1.0 - float(held.squares.sum() / halts.squares.sum())
    return JudgedCandidate(
        candidate=candidate,
        joints=(joint,),
        before=before,
        after=after,
        drop=drop,
        total_drop=drop,
        t=t_of(gains),
        gains=gains,
        separability=1.0,
        amplitudes=np.zeros(0),
        share_improved=float(np.mean(gains > 0)),
        measured=measured,
        after_weighted=held.squares / noise[joint] ** 2,
    )
