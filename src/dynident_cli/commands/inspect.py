"""`dynident inspect`: propose what a file's columns are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynident.text_encoding import encode_text
from dynident_cli.input_checks_and_writes import KNOWN_ROBOT, READABLE_FILE
from dynident_cli.shared_options import Json, Out, Rate, RobotAdditions

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.identification.column_inference import Inspection


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

    The answer has reasons, and the questions that you must answer before you can use the file.

    --out writes the proposal as JSON, for `dynident identify --metadata`.
    """
    from dynident.identification.column_inference import inspect_file
    from dynident_cli import argument_loading, command_output, input_checks_and_writes, metadata_files

    machine = None if robot is None else argument_loading.load_robot_argument(robot, additions)
    inspection = inspect_file(file, machine, rate)
    if inspection.proposal is not None:
        # An open question ends the command here, before anything is written.
        if as_proposed:
            metadata_files.accept_proposal(file, inspection, has_gains=True)
        if out is not None:
            document = json.dumps(metadata_files.proposal_document(inspection, rate), indent=2, ensure_ascii=False)
            input_checks_and_writes.write_atomically(out, encode_text(f"{document}\n"))
    messages = () if out is None or inspection.proposal is None else (f"proposal written to {out}",)
    command_output.print_result(
        as_json, lambda: _to_document(inspection), lambda console: _print_inspection(console, inspection), *messages
    )


def _to_document(inspection: Inspection) -> dict[str, Any]:
    from dynident_service.measurements.adapters import describe_inspection

    return describe_inspection(inspection, inspection.sha256).model_dump(mode="json")


def _print_inspection(console: Console, inspection: Inspection) -> None:
    from dynident.errors import word_remedies
    from dynident.presentation.recording_tables import build_guess_table
    from dynident_cli import metadata_files, terminal
    from dynident_cli.request_options import write_option

    console.print(f"{inspection.format}, {len(inspection.columns)} columns, {inspection.n_rows_seen} rows inspected")
    if inspection.proposal is None:
        console.print(", ".join(inspection.columns), soft_wrap=True)
        console.print("To find out what the columns are, give the robot: --robot ROBOT.")
        return
    terminal.print_tables(console, [build_guess_table(inspection.proposal.guesses, write_option)])
    for question in inspection.proposal.questions:
        choices = f" ({', '.join(question.choices[:8])})" if question.choices else ""
        detail = word_remedies(question.detail, question.remedies, write_option)
        console.print(f"? {question.field}: {detail}{choices}", soft_wrap=True)
        if answer := metadata_files.describe_answer(question):
            console.print(f"    → {answer}", soft_wrap=True, markup=False)
    if not inspection.proposal.questions:
        console.print("No question is open: identify with --as-proposed.")
