"""Stages between a form's evaluations and its rows: rates, the filter F(s), integrals; in streams.

Every stage takes and gives `Samples` and carries its state from block to block, so that the blocks' borders leave no
trace, and starts anew with every segment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil

import numpy as np
from scipy import signal

from dynident.arrays import BoolArray, FloatArray
from dynident.regressors.forms import EquationForm
from dynident.regressors.stream import Samples

# What is left of a step after (settling) / a seconds behind F(s): (1 + 9.2) exp(-9.2), a thousandth.
_SETTLED = 9.2
_REACH = 2


def differentiate_samples(samples: Iterable[Samples], form: EquationForm, rate: float) -> Iterator[Samples]:
    """Differentiate: dS/dt + D with y behind it, from evaluations of a form.

    The central difference has five points: that of three (as in [12.16]) would take (ωT)²/6 off a rate, which here,
    unlike there, stands alone against torque that nobody differentiated; five leave (ωT)⁴/30.

    Parameters
    ----------
    samples : iterable of Samples
    form : Form
    rate : float
        Sampling rate in Hz.

    Yields
    ------
    Samples
        Two samples shorter at either end of a segment, if anything is differentiated.
    """
    before, behind = (0, 0) if not form.has_rates else (_REACH, _REACH)
    for part in _add_neighbours(samples, before, behind):
        values = _collect_direct_part(part.values, form, before)
        if form.has_rates:
            _add_rates(part.values[:, : form.n_stored], rate, values[:, : form.n_stored])
        yield _replace_values(part, before, behind, values)


def integrate_samples(samples: Iterable[Samples], form: EquationForm, period: float) -> Iterator[Samples]:
    """Integrate: S + ∫D dt, and ∫y dt, from the beginning of the segment; differences of two rows are those of [12.43].

    The integral over one period is that of the cubic through four samples, exact to (ωT)⁴ 11/720.
    """
    total = np.zeros(0)
    for part in _add_neighbours(samples, 2, 1):
        inner = slice(2, len(part.t) - 1)
        rates = _collect_direct_part(part.values, form, 0)
        # The integral of the cubic through x(k-2) … x(k+1), from k - 1 to k: T / 24 (13 (x(k-1) + x(k)) - x(k-2) -
        # x(k+1)).
        steps = (period / 24.0) * (13.0 * (rates[1:-2] + rates[2:-1]) - rates[:-3] - rates[3:])
        if part.starts_segment:
            total = np.zeros(steps.shape[1])
        # One running sum, so that it does not depend on where the blocks end.
        sums = np.cumsum(np.vstack([total, steps]), axis=0)[1:]
        total = sums[-1]
        values = sums.copy()
        values[:, : form.n_stored] += part.values[inner, : form.n_stored]
        yield _replace_values(part, 2, 1, values)


def smooth_samples(samples: Iterable[Samples], pole: float, rate: float) -> Iterator[Samples]:
    """Filter rows by F(s) = a² / (s + a)² [12.29], made discrete by the bilinear transform; settled rows are used.

    W and Y pass the same filter, so that no discretisation can bias the estimates. Rows that are not used enter as
    zeros on both sides of the equations.

    Parameters
    ----------
    samples : iterable of Samples
    pole : float
        a in rad/s.
    rate : float
        Sampling rate in Hz.
    """
    b, a = signal.bilinear([pole**2], [1.0, 2.0 * pole, pole**2], rate)
    settling = ceil(_SETTLED / pole * rate)
    state = np.zeros((2, 0))
    run = 0
    for part in samples:
        if part.starts_segment:
            # A filter at rest: it needs the settling time before its output means anything.
            state, run = np.zeros((2, part.values.shape[1])), 0
        values, state = signal.lfilter(b, a, part.values * part.used[:, None], axis=0, zi=state)
        lengths = _count_run_lengths(part.used, run)
        run = int(lengths[-1]) if len(lengths) else run
        yield Samples(part.segment, part.starts_segment, part.t, part.used & (lengths > settling), values)


def take_differences(
    rows: Iterable[tuple[int, FloatArray, FloatArray]], length: int, step: int, spacing: float
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Take differences over intervals of `length` rows that begin every `step` rows.

    Parameters
    ----------
    rows : (segment, t (m,), values (m, k)), decimated
    length, step : int
    spacing : float
        Seconds from one row to the next; an interval that rows are missing in is left out.

    Yields
    ------
    segment, middle of the interval (m,), differences (m, k)
    """
    held: tuple[int, FloatArray, FloatArray] | None = None
    skip = 0
    for segment, t, values in rows:
        if held is None or held[0] != segment:
            skip = 0
        else:
            t, values = np.concatenate([held[1], t]), np.vstack([held[2], values])
        starts = np.arange(skip, len(t) - length, step)
        # Where rows are missing inside an interval, its ends are farther apart than `length` rows.
        whole = starts[np.abs(t[starts + length] - t[starts] - length * spacing) < 0.5 * spacing]
        if len(whole):
            yield segment, 0.5 * (t[whole] + t[whole + length]), values[whole + length] - values[whole]
        following = int(starts[-1]) + step if len(starts) else skip
        # The next interval may begin behind the rows that are here: `skip` counts what is then still to be left out.
        first_kept = min(following, len(t))
        skip, held = following - first_kept, (segment, t[first_kept:], values[first_kept:])


def _add_neighbours(samples: Iterable[Samples], before: int, behind: int) -> Iterator[Samples]:
    """Add to every block so many neighbours on either side; the outermost samples of a segment are left out."""
    reach = before + behind
    held: Samples | None = None
    starts = True
    for part in samples:
        if part.starts_segment or held is None:
            joined, starts = part, True
        else:
            joined = Samples(
                part.segment,
                False,
                np.concatenate([held.t, part.t]),
                np.concatenate([held.used, part.used]),
                np.vstack([held.values, part.values]),
            )
        if len(joined.t) > reach:
            yield Samples(joined.segment, starts, joined.t, joined.used, joined.values)
            starts = False
            first = len(joined.t) - reach
            joined = Samples(joined.segment, False, joined.t[first:], joined.used[first:], joined.values[first:])
        held = joined


def _replace_values(part: Samples, before: int, behind: int, values: FloatArray) -> Samples:
    """Return the inner samples with other values; used where all of their neighbours are."""
    inner = slice(before, len(part.t) - behind)
    # A moving count of used samples by differences of a running one.
    counts = np.concatenate([[0], np.cumsum(part.used)])
    width = before + behind + 1
    used: BoolArray = counts[width:] - counts[: len(counts) - width] == width
    return Samples(part.segment, part.starts_segment, part.t[inner], used, values)


def _collect_direct_part(values: FloatArray, form: EquationForm, reach: int) -> FloatArray:
    """Return D in the entries of dS/dt + D, with y behind them; the outer `reach` samples are left out."""
    inner = values[reach : len(values) - reach]
    out = np.zeros((len(inner), form.n_entries + form.n_equations))
    picked, places = form.shared_entries
    out[:, places] = inner[:, picked]
    out[:, form.n_stored : form.n_entries] = inner[:, form.separate_entries]
    out[:, form.n_entries :] = inner[:, len(form.observation.entry_rows) :]
    return out


def _add_rates(stored: FloatArray, rate: float, out: FloatArray) -> None:
    """Add the central difference of five points of `stored` (m, k) to `out` (m - 4, k)."""
    # (8 (x(k+1) - x(k-1)) - (x(k+2) - x(k-2))) / (12 T), in place: these arrays are as large as W.
    rates = stored[3:-1] - stored[1:-3]
    rates *= 8.0
    rates -= stored[4:]
    rates += stored[:-4]
    rates *= rate / 12.0
    out += rates


def _count_run_lengths(used: BoolArray, before: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return (m,): the number of used samples in a row up to each one, `before` of them in earlier blocks."""
    # The last unused sample before each one, by a running maximum; what earlier blocks had in a row lies before index
    # 0.
    index = np.arange(len(used))
    last = np.maximum.accumulate(np.where(used, -1 - before, index))
    return np.where(used, index - last, 0)
