"""From recordings to the equations of all models but the dynamic one: streamed, filtered, accumulated into factors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import Reduction
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.regressors.folding import EquationRows, accumulate_equations
from dynident.regressors.forms import EquationForm
from dynident.regressors.row_phases import RowPhases
from dynident.regressors.stages import differentiate_samples, integrate_samples, smooth_samples, take_differences
from dynident.regressors.stream import SampleFunction, Samples, low_pass_samples, stream_samples

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
        Evaluations of the form, and y behind them, at the full rate.
    form : Form
    recording : Recording
    preprocessing : Preprocessing

    Yields
    ------
    segment, t (m,), rows (m, k)
    """
    yield from low_pass_samples(differentiate_samples(samples, form, recording.sampling_rate), recording, preprocessing)


def filter_with_pole(pole: float) -> Treatment:
    """Return the treatment of the filtered dynamic model [12.28], [12.30]: `plain` behind F(s) with pole a in rad/s."""

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
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = ignore_progress,
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
        make_rows, [columns for _, columns in layout], form.observation.n_columns, recordings, progress
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
