"""Inspection of a file before it is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from dynident.desk.robots import DriveGains, set_drive_gains
from dynident.html import join_html, render_list, render_paragraph, render_table
from dynident.identification.imports import Guess, Inspection, Question, inspect_file
from dynident.recordings import RecordingMetadata
from dynident.recordings.names import check_readable_path
from dynident.robot import Robot

_COLUMNS = ("what", "proposed", "how sure", "why")
_SHOWN, _NAMES = 30, 12


class ProposedColumns(TypedDict, total=False):
    """Arguments of `read_recordings` that are proposed; empty where nothing is."""

    columns: dict[str, str]
    units: dict[str, str]
    metadata: RecordingMetadata


@dataclass(frozen=True, eq=False)
class InspectedFile:
    """The probable contents of a file; `read_recordings(path, robot=robot, **found.said)` reads it as proposed."""

    inspection: Inspection
    rate: float | None = None

    @property
    def guesses(self) -> tuple[Guess, ...]:
        """The guesses, with their probability and reason."""
        return () if self.inspection.proposal is None else self.inspection.proposal.guesses

    @property
    def questions(self) -> tuple[Question, ...]:
        """Questions to answer before the file can be used."""
        return () if self.inspection.proposal is None else self.inspection.proposal.questions

    @property
    def said(self) -> ProposedColumns:
        """Proposed columns and units, and the rate that was stated, as arguments of `read_recordings`."""
        proposal = self.inspection.proposal
        if proposal is None:
            return {}
        arguments: ProposedColumns = {"columns": dict(proposal.columns), "units": dict(proposal.units)}
        return arguments if self.rate is None else {**arguments, "metadata": RecordingMetadata(rate=self.rate)}

    def __repr__(self) -> str:
        lines = [self._format_head()]
        lines += [
            f"  {guess.field}: {guess.value} ({guess.confidence:.0%}: {guess.reason})"
            for guess in self.guesses[:_SHOWN]
        ]
        left_out = len(self.guesses) - _SHOWN
        lines += [f"  … and {left_out} more (.guesses)"] if left_out > 0 else []
        lines += [f"  ? {question.field}: {question.detail}" for question in self.questions]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [(guess.field, guess.value, f"{guess.confidence:.0%}", guess.reason) for guess in self.guesses]
        return join_html(
            render_paragraph(self._format_head(), strong=True),
            render_table(_COLUMNS, rows, right_from=len(_COLUMNS)) if rows else "",
            render_paragraph("To be answered:") if self.questions else "",
            render_list(_format_question(question) for question in self.questions),
        )

    def _format_head(self) -> str:
        names = self.inspection.columns
        rest = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
        return f"{self.inspection.format}, {len(names)} columns: {', '.join(names[:_NAMES])}{rest}"


def inspect(
    path: str | Path | tuple[str | Path, ...],
    robot: Robot | None = None,
    *,
    drive_gains: DriveGains | None = None,
    rate: float | None = None,
) -> InspectedFile:
    """Find out what the columns of a file are, in which units, and which questions are open.

    Parameters
    ----------
    path : path, or several
        In any format that can be read. Several files that are one recording are given as a tuple: ("q.csv", "dq.csv",
        "tau.csv").
    robot : Robot, optional
        The robot that was recorded; without it the columns are only listed.
    drive_gains : mapping of joint name to float, or one float a joint
        In N m (N) per unit of current, instead of the robot's.
    rate : float, optional
        Hz of the rows, where the file has no time.

    Returns
    -------
    InspectedFile

    Raises
    ------
    DynidentError
        For a file that is not there.
    RecordingError
        For a file that cannot be read.
    """
    readable = check_readable_path(path)
    machine = set_drive_gains(robot, drive_gains) if robot is not None and drive_gains is not None else robot
    return InspectedFile(inspect_file(readable, machine, rate), rate)


def _format_question(question: Question) -> str:
    return f"{question.field}: {question.detail}" + (f" ({', '.join(question.choices)})" if question.choices else "")
