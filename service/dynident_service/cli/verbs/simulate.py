"""`dynident simulate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import DriveGains, Json, RobotArgument, Seed


@dataclass(frozen=True)
class _Sensing:
    """How the virtual robot is measured."""

    rate: Annotated[float, typer.Option("--rate", help="Sampling rate of the sensors in Hz.")] = 500.0
    torque_noise: Annotated[
        float, typer.Option("--torque-noise", help="Standard deviation, as a share of the effort limit.")
    ] = 0.005
    encoder_counts: Annotated[int, typer.Option("--encoder-counts", help="Per turn; 0: exact positions.")] = 2**19
    jitter: Annotated[float, typer.Option("--jitter", help="Standard deviation of the sampling instants in s.")] = 0.0
    current: Annotated[bool, typer.Option("--current", help="Record currents; needs drive gains.")] = False


@dataclass(frozen=True)
class _Repeated:
    """How often it moves, and what is drawn."""

    runs: Annotated[
        int, typer.Option("--runs", help="How often the motion is made; the file tells the runs apart by `segment`.")
    ] = 1
    pause: Annotated[float, typer.Option("--pause", help="Seconds between runs; the session's time goes on.")] = 60.0
    seed: Seed = 0


def simulate(
    robot: RobotArgument,
    effects: Annotated[
        list[str],
        typer.Option(
            "--effects",
            metavar="EFFECT,…",
            help="What acts besides rotor inertia, Coulomb and viscous friction: stribeck@joint2, or with values "
            "stribeck@joint2:Fst=3,vs=0.05. Of a usual size where no values are given. payload:run=2: in run 2 alone.",
            default_factory=list,
            show_default=False,
        ),
    ],
    sensing: _Sensing,
    repeated: _Repeated,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            "--trajectory",
            metavar="FILE",
            help="What `dynident design` wrote: t, q_<joint>… and, unless they are to follow from q, dq_… and ddq_…. "
            "A random motion otherwise.",
        ),
        TO_READ,
    ] = None,
    drive_gains: DriveGains = "",
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The measurement, .csv or .parquet.")] = Path(
        "measurement.csv"
    ),
    as_json: Json = False,
) -> None:
    """Measure a virtual robot along a trajectory."""
    from dynident.progress import part
    from dynident.simulation import Sensors, SimulationRequest, measurement_table, typical_drive
    from dynident.simulation import simulate as simulate_robot
    from dynident_service.adapters.simulations import describe_simulation
    from dynident_service.cli import inputs, tables, terminal, virtual
    from dynident_service.models.common import plain

    tables.check_ending(out)
    machine = inputs.robot_of(robot, drive_gains)
    hidden = virtual.true_effects(effects, machine)
    sensors = Sensors(
        sampling_rate=sensing.rate,
        encoder_counts=sensing.encoder_counts or None,
        torque_noise=sensing.torque_noise,
        jitter=sensing.jitter,
        current=sensing.current,
    )
    with terminal.progress_bar("simulate") as progress:
        reference = virtual.reference_of(trajectory, machine, repeated.seed, part(progress, 0.0, 0.2))
        request = SimulationRequest(
            reference,
            virtual.beside(typical_drive(machine), hidden),
            sensors=sensors,
            seed=repeated.seed,
            runs=repeated.runs,
            pause=repeated.pause,
        )
        found = simulate_robot(machine, request, part(progress, 0.2, 1.0))
    tables.write_table(measurement_table(found), out)
    if as_json:
        terminal.print_json(plain(describe_simulation(found, sensing.rate)))
        return
    console = terminal.out()
    rows = [
        [joint.name, f"{found.noise[j]:.3g} {joint.effort_unit}", f"{found.tracking_error[j]:.2g}"]
        for j, joint in enumerate(machine.joints)
    ]
    columns = ("joint", "torque noise, standard deviation", "largest distance from the trajectory (rad or m)")
    console.print(terminal.table("", columns, rows))
    console.print(f"{found.n_samples} samples at {sensing.rate:g} Hz written to {out}", markup=False)
