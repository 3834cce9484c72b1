"""Helpers of `dynident design`: read limits and surroundings from files, print the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError
from rich.console import Console

from dynident.errors import DynidentError
from dynident.excitation import Design, DesignRequest
from dynident.known_robots import locate_robot
from dynident.motion import Surroundings
from dynident.reports.number_format import format_number, format_percent
from dynident.robot import Limits, Robot
from dynident.robot.collision import find_mesh_folders
from dynident_service.adapters.conversion import to_request
from dynident_service.cli.files import read_json_object
from dynident_service.cli.inputs import load_diagnosis
from dynident_service.cli.terminal import build_table
from dynident_service.models.request_bodies import find_body
from dynident_service.models.robots import Limits as WireLimits
from dynident_service.problems import to_problem_fields

Wanted = TypeVar("Wanted")
_LIMITS = TypeAdapter(dict[str, WireLimits])
_SURROUNDINGS = TypeAdapter(find_body(Surroundings))


def load_proposed_design(path: Path) -> DesignRequest:
    """Return the design request that a stored diagnosis proposes as next experiment."""
    proposed = load_diagnosis(path).next_experiment
    if proposed is None:
        raise DynidentError(f"the diagnosis in {path.name} proposes no experiment", pointer="--diagnosis")
    return proposed.design


def load_limits(path: Path | None) -> dict[str, Limits]:
    """Read limits by joint from a JSON file."""
    if path is None:
        return {}
    limits_by_joint = _load_validated(_LIMITS, path, "Unusable limits")
    return {name: to_request(value, Limits) for name, value in limits_by_joint.items()}


def choose_mesh_folders(robot: Robot, argument: str, folders: Sequence[Path] | None) -> tuple[Path, ...]:
    """Return the folders to search for meshes: those stated, or those above the robot's file that hold any."""
    if folders:
        return tuple(folders)
    file = locate_robot(argument)
    # An arm of this package has no file, and no meshes.
    return () if file is None else find_mesh_folders(robot, file)


def load_surroundings(path: Path | None, mesh_folders: Sequence[Path], *, floor: bool) -> Surroundings:
    """Read the robot's surroundings from a JSON file.

    Parameters
    ----------
    path : Path, optional
        The file; without it nothing around the robot is stated.
    mesh_folders : sequence of Path
        Folders to search for collision meshes.
    floor : bool
        Whether to assume a floor where nothing around the robot is stated.

    Returns
    -------
    Surroundings
        What the motion has to keep clear of.
    """
    surroundings = (
        Surroundings()
        if path is None
        else to_request(_load_validated(_SURROUNDINGS, path, "Unusable surroundings"), Surroundings)
    )
    # Folders are this machine's: a file of surroundings cannot know them.
    folders = tuple(str(folder) for folder in mesh_folders)
    return replace(surroundings, mesh_folders=folders, assume_floor=surroundings.assume_floor and floor)


def print_warnings(console: Console, design: Design) -> None:
    """Print the warnings of a design after everything else, where they are not overlooked."""
    for warning in design.warnings:
        console.print(f"warning: {warning}", style="bold red")


def _load_validated(fields: TypeAdapter[Wanted], path: Path, title: str) -> Wanted:
    document = read_json_object(path)
    try:
        return fields.validate_python(document)
    except ValidationError as error:
        # The service words validation errors by the place in the body; here the body is the whole file.
        first = to_problem_fields([{**item, "loc": ("body", *item["loc"])} for item in error.errors()], document)[0]
        raise DynidentError(first.detail, pointer=f"{path}{first.pointer}", title=title) from error


def show_design(console: Console, design: Design) -> None:
    """Print how good a design is, how near it comes to the limits, and its test motions."""
    values, baseline = design.criterion_values, design.baseline
    rows = [["this design", format_number(values.condition_number), format_number(values.smallest_singular_value)]]
    if baseline is not None:
        best = baseline.best
        rows.append(
            [
                f"best of {baseline.count} random ones",
                format_number(best.condition_number),
                format_number(best.smallest_singular_value),
            ]
        )
        rows.append(["median of those", format_number(baseline.median_condition_number), ""])
    console.print(build_table("", ("trajectory", "condition number", "smallest singular value"), rows))
    # A share of 1 touches the limit; the five nearest are what somebody decides by.
    nearest = sorted(design.margins, key=lambda margin: -margin.share)[:5]
    console.print(
        build_table(
            "Nearest limits",
            ("joint", "limit", "reached", "allowed", "used"),
            [
                [m.joint, m.limit, format_number(m.value), format_number(m.bound), format_percent(m.share)]
                for m in nearest
            ],
            right_from=2,
        )
    )
    if design.runs:
        console.print(
            build_table(
                "Runs",
                ("segment", "purpose", "joints that move", "from (s)", "to (s)"),
                [
                    [str(k), run.label, ", ".join(run.joints), format_number(run.start, 4), format_number(run.end, 4)]
                    for k, run in enumerate(design.runs, start=1)
                ],
                right_from=3,
            )
        )
    for note in design.notes:
        # Warnings are among the notes, and are printed by `print_warnings`.
        if note not in design.warnings:
            console.print(f"  {note}", style="dim")
    console.print(
        f"{design.n_samples} samples at {design.sampling_rate:g} Hz, {design.duration:.1f} s from rest to rest"
    )
