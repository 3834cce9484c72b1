"""Find the frequency band that a model explains, where the filters chosen for the motion let in far more torque.

A soft joint or a belt between encoder and link, and a clock with jitter, spoil accelerations above some frequency. A
spectrum cannot tell that from motion. A model can: it explains the torque below that frequency and not above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import EstimationError, weighted
from dynident.estimation.least_squares import compute_fitted_errors
from dynident.identification.study.result import Identification
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.choosing import OVERSAMPLING
from dynident.recordings.spectra import estimate_spectra
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


def find_narrower_band(
    identification: Identification, recordings: Sequence[Recording]
) -> tuple[Preprocessing, str] | None:
    """Find narrower filters where the model explains the torque below some frequency and not above it.

    Parameters
    ----------
    identification : Identification
        With the filters that were chosen from the motion and its noise.
    recordings : sequence of Recording
        What it was identified from.

    Returns
    -------
    tuple of Preprocessing and str, or None
        The filters and a sentence about them; None where the fit is good enough, or no better in a narrower band.
    """
    chosen = identification.preprocessing
    if (
        identification.fit.relative_total <= POOR_FIT
        or chosen.torque_cutoff is None
        or not identification.choices.rows.by_joint
    ):
        return None
    reference = identification.estimate.reference
    # Halve the cut-off until nothing narrower is sensible: about five candidates, a few passes over the data each.
    bands = [chosen]
    while (bands[-1].torque_cutoff or 0.0) / 2.0 >= _NARROWEST:
        bands.append(_lower_cutoffs(chosen, (bands[-1].torque_cutoff or 0.0) / 2.0, recordings))
    torque = _TorqueSpectrum.from_recordings(recordings)
    errors = {band: _compute_error(identification, recordings, band, reference) for band in bands}
    # A lower cut-off always leaves a smaller share of the torque below it. So the torque above the cut-off counts as
    # missed, which makes errors at different cut-offs comparable.
    best = min(errors, key=lambda band: torque.measure_missed(band, errors[band]))
    # Refine by half an octave to both sides of the best octave.
    for factor in (2.0**0.5, 0.5**0.5):
        cutoff = (best.torque_cutoff or 0.0) * factor
        if _NARROWEST <= cutoff < chosen.torque_cutoff:
            near = _lower_cutoffs(chosen, cutoff, recordings)
            errors[near] = _compute_error(identification, recordings, near, reference)
    narrow = min(errors, key=lambda band: torque.measure_missed(band, errors[band]))
    share_left, before = errors[narrow], errors[chosen]
    if narrow == chosen or share_left > _BETTER * before:
        return None
    why = (
        f"Below {narrow.torque_cutoff:g} Hz the model leaves {share_left:.0%} of the torque, with all up to "
        f"{chosen.torque_cutoff:g} Hz {before:.0%}: something gives, a joint or a belt, or the clock trembles. It is "
        f"identified below {narrow.torque_cutoff:g} Hz."
    )
    return replace(narrow, reasons=(why, *narrow.reasons)), why


def _lower_cutoffs(chosen: Preprocessing, cutoff: float, recordings: Sequence[Recording]) -> Preprocessing:
    """Return the filters with lower cut-offs, rounded to two digits, and the decimation that goes with them."""
    digits = 1 - floor(log10(cutoff))
    cutoff = round(cutoff, digits)
    rate = min(recording.sampling_rate for recording in recordings)
    decimation = max(1, floor(rate / (OVERSAMPLING * cutoff)))
    return Preprocessing(cutoff, cutoff, decimation, chosen.filter_order)


def _compute_error(
    identification: Identification, recordings: Sequence[Recording], band: Preprocessing, reference: ReferenceParameters
) -> float:
    """Return the share of the torque below the cut-off that the model leaves; 1 where it is not determined."""
    reduction = reduce_recordings(identification.model.observation, recordings, band, reference)
    try:
        return compute_fitted_errors(reduction, weighted(reduction).values).relative_total
    except EstimationError:
        return 1.0


@dataclass(frozen=True, eq=False)
class _TorqueSpectrum:
    """Spectrum of the squared torque of all joints.

    `total` is its mean over the recordings, `power` (k,) the part of it at each `frequency` (k,).
    """

    frequency: FloatArray
    power: FloatArray
    total: float

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording]) -> _TorqueSpectrum:
        """Return the mean spectrum of all recordings, each weighted by its number of samples."""
        frequency = np.linspace(0.0, 0.5 * max(recording.sampling_rate for recording in recordings), _FREQUENCIES)
        power, total, count = np.zeros(_FREQUENCIES), 0.0, sum(recording.n_samples for recording in recordings)
        for recording in recordings:
            share, spectrum = recording.n_samples / count, estimate_spectra(recording)
            power += share * np.interp(frequency, spectrum.frequency, spectrum.torque.sum(axis=1), right=0.0)
            total += share * spectrum.torque_squared
        return cls(frequency, power * float(frequency[1]), total)

    def measure_missed(self, band: Preprocessing, error: float) -> float:
        """Return the mean squared torque that a model misses: what it leaves below the cut-off, and all above it."""
        above = float(self.power[self.frequency > (band.torque_cutoff or np.inf)].sum())
        return error**2 * max(self.total - above, 0.0) + above
