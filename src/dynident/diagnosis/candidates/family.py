"""One test for all candidates together: could a gain as even as this be chance, with so many tried?

A candidate that explains nothing gains and loses alike on stretches of time that it was not fitted to: turning the
signs of whole stretches changes nothing about it. The same turns for all candidates keep how they resemble each other,
so the largest value over all of them tells what the best of so many reaches by chance (Westfall and Young 1993).
"""

from __future__ import annotations

import numpy as np

from dynident.robot.model import FloatArray

DRAWS = 2000
"""Turns of the signs: a p of 0.01 is then known to within a fifth of itself."""

_SEED = 20


def family_wise_p(gains: FloatArray) -> FloatArray:
    """(c,): how often the best of all candidates would gain as evenly by chance as each of them does.

    Parameters
    ----------
    gains : (c, s)
        What every candidate gains in every stretch of time.
    """
    count, n_stretches = gains.shape
    if not count or n_stretches < 2:
        return np.ones(count)
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(DRAWS, n_stretches))
    signs[0] = 1.0
    values = _roots(gains)
    mean = signs @ values.T / n_stretches
    variance = np.maximum((values**2).mean(axis=1) - mean**2, np.finfo(float).tiny) * n_stretches / (n_stretches - 1)
    largest = np.sort((mean / np.sqrt(variance / n_stretches)).max(axis=1))
    reached = len(largest) - np.searchsorted(largest, evenness(gains) - 1e-9, side="left")
    return np.asarray(reached / len(largest))


def evenness(gains: FloatArray) -> FloatArray:
    """(c,): t of the mean over the stretches of the signed roots of gains (c, s).

    Of the roots, since a gain is a square: else one stretch that shows an effect well hides that the others do, too.
    """
    values = _roots(gains)
    spread = values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
    return np.asarray(np.divide(values.mean(axis=-1), spread, out=np.zeros_like(spread), where=spread > 0))


def _roots(gains: FloatArray) -> FloatArray:
    return np.asarray(np.sign(gains) * np.sqrt(np.abs(gains)))
