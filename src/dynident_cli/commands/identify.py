"""`dynident inspect`, `effects`, `identify`, `extend`, `remove`, `essential` and `ladder`."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.identification.identification_choices import EssentialChoices, IdentificationChoices
from dynident.recordings.recording_metadata import Filters
from dynident.schema.fields import get_description
from dynident.text_encoding import encode_text
from dynident_cli.option_parsers import KNOWN_ROBOT, READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Effects,
    Json,
    Measurements,
    ModelArgument,
    Out,
    OutputOptions,
    Rate,
    Reading,
    RobotAdditions,
    RobotArgument,
    RobotReading,
    SomeFile,
    Validation,
    file_option,
    repeatable_file_option,
)

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.effects import EffectChoice
    from dynident.identification.column_inference import Inspection


def effects(as_json: Json = False) -> None:
    """List the effects that a model can contain."""
    from dynident.effects import CATALOGUE
    from dynident.presentation.model_tables import build_catalogue_table
    from dynident_cli import command_output, contract_documents

    table = build_catalogue_table(CATALOGUE.values())
    command_output.print_result(
        as_json, contract_documents.describe_catalogue, lambda console: command_output.print_tables(console, [table])
    )


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
    from dynident.api.model_identification import load_model
    from dynident.errors import DynidentError
    from dynident_cli import command_output, contract_documents, printed_results

    named = model.stem, load_model(model)
    other = None if against is None else (against.stem, load_model(against))
    if other is not None and other[1].robot.joint_names != named[1].robot.joint_names:
        raise DynidentError(f"{against} is a model of another robot", pointer="--against", title="Another robot")

    def print_ladder(console: Console) -> None:
        if other is None:
            printed_results.show_ladder(console, named[1].identification)
        else:
            printed_results.show_ladders(
                console, (named[0], named[1].identification), (other[0], other[1].identification)
            )

    command_output.print_result(as_json, lambda: contract_documents.describe_ladder(named, other), print_ladder)


def essential(
    model: ModelArgument,
    request_options: Annotated[TypedValues, RequestOptions(EssentialChoices)],
    result: OutputOptions,
) -> None:
    """Find the essential parameters by backward elimination.

    --out writes the model with the essential parameters estimated again, the others at zero.
    """
    from dynident.api.model_identification import load_model
    from dynident.identification import to_bytes
    from dynident.identification.identified_models.correlated_and_essential_parameters import essential_parameters
    from dynident_cli import command_output, contract_documents, printed_results

    path = essential_parameters(load_model(model).identification, request_options.build_request(EssentialChoices).ratio)
    command_output.write_result(
        result,
        "model",
        lambda: contract_documents.describe_essential(path),
        lambda console: printed_results.show_essential(console, path),
        lambda: to_bytes(path.identification),
    )


def remove(model: ModelArgument, effects: Effects, result: OutputOptions) -> None:
    """Remove effects from a model.

    No recording is needed: the model's file contains the reduced data.
    """
    from dynident.api.model_identification import load_model
    from dynident.errors import DynidentError
    from dynident_cli import argument_loading, printed_results

    identified = load_model(model)
    removed = argument_loading.name_runs(
        argument_loading.parse_unchecked_effects(effects), identified.identification.data.measurement_names
    )
    if not removed:
        raise DynidentError("the effects to remove are missing; give --effects", pointer="--effects")
    printed_results.write_extended_model(result, identified.remove(*removed), model.stem, identified)


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

    Give the recordings from which the model was identified. Ends with the verdict on the model, as `identify` does.
    """
    from dynident.api.model_identification import load_model
    from dynident.errors import DynidentError
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    identified = load_model(model)
    robot = identified.robot
    added = argument_loading.read_effects(effects, robot)
    recommended: tuple[EffectChoice, ...] = ()
    if diagnosis is not None:
        stored_diagnosis = contract_documents.load_diagnosis(diagnosis)
        recommended = stored_diagnosis.recommended
        if not (added or recommended):
            why = f"Nothing was added, because the diagnosis recommends nothing. {stored_diagnosis.summary}"
            command_output.write_model(result, "the same model", identified, lambda console: console.print(why))
            return
    if not (added or recommended):
        raise DynidentError(
            "the effects to add are missing; give --effects, or --diagnosis with a file", pointer="--effects"
        )
    with argument_loading.read_recordings("extend", measurements, robot, reading, validation) as data:
        recordings, held_out, progress = data
        whole = replace(identified.with_data(recordings), validation=held_out)
        named = argument_loading.name_runs(added, recordings.names)
        extended = whole.extend(*named, *recommended, progress=progress)
        verdict = extended.verdict()

    def show_next(console: Console) -> None:
        if result.out is not None and verdict.stop is None:
            files = [*validation[:1], *measurements] if validation else measurements[:1]
            fit = [word for path in files[1:] for word in ("--fit", path)]
            words = ["compare", result.out, files[0], *(fit if validation else ())]
            printed_results.show_next_command(console, "see where it still fails", words, files, reading)

    printed_results.write_extended_model(result, extended, model.stem, identified, verdict, show_next)
    if verdict.stop is not None:
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
            help="Recording at constant velocities, for the strategy separate_friction; may be repeated.",
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
    from dynident.api.model_identification import identify as identify_model
    from dynident.effects import DEFAULT_EFFECTS
    from dynident.identification.identified_models.fit_model import is_worse_on_held_out
    from dynident_cli import argument_loading, command_output, option_parsers, printed_results

    machine = argument_loading.load_robot_argument(robot, reading)
    chosen_effects = argument_loading.read_effects(further.effects, machine) or DEFAULT_EFFECTS
    # Options are read before the recordings: a mistake shows at once.
    choices = request_options.build_request(IdentificationChoices, effects=chosen_effects)
    filters = option_parsers.parse_filters(further.preprocessing)
    with argument_loading.read_recordings(
        "identify", [*measurements, *further.friction], machine, reading, further.validation, further.friction
    ) as data:
        recordings, held_out, progress = data
        choices = replace(choices, effects=argument_loading.name_runs(chosen_effects, recordings.names))
        model = identify_model(
            machine, recordings, validation=held_out, choices=choices, filters=filters, progress=progress
        )
        verdict = model.verdict()

    def print_result(console: Console) -> None:
        printed_results.show_measurements(console, recordings, held_out)
        printed_results.show_identification(console, model.identification)
        printed_results.show_verdict(console, verdict, model.effects)
        if result.out is not None and verdict.calls_for_diagnosis:
            held_out_words = [word for path in further.validation for word in ("--validation", path)]
            words = ["diagnose", result.out, *measurements, *held_out_words]
            files = [*measurements, *further.validation]
            printed_results.show_next_command(console, "find what is missing", words, files, reading)
        if result.out is not None and verdict.stop is None and is_worse_on_held_out(model.identification):
            # Two recordings that differ, as by the zeros of joints, look like a motion that determines too little.
            before, after = (
                [word for path in paths for word in (option, path)]
                for option, paths in (("--before", measurements), ("--after", further.validation))
            )
            words, files = ["changes", result.out, *before, *after], [*measurements, *further.validation]
            printed_results.show_next_command(console, "find what differs in the held-out data", words, files, reading)

    everything = (*recordings, *held_out)
    command_output.write_model(result, "model", model, print_result, verdict=verdict, recordings=everything)
    # The model is written all the same: a script sees by the exit code that it must not be used.
    if verdict.stop is not None:
        raise typer.Exit(printed_results.EXIT_STOPPED)


_MOST_COLUMNS = 60
"""Columns that are listed of a file: robots record less, and files that are no recordings may have thousands."""


def inspect(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A recording, as a robot or a logger wrote it.", show_default=False),
        READABLE_FILE,
    ],
    additions: RobotAdditions,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot", "-r", metavar="ROBOT", help="The robot of the recording; without it, columns are only listed."
        ),
        KNOWN_ROBOT,
    ] = None,
    rate: Rate = None,
    out: Out = None,
    as_proposed: Annotated[
        bool, typer.Option("--as-proposed/--no-as-proposed", help="Fail if a question is open, and write nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Find out what the columns of a file are.

    The output gives the probable meaning and unit of each column with reasons, and the questions that you must answer
    before you can use the file.

    --out writes the proposal as JSON, for `dynident identify --metadata`.
    """
    from dynident.api.proposed_metadata import accept_proposal
    from dynident.file_output import write_atomically
    from dynident.identification.column_inference import inspect_file
    from dynident_cli import argument_loading, command_output, contract_documents
    from dynident_cli.request_options import write_option

    machine = None if robot is None else argument_loading.load_robot_argument(robot, additions)
    inspection = inspect_file(file, machine, rate)
    if inspection.proposal is not None:
        # An open question ends the command here, before anything is written.
        if as_proposed:
            # Gains belong to the robot, so the proposal for the file does not need them.
            accept_proposal(inspection, has_gains=True, write=write_option)
        if out is not None:
            document = json.dumps(argument_loading.proposal_document(inspection, rate), indent=2, ensure_ascii=False)
            write_atomically(out, encode_text(f"{document}\n"))
    messages = () if out is None or inspection.proposal is None else (f"proposal written to {out}",)
    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_inspection(inspection),
        lambda console: _print_inspection(console, inspection),
        *messages,
    )


def _print_inspection(console: Console, inspection: Inspection) -> None:
    from dynident.api.proposed_metadata import describe_answer
    from dynident.errors import Remedy, word_remedies
    from dynident.presentation.recording_tables import build_guess_table
    from dynident_cli import command_output
    from dynident_cli.request_options import write_option

    console.print(f"{inspection.format}, {len(inspection.columns)} columns, {inspection.n_rows_seen} rows inspected")
    if inspection.proposal is None:
        rest = f" and {len(inspection.columns) - _MOST_COLUMNS} more" if len(inspection.columns) > _MOST_COLUMNS else ""
        console.print(f"{', '.join(inspection.columns[:_MOST_COLUMNS])}{rest}", soft_wrap=True)
        console.print("To find out what the columns are, give the robot: --robot ROBOT.")
        return
    command_output.print_tables(console, [build_guess_table(inspection.proposal.guesses, write_option)])
    for question in inspection.proposal.questions:
        choices = f" ({', '.join(question.choices[:8])})" if question.choices else ""
        detail = word_remedies(question.detail, question.remedies, write_option)
        console.print(f"? {question.field}: {detail}{choices}", soft_wrap=True)
        if answer := describe_answer(question, write_option):
            console.print(f"    → {answer}", soft_wrap=True, markup=False)
    if inspection.proposal.questions:
        return
    if inspection.proposal.units and all(ours == name for ours, name in inspection.proposal.columns.items()):
        # Columns of these names are read without a proposal.
        units = write_option(Remedy("units", dict(inspection.proposal.units)))
        console.print(
            "No question is open. identify takes columns with the names q1, tau1 and so on to be in SI units, unless "
            f"it has {units} or --as-proposed.",
            soft_wrap=True,
        )
        return
    console.print("No question is open: identify reads the file like this.")
