"""The band of frequencies that a model explains, where the filters that the motion asks for let in far more torque.

What gives between an encoder and a link (a soft joint, a belt) and a clock that trembles spoil accelerations from some
frequency on. A spectrum does not tell that from motion: a model does, that explains the torque below and not above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import floor, log10

from dynident.effects import ReferenceParameters
from dynident.estimation import EstimationError, weighted
from dynident.estimation.least_squares import fitted_errors
from dynident.identification.study.result import Identification
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.choosing import OVERSAMPLING
from dynident.regressors.stream import reduce_recordings

POOR_FIT = 0.2
"""Share of the torque left by the fit from which on a narrower band is looked for: rigid arms with all their friction
leave 3 to 15 %, so that their filters stay as their motion and noise ask for."""

_NARROWEST = 2.0
"""Hz, at least: below it there is little but gravity and friction."""

_NEARLY = 0.95
"""Of bands in which nearly as much power of the torque is explained as in the best, the widest is taken: the optimum is
flat below, and what the motion shows there is not to be thrown away."""

_BETTER = 0.7
"""Share of the error that may be left: a band in which the model is wrong as well is no better one."""


def narrow_band(found: Identification, recordings: Sequence[Recording]) -> tuple[Preprocessing, str] | None:
    """Find narrower filters where the model explains the torque below some frequency and not above it.

    Parameters
    ----------
    found : Identification
        With the filters that were chosen from the motion and its noise.
    recordings : sequence of Recording
        What it was identified from.

    Returns
    -------
    The filters and a sentence about them, or None where the fit is good enough, or no better in a narrower band.
    """
    chosen = found.preprocessing
    if found.fit.relative_total <= POOR_FIT or chosen.torque_cutoff is None or not found.choices.rows.by_joint:
        return None
    reference = found.estimate.reference
    tried = [chosen]
    while (tried[-1].torque_cutoff or 0.0) / 2.0 >= _NARROWEST:
        tried.append(_narrower(chosen, (tried[-1].torque_cutoff or 0.0) / 2.0, recordings))
    powers = {one: _explained(found, recordings, one, reference) for one in tried}
    best = max(powers, key=lambda one: powers[one][0])
    for factor in (2.0**0.5, 0.5**0.5):
        cutoff = (best.torque_cutoff or 0.0) * factor
        if _NARROWEST <= cutoff < (chosen.torque_cutoff or 0.0):
            near = _narrower(chosen, cutoff, recordings)
            powers[near] = _explained(found, recordings, near, reference)
    most = max(explained for explained, _ in powers.values())
    enough = [one for one, (explained, _) in powers.items() if explained >= _NEARLY * most]
    narrow = max(enough, key=lambda one: one.torque_cutoff or 0.0)
    left, before = powers[narrow][1], powers[chosen][1]
    if narrow == chosen or left > _BETTER * before:
        return None
    why = (
        f"Below {narrow.torque_cutoff:g} Hz the model leaves {left:.0%} of the torque, with all up to "
        f"{chosen.torque_cutoff:g} Hz {before:.0%}: something gives, a joint or a belt, or the clock trembles. It is "
        f"identified below {narrow.torque_cutoff:g} Hz."
    )
    return replace(narrow, reasons=(why, *narrow.reasons)), why


def _narrower(chosen: Preprocessing, cutoff: float, recordings: Sequence[Recording]) -> Preprocessing:
    """The same with both filters at a lower frequency, to two digits, and rows as far apart as they then may be."""
    digits = 1 - floor(log10(cutoff))
    cutoff = round(cutoff, digits)
    rate = min(recording.sampling_rate for recording in recordings)
    decimation = max(1, floor(rate / (OVERSAMPLING * cutoff)))
    return Preprocessing(cutoff, cutoff, decimation, chosen.filter_order)


def _explained(
    found: Identification, recordings: Sequence[Recording], band: Preprocessing, reference: ReferenceParameters
) -> tuple[float, float]:
    """The power of torque that the model explains below the cut-off, and the share of it that it leaves."""
    reduction = reduce_recordings(found.model.observation, recordings, band, reference)
    try:
        errors = fitted_errors(reduction, weighted(reduction).values)
    except EstimationError:
        return 0.0, 1.0
    rows = errors.counts.clip(min=1.0)
    return float(((errors.measured - errors.squares) / rows).sum()), errors.relative_total
