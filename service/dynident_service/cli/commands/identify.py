"""`dynident identify`."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.identification.choices import IdentificationChoices
from dynident.recordings.metadata import PreprocessingChoices
from dynident.schema.fields import get_description
from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.options import (
    Effects,
    Measurements,
    OutputOptions,
    RobotArgument,
    RobotReading,
    Validation,
    repeatable_file_option,
)
from dynident_service.cli.request_options import RequestOptions, TypedValues

if TYPE_CHECKING:
    from rich.console import Console

_FILTERS = ", ".join(
    f"{filter_field.name} ({unit})" if (unit := get_description(filter_field).unit) else filter_field.name
    for filter_field in fields(PreprocessingChoices)
)


@dataclass(frozen=True)
class FurtherInputs:
    """What is given beside the measurements."""

    validation: Validation
    effects: Effects
    friction: Annotated[
        list[Path],
        repeatable_file_option(
            "--friction",
            help="Measurement at constant velocities, for the strategy separate_friction; may be repeated.",
        ),
        READABLE_FILE,
    ]
    preprocessing: Annotated[
        str,
        typer.Option(
            "--preprocessing",
            metavar="auto|NAME=VALUE,…",
            help=f"auto, or any of {_FILTERS}; none: no filter.",
        ),
    ] = "auto"


def identify(
    robot: RobotArgument,
    measurements: Measurements,
    reading: RobotReading,
    further: FurtherInputs,
    request_options: Annotated[TypedValues, RequestOptions(IdentificationChoices)],
    result: OutputOptions,
) -> None:
    """Identify the base parameters of a robot."""
    from dynident.effects import DEFAULT_EFFECTS
    from dynident.identification import identify as identify_model
    from dynident.identification import to_bytes
    from dynident.recordings import preprocessing_from_request
    from dynident.verdict import verdict
    from dynident_service.cli import inputs, output, parsing, result_tables

    machine = inputs.load_robot_argument(robot, reading)
    chosen_effects = inputs.read_effects(further.effects, machine) or DEFAULT_EFFECTS
    # Options are read before the recordings: a mistake shows at once.
    unfiltered = request_options.build_request(IdentificationChoices, effects=chosen_effects)
    everything = [*measurements, *further.friction]
    with inputs.read_recordings("identify", everything, machine, reading, further.validation, further.friction) as data:
        preprocessing = parsing.parse_preprocessing(further.preprocessing)
        recordings, held_out = data.recordings, data.other_recordings
        filters = None if preprocessing == "auto" else preprocessing_from_request(preprocessing, recordings)
        choices = replace(unfiltered, preprocessing=filters)
        identification = identify_model(machine, recordings, held_out, choices, data.progress)
        checks = {item.recording.name: item.checks for item in (*data.loaded, *data.others)}
        model_verdict = verdict(identification, recordings, held_out, checks)

    def describe_result() -> dict[str, object]:
        from dynident_service.adapters.identifications import describe_identification
        from dynident_service.adapters.measurements import show_checks
        from dynident_service.adapters.verdicts import show_verdict
        from dynident_service.models.common import to_plain_json

        return {
            **to_plain_json(describe_identification(identification, None)),
            "verdict": to_plain_json(show_verdict(model_verdict)),
            "measurements": [
                {"name": item.recording.name, "checks": [to_plain_json(check) for check in show_checks(item.checks)]}
                for item in [*data.loaded, *data.others]
            ],
        }

    def print_result(console: Console) -> None:
        result_tables.show_measurements(console, data.loaded, data.others)
        result_tables.show_identification(console, identification)
        result_tables.show_verdict(console, model_verdict)

    output.write_result(result, "model", describe_result, print_result, lambda: to_bytes(identification))
    # The model is written all the same: a script sees by the exit code that it must not be used.
    if model_verdict.stop is not None:
        raise typer.Exit(result_tables.EXIT_STOPPED)
