"""Collections that models start from: robots, imports, measurements, designs, next experiments, simulations."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Literal, Unpack

from dynident_client import answers
from dynident_client.collection_bases import Collection, LabelledCollection
from dynident_client.computation_options import DesignKind, DesignOptions, SimulationOptions
from dynident_client.resource_objects import (
    Design,
    Diagnosis,
    Import,
    Measurement,
    NextExperiment,
    Record,
    Robot,
    Simulation,
    get_identifier,
)
from dynident_client.transport import Event
from dynident_client.upload_options import MeasurementOptions, RevisionOptions, RobotOptions

Files = Path | str | Sequence[Path | str]
"""One file, or several that are one recording."""


_JSON = "application/json"


def _encode_columns(columns: Mapping[str, Sequence[float]]) -> bytes:
    # Also arrays, whose elements are no numbers of Python.
    return json.dumps({name: [float(value) for value in values] for name, values in columns.items()}).encode()


def _list_paths(files: Files) -> list[Path]:
    return [Path(files)] if isinstance(files, (Path, str)) else [Path(file) for file in files]


class Robots(LabelledCollection[Robot]):
    """Robots."""

    kind = Robot

    def create(
        self,
        name: str,
        *,
        urdf: Path | str | None = None,
        mjcf: Path | str | None = None,
        modified_dh: Mapping[str, object] | str | None = None,
        **more: Unpack[RobotOptions],
    ) -> Robot:
        """Store a robot.

        Parameters
        ----------
        name : str
            What the robot is called.
        urdf, mjcf : Path or str, optional
            Path of a description, or its text.
        modified_dh : mapping or str, optional
            A modified Denavit-Hartenberg table. Just one of the three descriptions is given.
        **more : object
            Other fields of the robot, as `RobotOptions` has them.

        Returns
        -------
        Robot
            The stored robot.
        """
        descriptions = {"urdf": urdf, "mjcf": mjcf, "modified_dh": modified_dh}
        stated = {form: content for form, content in descriptions.items() if content is not None}
        # Refused here already: the service would say the same, one request later.
        if len(stated) != 1:
            raise ValueError("give one of urdf, mjcf and modified_dh")
        [(form, content)] = stated.items()
        # A string is the description itself, since a path and a URDF are both text.
        text = content.read_text() if isinstance(content, Path) else content
        return self._post({"name": name, "description": {"format": form, "content": text}, **more})

    def geometry(self, robot: Robot | str) -> answers.GeometryView:
        """Read where the robot's links are: the frames of its joints, capsules around the links, and meshes."""
        return self._transport.get(f"{self.path}/{get_identifier(robot)}/geometry", answers.GeometryView)

    def poses(self, robot: Robot | str, positions: Sequence[Sequence[float]]) -> answers.PosesView:
        """Read where the frames of the geometry are at some postures.

        Parameters
        ----------
        robot : Robot or str
            The robot or its identifier.
        positions : sequence of sequence of float
            Positions of all joints in rad or m, posture by posture.

        Returns
        -------
        answers.PosesView
            12 numbers for each frame, row by row; None for a frame in a loop that cannot be closed at that posture.
        """
        body = {"positions": [list(posture) for posture in positions]}
        return self._transport.post(f"{self.path}/{get_identifier(robot)}/poses", answers.PosesView, body)

    def send_meshes(self, robot: Robot | str, folder: Path | str) -> answers.MeshesView:
        """Send the files below a folder that have the name of a mesh of the robot's description.

        Parameters
        ----------
        robot : Robot or str
            The robot or its identifier.
        folder : Path or str
            Where to look, in all folders below it, too.

        Returns
        -------
        answers.MeshesView
            The meshes that the description names, each with what was stored for it, and the files that are none of
            them.

        Raises
        ------
        ValueError
            If no file has the name of a mesh.
        """
        # By the last part of the name, in small letters: descriptions often come from systems that ignore case.
        needed = {PurePosixPath(mesh["name"]).name.casefold() for mesh in self.get(robot)["meshes"]}
        below = Path(folder)
        # In a fixed order: the same folder gives the same request everywhere.
        mesh_files = [path for path in sorted(below.rglob("*")) if path.is_file() and path.name.casefold() in needed]
        if not mesh_files:
            raise ValueError(
                f"no file below {below} has the name of a mesh of the robot; its meshes are: "
                f"{', '.join(sorted(needed))}"
            )
        return self.put_meshes(robot, {path.relative_to(below.parent).as_posix(): path for path in mesh_files})

    def put_meshes(self, robot: Robot | str, files: Mapping[str, Path]) -> answers.MeshesView:
        """Send files of meshes by their names, as `send_meshes` does those of a folder.

        Parameters
        ----------
        robot : Robot or str
            The robot or its identifier.
        files : mapping of str to Path
            Files by the names under which they are sent.

        Returns
        -------
        answers.MeshesView
            The meshes that the description names, each with what was stored for it, and the files that are none of
            them.
        """
        return self._transport.put_files(f"{self.path}/{get_identifier(robot)}/meshes", answers.MeshesView, files)

    def bundle(self, robot: Robot | str) -> Iterator[bytes]:
        """Read a robot with all that depends on it as a ZIP, in pieces, for `dynident import-robot` elsewhere."""
        return self._transport.stream(f"{self.path}/{get_identifier(robot)}/bundle")


class Imports(Collection[Import]):
    """Files that are inspected before they are used."""

    kind = Import

    def upload(
        self, robot: Record | str, file: Files, *, name: str | None = None, **more: Unpack[MeasurementOptions]
    ) -> Import:
        """Upload a file, or several that are one recording, for an inspection of its columns.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        file : path, or several
            A file in any format that can be read, or several that are one recording.
        name : str, optional
            What the recording is called; the file's name without the ending by default.
        **more : object
            Role, windows, columns, units, rate, as far as they are known.

        Returns
        -------
        Import
            What was found in the file, with proposed metadata and questions.
        """
        paths = _list_paths(file)
        metadata = {"robot_id": get_identifier(robot), "name": name or paths[0].stem, **more}
        return self._record(self._transport.upload(self.path, dict, paths, {"metadata": json.dumps(metadata)}))


class Measurements(LabelledCollection[Measurement]):
    """Recordings."""

    kind = Measurement

    def upload(
        self, robot: Record | str, file: Files, *, name: str | None = None, **more: Unpack[MeasurementOptions]
    ) -> Measurement:
        """Upload a recording.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        file : path, or several
            A file in any format that can be read, or several that are one recording.
        name : str, optional
            What the recording is called; the file's name without the ending by default.
        **more : object
            What is known of the file, as `MeasurementOptions` has it.

        Returns
        -------
        Measurement
            The stored recording, with its checks.
        """
        paths = _list_paths(file)
        metadata = {"robot_id": get_identifier(robot), "name": name or paths[0].stem, **more}
        return self._record(self._transport.upload(self.path, dict, paths, {"metadata": json.dumps(metadata)}))

    def begin(self, robot: Record | str, name: str, **more: Unpack[MeasurementOptions]) -> Measurement:
        """Begin a recording whose rows come while the robot moves: see `append_rows` and `follow`.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        name : str
            What the recording is called.
        **more : object
            What is known of its columns, as `MeasurementOptions` has it.

        Returns
        -------
        Measurement
            The recording, without rows.
        """
        return self._post({"under_way": True, "metadata": {"robot_id": get_identifier(robot), "name": name, **more}})

    def append_rows(
        self,
        measurement: Record | str,
        rows: Mapping[str, Sequence[float]] | bytes = b"",
        *,
        offset: int,
        finished: bool = False,
        media_type: Literal["text/csv", "application/vnd.apache.parquet"] = "text/csv",
    ) -> Measurement:
        """Append rows to a recording under way.

        Parameters
        ----------
        measurement : Record or str
            The recording or its identifier.
        rows : mapping or bytes
            Columns of numbers by name, the same each time; or a CSV or Parquet file.
        offset : int
            Number of rows that were sent before. A request that is sent twice does no harm.
        finished : bool
            Whether these are the last rows. Then all checks are made, and it is a recording like any other.
        media_type : str
            What the bytes are.

        Returns
        -------
        Measurement
            The recording so far.
        """
        content, media = (rows, str(media_type)) if isinstance(rows, bytes) else (_encode_columns(rows), _JSON)
        path = f"{self.path}/{get_identifier(measurement)}/rows"
        return self._record(self._transport.patch_content(path, dict, content, media, offset=offset, finished=finished))

    def follow(self, measurement: Record | str, *, design: Record | str | None = None) -> Iterator[Event]:
        """Follow a recording under way: estimates as rows come, and reasons to stop the robot.

        Parameters
        ----------
        measurement : Record or str
            The recording or its identifier.
        design : Record or str, optional
            The design of its motion: a run that is much slower is to be stopped.

        Yields
        ------
        Event
            `estimate`, and `finished` with the model of all rows; or `problem`, the last one, where nothing can be
            computed.
        """
        query = "" if design is None else f"?design_id={get_identifier(design)}"
        return self._transport.events(f"{self.path}/{get_identifier(measurement)}/estimates{query}")

    def revise(self, measurement: Record | str, **changes: Unpack[RevisionOptions]) -> Measurement:
        """Change the metadata of a measurement's file: a new measurement, whose parent is this one, without an upload.

        Parameters
        ----------
        measurement : Record or str
            The measurement or its identifier.
        **changes : object
            What is to be said of it, as `RevisionOptions` has it; also the `apply` of a check.

        Returns
        -------
        Measurement
            The new measurement.
        """
        return self._post(changes, f"/{get_identifier(measurement)}/revisions")

    def raw(
        self,
        measurement: Record | str,
        signals: Sequence[str] = (),
        *,
        start: float | None = None,
        end: float | None = None,
        points: int | None = None,
    ) -> answers.RawSignals:
        """Read signals as they were recorded.

        Parameters
        ----------
        measurement : Record or str
            The measurement or its identifier.
        signals : sequence of str
            Names of signals; all q and tau where none is named.
        start, end : float, optional
            Seconds of t from which and to which samples are read.
        points : int, optional
            The signals are thinned to about so many points, with their extremes; None: all samples.

        Returns
        -------
        answers.RawSignals
            t, signals, units, n_samples.
        """
        path = f"{self.path}/{get_identifier(measurement)}/raw"
        # The service reads the list from one parameter of the query.
        narrow = {"signals": ",".join(signals) or None, "from": start, "to": end, "points": points}
        return self._transport.get(path, answers.RawSignals, **narrow)

    def standstills(self, measurement: Record | str) -> answers.Standstills:
        """Read when each joint stands, as intervals of time in s."""
        return self._transport.get(f"{self.path}/{get_identifier(measurement)}/standstills", answers.Standstills)

    def of_import(self, looked_at: Import, metadata: Mapping[str, object] | None = None) -> Measurement:
        """Store a file that was imported, with the given metadata or the proposed ones.

        Parameters
        ----------
        looked_at : Import
            The import whose file is used.
        metadata : mapping, optional
            What is said of the file; the proposed metadata where not given.

        Returns
        -------
        Measurement
            The stored recording, with its checks.
        """
        return self._post({"import_id": looked_at.id, "metadata": dict(metadata or looked_at.proposed)})

    def content(self, measurement: Record | str) -> Iterator[bytes]:
        """Read the file as it was uploaded, in pieces."""
        return self._transport.stream(f"{self.path}/{get_identifier(measurement)}/content")


class Designs(Collection[Design]):
    """Designs of experiments."""

    kind = Design

    def create(self, robot: Record | str, *, kind: DesignKind = "optimized", **more: Unpack[DesignOptions]) -> Design:
        """Design an experiment.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        kind : str
            How the motion is found.
        **more : object
            Other fields of the request, as `DesignOptions` has them.

        Returns
        -------
        Design
            The design, whose job is queued; see `wait`.
        """
        return self._post({"robot_id": get_identifier(robot), "kind": kind, **more})

    def trajectory(
        self, design: Record | str, format: Literal["csv", "parquet", "json", "ros2"] = "csv", *, speed: float = 1.0
    ) -> bytes:
        """Read the trajectory: t, q…, dq…, ddq… at the sampling rate.

        Parameters
        ----------
        design : Record or str
            The design or its identifier.
        format : {"csv", "parquet", "json", "ros2"}
            Format of the file.
        speed : float
            Share of the designed speed: 1/3 for a first run on the robot.

        Returns
        -------
        bytes
            The file.
        """
        return self._transport.get_bytes(f"{self.path}/{get_identifier(design)}/trajectory", format=format, speed=speed)

    def clearances(self, design: Record | str, points: int = 200) -> answers.DesignClearances:
        """Read what every link is nearest to along the motion.

        Parameters
        ----------
        design : Record or str
            The design or its identifier.
        points : int
            About how many samples of the motion are looked at.

        Returns
        -------
        answers.DesignClearances
            Distances over time, link by link.
        """
        return self._transport.get(
            f"{self.path}/{get_identifier(design)}/clearances", answers.DesignClearances, points=points
        )


class Simulations(Collection[Simulation]):
    """Virtual robots that record their motion."""

    kind = Simulation

    def create(
        self,
        robot: Record | str,
        *,
        design: Record | str | None = None,
        trajectory: Mapping[str, object] | None = None,
        effects: Sequence[Mapping[str, object]] | None = None,
        **more: Unpack[SimulationOptions],
    ) -> Simulation:
        """Let a virtual robot follow the motion of a design, or a trajectory.

        Parameters
        ----------
        robot : Record or str
            The robot or its identifier.
        design : Record or str, optional
            The design whose motion is followed, or its identifier.
        trajectory : mapping, optional
            Another motion, as the contract has it.
        effects : sequence of mapping, optional
            Effects that the virtual robot has.
        **more : object
            Other fields of the request, as `SimulationOptions` has them.

        Returns
        -------
        Simulation
            The simulation, whose job is queued; its result names the measurement.
        """
        motion: dict[str, object] = {
            "design_id": None if design is None else get_identifier(design),
            "trajectory": trajectory,
        }
        return self._post({"robot_id": get_identifier(robot), "effects": effects, **motion, **more})


class NextExperiments(Collection[NextExperiment]):
    """Searches for the experiments that decide what diagnoses leave open."""

    kind = NextExperiment

    def create(self, diagnosis: Record | str) -> NextExperiment:
        """Look for a motion that decides what a diagnosis leaves open.

        Parameters
        ----------
        diagnosis : Record or str
            The diagnosis or its identifier.

        Returns
        -------
        NextExperiment
            The search, whose job is queued; its result has the `experiment`, None where no motion decides anything.
        """
        path = f"{Diagnosis.path}/{get_identifier(diagnosis)}/next_experiment"
        return self._record(self._transport.post(path, dict))
