"""`dynident demo`: find a hidden effect in a virtual robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_cli.shared_options import Json, Seed


def demo(
    effect: Annotated[str, typer.Option("--effect", help="The effect to hide; see `dynident effects`.")] = "stribeck",
    robot: Annotated[str, typer.Option("--robot", help="A robot file with inertias, or a well-known arm.")] = "ur10",
    joint: Annotated[str, typer.Option("--joint", help="Joint where the effect is hidden; random by default.")] = "",
    seed: Seed = 0,
    quick: Annotated[bool, typer.Option("--quick/--no-quick", help="Make a shorter experiment.")] = False,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder to write to.")] = Path(
        "demo-output"
    ),
    as_json: Json = False,
) -> None:
    """Hide an effect in a virtual robot, and find it by name.

    The exit code is 1 if the effect is not named.
    """
    from dynident_cli import argument_loading, command_output
    from dynident_cli.demo.demonstration import run_demonstration
    from dynident_cli.demo.scenario import Scenario

    scenario = Scenario.draw(argument_loading.load_robot_argument(robot), effect, joint, seed, quick)
    console = command_output.message_console() if as_json else command_output.result_console()
    story = run_demonstration(scenario, out, console)
    if as_json:
        command_output.print_json(story.to_document())
    if not story.is_named_correctly:
        raise typer.Exit(1)
