"""`dynident validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import (
    Accept,
    Columns,
    Cure,
    Json,
    ModelArgument,
    Out,
    Seed,
    Units,
    Validation,
    Windows,
)


def validate(
    model: ModelArgument,
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="direct, cross, inertia_matrix, payload, methods, simulation, filters or bootstrap.",
            show_default=False,
        ),
    ],
    columns: Columns,
    units: Units,
    windows: Windows,
    accept: Accept,
    validation: Validation,
    measurements: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[MEASUREMENT]…",
            help="direct, methods, filters: what the model was identified from; cross: what it has not seen; "
            "simulation: the motion; payload: runs with the load.",
            show_default=False,
        ),
        TO_READ,
    ] = None,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--methods",
            metavar="MODEL/STRATEGY/ESTIMATOR,…",
            help="For methods: which; filtered or sequential/ols is enough. All that are available if left out.",
            show_default=False,
        ),
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option("--limit", help="For direct, cross, simulation: largest relative error that passes, 0.15."),
    ] = None,
    cutoffs: Annotated[
        str, typer.Option("--cutoffs", metavar="F1,F2,…", help="For filters: position cut-offs in Hz to try.")
    ] = "",
    longest: Annotated[
        float | None, typer.Option("--longest", help="For simulation, filters: seconds that are simulated at most.")
    ] = None,
    mass: Annotated[float | None, typer.Option("--mass", help="For payload: what the load weighs in kg.")] = None,
    draws: Annotated[
        int | None, typer.Option("--draws", help="For bootstrap: how often stretches of time are drawn, 999.")
    ] = None,
    unloaded: Annotated[
        list[Path] | None,
        typer.Option("--unloaded", metavar="FILE", help="For payload: runs without the load.", show_default=False),
        TO_READ,
    ] = None,
    seed: Seed = 0,
    out: Out = None,
    cure: Cure = False,
    as_json: Json = False,
) -> None:
    """Try whether an identified model is to be trusted.

    Ends with pass, fail or not evaluated and the reason; exit code 1 after fail. --out writes the result as JSON.
    """
    import json

    from dynident.progress import part
    from dynident_service.cli import inputs, parsing, shown_validations, terminal, validating
    from dynident_service.cli import methods as by_name
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    asked = validating.Asked(
        kind=validating.kind_of(kind),
        methods=by_name.methods_of(methods or []),
        limit=limit,
        cutoffs=tuple(parsing.numbers(cutoffs, "--cutoffs")) or None,
        longest=longest,
        mass=mass,
        draws=draws,
        seed=seed,
    )
    given = measurements or []
    beside = [*validation, *(unloaded or [])]
    validating.check(asked, len(given), len(beside))
    options = inputs.FileOptions(columns, units, windows, accept, cure=cure)
    robot = identification.model.robot
    with (
        terminal.progress_bar("validate") as progress,
        inputs.loaded(given, robot, options, part(progress, 0.0, 0.3), beside) as (tried, held_out),
    ):
        recordings, others = inputs.recordings_of(tried), inputs.recordings_of(held_out)
        found = validating.run(identification, asked, recordings, others, part(progress, 0.3, 1.0))
    if out is not None:
        inputs.write_whole(out, json.dumps(plain(found), indent=1).encode())
    if as_json:
        terminal.print_json(plain(found))
    else:
        console = terminal.out()
        shown_validations.show_validation(console, found, robot)
        if out is not None:
            console.print(f"result written to {out}", markup=False)
    if found.verdict == "fail":
        raise typer.Exit(1)
