"""Low-passes of ours are those of SciPy, which takes longer to load than a short recording takes to filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from dynident.recordings.parallel import ATTENUATION, low_pass
from dynident.recordings.sections import butterworth

RATES_AND_CUTOFFS = [(rate, share * rate) for rate in (93.854, 500.0, 8000.0) for share in (2e-3, 0.067, 0.2, 0.47)]
# Compilers may fuse a product with a sum on other processors; here they are equal to the last bit.
CLOSE = {"rtol": 1e-9, "atol": 1e-12}


@pytest.mark.parametrize("order", range(1, 9))
def test_butterworth_filters_are_those_of_scipy(order: int) -> None:
    rows = np.random.default_rng(order).normal(size=(300, 3))
    for rate, cutoff in RATES_AND_CUTOFFS:
        ours, sections = butterworth(order, cutoff, rate), signal.butter(order, cutoff, fs=rate, output="sos")
        np.testing.assert_allclose(ours.sections, sections, **CLOSE)
        steady = signal.sosfilt_zi(sections)
        np.testing.assert_allclose(ours.steady, steady, **CLOSE)
        there, behind = signal.sosfilt(sections, rows, axis=0, zi=steady[:, :, None] * rows[0])
        here, state = ours.run(rows, ours.steady[:, :, None] * rows[0])
        np.testing.assert_allclose(here, there, **CLOSE)
        np.testing.assert_allclose(state, behind, **CLOSE)


def test_a_butterworth_filter_is_refused_from_half_the_rate_on() -> None:
    for cutoff in (0.0, 50.0, 60.0):
        with pytest.raises(ValueError, match="half the rate"):
            butterworth(2, cutoff, 100.0)


def test_filters_of_rows_are_windowed_as_those_of_scipy() -> None:
    for rate, cutoff in RATES_AND_CUTOFFS:
        taps = low_pass(rate, cutoff)
        window = ("kaiser", signal.kaiser_beta(ATTENUATION))
        np.testing.assert_allclose(taps, signal.firwin(len(taps), cutoff, window=window, fs=rate), **CLOSE)
