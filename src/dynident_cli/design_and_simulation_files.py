"""Read limits, surroundings, effects and motions from files for `design` and `simulate`, and print their results.

For designs: limits and surroundings from files, the result. For virtual robots: their effects and their motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from dynident.effects import get_effect
from dynident.effects.effect_text_format import parse_effect, split_effects
from dynident.errors import DynidentError, word_notes
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.known_robots import locate_robot
from dynident.presentation.design_tables import build_design_tables, describe_design
from dynident.progress import Progress
from dynident.robot import Robot
from dynident.robot.collision_reader import find_mesh_folders
from dynident.simulation import ActingEffect, Reference, TrueEffect
from dynident.simulation.reference_motion import read_reference
from dynident_cli.command_output import print_tables
from dynident_cli.contract_documents import load_diagnosis
from dynident_cli.request_options import write_option


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


def choose_mesh_folders(robot: Robot, argument: str, folders: Sequence[Path] | None) -> tuple[Path, ...]:
    """Return the folders to search for meshes: those stated, or those above the robot's file that hold any."""
    if folders:
        return tuple(folders)
    file = locate_robot(argument)
    # An arm of this package has no file, and no meshes.
    return () if file is None else find_mesh_folders(robot, file)


def print_warnings(console: Console, design: Design) -> None:
    """Print the warnings of a design after everything else, where they are not overlooked."""
    for warning in word_notes(design.warnings, write_option):
        console.print(f"warning: {warning}", style="bold red")


def show_design(console: Console, design: Design, robot: Robot) -> None:
    """Print how good a design is, how near it comes to the limits, and its test motions."""
    # The nearest limits are what somebody decides by.
    print_tables(console, build_design_tables(robot, design, most_limits=5))
    # Warnings are among the notes, and are printed by `print_warnings`.
    for note in word_notes((note for note in design.notes if note not in design.warnings), write_option):
        console.print(f"  {note}", style="dim")
    console.print(describe_design(design))


_RANDOM = TrajectoryRequest(sampling_rate=200.0)
_MOST_DRAWN = 100
"""Random motions of which a simulation takes the best, of a robot of up to six joints."""


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


def format_true_effect(effect: TrueEffect) -> str:
    """Write an effect of a virtual robot as `--effects` takes it, with all its values."""
    values = [f"{name}={value:.4g}" for name, value in (*effect.values, *effect.shape)]
    runs = [f"run={run}" for run in effect.runs]
    place = f"@{effect.joint}" if effect.joint else ""
    return f"{effect.effect}{place}:{','.join([*values, *runs])}"


def load_reference(path: Path | None, robot: Robot, seed: int, progress: Progress) -> Reference:
    """Read the motion in a file, or draw a random one within the robot's limits."""
    if path is None:
        # W of n joints has about n² entries a sample: a hundred motions of a humanoid would take seconds.
        count = max(1, min(_MOST_DRAWN, _MOST_DRAWN * 6**2 // robot.n**2))
        request = DesignRequest(kind="random", trajectory=_RANDOM, seed=seed, random_trajectories=count)
        design = design_experiment(robot, request, progress)
        return Reference(design.t, design.q, design.dq, design.ddq)
    return read_reference(path, robot)
