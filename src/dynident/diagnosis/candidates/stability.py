"""How far a candidate's amplitudes move when one stretch of time is left out (jackknife)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.products import IntArray, Products, present, weighted_sums
from dynident.diagnosis.candidates.scoring import Batch, Fit, batches, extra_columns
from dynident.robot.model import FloatArray

_RIDGE = 1e-9


def consistencies(data: Products, base: IntArray, candidates: Sequence[Candidate], noise: FloatArray) -> FloatArray:
    """(C,): F of every candidate's amplitudes over their jackknife covariance beside the model `base`.

    Large where every stretch asks for the same amplitudes; 0 where the stretches are too few for so many.
    """
    out = np.zeros(len(candidates))
    if not candidates:
        return out
    extra = extra_columns(candidates)
    fit = Fit(weighted_sums(data, base, extra, noise, None))
    for portion in batches(candidates, extra):
        out[portion.members] = _f_values(*_parts(data, base, extra, noise, fit, portion))
    return out


def _parts(
    data: Products, base: IntArray, extra: IntArray, noise: FloatArray, fit: Fit, portion: Batch
) -> tuple[FloatArray, FloatArray]:
    """Zᵀρ (s, g, k) and ZᵀZ (s, g, k, k) of every stretch, Z = X - W P."""
    s, g, k = data.n_stretches, len(portion.members), portion.width
    rests, inner = np.zeros((s, g, k)), np.zeros((s, g, k, k))
    for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
        weight = sigma**-2
        wi, wp = present(where, base)
        xi, xp = present(where, extra)
        place = np.full(len(extra), len(xi), dtype=np.intp)
        place[xi] = np.arange(len(xi))
        places = place[portion.columns]
        chi, projection = fit.chi[wi], fit.projection[wi]
        ww = gram[:, wp[:, None], wp]
        wx = np.pad(gram[:, wp[:, None], xp], ((0, 0), (0, 0), (0, 1)))
        xx = np.pad(gram[:, xp[:, None], xp], ((0, 0), (0, 1), (0, 1)))
        w_rest = gram[:, wp, -1] - ww @ chi
        x_rest = np.pad(gram[:, xp, -1], ((0, 0), (0, 1))) - chi @ wx
        said = [projection[:, portion.columns[:, a]] for a in range(k)]
        for a in range(k):
            rests[:, :, a] += weight * (x_rest[:, places[:, a]] - w_rest @ said[a])
            mixed = ww @ said[a] - wx[:, :, places[:, a]]
            for b in range(k):
                inner[:, :, a, b] += weight * (
                    np.einsum("sbg,bg->sg", mixed, said[b])
                    - np.einsum("sbg,bg->sg", wx[:, :, places[:, b]], said[a])
                    + xx[:, places[:, a], places[:, b]]
                )
    return rests, inner


def _f_values(rests: FloatArray, inner: FloatArray) -> FloatArray:
    """(g,): F from the parts of the stretches."""
    s, g, k = rests.shape
    if s <= k + 1:
        return np.zeros(g)
    scale = np.sqrt(np.maximum(np.diagonal(inner.sum(axis=0), axis1=1, axis2=2), np.finfo(float).tiny))
    inner = inner / (scale[:, :, None] * scale[:, None, :])
    rests = rests / scale
    ridge = _RIDGE * np.eye(k)
    total = inner.sum(axis=0) + ridge
    beta = _solved(total, rests.sum(axis=0))
    without = _solved(total - inner + ridge, rests.sum(axis=0) - rests)
    moved = without - without.mean(axis=0)
    covariance = (s - 1) / s * np.einsum("sga,sgb->gab", moved, moved)
    # Amplitudes that do not move at all: the data decide them exactly.
    covariance += np.finfo(float).tiny * np.eye(k)
    with np.errstate(all="ignore"):
        against = np.einsum("ga,ga->g", beta, _solved(covariance, beta))
    value = np.maximum(0.0, against) / k * (s - k) / (s - 1)
    return np.where(np.isfinite(value), value, 0.0)


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions (…, k) of systems (…, k, k); by pseudo-inverse where one of them is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(matrices, hermitian=True) @ right[..., None])[..., 0])
