"""Contact: a stretch of time far above the rest that a force on the tool explains.

It cannot be held out, since it happens once. What speaks for it instead is that the few numbers of one wrench explain
the residual of all joints at all times of the stretch, as noise or a missing function of the motion would not.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from dynident.arrays import FloatArray
from dynident.diagnosis.candidates.gate import JudgedCandidate
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.candidates.products import Products
from dynident.diagnosis.candidates.scoring import fitted_errors
from dynident.diagnosis.residuals.stretches import usual_of
from dynident.diagnosis.search.state import Finding
from dynident.effects import effect_by_id

_EXPLAINED, _LARGEST_P = 0.7, 1e-6


def find_contacts(
    data: PhasedProducts, pool: Pool, base: tuple[int, ...], noise: FloatArray, band: float
) -> tuple[Finding, ...]:
    """Try every burst as a contact.

    Parameters
    ----------
    base : columns of the model
    noise : (n,)
    band : float
        Hz: twice as many independent samples a second come out of the filter.
    """
    tried = [candidate for candidate in pool.candidates if effect_by_id(candidate.effect).is_transient]
    found: list[Finding] = []
    columns = base
    for candidate in tried:
        window = dict(candidate.shape)
        rows = data.beside(columns, np.zeros(2, dtype=bool))
        judged, p = _tried(rows, columns, candidate, noise, 2 * band * (window["t1"] - window["t0"]))
        if judged.drop >= _EXPLAINED and p * len(tried) <= _LARGEST_P:
            found.append(Finding(judged, (), p * len(tried)))
            columns = columns + candidate.columns
    return tuple(found)


def _tried(
    data: Products, base: tuple[int, ...], candidate: Candidate, noise: FloatArray, independent: float
) -> tuple[JudgedCandidate, float]:
    before, after, separability, amplitudes = fitted_errors(data, np.array(base, dtype=np.intp), candidate, noise)
    gains = ((before - after) / noise**2).sum(axis=1)
    whole = (before / noise**2).sum(axis=1)
    # Only the stretches that the contact is in gain; the others would dilute what it explains.
    strong = np.flatnonzero(gains > max(0.1 * float(gains.max(initial=0.0)), 0.0))
    usual = usual_of(whole)
    excess = float((whole[strong] - usual).sum())
    drop = float(gains[strong].sum()) / excess if excess > 0 else 0.0
    k = len(candidate.columns)
    freedom = max(independent * data.n_joints - k, 1.0)
    left = max(excess - float(gains[strong].sum()), usual * 0.1, 1e-12)
    f = float(gains[strong].sum()) / k / (left / freedom)
    judged = JudgedCandidate(
        candidate=candidate,
        joints=tuple(range(data.n_joints)),
        before=before,
        after=after,
        drop=drop,
        total_drop=drop,
        t=float(np.sqrt(max(f, 0.0))),
        gains=gains,
        separability=separability,
        amplitudes=amplitudes,
        share_improved=float(np.mean(gains > 0)),
        measured=data.torque_squared(),
        after_weighted=(after / noise**2).sum(axis=1),
    )
    return judged, float(stats.f.sf(f, k, freedom))
