"""Options that several commands share (measurements and how to read them, drive gains, metadata, output), in groups.

The dataclasses here are groups of options: a command takes one as a parameter, and `spread_options` spreads it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, get_args

import typer

from dynident.known_robots import list_library_arms
from dynident.recordings.recording_metadata import ConditioningStep
from dynident.robot.limits_and_drives import HARDWARE
from dynident_cli.option_parsers import FILE_IN_FOLDER, KNOWN_ROBOT, READABLE_FILE


def repeatable_option(*names: str, metavar: str, help: str) -> object:
    """Return an option that may be repeated; its default is an empty list."""
    return typer.Option(*names, metavar=metavar, help=help, default_factory=list, show_default=False)


def repeatable_file_option(*names: str, help: str) -> object:
    """Return an option that names a file and may be repeated."""
    return repeatable_option(*names, metavar="FILE", help=help)


def file_option(*names: str, help: str) -> object:
    """Return an option that names a file, or several where its type is a list."""
    return typer.Option(*names, metavar="FILE", help=help, show_default=False)


SomeFile = Annotated[Path | None, READABLE_FILE]
SomeFiles = Annotated[list[Path] | None, READABLE_FILE]
RobotArgument = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="A URDF, xacro or MJCF file, a text file with a classical or modified Denavit-Hartenberg table, a "
        "JSON file (a modified table, or a robot in the format of the service), or a well-known arm: "
        f"{', '.join(list_library_arms())}; or a robot of the package example-robot-data, such as so101.",
        show_default=False,
    ),
    KNOWN_ROBOT,
]
ModelArgument = Annotated[
    Path,
    typer.Argument(metavar="MODEL", help="A model that `dynident identify --out` wrote.", show_default=False),
    READABLE_FILE,
]
Measurements = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORDING",
        help="Files with the columns t, q1… and tau1… or current1… (or q_<joint>…): CSV, JSON, Parquet, NumPy, "
        "MAT, HDF5, bags, MCAP. Join the files of one recording with +: q.csv+dq.csv+tau.csv.",
        show_default=False,
    ),
    READABLE_FILE,
]
Validation = Annotated[
    list[Path],
    repeatable_file_option(
        "--validation", "-v", help="Held-out recording, to which no parameter is fitted; may be repeated."
    ),
    READABLE_FILE,
]


@dataclass(frozen=True)
class RobotAdditions:
    """What the description of a robot does not state: drive gains, locked joints, gravity, hardware."""

    drive_gains: Annotated[
        str,
        typer.Option(
            "--drive-gains",
            metavar="G1,G2,…",
            help="Drive gains [12.17] in N m per unit of current (of position servos without a torque signal: per rad "
            "between command and position): one per joint, or joint=gain pairs.",
        ),
    ] = ""
    lock: Annotated[
        str,
        typer.Option(
            "--lock",
            metavar="JOINT[=POSITION],…",
            help="Joints that do not move or are in no recording (such as a gripper's), with positions in rad (m), by "
            "default 0.",
        ),
    ] = ""
    gravity: Annotated[
        str,
        typer.Option(
            "--gravity",
            metavar="X,Y,Z",
            help="Gravity in the base frame in m/s², if the base is not upright: 0,0,9.81 for a ceiling.",
        ),
    ] = ""
    base: Annotated[
        str,
        typer.Option(
            "--base",
            metavar="KIND",
            help="How the root link moves: fixed, floating or planar; by default as in the description.",
        ),
    ] = ""
    contacts: Annotated[
        str,
        typer.Option(
            "--contacts",
            metavar="LINK,…",
            help="Feet of a floating robot whose forces were not measured; they are eliminated from the equations. A "
            "link, a point or a ball (calf@0,0,-0.21,0.02), with semicolons between points. Behind ^: on level ground "
            "nothing acts on a foot so high (m) above the lowest one, by its point or its link's frame; from twice "
            "this height on it is not eliminated.",
        ),
    ] = ""
    has: Annotated[str, typer.Option("--has", metavar="PART,…", help=f"Parts of the robot: {', '.join(HARDWARE)}.")] = (
        ""
    )
    has_not: Annotated[
        str,
        typer.Option(
            "--has-not",
            metavar="PART,…",
            help="Parts that the robot does not have; a diagnosis does not propose their effects.",
        ),
    ] = ""


Rate = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Sampling rate in Hz, for files without time."),
]


@dataclass(frozen=True)
class TimedReading:
    """How measurement files are read. Their time is a column, or metadata state their rate."""

    columns: Annotated[
        list[str],
        repeatable_option(
            "--columns",
            metavar="OURS=THEIRS,…",
            help="Columns with other names: q1=shoulder,tau1=torque_a; or a JSON object.",
        ),
    ] = field(default_factory=list)
    units: Annotated[
        list[str],
        repeatable_option("--units", metavar="KIND=UNIT,…", help="Units that are not SI: q=deg,tau=mN m."),
    ] = field(default_factory=list)
    windows: Annotated[
        list[str],
        repeatable_option(
            "--windows",
            metavar="[NAME=]FROM:TO,…",
            help="Seconds of t to use, of all files or of the file with that name (without its ending).",
        ),
    ] = field(default_factory=list)
    accept: Annotated[
        list[str],
        repeatable_option(
            "--accept", metavar="CHECK", help="Treat the errors of this check as warnings; may be repeated."
        ),
    ] = field(default_factory=list)
    skip: Annotated[
        list[str],
        repeatable_option(
            "--skip",
            metavar="STEP",
            help=f"Do not correct this, even if it looks wrong: {', '.join(get_args(ConditioningStep))}; may be "
            "repeated.",
        ),
    ] = field(default_factory=list)
    metadata: Annotated[
        list[str],
        repeatable_option(
            "--metadata",
            metavar="[NAME=]FILE",
            help="Metadata, as `dynident inspect --out` or a report writes them, of all files or of the file with that "
            "name; may be repeated.",
        ),
    ] = field(default_factory=list)
    as_proposed: Annotated[
        bool | None,
        typer.Option(
            "--as-proposed/--no-as-proposed",
            help="Use the columns that `dynident inspect` proposes; fail if it asks a question. By default only where "
            "a file lacks the usual columns.",
            show_default=False,
        ),
    ] = None
    cure: Annotated[
        bool,
        typer.Option(
            "--cure/--no-cure",
            help="Correct faults as the checks propose (order, sign, unit, …), and report each correction.",
        ),
    ] = False

    @property
    def rate(self) -> float | None:
        """Rows a second where files have no time: here none, as this group has no such option."""
        return None


@dataclass(frozen=True)
class Reading(TimedReading):
    """How measurement files are read, with an option for the rate of files without time."""

    rate: Rate = None


@dataclass(frozen=True)
class RobotReading(RobotAdditions, Reading):
    """What the robot's description does not state, and how measurement files are read."""


@dataclass(frozen=True)
class RobotTimedReading(RobotAdditions, TimedReading):
    """The same for commands whose `--rate` means something else, such as the rate of a design."""


Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE", help="File to write the result to."), FILE_IN_FOLDER
]
Json = Annotated[
    bool, typer.Option("--json/--no-json", help="Print the result as JSON, with the fields of the HTTP contract.")
]
Effects = Annotated[
    list[str],
    repeatable_option(
        "--effects",
        metavar="EFFECT,…",
        help="Effects of the catalogue: `default,offset`, right for recordings of a real robot, or "
        "`stribeck@joint1+joint2:vs=0.05`; `default` stands for rigid_body,rotor_inertia,coulomb,viscous.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="The same seed gives the same result.")]


@dataclass(frozen=True)
class OutputOptions:
    """Where a result goes: into a file, and as JSON to stdout."""

    out: Out = None
    as_json: Json = False
