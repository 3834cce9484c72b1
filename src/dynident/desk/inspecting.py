"""A look at a file before it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from dynident.desk.robots import DriveGains, with_gains
from dynident.html import block, listed, paragraph, table
from dynident.identification.imports import Guess, Inspection, Question, inspect_file
from dynident.recordings.names import readable_path
from dynident.robot import Robot

_COLUMNS = ("what", "proposed", "how sure", "why")
_SHOWN, _NAMES = 30, 12


class ProposedColumns(TypedDict, total=False):
    """Arguments of `read_recordings`; none where nothing is proposed."""

    columns: dict[str, str]
    units: dict[str, str]
    rate: float


@dataclass(frozen=True, eq=False)
class InspectedFile:
    """What a file most probably holds; `read_recordings(path, robot=robot, **found.said)` takes it as proposed."""

    inspection: Inspection
    rate: float | None = None

    @property
    def guesses(self) -> tuple[Guess, ...]:
        """What was guessed, how surely, and why."""
        return () if self.inspection.proposal is None else self.inspection.proposal.guesses

    @property
    def questions(self) -> tuple[Question, ...]:
        """What has to be answered before the file can be used."""
        return () if self.inspection.proposal is None else self.inspection.proposal.questions

    @property
    def said(self) -> ProposedColumns:
        """Columns and units that are proposed, and the rate that was stated, as `read_recordings` takes them."""
        proposal = self.inspection.proposal
        if proposal is None:
            return {}
        said: ProposedColumns = {"columns": dict(proposal.columns), "units": dict(proposal.units)}
        return said if self.rate is None else {**said, "rate": self.rate}

    def __repr__(self) -> str:
        lines = [self._head()]
        lines += [f"  {one.field}: {one.value} ({one.confidence:.0%}: {one.reason})" for one in self.guesses[:_SHOWN]]
        left_out = len(self.guesses) - _SHOWN
        lines += [f"  … and {left_out} more (.guesses)"] if left_out > 0 else []
        lines += [f"  ? {one.field}: {one.detail}" for one in self.questions]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [(one.field, one.value, f"{one.confidence:.0%}", one.reason) for one in self.guesses]
        return block(
            paragraph(self._head(), strong=True),
            table(_COLUMNS, rows, right_from=len(_COLUMNS)) if rows else "",
            paragraph("To be answered:") if self.questions else "",
            listed(_question(one) for one in self.questions),
        )

    def _head(self) -> str:
        names = self.inspection.columns
        more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
        return f"{self.inspection.format}, {len(names)} columns: {', '.join(names[:_NAMES])}{more}"


def inspect(
    path: str | Path | Sequence[str | Path],
    robot: Robot | None = None,
    *,
    drive_gains: DriveGains | None = None,
    rate: float | None = None,
) -> InspectedFile:
    """Look at a file in any format that is read: what its columns are, in which units, and what is to be answered.

    Parameters
    ----------
    path : path, or several
        Several files that are one recording are given together: ("q.csv", "dq.csv", "tau.csv").
    robot : Robot, optional
        Whose recording it is; without it the columns are only listed.
    drive_gains : mapping of joint name to float, or one float a joint
        In N m (N) per unit of current, instead of the robot's.
    rate : float, optional
        Hz of the rows, where the file has no time.

    Raises
    ------
    DynidentError
        For a file that is not there.
    RecordingError
        For a file that cannot be read.
    """
    found = readable_path(path)
    machine = with_gains(robot, drive_gains) if robot is not None and drive_gains is not None else robot
    return InspectedFile(inspect_file(found, machine, rate), rate)


def _question(one: Question) -> str:
    return f"{one.field}: {one.detail}" + (f" ({', '.join(one.choices)})" if one.choices else "")
