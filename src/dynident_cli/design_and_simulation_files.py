"""Read limits, surroundings, effects and motions from files for `design` and `simulate`, and print their results.

For designs: limits and surroundings from files, the result. For virtual robots: their effects and their motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from pydantic import TypeAdapter, ValidationError
from rich.console import Console
from scipy.interpolate import CubicSpline

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.effects.effect_text_format import parse_effect, split_effects
from dynident.errors import DynidentError
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.known_robots import locate_robot
from dynident.motion import Surroundings
from dynident.presentation.design_tables import build_design_tables, describe_design
from dynident.progress import Progress
from dynident.robot import Limits, Robot
from dynident.robot.collision_reader import find_mesh_folders
from dynident.simulation import ActingEffect, Reference
from dynident_cli.argument_loading import load_diagnosis
from dynident_cli.input_checks_and_writes import check_readable, read_json_object
from dynident_cli.terminal import print_tables
from dynident_service.problems import to_problem_fields
from dynident_service.robots.wire_types import Limits as WireLimits
from dynident_service.shared.field_by_field import to_request
from dynident_service.shared.request_bodies import find_body

Wanted = TypeVar("Wanted")
_LIMITS = TypeAdapter(dict[str, WireLimits])
_SURROUNDINGS = TypeAdapter(find_body(Surroundings))


def load_proposed_design(path: Path) -> DesignRequest:
    """Return the design request that a stored diagnosis proposes as next experiment."""
    proposed = load_diagnosis(path).next_experiment
    if proposed is None:
        raise DynidentError(
            f"the diagnosis in {path.name} proposes no experiment: it was made without --next-experiment, or no motion "
            "decides anything",
            pointer="--diagnosis",
        )
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


def show_design(console: Console, design: Design, robot: Robot) -> None:
    """Print how good a design is, how near it comes to the limits, and its test motions."""
    # The nearest limits are what somebody decides by.
    print_tables(console, build_design_tables(robot, design, most_limits=5))
    for note in design.notes:
        # Warnings are among the notes, and are printed by `print_warnings`.
        if note not in design.warnings:
            console.print(f"  {note}", style="dim")
    console.print(describe_design(design))


_TITLE = "Unusable trajectory"
_RANDOM = TrajectoryRequest(sampling_rate=200.0)


def parse_acting_effects(texts: Sequence[str]) -> tuple[ActingEffect, ...]:
    """Parse the effects of a virtual robot."""
    acting = []
    for index, text in enumerate(split_effects(texts)):
        name, joints, values = parse_effect(text, "--effects")
        # `run` is no constant of the effect: it says in which run the effect acts.
        run = values.pop("run", None)
        shapes = {spec.name for spec in get_effect(name, f"/effects/{index}").shapes}
        acting.append(
            ActingEffect(
                name,
                joints,
                {key: value for key, value in values.items() if key not in shapes},
                {key: value for key, value in values.items() if key in shapes},
                () if run is None else (f"{run:g}",),
            )
        )
    return tuple(acting)


def load_reference(path: Path | None, robot: Robot, seed: int, progress: Progress) -> Reference:
    """Read the motion in a file, or draw a random one within the robot's limits."""
    if path is None:
        request = DesignRequest(kind="random", trajectory=_RANDOM, seed=seed)
        design = design_experiment(robot, request, progress)
        return Reference(design.t, design.q, design.dq, design.ddq)
    table = _read_table(path)
    t, q = _read_column(table, "t", path), _read_signal(table, "q", robot, path)
    if len(t) < 4 or not np.all(np.diff(t) > 0):
        raise DynidentError("t must increase and have at least four rows", pointer=f"{path}: t", title=_TITLE)
    spline = CubicSpline(t, q)
    derivatives = []
    for order, kind in enumerate(("dq", "ddq"), start=1):
        # Of all joints or of none: a spline for some of them would not fit the others.
        present = all(f"{kind}_{name}" in table.column_names for name in robot.joint_names)
        derivatives.append(_read_signal(table, kind, robot, path) if present else np.asarray(spline(t, order)))
    return Reference(t, q, *derivatives)


def _read_table(path: Path) -> pa.Table:
    check_readable(path)
    try:
        return pq.read_table(path) if path.suffix == ".parquet" else pacsv.read_csv(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise DynidentError(f"{path.name} cannot be read: {error}", pointer=str(path), title=_TITLE) from error


def _read_signal(table: pa.Table, kind: str, robot: Robot, path: Path) -> FloatArray:
    return np.column_stack([_read_column(table, f"{kind}_{name}", path) for name in robot.joint_names])


def _read_column(table: pa.Table, name: str, path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if name not in table.column_names:
        raise DynidentError(
            f"{path.name} has no column {name}; it has: {', '.join(table.column_names)}",
            pointer=name,
            title=_TITLE,
        )
    column = table[name]
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise DynidentError(f"column {name} of {path.name} does not hold numbers", pointer=name, title=_TITLE)
    return np.asarray(column.to_numpy(), dtype=np.float64)
