"""A look at a file before it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynident.desk.robots import DriveGains, with_gains
from dynident.errors import DynidentError
from dynident.identification.imports import Guess, Inspection, Question, inspect_file
from dynident.robot import Robot


@dataclass(frozen=True, eq=False)
class InspectedFile:
    """What a file most probably holds; `read_recordings(path, robot=robot, **found.said)` takes it as proposed."""

    inspection: Inspection

    @property
    def guesses(self) -> tuple[Guess, ...]:
        """What was guessed, how surely, and why."""
        return () if self.inspection.proposal is None else self.inspection.proposal.guesses

    @property
    def questions(self) -> tuple[Question, ...]:
        """What has to be answered before the file can be used."""
        return () if self.inspection.proposal is None else self.inspection.proposal.questions

    @property
    def said(self) -> Mapping[str, Any]:
        """Columns and units that are proposed, as `read_recordings` takes them."""
        proposal = self.inspection.proposal
        return {} if proposal is None else {"columns": dict(proposal.columns), "units": dict(proposal.units)}

    def __repr__(self) -> str:
        found = self.inspection
        lines = [f"{found.format}, {len(found.columns)} columns: {', '.join(found.columns[:12])}"]
        lines += [f"  {one.field}: {one.value} ({one.confidence:.0%}: {one.reason})" for one in self.guesses]
        lines += [f"  ? {one.field}: {one.detail}" for one in self.questions]
        return "\n".join(lines)


def inspect(path: str | Path, robot: Robot | None = None, *, drive_gains: DriveGains | None = None) -> InspectedFile:
    """Look at a file in any format that is read: what its columns are, in which units, and what is to be answered.

    Parameters
    ----------
    path : path
    robot : Robot, optional
        Whose recording it is; without it the columns are only listed.
    drive_gains : mapping of joint name to float, or one float a joint
        In N m (N) per unit of current, instead of the robot's.

    Raises
    ------
    DynidentError
        For a file that is not there.
    RecordingError
        For a file that cannot be read.
    """
    found = Path(path)
    if not found.is_file():
        raise DynidentError(f"there is no file {found}", pointer=str(found), title="No such file")
    machine = with_gains(robot, drive_gains) if robot is not None and drive_gains is not None else robot
    return InspectedFile(inspect_file(found, machine))
