"""`dynident diagnose`."""

from __future__ import annotations

from typing import Annotated

import typer

from dynident_service.cli.options import Json, Measurements, ModelArgument, Out, Reading


def diagnose(
    model: ModelArgument,
    measurements: Measurements,
    reading: Reading,
    candidates: Annotated[
        str, typer.Option("--candidates", metavar="EFFECT,…", help="Only these effects; the whole catalogue otherwise.")
    ] = "",
    max_effects: Annotated[int | None, typer.Option("--max-effects", min=1, help="Recommend at most so many.")] = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Name the physics that a model is missing.

    Give the measurements that it was identified from. --out writes the diagnosis as JSON.
    """
    import json

    from dynident.diagnosis import diagnose as diagnose_model
    from dynident.diagnosis.diagnosing import DEFAULT_MOST_EFFECTS
    from dynident.progress import part
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, shown, terminal
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    robot = identification.model.robot
    names = [name.strip() for name in candidates.split(",") if name.strip()] or None
    with (
        terminal.progress_bar("diagnose") as progress,
        inputs.loaded(measurements, robot, reading, part(progress, 0.0, 0.3)) as (given, _),
    ):
        found = diagnose_model(
            identification,
            inputs.recordings_of(given),
            candidates=names,
            most_effects=max_effects or DEFAULT_MOST_EFFECTS,
            progress=part(progress, 0.3, 1.0),
        )
    document = plain(describe_diagnosis(found, robot.name))
    if out is not None:
        inputs.write_whole(out, json.dumps(document, indent=1).encode())
    if as_json:
        terminal.print_json(document)
        return
    console = terminal.out()
    shown.show_diagnosis(console, found, robot)
    if out is not None:
        console.print(f"diagnosis written to {out}", markup=False)
