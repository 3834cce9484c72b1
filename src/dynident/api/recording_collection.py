"""`Recordings`: checked recordings as a list with their findings; holds how many are shown."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynident.api.figure import Figure, join_figures
from dynident.api.named_tables import Framed, Items, Table
from dynident.errors import DynidentError, describe_value
from dynident.number_format import format_count
from dynident.presentation.recording_tables import (
    ShownRecording,
    build_recording_table,
    describe_findings,
    format_duration,
    format_windows,
)
from dynident.recordings import Check, Recording, RecordingMetadata, Revision
from dynident.recordings.file_names_and_digests import compute_digest, number_repeated_names, split_path
from dynident.recordings.row_storage import StoredSamples, load_stored_samples
from dynident.robot import Robot
from dynident.text_and_html_tables import join_html, render_list, render_paragraph

_SHOWN = 8
_LONGEST = 160


@dataclass(frozen=True)
class RecordingSource:
    """The file of a recording, its metadata, and what was changed in these since it was first read.

    Parameters
    ----------
    path : Path
        The file that was read, or the files of one recording joined to one path.
    metadata : RecordingMetadata
        How the file was read at last, with all changes.
    edits : tuple of Revision
        The changes of the metadata since the first reading, in their order.
    owner : object
        Keeps the temporary file of a recording that was given as data; None for a user's file.
    """

    path: Path
    metadata: RecordingMetadata
    edits: tuple[Revision, ...] = ()
    owner: object = None

    @property
    def sha256(self) -> str:
        """The hash of the file, "" where it no longer exists."""
        return compute_digest(self.path) if all(part.is_file() for part in split_path(self.path)) else ""


@dataclass(frozen=True, eq=False)
class CheckedRecording(Framed):
    """One recording that can be used for identification, with its checks.

    `to_frame` has a row for each stored sample, in order of time within each segment, none of it filtered: t (s),
    segment (its label), q_<joint> (rad, m where it slides), tau_<joint> (N m, N); where the file has them dq_<joint>
    (rad/s, m/s), ddq_<joint> (rad/s^2, m/s^2), q_command_<joint>, temperature_<joint> (degC) and base_fx to base_mz (N,
    N m); and used, whether the sample lies in the windows.

    Parameters
    ----------
    recording : Recording
        The recording as the library has it.
    checks : tuple of Check
        Results of the checks that were made when the file was read.
    robot : Robot, optional
        The robot that was recorded; it decides on the units of sliding joints.
    source : RecordingSource, optional
        The file that it was read from; None for a recording that was made in memory.
    """

    recording: Recording
    checks: tuple[Check, ...] = ()
    robot: Robot | None = None
    source: RecordingSource | None = None

    @property
    def name(self) -> str:
        """The name of the recording: that of its file without the ending."""
        return self.recording.name

    def __len__(self) -> int:
        return self.recording.n_samples

    @property
    def sampling_rate(self) -> float:
        """Samples per second, Hz."""
        return self.recording.sampling_rate

    @property
    def findings(self) -> tuple[Check, ...]:
        """The checks that found something."""
        return tuple(check for check in self.checks if check.status != "ok")

    def save(self, folder: str | Path) -> None:
        """Save the checked recording in a folder, as `Recordings.save` does.

        Parameters
        ----------
        folder : path
            It is made where it does not exist.

        Raises
        ------
        DynidentError
            For a recording that is held in memory.
        """
        Recordings((self,)).save(folder)

    def _columns(self) -> Table:
        samples = self._read_samples()
        return Table(samples.columns, samples.units)

    def plot(self) -> Figure:
        """Draw position and torque of every joint over time.

        Returns
        -------
        Figure
            Positions and torques over time; times outside of the windows are grey.
        """
        from dynident.reports.figures.signals_over_time import draw_recording

        # Without a robot the kinds of the joints are not known, and all are drawn as revolute.
        slides = () if self.robot is None else tuple(joint.kind == "prismatic" for joint in self.robot.joints)
        return join_figures([draw_recording(self.recording, slides)], f"recording {self.name}")

    def _read_samples(self) -> StoredSamples:
        samples = load_stored_samples(
            self.recording, () if self.robot is None else [joint.kind for joint in self.robot.joints]
        )
        used = self.recording.inside_windows(np.asarray(samples.columns["t"], dtype=np.float64))
        return replace(samples, columns={**samples.columns, "used": used})

    def __repr__(self) -> str:
        n_findings = len(self.findings)
        words = f", {n_findings} finding{'s' if n_findings > 1 else ''} (.findings)" if n_findings else ""
        return f"CheckedRecording({_format_line(self.recording)}{words})"

    def _repr_html_(self) -> str:
        return Recordings((self,))._repr_html_()


@dataclass(frozen=True, eq=False)
class Recordings(Items[CheckedRecording], Framed):
    """Recordings in the order of their files: `runs[0]`, `runs[:1]`, or by name, `runs["run2"]`.

    `to_frame` has one below the other: recording (its name), then the columns of `CheckedRecording`; NaN where a
    recording lacks a column.

    Parameters
    ----------
    items : tuple of CheckedRecording
        The recordings, in the order of their files.

    Examples
    --------
    >>> runs = dy.read_recordings("run1.csv", robot=robot) + dy.read_recordings("run2.csv", robot=robot)
    >>> [run.name for run in runs[1:]]
    ['run2']
    """

    items: tuple[CheckedRecording, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the recordings."""
        return tuple(item.name for item in self.items)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings as the functions of the library take them."""
        return tuple(item.recording for item in self.items)

    @property
    def findings(self) -> dict[str, tuple[Check, ...]]:
        """The checks that found something, by recording; only recordings that have any."""
        return {item.name: item.findings for item in self.items if item.findings}

    def save(self, folder: str | Path) -> None:
        """Save the checked recordings in a folder, each as `<name>.checked.parquet`.

        `dynident.recordings.open_recording` opens them again.

        Parameters
        ----------
        folder : path
            It is made where it does not exist.

        Raises
        ------
        DynidentError
            For a recording that is held in memory, or two of the same name.
        """
        # Checked before anything is written: the second file would replace the first.
        repeated = next((name for name in self.names if self.names.count(name) > 1), None)
        if repeated is not None:
            raise DynidentError(f"two recordings are called {repeated!r}; save them in different folders")
        folder = Path(folder)
        # Only now, after all names are checked: a refused call leaves no empty folder.
        folder.mkdir(parents=True, exist_ok=True)
        for item in self.items:
            if item.recording.path is None:
                raise DynidentError(
                    f"{item.name} exists only in memory; only recordings from read_recordings can be saved"
                )
            destination = folder / f"{item.name}.checked.parquet"
            # Copied beside its destination first: a copy that breaks off does not destroy an older file.
            unfinished = destination.with_suffix(".unfinished")
            shutil.copyfile(item.recording.path, unfinished)
            unfinished.replace(destination)

    def _columns(self) -> Table:
        # The stored samples, not the filtered ones: a frame is for looking at the data themselves.
        samples = [item._read_samples() for item in self.items]
        counts = [len(recording_samples.columns["t"]) for recording_samples in samples]
        names = dict.fromkeys(name for recording_samples in samples for name in recording_samples.columns)
        columns: dict[str, NDArray[np.generic]] = {"recording": np.repeat(self.names, counts)}
        # A column that only some recordings have is NaN in the others.
        for name in names:
            parts = [
                recording_samples.columns.get(name, np.full(m, np.nan))
                for recording_samples, m in zip(samples, counts, strict=True)
            ]
            columns[name] = np.concatenate(parts)
        return Table(
            columns, {name: unit for recording_samples in samples for name, unit in recording_samples.units.items()}
        )

    def plot(self) -> Figure:
        """Draw position and torque of every joint over time, one recording below the other.

        Returns
        -------
        Figure
            The drawings, each under the name of its recording.

        Raises
        ------
        DynidentError
            Where there is no recording.
        """
        if not self.items:
            raise DynidentError("nothing to draw: there are no recordings")
        parts = [item.plot() for item in self.items]
        return join_figures(parts, f"recordings {', '.join(self.names)}", self.names)

    def __contains__(self, item: object) -> bool:
        return item in self.names if isinstance(item, str) else item in self.items

    def report_unused_gains(self) -> Recordings:
        """Return the recordings with a warning where gains stated for them have no effect, as torque was recorded."""
        return Recordings(tuple(_report_unused_gains(item) for item in self.items))

    def __add__(self, other: SomeRecordings) -> Recordings:
        added = as_recordings(other).items
        # Data from memory have the same name unless one is stated; tables and models tell recordings apart by it.
        names = number_repeated_names([item.name for item in (*self.items, *added)])[len(self.items) :]
        renamed = (
            item if item.name == name else replace(item, recording=replace(item.recording, name=name))
            for item, name in zip(added, names, strict=True)
        )
        return Recordings((*self.items, *renamed))

    def __repr__(self) -> str:
        lines = [f"  {_format_line(item.recording)}" for item in self.items[:_SHOWN]]
        lines += [f"  … and {len(self.items) - _SHOWN} more"] if len(self.items) > _SHOWN else []
        findings = [f"  {line}" for line in describe_findings(self._show())]
        # Details of checks may be long; `findings` has them in full.
        lines += [text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…" for text in findings[:_SHOWN]]
        lines += [f"  … and {len(findings) - _SHOWN} more findings (.findings)"] if len(findings) > _SHOWN else []
        return "\n".join([f"Recordings({len(self.items)})", *lines])

    def _repr_html_(self) -> str:
        shown = self._show()
        return join_html(
            render_paragraph(format_count(len(self.items), "recording"), strong=True),
            build_recording_table(shown).drop_columns("used for").to_html(),
            render_list(describe_findings(shown)),
        )

    def _show(self) -> list[ShownRecording]:
        return [ShownRecording(item.recording, item.checks) for item in self.items]


SomeRecordings = Recordings | CheckedRecording | Recording | Iterable[CheckedRecording | Recording]
"""What functions take for recordings: several or one, as `read_recordings` or the library gives them."""


def as_recordings(recordings: SomeRecordings) -> Recordings:
    """Return recordings of any accepted form as one collection.

    Parameters
    ----------
    recordings : Recordings, CheckedRecording, Recording, or several of the latter two
        What a function was given as recordings.

    Returns
    -------
    Recordings
        The same recordings; those of the library have no checks and no source.

    Raises
    ------
    DynidentError
        For a file's name, or anything else that is no recording.
    """
    if isinstance(recordings, Recordings):
        return recordings
    # A text counts as one item, so that a file's name is refused as a whole and not letter by letter; a frame, too.
    is_one = isinstance(recordings, (CheckedRecording, Recording, str, Mapping)) or hasattr(recordings, "columns")
    is_one = is_one or not isinstance(recordings, Iterable)
    items: list[object] = [recordings] if is_one else list(recordings)  # type: ignore[arg-type]
    return Recordings(tuple(_to_checked(item) for item in items))


def _report_unused_gains(item: CheckedRecording) -> CheckedRecording:
    warning = "The stated drive gains are not used: give columns of currents, or leave them out."
    # The check names the column of a current where gains are used.
    checks = tuple(
        replace(check, status="warning", detail=f"{check.detail} {warning}")
        if (check.name, check.status, check.column) == ("torque_source", "ok", "")
        else check
        for check in item.checks
    )
    return replace(item, checks=checks)


def _to_checked(item: object) -> CheckedRecording:
    if isinstance(item, CheckedRecording):
        return item
    if isinstance(item, Recording):
        return CheckedRecording(item)
    raise DynidentError(
        f"{describe_value(item)} is not a recording; read files and data with read_recordings(…, robot=robot) first",
        title="Not a recording",
    )


def _format_line(recording: Recording) -> str:
    used = f"; used: {format_windows(recording)}" if recording.windows else ""
    return (
        f"{recording.name}: {recording.n} joints, {recording.n_samples} samples at {recording.sampling_rate:.4g} Hz, "
        f"{format_duration(recording)}{used}"
    )
