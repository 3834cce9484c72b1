"""From recordings to the equations of all models but the dynamic one: streamed, filtered, accumulated into factors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import Reduction
from dynident.progress import Progress, silent
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.regressors.folding import EquationRows, folded
from dynident.regressors.forms import Form
from dynident.regressors.row_phases import RowPhases
from dynident.regressors.stages import differences, integrated, rated, smoothed
from dynident.regressors.stream import SampleFunction, Samples, low_passed, sampled

# Intervals of the energy model begin every eighth of their length: nearer to each other they repeat each other.
_OVERLAP = 8

SHARE_OF_PERIOD = 8.0
"""Intervals of the energy model are so much shorter than the shortest period of the motion: energy swings twice as fast
as the motion, over half a swing it differs most, over a whole one not at all; and offsets add up over longer ones."""

Rows = Iterator[tuple[int, FloatArray, FloatArray]]
"""(segment, t (m,), [entries | y] (m, k)), used rows alone."""

Treatment = Callable[[Iterable[Samples], Form, Recording, Preprocessing], Rows]
"""Makes rows of the evaluations of a form beside y."""


def plain(samples: Iterable[Samples], form: Form, recording: Recording, preprocessing: Preprocessing) -> Rows:
    """Stream dS/dt + D and y through the parallel filter: the power model [12.52] and the base wrench.

    Parameters
    ----------
    samples : iterable of Samples
        Evaluations of the form, and y behind them, at the full rate.
    form : Form
    recording : Recording
    preprocessing : Preprocessing

    Yields
    ------
    segment, t (m,), rows (m, k)
    """
    yield from low_passed(rated(samples, form, recording.sampling_rate), recording, preprocessing)


def filtered(pole: float) -> Treatment:
    """Return the treatment of the filtered dynamic model [12.28], [12.30]: `plain` behind F(s) with pole a in rad/s."""

    def rows(samples: Iterable[Samples], form: Form, recording: Recording, preprocessing: Preprocessing) -> Rows:
        rate = recording.sampling_rate
        yield from low_passed(smoothed(rated(samples, form, rate), pole, rate), recording, preprocessing)

    return rows


def over_intervals(interval: float) -> Treatment:
    """Return the treatment of the energy model [12.43]-[12.49]: ΔS + ∫D dt and ∫y dt over intervals (s).

    S and the integrals pass the parallel filter before they are subtracted, so that an interval's ends are not two
    noisy samples; intervals begin every eighth of their length.
    """

    def rows(samples: Iterable[Samples], form: Form, recording: Recording, preprocessing: Preprocessing) -> Rows:
        spacing = recording.period * preprocessing.decimation
        length = max(1, round(interval / spacing))
        # Decimated rows are at the same time the ends of the intervals: intervals of all starts share them.
        knots = low_passed(integrated(samples, form, recording.period), recording, preprocessing)
        yield from differences(knots, length, max(1, length // _OVERLAP), spacing)

    return rows


def reduce_form(
    form: Form,
    treatment: Treatment,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = silent,
    memory: float = 0.0,
) -> Reduction:
    """Accumulate the equations of all recordings in triangular factors, one for each equation and block of time.

    Where an equation is about one joint alone, rows near which that joint stands are left out.

    Parameters
    ----------
    form : Form
        Its columns become the reduction's.
    treatment : Treatment
        What the model does with them: `plain`, `filtered` or `over_intervals`.
    recordings : sequence of Recording
    preprocessing : Preprocessing
    reference : ReferenceParameters
        What torque is predicted with.
    progress : Progress
    memory : float
        Seconds that the treatment remembers.

    Returns
    -------
    Reduction
    """
    layout = form.layout
    n_entries = form.n_entries
    # Only the filtered dynamic model has one equation for each joint; power, energy and wrench mix all joints.
    joint_by_joint = form.n_equations == form.observation.robot.n

    def rows_of(recording: Recording) -> Iterator[EquationRows]:
        phases = RowPhases.of(form.observation, recording, preprocessing) if joint_by_joint else None
        samples = sampled(recording, preprocessing, _evaluations(form, reference, recording))
        for segment, t, values in treatment(samples, form, recording, preprocessing):
            rows = [
                np.hstack([values[:, places], values[:, n_entries + k : n_entries + k + 1]])
                for k, (places, _) in enumerate(layout)
            ]
            yield EquationRows(t, rows, segment, None if phases is None else phases.used(segment, t, memory))

    return folded(rows_of, [columns for _, columns in layout], form.observation.n_columns, recordings, progress)


def _evaluations(
    form: Form, reference: ReferenceParameters, recording: Recording
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
