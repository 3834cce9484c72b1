"""`dynident identify`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import (
    Accept,
    AsProposed,
    Columns,
    DriveGains,
    Effects,
    Estimator,
    Json,
    Measurements,
    Metadata,
    Model,
    Out,
    Prior,
    RobotArgument,
    Steps,
    Strategy,
    Units,
    Validation,
    Windows,
)


def identify(
    robot: RobotArgument,
    measurements: Measurements,
    validation: Validation,
    columns: Columns,
    units: Units,
    windows: Windows,
    accept: Accept,
    effects: Effects,
    metadata: Metadata,
    friction: Annotated[
        list[Path],
        typer.Option(
            "--friction",
            metavar="FILE",
            help="Measurement at constant velocities, for the strategy separate_friction; may be repeated.",
            default_factory=list,
            show_default=False,
        ),
        TO_READ,
    ],
    drive_gains: DriveGains = "",
    as_proposed: AsProposed = False,
    model: Model = "dynamic",
    strategy: Strategy = "global",
    steps: Steps = "link_by_link",
    estimator: Estimator = "wls",
    prior: Prior = "",
    free_links: Annotated[
        str, typer.Option("--free-links", metavar="JOINT,…", help="Links that the prior is not believed of.")
    ] = "",
    prior_error: Annotated[
        float, typer.Option("--prior-error", help="Share by which the description's inertias are usually off.")
    ] = 0.2,
    covariance: Annotated[
        str,
        typer.Option(
            "--covariance",
            help="What of the residuals counts as correlated: by_time_and_joints, by_joint, or independent (nothing).",
        ),
    ] = "by_time_and_joints",
    pole: Annotated[
        float | None, typer.Option("--pole", help="a of the filtered model's F(s) in rad/s; from the data if left out.")
    ] = None,
    interval: Annotated[
        float | None,
        typer.Option("--interval", help="Seconds that the energy model's equations span; from the data if left out."),
    ] = None,
    preprocessing: Annotated[
        str,
        typer.Option(
            "--preprocessing",
            metavar="auto|NAME=VALUE,…",
            help="auto, or any of position_cutoff, torque_cutoff (Hz, or none), decimation, filter_order.",
        ),
    ] = "auto",
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Identify the base parameters of a robot."""
    from dynident.effects import DEFAULT_EFFECTS
    from dynident.identification import IdentificationChoices, to_bytes
    from dynident.identification import identify as identify_model
    from dynident.progress import part
    from dynident.recordings import preprocessing_from_request
    from dynident_service.adapters.identifications import describe_identification
    from dynident_service.adapters.measurements import show_checks
    from dynident_service.cli import inputs, methods, parsing, shown, terminal
    from dynident_service.models.common import plain

    machine = inputs.robot_of(robot, drive_gains)
    options = inputs.FileOptions(
        columns, units, windows, accept, dict.fromkeys(friction, "friction"), metadata, as_proposed
    )
    chosen = inputs.effects_of(effects, machine) or DEFAULT_EFFECTS
    method = methods.method_of(model, strategy, steps, estimator, prior)
    unfiltered = replace(
        method.of(
            IdentificationChoices(
                effects=chosen,
                pole=pole,
                interval=interval,
                prior_error=prior_error,
                covariance=methods.covariance_of(covariance),
            )
        ),
        free_links=tuple(name.strip() for name in free_links.split(",") if name.strip()),
    )
    with (
        terminal.progress_bar("identify") as progress,
        inputs.loaded([*measurements, *friction], machine, options, part(progress, 0.0, 0.5), validation) as (
            training,
            held_out,
        ),
    ):
        asked = parsing.preprocessing_request(preprocessing)
        recordings = inputs.recordings_of(training)
        filters = None if asked == "auto" else preprocessing_from_request(asked, recordings)
        choices = replace(unfiltered, preprocessing=filters)
        found = identify_model(machine, recordings, inputs.recordings_of(held_out), choices, part(progress, 0.5, 1.0))
    if out is not None:
        inputs.write_whole(out, to_bytes(found))
    if as_json:
        document = plain(describe_identification(found, None))
        document["measurements"] = [
            {"name": item.recording.name, "checks": [plain(check) for check in show_checks(item.checks)]}
            for item in [*training, *held_out]
        ]
        terminal.print_json(document)
        return
    console = terminal.out()
    shown.show_measurements(console, training, held_out)
    shown.show_identification(console, found)
    if out is not None:
        console.print(f"model written to {out}", markup=False)
