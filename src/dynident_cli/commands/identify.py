"""`dynident effects`, `identify`, `extend`, `remove`, `essential` and `ladder`."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.identification.identification_choices import EssentialChoices, IdentificationChoices
from dynident.recordings.recording_metadata import Filters
from dynident.schema.fields import get_description
from dynident_cli.input_checks_and_writes import READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Effects,
    Json,
    Measurements,
    ModelArgument,
    OutputOptions,
    Reading,
    RobotArgument,
    RobotReading,
    SomeFile,
    Validation,
    file_option,
    repeatable_file_option,
)

if TYPE_CHECKING:
    from pydantic import BaseModel
    from rich.console import Console


def effects(as_json: Json = False) -> None:
    """List the effects that a model can contain."""
    from dynident.effects import CATALOGUE
    from dynident_cli import command_output, terminal

    rows = [
        [
            effect.id,
            effect.title,
            ", ".join(
                f"{parameter.name} ({parameter.unit})" if parameter.unit != "-" else parameter.name
                for parameter in effect.parameters
            ),
            effect.signature,
        ]
        for effect in CATALOGUE.values()
    ]
    columns = ("effect", "what it is", "parameters", "what it leaves in the residual")
    table = terminal.build_table("", columns, rows, right_from=len(columns))

    def describe_catalogue() -> BaseModel:
        from dynident_service.shared.field_by_field import show_catalogue

        return show_catalogue()

    command_output.print_result(as_json, describe_catalogue, lambda console: console.print(table))


def ladder(
    model: ModelArgument,
    against: Annotated[
        Path | None,
        typer.Option("--against", metavar="MODEL", help="Another model, to compare its ladder with this one."),
        READABLE_FILE,
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the steps that led to a model, with their errors. The step that predicts held-out data best is marked."""
    from dynident.errors import DynidentError
    from dynident_cli import argument_loading, command_output, printed_results
    from dynident_service.identifications.adapters import build_steps, compare_ladders
    from dynident_service.identifications.wire_types import Lineage

    identification = argument_loading.load_model(model)
    other = None if against is None else argument_loading.load_model(against)
    if other is not None and other.model.robot.joint_names != identification.model.robot.joint_names:
        raise DynidentError(f"{against} is a model of another robot", pointer="--against", title="Another robot")

    def describe_ladder() -> Lineage:
        own = build_steps(identification, model.stem)
        if other is None or against is None:
            return Lineage(items=own)
        data_sets = (step.data for top in (identification, other) for step in top.ladder())
        data = {(data_set.measurement_names, data_set.validation_names) for data_set in data_sets}
        return compare_ladders(own, build_steps(other, against.stem, (identification, model.stem)), len(data) == 1)

    def print_ladder(console: Console) -> None:
        if other is None or against is None:
            printed_results.show_ladder(console, identification)
        else:
            printed_results.show_ladders(console, (model.stem, identification), (against.stem, other))

    command_output.print_result(as_json, describe_ladder, print_ladder)


def essential(
    model: ModelArgument,
    request_options: Annotated[TypedValues, RequestOptions(EssentialChoices)],
    result: OutputOptions,
) -> None:
    """Find the essential parameters by backward elimination.

    --out writes the model with the essential parameters estimated again, the others at zero.
    """
    from dynident.identification import to_bytes
    from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
    from dynident_cli import argument_loading, command_output, printed_results
    from dynident_service.identifications.adapters import describe_essential

    path = essential_parameters(
        argument_loading.load_model(model), request_options.build_request(EssentialChoices).ratio
    )
    command_output.write_result(
        result,
        "model",
        lambda: describe_essential(path),
        lambda console: printed_results.show_essential(console, path),
        lambda: to_bytes(path.identification),
    )


def remove(model: ModelArgument, effects: Effects, result: OutputOptions) -> None:
    """Remove effects from a model.

    No measurement is needed: the model's file holds the reduced data.
    """
    from dynident.errors import DynidentError
    from dynident.identification import remove as remove_effects
    from dynident_cli import argument_loading, command_output

    identification = argument_loading.load_model(model)
    removed = argument_loading.parse_unchecked_effects(effects)
    if not removed:
        raise DynidentError("the effects to remove are missing; give --effects", pointer="--effects")
    reduced_model = remove_effects(identification, removed)
    command_output.write_extended_model(result, reduced_model, model.stem, identification)


def extend(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    effects: Effects,
    result: OutputOptions,
    diagnosis: Annotated[
        SomeFile, file_option("--diagnosis", help="Add what a diagnosis recommends (`dynident diagnose --out`).")
    ] = None,
) -> None:
    """Add effects to a model.

    Give the measurements that the model was identified from. Ends with the verdict on the model, as `identify` does.
    """
    from dynident.errors import DynidentError
    from dynident.identification import extend as extend_model
    from dynident.verdict import verdict
    from dynident_cli import argument_loading, command_output, printed_results

    identification = argument_loading.load_model(model)
    robot = identification.model.robot
    added = argument_loading.read_effects(effects, robot)
    if diagnosis is not None:
        stored_diagnosis = argument_loading.load_diagnosis(diagnosis)
        added += stored_diagnosis.recommended
        if not added:
            why = f"Nothing was added, because the diagnosis recommends nothing. {stored_diagnosis.summary}"
            command_output.write_unchanged_model(result, identification, why)
            return
    if not added:
        raise DynidentError(
            "the effects to add are missing; give --effects, or --diagnosis with a file", pointer="--effects"
        )
    with argument_loading.read_recordings("extend", measurements, robot, reading, validation) as data:
        extended = extend_model(identification, added, data.recordings, data.other_recordings, data.progress)
        checks = {item.recording.name: item.checks for item in (*data.loaded, *data.others)}
        model_verdict = verdict(extended, data.recordings, data.other_recordings, checks)
    command_output.write_extended_model(result, extended, model.stem, identification, model_verdict)
    if model_verdict.stop is not None:
        raise typer.Exit(printed_results.EXIT_STOPPED)


_FILTERS = ", ".join(
    f"{filter_field.name} ({unit})" if (unit := get_description(filter_field).unit) else filter_field.name
    for filter_field in fields(Filters)
)


@dataclass(frozen=True)
class FurtherInputs:
    """Further input files besides the measurements."""

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
    from dynident_cli import argument_loading, command_output, option_parsers, printed_results

    machine = argument_loading.load_robot_argument(robot, reading)
    chosen_effects = argument_loading.read_effects(further.effects, machine) or DEFAULT_EFFECTS
    # Options are read before the recordings: a mistake shows at once.
    unfiltered = request_options.build_request(IdentificationChoices, effects=chosen_effects)
    everything = [*measurements, *further.friction]
    with argument_loading.read_recordings(
        "identify", everything, machine, reading, further.validation, further.friction
    ) as data:
        preprocessing = option_parsers.parse_preprocessing(further.preprocessing)
        recordings, held_out = data.recordings, data.other_recordings
        filters = None if preprocessing == "auto" else preprocessing_from_request(preprocessing, recordings)
        choices = replace(unfiltered, preprocessing=filters)
        identification = identify_model(machine, recordings, held_out, choices, data.progress)
        checks = {item.recording.name: item.checks for item in (*data.loaded, *data.others)}
        model_verdict = verdict(identification, recordings, held_out, checks)

    def describe_result() -> dict[str, object]:
        from dynident_service.identifications.adapters import describe_identification, show_verdict
        from dynident_service.measurements.adapters import show_checks
        from dynident_service.shared.wire_types import to_plain_json

        return {
            **to_plain_json(describe_identification(identification, None)),
            "verdict": to_plain_json(show_verdict(model_verdict)),
            "measurements": [
                {"name": item.recording.name, "checks": [to_plain_json(check) for check in show_checks(item.checks)]}
                for item in [*data.loaded, *data.others]
            ],
        }

    def print_result(console: Console) -> None:
        printed_results.show_measurements(console, data.loaded, data.others)
        printed_results.show_identification(console, identification)
        printed_results.show_verdict(console, model_verdict)

    command_output.write_result(result, "model", describe_result, print_result, lambda: to_bytes(identification))
    # The model is written all the same: a script sees by the exit code that it must not be used.
    if model_verdict.stop is not None:
        raise typer.Exit(printed_results.EXIT_STOPPED)
