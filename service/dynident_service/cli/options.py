"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import A_ROBOT, TO_READ, known_arms

RobotArgument = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="A URDF, xacro or MJCF file, a text file with a classical or modified Denavit-Hartenberg table, a JSON "
        "file (a modified table, or a robot as the service takes it), or "
        f"a well-known arm: {', '.join(known_arms())}.",
        show_default=False,
    ),
    A_ROBOT,
]
ModelArgument = Annotated[
    Path,
    typer.Argument(metavar="MODEL", help="A model that `dynident identify --out` wrote.", show_default=False),
    TO_READ,
]
Measurements = Annotated[
    list[Path],
    typer.Argument(
        metavar="MEASUREMENT",
        help="Files with the columns t, q1… and tau1… or current1… (or q_<joint>…): CSV, Parquet, NumPy, MAT, HDF5, "
        "bags, MCAP.",
        show_default=False,
    ),
    TO_READ,
]
Validation = Annotated[
    list[Path],
    typer.Option(
        "--validation",
        "-v",
        metavar="FILE",
        help="Measurement that no parameter sees; may be repeated.",
        default_factory=list,
        show_default=False,
    ),
    TO_READ,
]
Columns = Annotated[
    list[str],
    typer.Option(
        "--columns",
        metavar="OURS=THEIRS,…",
        help="Columns with other names: q1=shoulder,tau1=torque_a; or a JSON object.",
        default_factory=list,
        show_default=False,
    ),
]
Units = Annotated[
    list[str],
    typer.Option(
        "--units",
        metavar="KIND=UNIT,…",
        help="Units other than SI: q=deg,tau=mN m.",
        default_factory=list,
        show_default=False,
    ),
]
Windows = Annotated[
    list[str],
    typer.Option(
        "--windows",
        metavar="[NAME=]FROM:TO,…",
        help="Seconds of t to use, of all files or of the one with that name (its file's, without the ending).",
        default_factory=list,
        show_default=False,
    ),
]
Metadata = Annotated[
    list[str],
    typer.Option(
        "--metadata",
        metavar="[NAME=]FILE",
        help="What is said of all files, or of the one with that name, as `dynident inspect --out` or a report writes "
        "it; may be repeated.",
        default_factory=list,
        show_default=False,
    ),
]
AsProposed = Annotated[
    bool,
    typer.Option("--as-proposed", help="Take the columns as `dynident inspect` proposes them, where nothing is asked."),
]
Accept = Annotated[
    list[str],
    typer.Option(
        "--accept",
        metavar="CHECK",
        help="Treat the errors of this check as warnings; may be repeated.",
        default_factory=list,
        show_default=False,
    ),
]
Cure = Annotated[
    bool,
    typer.Option("--cure", help="Read what would be refused as its checks propose, and say so: order, sign, unit, …."),
]
DriveGains = Annotated[
    str,
    typer.Option(
        "--drive-gains",
        metavar="G1,G2,…",
        help="Drive gains [12.17] in N m per unit of current, one a joint, or joint=gain pairs.",
    ),
]

Lock = Annotated[
    str,
    typer.Option(
        "--lock",
        metavar="JOINT[=POSITION],…",
        help="Joints that do not move, or are in no recording (a gripper's), at these positions in rad (m); 0 where "
        "none is said.",
    ),
]
Gravity = Annotated[
    str,
    typer.Option(
        "--gravity",
        metavar="X,Y,Z",
        help="Gravity in the base frame in m/s², where the base does not stand upright: 0,0,9.81 for a ceiling.",
    ),
]


@dataclass(frozen=True)
class Beside:
    """What a robot's description does not say."""

    drive_gains: DriveGains = ""
    lock: Lock = ""
    gravity: Gravity = ""


@dataclass(frozen=True)
class Reading:
    """How measurement files are read."""

    columns: Columns
    units: Units
    windows: Windows
    accept: Accept
    metadata: Metadata
    as_proposed: AsProposed = False
    cure: Cure = False


@dataclass(frozen=True)
class RobotReading(Reading):
    """The same, with what the robot's description does not say."""

    drive_gains: DriveGains = ""
    lock: Lock = ""
    gravity: Gravity = ""


Out = Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Where to write the result.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, with the fields of the HTTP contract.")]
Effects = Annotated[
    list[str],
    typer.Option(
        "--effects",
        metavar="EFFECT,…",
        help="Effects of the catalogue: `default,offset` or `stribeck@joint1+joint2:vs=0.05`; `default` stands for "
        "rigid_body,rotor_inertia,coulomb,viscous.",
        default_factory=list,
        show_default=False,
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="The same seed gives the same result.")]


@dataclass(frozen=True)
class Result:
    """Where a result goes."""

    out: Out = None
    as_json: Json = False
