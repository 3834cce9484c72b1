"""Rows of the filtered, energy, power and wrench models: differentiated, filtered, integrated, accumulated.

Holds the length of the energy model's intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import ceil

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import Reduction
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.recordings.low_pass_decimation import Samples, low_pass_samples, stream_samples
from dynident.regressors.dynamic_model_rows import SampleFunction
from dynident.regressors.equation_forms import EquationForm
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.qr_accumulation import EquationRows, accumulate_equations
from dynident.regressors.row_phases import RowPhases

# What is left of a step after (settling) / a seconds behind F(s): (1 + 9.2) exp(-9.2), a thousandth.
_SETTLED = 9.2
# Samples that the central difference of five points needs on either side.
_REACH = 2


def differentiate_samples(samples: Iterable[Samples], form: EquationForm, rate: float) -> Iterator[Samples]:
    """Differentiate: dS/dt + D with y behind it, from evaluations of a form.

    The central difference has five points: that of three (as in [12.16]) would take (ωT)²/6 off a rate, which here,
    unlike there, stands alone against torque that nobody differentiated; five leave (ωT)⁴/30.

    Parameters
    ----------
    samples : iterable of Samples
        Consecutive evaluations of the form with y behind them, at the full rate.
    form : EquationForm
        Tells which entries belong to S and which to D.
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

    Parameters
    ----------
    samples : iterable of Samples
        Consecutive evaluations of the form with y behind them, at the full rate.
    form : EquationForm
        Tells which entries belong to S and which to D.
    period : float
        Sampling period, s.

    Yields
    ------
    Samples
        Two samples shorter at the beginning of a segment, and one at its end.
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
        # The integral of dS/dt is S itself: no error of a derivative or an integral gets into it.
        values[:, : form.n_stored] += part.values[inner, : form.n_stored]
        yield _replace_values(part, 2, 1, values)


def smooth_samples(samples: Iterable[Samples], pole: float, rate: float) -> Iterator[Samples]:
    """Filter rows by F(s) = a² / (s + a)² [12.29], made discrete by the bilinear transform; settled rows are used.

    W and Y pass the same filter, so that no discretisation can bias the estimates. Rows that are not used enter as
    zeros on both sides of the equations.

    Parameters
    ----------
    samples : iterable of Samples
        Consecutive rows of W and Y at the full rate.
    pole : float
        a in rad/s.
    rate : float
        Sampling rate in Hz.

    Yields
    ------
    Samples
        The filtered rows; those before the filter has settled are marked as not used.
    """
    # Importing it takes half a second, so that only those who need it do.
    from scipy import signal

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
    rows : iterable
        Decimated rows as (segment, t (m,), values (m, k)).
    length, step : int
        Rows in an interval, and rows from the beginning of one interval to that of the next.
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
            # Nothing is held over from one segment to the next: between them time is missing.
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
    selected, places = form.shared_entries
    out[:, places] = inner[:, selected]
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


# Intervals of the energy model begin every eighth of their length: nearer to each other they repeat each other.
_OVERLAP = 8

SHARE_OF_PERIOD = 8.0
"""Intervals of the energy model are so much shorter than the shortest period of the motion: energy swings twice as fast
as the motion, over half a swing it differs most, over a whole one not at all; and offsets add up over longer ones."""

Rows = Iterator[tuple[int, FloatArray, FloatArray]]
"""(segment, t (m,), [entries | y] (m, k)), used rows alone."""

Treatment = Callable[[Iterable[Samples], EquationForm, Recording, Preprocessing], Rows]
"""Makes rows of the evaluations of a form beside y."""


def stream_equations(
    samples: Iterable[Samples], form: EquationForm, recording: Recording, preprocessing: Preprocessing
) -> Rows:
    """Stream dS/dt + D and y through the parallel filter: the power model [12.52] and the base wrench.

    Parameters
    ----------
    samples : iterable of Samples
        Consecutive evaluations of the form with y behind them, at the full rate.
    form : EquationForm
        Tells which entries belong to S and which to D.
    recording : Recording
        The recording that the samples are of.
    preprocessing : Preprocessing
        Cut-off of the parallel filter, and decimation.

    Yields
    ------
    segment, t (m,), rows (m, k)
    """
    yield from low_pass_samples(differentiate_samples(samples, form, recording.sampling_rate), recording, preprocessing)


def filter_with_pole(pole: float) -> Treatment:
    """Return the treatment of the filtered dynamic model [12.28], [12.30]: rows pass F(s) with the pole a in rad/s."""

    def rows(
        samples: Iterable[Samples], form: EquationForm, recording: Recording, preprocessing: Preprocessing
    ) -> Rows:
        rate = recording.sampling_rate
        yield from low_pass_samples(
            smooth_samples(differentiate_samples(samples, form, rate), pole, rate), recording, preprocessing
        )

    return rows


def integrate_over_intervals(interval: float) -> Treatment:
    """Return the treatment of the energy model [12.43]-[12.49]: ΔS + ∫D dt and ∫y dt over intervals (s).

    S and the integrals pass the parallel filter before they are subtracted, so that an interval's ends are not two
    noisy samples; intervals begin every eighth of their length.
    """

    def rows(
        samples: Iterable[Samples], form: EquationForm, recording: Recording, preprocessing: Preprocessing
    ) -> Rows:
        spacing = recording.period * preprocessing.decimation
        length = max(1, round(interval / spacing))
        # Decimated rows are at the same time the ends of the intervals: intervals of all starts share them.
        knots = low_pass_samples(integrate_samples(samples, form, recording.period), recording, preprocessing)
        yield from take_differences(knots, length, max(1, length // _OVERLAP), spacing)

    return rows


def reduce_form(
    form: EquationForm,
    treatment: Treatment,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    memory: float = 0.0,
) -> Reduction:
    """Accumulate the equations of all recordings in triangular factors, one for each equation and block of time.

    Where an equation is about one joint alone, rows near which that joint stands are left out.

    Parameters
    ----------
    form : EquationForm
        Its columns become the reduction's.
    treatment : Treatment
        What the model does with them: `stream_equations`, `filter_with_pole` or `integrate_over_intervals`.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Hears of the share that is done.
    memory : float
        Seconds that the treatment remembers.

    Returns
    -------
    Reduction
        One equation for each equation of the form.
    """
    preprocessing, reference = inputs.preprocessing, inputs.reference
    layout = form.layout
    n_entries = form.n_entries
    # Only the filtered dynamic model has one equation for each joint; power, energy and wrench mix all joints.
    joint_by_joint = form.n_equations == form.observation.robot.n

    def make_rows(recording: Recording) -> Iterator[EquationRows]:
        phases = RowPhases.from_recording(form.observation, recording, preprocessing) if joint_by_joint else None
        samples = stream_samples(recording, preprocessing, _make_evaluation(form, reference, recording))
        for segment, t, values in treatment(samples, form, recording, preprocessing):
            rows = [
                np.hstack([values[:, places], values[:, n_entries + k : n_entries + k + 1]])
                for k, (places, _) in enumerate(layout)
            ]
            yield EquationRows(t, rows, segment, None if phases is None else phases.find_used_rows(segment, t, memory))

    return accumulate_equations(
        make_rows, [columns for _, columns in layout], form.observation.n_columns, inputs.recordings, progress
    )


def _make_evaluation(
    form: EquationForm, reference: ReferenceParameters, recording: Recording
) -> Callable[[SampleBlock], FloatArray]:
    """Return the function that evaluates the entries of S and D, with y behind them."""
    entries = SampleFunction(form.observation, reference, recording)
    n_entries = len(form.observation.entry_rows)

    def values(block: SampleBlock) -> FloatArray:
        rows = np.empty((len(block.t), n_entries + form.n_equations))
        entries.fill(block, rows[:, :n_entries])
        rows[:, n_entries:] = form.measured(block)
        return rows

    return values
