"""`dynident simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from dynident.simulation.virtual_robot_request import Simulated
from dynident_service.cli.options import Json, RobotAdditions, RobotArgument, SomeFile, file_option, repeatable_option
from dynident_service.cli.request_options import RequestOptions, TypedValues


def simulate(
    robot: RobotArgument,
    additions: RobotAdditions,
    effects: Annotated[
        list[str],
        repeatable_option(
            "--effects",
            metavar="EFFECT,…",
            help="What acts besides rotor inertia, Coulomb and viscous friction: stribeck@joint2, or with values "
            "stribeck@joint2:Fst=3,vs=0.05. Of a usual size where no values are given. payload:run=2: in run 2 alone.",
        ),
    ],
    request_options: Annotated[TypedValues, RequestOptions(Simulated, but=("effects", "sampling_rate"))],
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate of the sensors in Hz.")] = 500.0,
    trajectory: Annotated[
        SomeFile,
        file_option(
            "--trajectory",
            help="What `dynident design` wrote: t, q_<joint>… and, unless they are to follow from q, dq_… and ddq_…. "
            "A random motion otherwise.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The measurement, .csv or .parquet.")] = Path(
        "measurement.csv"
    ),
    as_json: Json = False,
) -> None:
    """Measure a virtual robot along a trajectory."""
    from dynident.progress import scale_progress
    from dynident.simulation import (
        build_recording_table,
        build_simulation_request,
        replace_usual_effects,
        resolve_true_effects,
    )
    from dynident.simulation import simulate as simulate_robot
    from dynident_service.adapters.simulations import describe_simulation
    from dynident_service.cli import inputs, output, table_files, terminal, virtual_robot

    table_files.check_ending(out)
    machine = inputs.load_robot_argument(robot, additions)
    request = request_options.build_request(Simulated)
    hidden = resolve_true_effects(virtual_robot.parse_acting_effects(effects), machine)
    with terminal.show_progress_bar("simulate") as progress:
        reference = virtual_robot.load_reference(trajectory, machine, request.seed, scale_progress(progress, 0.0, 0.2))
        simulation = build_simulation_request(request, machine, reference, rate)
        measurement = simulate_robot(
            machine,
            replace(simulation, effects=replace_usual_effects(simulation.effects, hidden)),
            scale_progress(progress, 0.2, 1.0),
        )
    table_files.write_table(build_recording_table(measurement), out)
    rows = [
        [joint.name, f"{measurement.noise[j]:.3g} {joint.effort_unit}", f"{measurement.tracking_error[j]:.2g}"]
        for j, joint in enumerate(machine.joints)
    ]
    columns = ("joint", "torque noise, standard deviation", "largest distance from the trajectory (rad or m)")
    output.print_result(
        as_json,
        lambda: describe_simulation(measurement, rate),
        lambda console: console.print(terminal.build_table("", columns, rows)),
        f"{measurement.n_samples} samples at {rate:g} Hz written to {out}",
    )
