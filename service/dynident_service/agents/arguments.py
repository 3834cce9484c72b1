"""Arguments of agents' tools: files within the one folder, robots, requests as the contract states them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

import dynident as dy
from dynident.api.proposed_metadata import ProposalReader
from dynident.api.recording_files import read_files
from dynident.api.recordings_in_memory import SourceFile
from dynident.api.robot_files import check_reads_no_others
from dynident.diagnosis.diagnosis_request import DiagnosisChoices
from dynident.errors import DynidentError, Remedy
from dynident.excitation.design_request import DesignRequest
from dynident.export.export_request import ExportChoices
from dynident.identification.identification_choices import IdentificationChoices
from dynident.known_robots import list_library_arms, list_stock_robots
from dynident.progress import Progress, scale_progress
from dynident.recordings import Filters, RecordingMetadata
from dynident.recordings.file_names_and_digests import JOINT, split_path
from dynident.validation import LARGEST_ERROR
from dynident_service.designs.wire_types import Criterion, Trajectory
from dynident_service.identifications.wire_types import Preprocessing
from dynident_service.robots.wire_types import Limits
from dynident_service.shared.field_by_field import from_wire_choice, to_request
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import MOST_EFFECTS, EffectChoice, RequestModel

if TYPE_CHECKING:
    from dynident.robot import Robot


_TITLE = "Outside of the folder"


class Folder:
    """A folder, as far as tools may reach: files in it, and none that a link, `..` or an absolute path leads to.

    The process works in it, so that paths of messages are relative to it.
    """

    def __init__(self, root: Path) -> None:
        self._root = root.resolve(strict=True)

    def find_recording(self, text: str, pointer: str) -> Path:
        """Return the path of a recording, whose files may be joined by +.

        Refuse a file that is outside of the folder, or not there.
        """
        # Parts are looked at one by one before any is opened: the second of `a.csv+../b.csv` could lead outside.
        for part in text.split(JOINT):
            self._check_inside(Path(part), pointer)
        for path in split_path(Path(text)):
            self._check_file(path, pointer)
        return Path(text)

    def find_file(self, text: str, pointer: str) -> Path:
        """Return the path of a file; `DynidentError` where it is outside of the folder or not there."""
        self._check_file(Path(text), pointer)
        return Path(text)

    def find_robot(self, text: str, pointer: str) -> str:
        """Return a robot's source: a file of the folder, or the name of a well-known arm."""
        if text in list_library_arms() or text in list_stock_robots():
            return text
        path = self.find_file(text, pointer)
        check_reads_no_others(path, pointer)
        return text

    def find_new_file(self, text: str, pointer: str) -> Path:
        """Return the path of a file to write.

        Refuse one that is outside of the folder, or would replace a file: recordings lie there, too.
        """
        path = Path(text)
        self._check_inside(path, pointer)
        if path.is_symlink() or path.exists():
            raise DynidentError(f"there is already a file {text}; give another name", pointer=pointer, title="Exists")
        if not path.parent.is_dir():
            raise DynidentError(f"there is no folder {path.parent}", pointer=pointer, title="No such folder")
        return path

    def _check_file(self, path: Path, pointer: str) -> None:
        # Where it leads comes first: whether there is something outside is nobody's business.
        self._check_inside(path, pointer)
        if not path.is_file():
            raise DynidentError(f"there is no file {path}", pointer=pointer, title="No such file")

    def _check_inside(self, path: Path, pointer: str) -> None:
        try:
            target = (self._root / path).resolve()
            is_inside = target.is_relative_to(self._root)
            if is_inside:
                target.exists()  # raises for a name that no file can have
        # A NUL character, a loop of links, a name that is too long.
        except (OSError, RuntimeError, ValueError):
            is_inside = False
        if not is_inside:
            raise DynidentError(
                f"{str(path)!r:.200} does not lie in the folder that these tools work in; give a path relative to it",
                pointer=pointer,
                title=_TITLE,
            )


_LONGEST = 1000
_Path = Annotated[str, Field(min_length=1, max_length=_LONGEST)]


def _list_fields(science: type, *but: str) -> tuple[str, ...]:
    return tuple(request_field.name for request_field in fields(science) if request_field.name not in but)


@derive_body(RecordingMetadata, only=_list_fields(RecordingMetadata, "name", "format"))
class RecordingFile(RequestModel):
    """A recording, and how its file is read."""

    path: _Path = Field(description="Files of one recording are joined by +: q.csv+tau.csv")
    cure: bool = Field(default=False, description="Read a file that would be refused with the cures of its checks")


Recordings = Annotated[list[_Path | RecordingFile], Field(max_length=100)]
Effects = Annotated[
    list[str | EffectChoice],
    Field(
        max_length=MOST_EFFECTS,
        description='Texts such as "default" (links, rotors, Coulomb and viscous friction) and "stribeck@joint2", or '
        "objects as a diagnosis recommends them",
    ),
]


class RobotSource(RequestModel):
    """A robot, and what its description does not state."""

    source: _Path = Field(
        description="URDF, MJCF, a Denavit-Hartenberg table, a robot as JSON, or the name of a well-known arm"
    )
    drive_gains: dict[str, float] = Field(
        default={}, description="By joint: torque per unit of current [12.17], for recordings of currents"
    )
    locked_joints: dict[str, float] = Field(default={}, description="Positions of joints that are in no recording")
    gravity: tuple[float, float, float] | None = Field(default=None, description="In the base frame, m/s²")


SomeRobot = _Path | RobotSource


class InspectArguments(RequestModel):
    """A file to inspect."""

    file: _Path
    robot: SomeRobot | None = Field(
        default=None, description="The robot of the recording; without it, columns are only listed"
    )
    rate: float | None = Field(default=None, gt=0, le=1e6, description="Rows per second of a file without time, Hz")


@derive_body(IdentificationChoices, only=_list_fields(IdentificationChoices, "effects", "preprocessing", "tolerance"))
class IdentifyArguments(RequestModel):
    """What to identify, from which recordings, and how."""

    robot: SomeRobot
    recordings: Recordings = Field(min_length=1)
    validation: Recordings = Field(default=[], description="Held-out recordings: no parameter is fitted to them")
    effects: Effects | None = None
    preprocessing: Preprocessing | Literal["auto"] = "auto"
    out: _Path = Field(description="The model to write, .npz; other tools take it as `model`")


@derive_body(DiagnosisChoices, only=_list_fields(DiagnosisChoices))
class DiagnoseArguments(RequestModel):
    """A model, and the recordings that it was identified from."""

    model: _Path
    recordings: Recordings = Field(min_length=1)
    validation: Recordings = Field(default=[], description="Held-out recordings: what they do not confirm is not named")
    next_experiment: bool = Field(default=False, description="Look also for the motion that would show more")
    out: _Path = Field(description="The diagnosis to write, .json; why_not and design take it as `diagnosis`")


class WhyNotArguments(RequestModel):
    """A stored diagnosis, and the effect that is asked about."""

    diagnosis: _Path
    effect: str = Field(max_length=_LONGEST)
    joint: str = Field(
        default="", max_length=_LONGEST, description="By default, the joint where the effect explains most"
    )


@derive_body(DesignRequest, only=_list_fields(DesignRequest, "model"))
class DesignArguments(RequestModel):
    """The experiment to design."""

    robot: SomeRobot | None = Field(default=None, description="The robot; give either it or a model")
    model: _Path | None = Field(
        default=None, description="An identified model of the robot, by which torque is predicted for its limits"
    )
    diagnosis: _Path | None = Field(
        default=None, description="Design its next experiment; other options but limits and surroundings are ignored"
    )
    earlier: Recordings = Field(default=[], description="Recordings that the motion complements")
    effects: Effects | None = None
    criterion: Criterion = Field(default_factory=Criterion)
    trajectory: Trajectory = Field(default_factory=Trajectory)
    limits: dict[str, Limits] = Field(default={})
    out: _Path = Field(description="The trajectory to write: .csv, .parquet, or .yaml for ROS 2")


class ChangesArguments(RequestModel):
    """A model, and two sets of recordings of its robot."""

    model: _Path
    before: Recordings = Field(min_length=1)
    after: Recordings = Field(min_length=1)
    candidates: list[str] | None = Field(
        default=None, min_length=1, max_length=MOST_EFFECTS, description="Only these are tried"
    )


class ValidateArguments(RequestModel):
    """A model, and recordings to test it by."""

    model: _Path
    recordings: Recordings = Field(default=[], description="The recordings from which the model was identified")
    validation: Recordings = Field(default=[], description="Held-out recordings")
    limit: float = Field(default=LARGEST_ERROR, gt=0, le=1, description="Largest relative error that passes")


@derive_body(ExportChoices, only=_list_fields(ExportChoices, "format"))
class ExportArguments(RequestModel):
    """A model, and the file to write."""

    model: _Path
    out: _Path = Field(description=".urdf, .xml or .mjcf (MuJoCo), .c, .casadi or .json")


def load_robot(folder: Folder, robot: SomeRobot) -> Robot:
    """Return the robot that an argument names; `DynidentError` where it cannot be read."""
    stated = RobotSource(source=robot) if isinstance(robot, str) else robot
    return dy.load_robot(
        folder.find_robot(stated.source, "/robot"),
        drive_gains=stated.drive_gains or None,
        locked_joints=stated.locked_joints,
        gravity=stated.gravity,
    )


def read_recordings(
    folder: Folder, robot: Robot, recordings: Sequence[str | RecordingFile], place: str, progress: Progress
) -> dy.Recordings:
    """Return the recordings of an argument, read and checked.

    Returned in their order; `place` is the argument's name, for messages.
    """
    stated = [RecordingFile(path=item) if isinstance(item, str) else item for item in recordings]
    # All of them are looked for before the first is read, which may take minutes.
    paths = [folder.find_recording(item.path, f"/{place}/{index}") for index, item in enumerate(stated)]
    runs = dy.Recordings(())
    for index, (item, path) in enumerate(zip(stated, paths, strict=True)):
        share = scale_progress(progress, index / len(paths), (index + 1) / len(paths))
        metadata = to_request(item, RecordingMetadata)
        try:
            file = SourceFile(path, split_path(path)[0].stem)
            reader = ProposalReader(robot, [file], [replace(metadata, name=file.name)], item.cure, _write_field)
            runs += reader.report_columns(read_files(reader, progress=share))
        except dy.RecordingError as error:
            error.pointer = error.pointer or f"/{place}/{index}"
            raise
    return runs


def _write_field(remedy: Remedy) -> str:
    """Return a remedy as a field of a recording, or of its robot."""
    return str(Remedy("drive_gains", remedy.value)) if remedy.field == "drives" else str(remedy)


def to_effects(effects: Iterable[str | EffectChoice] | None) -> list[str | dy.EffectChoice] | None:
    """Return effects of an argument as the library takes them."""
    return None if effects is None else [item if isinstance(item, str) else from_wire_choice(item) for item in effects]


def to_filters(preprocessing: Preprocessing | Literal["auto"]) -> Filters | None:
    """Return the filters that an argument states; None where the data decide on them."""
    return None if preprocessing == "auto" else to_request(preprocessing, Filters)
