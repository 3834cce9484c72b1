"""`dynident.compare`: measured against predicted torque of recordings, as tables and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynident.api.argument_checks import check_arguments, require
from dynident.api.figure import Figure, join_figures
from dynident.api.model import Model
from dynident.api.model_identification import as_model
from dynident.api.named_tables import Framed, Items, Table
from dynident.api.recording_collection import CheckedRecording, SomeRecordings, as_recordings
from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison, Judgement, judge
from dynident.diagnosis import compare as compare_recording
from dynident.errors import DynidentError, describe_missing_joint
from dynident.file_output import TABLE_ENDINGS, check_ending
from dynident.identification import Identification, check_same_recordings
from dynident.number_format import format_percent
from dynident.presentation.model_tables import compare_by_joint, describe_interval
from dynident.presentation.tables import ReportedTable
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings.arrow_tables import table_from_arrays, write_table
from dynident.recordings.joint_phases import Phase
from dynident.text_and_html_tables import join_html, render_list, render_paragraph

_SHOWN = 5
_PHASES = np.array([phase.name.lower() for phase in Phase])


@dataclass(frozen=True, eq=False)
class ComparedRecording(Framed):
    """One recording compared with the prediction of a model.

    `to_frame` has a row for each joint and time, joint after joint: joint, unit (N m or N), t (s), segment (of the
    recording, from 0 on), measured, predicted, raw_residual, residual, friction_lower, friction_upper, interval_lower,
    interval_upper, all eight in `unit`, and phase (moving, reversing, standing, passive_halt, no_torque). Torque is
    filtered and decimated. raw_residual is measured minus predicted on every row. residual is the same where a joint
    moves or reverses; where it stands the sign of friction is unknown, and residual is the distance to what static
    friction may hold, from friction_lower to friction_upper. Measured torque of a right model is between interval_lower
    and interval_upper with a probability of 95 %: the band of the plot about the prediction. Errors of the model are
    root mean squares of residual, where joints move or on all rows, as `ErrorTable` says.

    Parameters
    ----------
    recording : CheckedRecording
        The recording that was compared.
    comparison : Comparison
        Measured and predicted signals over time.
    judgement : Judgement
        The error in comparison with the noise.
    """

    recording: CheckedRecording
    comparison: Comparison
    judgement: Judgement

    @property
    def name(self) -> str:
        """The name of the recording."""
        return self.recording.name

    def _columns(self) -> Table:
        return Table(self._build_arrays())

    def save(self, path: str | Path) -> None:
        """Write the signals with a row for each time, as .csv or .parquet.

        Its columns are t, segment, and for every joint measured_, predicted_, raw_residual_, residual_,
        friction_lower_, friction_upper_, band_ (half of the 95 % interval), q_, dq_ and phase_, as in `to_frame`. The
        phase is moving, reversing, standing, or passive_halt where a passive joint reverses or stands.

        Parameters
        ----------
        path : path
            The file to write; its ending decides on the format.

        Raises
        ------
        DynidentError
            For another ending, or a folder that does not exist.
        """
        comparison = self.comparison
        columns: dict[str, NDArray[np.generic]] = {"t": comparison.t, "segment": comparison.segment.astype(np.int64)}
        signals = {**self._list_signals(), "band": comparison.band, "q": comparison.q, "dq": comparison.dq}
        for signal, values in signals.items():
            if signal.startswith("interval"):
                continue
            for index, joint in enumerate(comparison.joint_names):
                # Arrow takes columns that are contiguous.
                columns[f"{signal}_{joint}"] = np.ascontiguousarray(values[:, index])
        for index, joint in enumerate(comparison.joint_names):
            columns[f"phase_{joint}"] = _PHASES[comparison.phase[:, index]]
        write_table(table_from_arrays(columns), check_ending(path, TABLE_ENDINGS))

    def plot(self, joints: str | Sequence[str] = ()) -> Figure:
        """Draw measured and predicted torque, and the residual, over time.

        Parameters
        ----------
        joints : names of joints
            All of them where none is named.

        Returns
        -------
        Figure
            A panel for each joint, with torque and residual over time.

        Raises
        ------
        DynidentError
            For a joint that the robot does not have.
        """
        from dynident.reports.figures.signals_over_time import JOINTS_PER_FIGURE, draw_torque

        names = self.comparison.joint_names
        joints = [joints] if isinstance(joints, str) else joints
        # A misspelt joint is refused: leaving it out would look as if all had been drawn.
        strangers = [name for name in joints if name not in names]
        if strangers:
            raise DynidentError(describe_missing_joint(strangers[0], names))
        indices = [names.index(name) for name in joints or names]
        parts = [
            draw_torque(self.comparison, indices[first : first + JOINTS_PER_FIGURE], self.name)
            for first in range(0, len(indices), JOINTS_PER_FIGURE)
        ]
        return join_figures(parts, f"measured and predicted torque of {self.name}")

    def _build_arrays(self) -> dict[str, NDArray[np.generic]]:
        comparison = self.comparison
        m, n = comparison.measured.shape
        return {
            "joint": np.repeat(comparison.joint_names, m),
            "unit": np.repeat(comparison.units, m),
            "t": np.tile(comparison.t, n),
            "segment": np.tile(comparison.segment.astype(np.int64), n),
            # Column by column, as the joints are repeated: joint after joint.
            **{name: values.ravel("F") for name, values in self._list_signals().items()},
            "phase": _PHASES[comparison.phase.ravel("F")],
        }

    def _list_signals(self) -> dict[str, FloatArray]:
        """Return torques (m, n) in the joint's unit by name."""
        comparison = self.comparison
        return {
            "measured": comparison.measured,
            "predicted": comparison.predicted,
            "raw_residual": comparison.raw_residual,
            "residual": comparison.residual,
            "friction_lower": comparison.lower,
            "friction_upper": comparison.upper,
            "interval_lower": comparison.predicted - comparison.band,
            "interval_upper": comparison.predicted + comparison.band,
        }

    def __repr__(self) -> str:
        return self._table().to_text(f"ComparedRecording({self._format_head()})")

    def _repr_html_(self) -> str:
        worst = [describe_interval(interval) for interval in self.comparison.worst[:_SHOWN]]
        return join_html(
            render_paragraph(self._format_head(), strong=True),
            self._table().to_html(),
            render_list(self.judgement.notes),
            render_paragraph("Worst:") + render_list(worst) if worst else "",
        )

    def _table(self) -> ReportedTable:
        return compare_by_joint(self.name, self.comparison, self.judgement)

    def _format_head(self) -> str:
        comparison = self.comparison
        moving, everywhere = comparison.moving_errors.relative_total, comparison.errors.relative_total
        return (
            f"{self.name}: error {format_percent(moving)} where joints move, {format_percent(everywhere)} on all rows"
        )


@dataclass(frozen=True, eq=False)
class Comparisons(Items[ComparedRecording], Framed):
    """Recordings compared with the prediction of one model; by number, or by the recording's name.

    `to_frame` has one below the other: recording (its name), then the columns of `ComparedRecording`.

    Parameters
    ----------
    model : Model
        The model that predicted the torque.
    items : tuple of ComparedRecording
        The comparisons, in the order of the recordings.
    """

    model: Model
    items: tuple[ComparedRecording, ...]

    def _columns(self) -> Table:
        arrays = [item._build_arrays() for item in self.items]
        counts = [len(recording_arrays["t"]) for recording_arrays in arrays]
        columns: dict[str, NDArray[np.generic]] = {"recording": np.repeat([item.name for item in self.items], counts)}
        columns |= {
            name: np.concatenate([recording_arrays[name] for recording_arrays in arrays])
            for name in (arrays[0] if arrays else ())
        }
        return Table(columns)

    def plot(self, joints: str | Sequence[str] = ()) -> Figure:
        """Draw all of them, one below the other.

        Parameters
        ----------
        joints : names of joints
            All of them where none is named.

        Returns
        -------
        Figure
            A panel for each joint, with torque and residual over time.

        Raises
        ------
        DynidentError
            For a joint that the robot does not have.
        """
        # One <svg> per recording, each under the recording's name.
        names = [item.name for item in self.items]
        parts = [item.plot(joints) for item in self.items]
        return join_figures(parts, f"measured and predicted torque of {', '.join(names)}", names)

    def __repr__(self) -> str:
        lines = [f"  {item._format_head()}" for item in self.items[:_SHOWN]]
        rest = [f"  … and {len(self.items) - _SHOWN} more"] if len(self.items) > _SHOWN else []
        return "\n".join([f"Comparisons({len(self.items)})", *lines, *rest])

    def _repr_html_(self) -> str:
        return join_html(*(item._repr_html_() for item in self.items))


@check_arguments
def compare(
    model: Model | Identification,
    recordings: SomeRecordings,
    *,
    fit: SomeRecordings | None = None,
    progress: Progress = ignore_progress,
) -> Comparisons:
    """Compare measured with predicted torque, joint by joint.

    Parameters
    ----------
    model : Model
        The identified model, with or without its recordings.
    recordings : recordings
        Recordings of the same robot, whose torque is predicted.
    fit : recordings, optional
        Recordings that the model was fitted to, if the model does not contain them. With them, the comparison
        says whether a motion only repeats one of theirs.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Comparisons
        One comparison for each recording, in their order.

    Raises
    ------
    DynidentError
        If there is no recording, if it is of another robot, or if no row is left after filtering.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1])
    >>> (comparison,) = dy.compare(model, runs[1])
    >>> comparison.name
    'run2'
    """
    desk_model = as_model(model)
    require(
        not isinstance(recordings, (Model, Identification)),
        recordings,
        "recordings",
        "a model is compared with recordings; dy.Ladder((a, b)) shows the errors of two models",
    )
    checked_recordings = as_recordings(recordings)
    if not checked_recordings:
        raise DynidentError("give at least one recording for the comparison", title="Recordings needed")
    # Only with the recordings of the fit can it be told whether a recording was fitted to, or repeats one of these.
    fit_recordings = (desk_model.recordings if fit is None else as_recordings(fit)).recordings
    if fit is not None:
        check_same_recordings(desk_model.identification, fit_recordings)
    compared = []
    for index, item in enumerate(checked_recordings):
        share = scale_progress(progress, index / len(checked_recordings), (index + 1) / len(checked_recordings))
        comparison = compare_recording(desk_model.identification, item.recording, share)
        # A recording that the model was identified from is fit data, and no repetition is looked for.
        others = [recording for recording in fit_recordings if recording.source is not item.recording.source]
        is_fit_data = len(others) < len(fit_recordings)
        judgement = judge(
            comparison, item.recording, desk_model.identification.preprocessing, () if is_fit_data else others
        )
        compared.append(ComparedRecording(item, comparison, judgement))
    return Comparisons(desk_model, tuple(compared))
