"""The band of frequencies that a model explains, where the filters that the motion asks for let in far more torque.

What gives between an encoder and a link (a soft joint, a belt) and a clock that trembles spoil accelerations from some
frequency on. A spectrum does not tell that from motion: a model does, that explains the torque below and not above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import EstimationError, weighted
from dynident.estimation.least_squares import fitted_errors
from dynident.identification.study.result import Identification
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.choosing import OVERSAMPLING
from dynident.recordings.spectra import spectra
from dynident.regressors.stream import reduce_recordings

POOR_FIT = 0.2
"""Share of the torque left by the fit from which on a narrower band is looked for: rigid arms with all their friction
leave 3 to 15 %, so that their filters stay as their motion and noise ask for."""

_FREQUENCIES = 4001

_NARROWEST = 4.0
"""Hz, at least: a filter below it smears a quarter of a second to either side of a reversal, so that of a joint that
swings at 1 Hz hardly a row is left where it moves."""

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
    torque = _TorqueSpectrum.of(recordings)
    errors = {one: _error(found, recordings, one, reference) for one in tried}
    best = min(errors, key=lambda one: torque.measure_missed(one, errors[one]))
    for factor in (2.0**0.5, 0.5**0.5):
        cutoff = (best.torque_cutoff or 0.0) * factor
        if _NARROWEST <= cutoff < chosen.torque_cutoff:
            near = _narrower(chosen, cutoff, recordings)
            errors[near] = _error(found, recordings, near, reference)
    narrow = min(errors, key=lambda one: torque.measure_missed(one, errors[one]))
    left, before = errors[narrow], errors[chosen]
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


def _error(
    found: Identification, recordings: Sequence[Recording], band: Preprocessing, reference: ReferenceParameters
) -> float:
    """The share of the torque below the cut-off that the model leaves; all of it where it is not determined."""
    reduction = reduce_recordings(found.model.observation, recordings, band, reference)
    try:
        return fitted_errors(reduction, weighted(reduction).values).relative_total
    except EstimationError:
        return 1.0


@dataclass(frozen=True, eq=False)
class _TorqueSpectrum:
    """Squared torque of all joints: its mean over the recordings, and how much of it lies at each `frequency` (k,)."""

    frequency: FloatArray
    power: FloatArray
    total: float

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> _TorqueSpectrum:
        """The mean of all recordings, each for its samples."""
        frequency = np.linspace(0.0, 0.5 * max(recording.sampling_rate for recording in recordings), _FREQUENCIES)
        power, total, count = np.zeros(_FREQUENCIES), 0.0, sum(recording.n_samples for recording in recordings)
        for recording in recordings:
            share, found = recording.n_samples / count, spectra(recording)
            power += share * np.interp(frequency, found.frequency, found.torque.sum(axis=1), right=0.0)
            total += share * found.torque_squared
        return cls(frequency, power * float(frequency[1]), total)

    def measure_missed(self, band: Preprocessing, error: float) -> float:
        """Mean squared torque that a model does not explain: what it leaves below the cut-off, and all above it."""
        above = float(self.power[self.frequency > (band.torque_cutoff or np.inf)].sum())
        return error**2 * max(self.total - above, 0.0) + above
