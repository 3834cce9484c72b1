"""`dynident design`, `simulate` and `demo`, which finds a hidden effect in a virtual robot.

Holds the sampling rate of the sensors of a simulation (500 Hz).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.errors import DynidentError
from dynident.excitation.design_request import DesignRequest
from dynident.simulation.virtual_robot_request import Simulated
from dynident_cli.option_parsers import FILE_IN_FOLDER, READABLE_FOLDER
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Effects,
    Json,
    RobotAdditions,
    RobotArgument,
    RobotTimedReading,
    Seed,
    SomeFile,
    SomeFiles,
    file_option,
    repeatable_option,
)

if TYPE_CHECKING:
    from rich.console import Console

# Share of the speed of a first run, as the warnings of a design advise.
_FIRST_SPEED = 1 / 3


def simulate(
    robot: RobotArgument,
    additions: RobotAdditions,
    effects: Annotated[
        list[str],
        repeatable_option(
            "--effects",
            metavar="EFFECT,…",
            help="Effects besides rotor inertia, Coulomb and viscous friction: stribeck@joint2, or with values "
            "stribeck@joint2:Fst=3,vs=0.05. Without values, they have typical sizes. payload:run=2 acts in "
            "run 2 only.",
        ),
    ],
    request_options: Annotated[TypedValues, RequestOptions(Simulated, but=("effects", "sampling_rate"))],
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate of the sensors in Hz.")] = 500.0,
    trajectory: Annotated[
        SomeFile,
        file_option(
            "--trajectory",
            help="Trajectory that `dynident design` wrote: t, q_<joint>… and optionally dq_… and ddq_…, which "
            "otherwise follow from q. By default, a random motion.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="The recording to write, .csv or .parquet."),
        FILE_IN_FOLDER,
    ] = Path("measurement.csv"),
    as_json: Json = False,
) -> None:
    """Simulate recordings of a virtual robot on a trajectory."""
    from dynident.file_output import TABLE_ENDINGS, check_ending
    from dynident.presentation.tables import Cell, ReportedTable, make_number_cell
    from dynident.progress import scale_progress
    from dynident.recordings.arrow_tables import write_table
    from dynident.simulation import (
        build_recording_table,
        build_simulation_request,
        replace_usual_effects,
        resolve_true_effects,
    )
    from dynident.simulation import simulate as simulate_robot
    from dynident_cli import (
        argument_loading,
        command_output,
        contract_documents,
        design_and_simulation_files,
        printed_results,
    )

    check_ending(out, TABLE_ENDINGS)
    machine = argument_loading.load_robot_argument(robot, additions)
    request = request_options.build_request(Simulated)
    hidden = resolve_true_effects(design_and_simulation_files.parse_acting_effects(effects), machine)
    with command_output.show_progress_bar("simulate") as progress:
        reference = design_and_simulation_files.load_reference(
            trajectory, machine, request.seed, scale_progress(progress, 0.0, 0.2)
        )
        simulation = build_simulation_request(request, machine, reference, rate)
        measurement = simulate_robot(
            machine,
            replace(simulation, effects=replace_usual_effects(simulation.effects, hidden)),
            scale_progress(progress, 0.2, 1.0),
        )
    write_table(build_recording_table(measurement), out)
    rows = tuple(
        (
            Cell(joint.name),
            make_number_cell(float(measurement.noise[j]), unit=joint.effort_unit),
            make_number_cell(float(measurement.tracking_error[j]), 2),
        )
        for j, joint in enumerate(machine.joints)
    )
    columns = ("joint", "torque noise, standard deviation", "largest distance from the trajectory (rad or m)")
    table = ReportedTable("", columns, rows)

    def show(console: Console) -> None:
        command_output.print_tables(console, [printed_results.fold_joints(table, columns[2])])
        for effect in hidden:
            console.print(f"in it: {design_and_simulation_files.format_true_effect(effect)}")

    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_simulation(measurement, rate),
        show,
        f"{measurement.n_samples} samples at {rate:g} Hz written to {out}",
    )


@dataclass(frozen=True)
class SafetyFiles:
    """Files of what a motion must keep to."""

    limits: Annotated[
        SomeFile,
        file_option(
            "--limits",
            help='Tighter limits for this experiment, JSON: {"joint": {"position": [lo, hi], "velocity": …}}.',
        ),
    ] = None
    surroundings: Annotated[
        SomeFile,
        file_option(
            "--surroundings",
            help='Obstacles and bounds that the robot must not touch, JSON: {"floor": z, "boxes": […], "walls": '
            '[…], "tool_range": {…}, …}.',
        ),
    ] = None
    meshes: Annotated[
        list[Path] | None,
        typer.Option(
            "--meshes",
            metavar="FOLDER",
            help="Folder with the URDF's collision meshes; may be repeated. By default, the folders above the URDF "
            "and those of ROS_PACKAGE_PATH.",
        ),
        READABLE_FOLDER,
    ] = None
    floor: Annotated[
        bool,
        typer.Option(
            "--floor/--no-floor",
            help="If no surroundings are stated, assume a floor through the base of an upright arm.",
        ),
    ] = True


@dataclass(frozen=True)
class DesignFiles(SafetyFiles):
    """Files that a design reads."""

    diagnosis: Annotated[
        SomeFile,
        file_option(
            "--diagnosis",
            help="Design the next experiment of a diagnosis (`dynident diagnose --next-experiment --out`).",
        ),
    ] = None
    earlier: Annotated[
        SomeFiles, file_option("--earlier", help="Recording that the experiment complements; may be repeated.")
    ] = None
    identified: Annotated[
        SomeFile,
        file_option(
            "--identified",
            help="Identified model of the robot (`dynident identify --out`). It predicts the torque with friction and "
            "rotors, and with a margin for the uncertainty, to keep the torque limits.",
        ),
    ] = None


def design(
    robot: RobotArgument,
    effects: Effects,
    request_options: Annotated[TypedValues, RequestOptions(DesignRequest)],
    files: DesignFiles,
    reading: RobotTimedReading,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="Trajectory: .csv, .parquet, .yaml (ROS 2)."),
        FILE_IN_FOLDER,
    ] = Path("trajectory.csv"),
    slow: Annotated[
        Path | None,
        typer.Option(
            "--slow",
            metavar="FILE",
            help="The same motion at a third of its speed, for a first run.",
            show_default=False,
        ),
        FILE_IN_FOLDER,
    ] = None,
    as_json: Json = False,
) -> None:
    """Design an exciting trajectory within the robot's limits.

    The options for columns, units, windows, checks and drive gains apply to the recordings of --earlier.
    """
    from dynident.api.model_identification import load_model
    from dynident.api.motion_design import TRAJECTORY_ENDINGS, DesignedMotion
    from dynident.excitation import design_experiment
    from dynident.file_output import check_ending
    from dynident_cli import argument_loading, command_output, contract_documents
    from dynident_cli.design_and_simulation_files import (
        choose_mesh_folders,
        load_proposed_design,
        print_warnings,
        show_design,
    )

    # Before the design, which takes minutes.
    for path in (out, *([] if slow is None else [slow])):
        check_ending(path, TRAJECTORY_ENDINGS)
    if slow is not None and slow.resolve() == out.resolve():
        raise DynidentError("--slow and --out name the same file; name two", pointer="--slow")
    machine = argument_loading.load_robot_argument(robot, reading)
    typed_request = request_options.build_request(
        DesignRequest, effects=argument_loading.read_effects(effects, machine) or None
    )
    request = replace(
        typed_request if files.diagnosis is None else load_proposed_design(files.diagnosis),
        limits=contract_documents.load_limits(files.limits),
        torque_margin=typed_request.torque_margin,
        surroundings=contract_documents.load_surroundings(
            files.surroundings, choose_mesh_folders(machine, robot, files.meshes), floor=files.floor
        ),
    )
    identified = None if files.identified is None else load_model(files.identified).identification.estimate
    with argument_loading.read_recordings("design", files.earlier or [], machine, reading, share=0.1) as data:
        recordings, _, progress = data
        experiment = design_experiment(machine, request, progress, recordings.recordings, identified=identified)
    motion = DesignedMotion(machine, experiment)
    motion.save(out)
    if slow is not None:
        motion.save(slow, _FIRST_SPEED)
    messages = [f"trajectory written to {out}", *([] if slow is None else [f"a third of its speed: {slow}"])]
    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_design(experiment),
        lambda console: show_design(console, experiment, machine),
        *messages,
    )
    # On stderr, so that they are seen where the result goes into a file or as JSON to a script.
    print_warnings(command_output.message_console(), experiment)


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
