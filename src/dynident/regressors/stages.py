"""What happens to samples between a form and its rows: rates, the filter F(s), integrals; in streams.

Every stage takes and gives `Samples` and carries its state from block to block, so that the blocks' borders leave no
trace, and starts anew with every segment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil

import numpy as np
from scipy import signal

from dynident.arrays import BoolArray, FloatArray
from dynident.regressors.forms import Form
from dynident.regressors.stream import Samples

# What is left of a step after (settling) / a seconds behind F(s): (1 + 9.2) exp(-9.2), a thousandth.
_SETTLED = 9.2
_REACH = 2


def rated(samples: Iterable[Samples], form: Form, rate: float) -> Iterator[Samples]:
    """dS/dt + D beside y, from evaluations of the form beside y.

    The central difference has five points: that of three (as in [12.16]) would take (ωT)²/6 off a rate, which here,
    unlike there, stands alone against torque that nobody differentiated; five leave (ωT)⁴/30.
    """
    before, behind = (0, 0) if not form.has_rates else (_REACH, _REACH)
    for part in _with_neighbours(samples, before, behind):
        values = _direct(part.values, form, before)
        if form.has_rates:
            _add_rates(part.values[:, : form.n_stored], rate, values[:, : form.n_stored])
        yield _changed(part, before, behind, values)


def integrated(samples: Iterable[Samples], form: Form, period: float) -> Iterator[Samples]:
    """S + ∫D dt beside ∫y dt from the beginning of the segment: differences of two such rows are those of [12.43].

    The integral over one period is that of the cubic through four samples, exact to (ωT)⁴ 11/720.
    """
    total = np.zeros(0)
    for part in _with_neighbours(samples, 2, 1):
        inner = slice(2, len(part.t) - 1)
        rates = _direct(part.values, form, 0)
        steps = (period / 24.0) * (13.0 * (rates[1:-2] + rates[2:-1]) - rates[:-3] - rates[3:])
        if part.starts_segment:
            total = np.zeros(steps.shape[1])
        # One running sum, so that it does not depend on where the blocks end.
        sums = np.cumsum(np.vstack([total, steps]), axis=0)[1:]
        total = sums[-1]
        values = sums.copy()
        values[:, : form.n_stored] += part.values[inner, : form.n_stored]
        yield _changed(part, 2, 1, values)


def smoothed(samples: Iterable[Samples], pole: float, rate: float) -> Iterator[Samples]:
    """Rows behind F(s) = a² / (s + a)² [12.29], made discrete by the bilinear transform; settled rows are used.

    W and Y pass the same filter, so that no discretisation can bias the estimates. Rows that are not used enter as
    zeros on both sides of the equations.
    """
    b, a = signal.bilinear([pole**2], [1.0, 2.0 * pole, pole**2], rate)
    settling = ceil(_SETTLED / pole * rate)
    state = np.zeros((2, 0))
    run = 0
    for part in samples:
        if part.starts_segment:
            state, run = np.zeros((2, part.values.shape[1])), 0
        values, state = signal.lfilter(b, a, part.values * part.used[:, None], axis=0, zi=state)
        lengths = _run_lengths(part.used, run)
        run = int(lengths[-1]) if len(lengths) else run
        yield Samples(part.segment, part.starts_segment, part.t, part.used & (lengths > settling), values)


def differences(
    rows: Iterable[tuple[int, FloatArray, FloatArray]], length: int, step: int, spacing: float
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Differences over intervals of `length` rows that begin every `step` rows: (segment, middle (m,), rows (m, k)).

    Parameters
    ----------
    rows : (segment, t (m,), values (m, k)), decimated
    spacing : float
        Seconds from one row to the next; an interval that rows are missing in is left out.
    """
    held: tuple[int, FloatArray, FloatArray] | None = None
    skip = 0
    for segment, t, values in rows:
        if held is None or held[0] != segment:
            skip = 0
        else:
            t, values = np.concatenate([held[1], t]), np.vstack([held[2], values])
        starts = np.arange(skip, len(t) - length, step)
        whole = starts[np.abs(t[starts + length] - t[starts] - length * spacing) < 0.5 * spacing]
        if len(whole):
            yield segment, 0.5 * (t[whole] + t[whole + length]), values[whole + length] - values[whole]
        following = int(starts[-1]) + step if len(starts) else skip
        first_kept = min(following, len(t))
        skip, held = following - first_kept, (segment, t[first_kept:], values[first_kept:])


def _with_neighbours(samples: Iterable[Samples], before: int, behind: int) -> Iterator[Samples]:
    """The samples with so many of their neighbours on either side; a segment's outermost have none and are left out."""
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


def _changed(part: Samples, before: int, behind: int, values: FloatArray) -> Samples:
    """The inner samples with other values; used where all of their neighbours are."""
    inner = slice(before, len(part.t) - behind)
    counts = np.concatenate([[0], np.cumsum(part.used)])
    width = before + behind + 1
    used: BoolArray = counts[width:] - counts[: len(counts) - width] == width
    return Samples(part.segment, part.starts_segment, part.t[inner], used, values)


def _direct(values: FloatArray, form: Form, reach: int) -> FloatArray:
    """D, in the entries of dS/dt + D, beside y; the outer `reach` samples are left out."""
    inner = values[reach : len(values) - reach]
    out = np.zeros((len(inner), form.n_entries + form.n_equations))
    picked, places = form.shared
    out[:, places] = inner[:, picked]
    out[:, form.n_stored : form.n_entries] = inner[:, form.alone]
    out[:, form.n_entries :] = inner[:, len(form.observation.entry_rows) :]
    return out


def _add_rates(stored: FloatArray, rate: float, out: FloatArray) -> None:
    """Add the central difference of five points of `stored` (m, k) to `out` (m - 4, k)."""
    rates = stored[3:-1] - stored[1:-3]
    rates *= 8.0
    rates -= stored[4:]
    rates += stored[:-4]
    rates *= rate / 12.0
    out += rates


def _run_lengths(used: BoolArray, before: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """(m,): of how many used samples in a row each is the last, `before` of them in earlier blocks."""
    index = np.arange(len(used))
    last = np.maximum.accumulate(np.where(used, -1 - before, index))
    return np.where(used, index - last, 0)
