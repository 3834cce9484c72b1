"""When an improvement on held-out data counts as a finding, and when two explanations count as equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from dynident.diagnosis.candidates import Candidate
from dynident.diagnosis.scoring import Score
from dynident.robot.model import FloatArray

SMALLEST_DROP = 0.03
"""Share of the squared held-out error of its joints that an effect must remove."""

SMALLEST_T = 3.5
"""t of the drop over the stretches of time; calibrated on columns shifted in time, which explain nothing."""

_ROBOT_DROP, _ROBOT_SHARE = 0.08, 0.7
_LARGE_DROP, _LARGE_SHARE = 0.4, 0.8
_UNEVEN_T = 2.0
_CAP = 3.0


@dataclass(frozen=True, eq=False)
class Judged:
    """A candidate with its score in interleaved and contiguous folds.

    `drop` is the share of the squared held-out error on its joints that it removes, the smaller of the two fold
    kinds; `t` likewise; `gains` (s,) the drop of every stretch in units of the noise, all joints, fold kinds averaged;
    `measured` (n,) the squared torque.
    """

    candidate: Candidate
    joints: tuple[int, ...]
    before: FloatArray
    after: FloatArray
    drop: float
    t: float
    gains: FloatArray
    separability: float
    amplitudes: FloatArray
    share_improved: float
    measured: FloatArray

    @property
    def total_gain(self) -> float:
        """What the candidate removes in all, in units of the noise."""
        return float(self.gains.sum())

    def passes(self, whole_robot: bool) -> bool:
        """Whether the improvement is a finding."""
        if self.drop >= SMALLEST_DROP and self.t >= SMALLEST_T:
            return True
        # A gain that is large and nearly everywhere, but very uneven, has a small t.
        least, share = (_ROBOT_DROP, _ROBOT_SHARE) if whole_robot else (_LARGE_DROP, _LARGE_SHARE)
        return self.drop >= least and self.t >= _UNEVEN_T and self.share_improved >= share


def judge(scores: Sequence[Score], joints: tuple[int, ...], noise: FloatArray) -> Judged:
    """Put a candidate's scores in the two kinds of folds together.

    Parameters
    ----------
    scores : one a kind of folds
    joints : indices of the joints that the candidate acts on
    noise : (n,)
    """
    drops, ts, gains = [], [], []
    index = list(joints)
    for score in scores:
        before, after = score.before / noise**2, score.after / noise**2
        gain = (before - after).sum(axis=1)
        whole = before.sum(axis=1)
        # One stretch with half of all the error must not decide: its gain counts up to three times a usual one's.
        cap = _CAP * float(np.median(whole)) if len(whole) else 0.0
        factor = np.minimum(1.0, cap / np.maximum(whole, 1e-300))
        gain = gain * factor
        gains.append(gain)
        base = float((before[:, index].sum(axis=1) * factor).sum())
        own = float(((before - after)[:, index].sum(axis=1) * factor).sum())
        drops.append(own / base if base > 0 else 0.0)
        ts.append(t_of(gain))
    mean_gain = np.mean(gains, axis=0)
    before = np.mean([score.before for score in scores], axis=0)
    after = np.mean([score.after for score in scores], axis=0)
    return Judged(
        candidate=scores[0].candidate,
        joints=joints,
        before=before,
        after=after,
        drop=min(drops),
        t=min(ts),
        gains=mean_gain,
        separability=scores[0].separability,
        amplitudes=scores[0].amplitudes,
        share_improved=float(np.mean(mean_gain > 0)),
        measured=scores[0].measured,
    )


def t_of(gain: FloatArray) -> float:
    """t of the mean gain over stretches of time, which are long against the correlation of the residual."""
    if len(gain) < 2:
        return 0.0
    spread = float(gain.std(ddof=1))
    return float(gain.mean() / (spread / np.sqrt(len(gain)))) if spread > 0 else 0.0


def p_value(t: float, n_stretches: int, n_tried: int) -> float:
    """One-sided p of a gain, corrected for the number of candidates tried (Bonferroni)."""
    return float(min(1.0, n_tried * stats.t.sf(t, max(n_stretches - 1, 1))))


def indistinguishable(best: Judged, other: Judged) -> bool:
    """Whether the stretches do not tell two explanations apart: mean difference below its standard error."""
    difference = best.gains - other.gains
    return abs(t_of(difference)) < 1.0 or np.allclose(difference, 0.0)


def simplest(judged: Sequence[Judged]) -> tuple[Judged, tuple[Judged, ...]]:
    """The best candidate, or the one with the fewest columns among those the data cannot tell from it; and these."""
    ordered = sorted(judged, key=lambda item: -item.total_gain)
    best = ordered[0]
    equal = [item for item in ordered if item is best or indistinguishable(best, item)]
    chosen = min(equal, key=lambda item: (len(item.candidate.columns), -item.total_gain))
    return chosen, tuple(item for item in equal if item is not chosen)
