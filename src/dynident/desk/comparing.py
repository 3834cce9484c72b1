"""Measured against predicted torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from dynident.desk.figure import Figure, figure_of
from dynident.desk.frames import Columns, Framed
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import CheckedRecording, SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.diagnosis import Comparison, Judgement, judge
from dynident.diagnosis import compare as compare_recording
from dynident.errors import DynidentError
from dynident.html import block, listed, paragraph, table
from dynident.identification import Identification, check_same_recordings
from dynident.progress import Progress, part, silent
from dynident.recordings.phases import Phase
from dynident.reports.numbers import number, percent

_SHOWN = 5
_PHASES = np.array([phase.name.lower() for phase in Phase])
_COLUMNS = ("joint", "error, moving", "rms", "all rows", "noise floor", "over noise")


@dataclass(frozen=True, eq=False)
class ComparedRecording(Framed):
    """One recording beside the prediction: `comparison` holds the signals, `judgement` what the error is worth.

    `to_frame` has a row a joint and time, joint after joint: joint, unit (N m or N), t (s), segment (the recording's,
    from 0 on), measured, predicted, residual, lower, upper, all five in `unit`, and phase (moving, reversing, standing,
    passive_halt). Torque is filtered and thinned. Where a joint stands its residual is the distance to what static
    friction may hold, from lower to upper.
    """

    recording: CheckedRecording
    comparison: Comparison
    judgement: Judgement

    @property
    def name(self) -> str:
        """What the recording is called."""
        return self.recording.name

    def _columns(self) -> Columns:
        return Columns(self._arrays())

    def plot(self, joints: Sequence[str] = ()) -> Figure:
        """Draw measured and predicted torque, and what is left, over time.

        Parameters
        ----------
        joints : names of joints
            All of them where none is named.

        Raises
        ------
        DynidentError
            For a joint that there is not.
        """
        from dynident.reports.figures.torque import JOINTS_A_FIGURE, torque_figure

        names = self.comparison.joint_names
        strangers = [name for name in joints if name not in names]
        if strangers:
            raise DynidentError(f"there is no joint {strangers[0]!r}; the robot has: {', '.join(names)}")
        wanted = [names.index(name) for name in joints or names]
        parts = [
            torque_figure(self.comparison, wanted[first : first + JOINTS_A_FIGURE], self.name)
            for first in range(0, len(wanted), JOINTS_A_FIGURE)
        ]
        return figure_of(parts, f"measured and predicted torque of {self.name}")

    def _arrays(self) -> dict[str, NDArray[np.generic]]:
        found = self.comparison
        m, n = found.measured.shape
        signals = {
            "measured": found.measured,
            "predicted": found.predicted,
            "residual": found.residual,
            "lower": found.lower,
            "upper": found.upper,
        }
        return {
            "joint": np.repeat(found.joint_names, m),
            "unit": np.repeat(found.units, m),
            "t": np.tile(found.t, n),
            "segment": np.tile(found.segment.astype(np.int64), n),
            **{name: values.ravel("F") for name, values in signals.items()},
            "phase": _PHASES[found.phase.ravel("F")],
        }

    def __repr__(self) -> str:
        rows = [self._row(j) for j in range(len(self.comparison.joint_names))]
        return text_table(f"ComparedRecording({self._head()})", _COLUMNS, rows, len(rows))

    def _repr_html_(self) -> str:
        rows = [self._row(j) for j in range(len(self.comparison.joint_names))]
        worst = [
            f"{one.joint}, {one.start:.2f} to {one.end:.2f} s: {one.ratio:.1f} x the joint's own rms"
            for one in self.comparison.worst[:_SHOWN]
        ]
        return block(
            paragraph(self._head(), strong=True),
            table(_COLUMNS, rows),
            listed(self.judgement.notes),
            paragraph("Worst:") + listed(worst) if worst else "",
        )

    def _head(self) -> str:
        found = self.comparison
        moving, everywhere = found.moving_errors.relative_total, found.errors.relative_total
        return f"{self.name}: error {percent(moving)} where joints move, {percent(everywhere)} on all rows"

    def _row(self, joint: int) -> tuple[str, ...]:
        found, judged = self.comparison, self.judgement
        moving, unit = found.moving_errors, found.units[joint]
        moves = bool(moving.counts[joint])
        return (
            found.joint_names[joint],
            percent(float(moving.relative[joint])) if moves else "never",
            f"{number(float(moving.rms[joint]))} {unit}" if moves else "–",
            percent(float(found.errors.relative[joint])),
            f"{number(float(judged.noise.values[joint]))} {unit}",
            f"{judged.over_noise[joint]:.1f} x" if moving.counts[joint] else "–",
        )


@dataclass(frozen=True, eq=False)
class Comparisons(Sequence[ComparedRecording], Framed):
    """Recordings beside the prediction of one model; by number, or by the recording's name.

    `to_frame` has one below the other: recording (its name), then the columns of `ComparedRecording`.
    """

    model: Model
    items: tuple[ComparedRecording, ...]

    def _columns(self) -> Columns:
        found = [item._arrays() for item in self.items]
        counts = [len(one["t"]) for one in found]
        columns: dict[str, NDArray[np.generic]] = {"recording": np.repeat([item.name for item in self.items], counts)}
        columns |= {name: np.concatenate([one[name] for one in found]) for name in (found[0] if found else ())}
        return Columns(columns)

    def plot(self, joints: Sequence[str] = ()) -> Figure:
        """Draw all of them, one below the other.

        Raises
        ------
        DynidentError
            For a joint that there is not.
        """
        names = [item.name for item in self.items]
        svgs = [item.plot(joints).svg for item in self.items]
        return figure_of(svgs, f"measured and predicted torque of {', '.join(names)}", names)

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[ComparedRecording]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int | str) -> ComparedRecording: ...
    @overload
    def __getitem__(self, index: slice) -> Comparisons: ...
    def __getitem__(self, index: int | str | slice) -> ComparedRecording | Comparisons:
        if isinstance(index, slice):
            return Comparisons(self.model, self.items[index])
        if isinstance(index, str):
            found = next((item for item in self.items if item.name == index), None)
            if found is None:
                raise KeyError(f"there is no {index!r}; there are: {', '.join(item.name for item in self.items)}")
            return found
        return self.items[index]

    def __repr__(self) -> str:
        shown = [f"  {item._head()}" for item in self.items[:_SHOWN]]
        more = [f"  … and {len(self.items) - _SHOWN} more"] if len(self.items) > _SHOWN else []
        return "\n".join([f"Comparisons({len(self.items)})", *shown, *more])

    def _repr_html_(self) -> str:
        return block(*(item._repr_html_() for item in self.items))


def compare(
    model: Model | Identification,
    recordings: SomeRecordings,
    *,
    learnt: SomeRecordings | None = None,
    progress: Progress = silent,
) -> Comparisons:
    """Hold predicted torque against recordings, joint by joint.

    Parameters
    ----------
    model : Model
    recordings : recordings
    learnt : recordings, optional
        What the model was identified from, where the model has not kept it: tells whether a motion only repeats that.

    Raises
    ------
    DynidentError
        Where there is no recording, it is another robot's, or no row is left after filtering.
    """
    known, tried = as_model(model), as_recordings(recordings)
    if not tried:
        raise DynidentError("give at least one recording to compare with", title="Recordings needed")
    seen = (known.recordings if learnt is None else as_recordings(learnt)).recordings
    if learnt is not None:
        check_same_recordings(known.identification, seen)
    found = []
    for index, item in enumerate(tried):
        share = part(progress, index / len(tried), (index + 1) / len(tried))
        comparison = compare_recording(known.identification, item.recording, share)
        others = [one for one in seen if one.source is not item.recording.source]
        own = len(others) < len(seen)
        judged = judge(comparison, item.recording, known.identification.preprocessing, () if own else others)
        found.append(ComparedRecording(item, comparison, judged))
    return Comparisons(known, tuple(found))
