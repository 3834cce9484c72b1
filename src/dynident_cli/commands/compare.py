"""`dynident compare`: measured against predicted torque."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_cli.input_checks import READABLE_FILE
from dynident_cli.shared_options import Json, ModelArgument, Out, Reading, repeatable_file_option

if TYPE_CHECKING:
    from rich.console import Console


def compare(
    model: ModelArgument,
    measurement: Annotated[
        Path, typer.Argument(metavar="MEASUREMENT", help="CSV or Parquet file.", show_default=False), READABLE_FILE
    ],
    reading: Reading,
    learnt: Annotated[
        list[Path],
        repeatable_file_option(
            "--learnt",
            help="Recording that the model was identified from; may be repeated. Shows whether MEASUREMENT only "
            "repeats its motion.",
        ),
        READABLE_FILE,
    ],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Compare predicted with measured torque.

    --out writes the signals as .csv or .parquet.
    """
    from dynident.api.model_identification import load_model
    from dynident.api.torque_comparison import compare as compare_model
    from dynident.file_output import TABLE_ENDINGS, check_ending
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    identified = load_model(model)
    if out is not None:
        check_ending(out, TABLE_ENDINGS)
    with argument_loading.read_recordings("compare", [measurement], identified.robot, reading, learnt) as data:
        recordings, others, progress = data
        (compared,) = compare_model(identified, recordings, learnt=others or None, progress=progress)
    if out is not None:
        compared.save(out)

    def print_comparison(console: Console) -> None:
        printed_results.show_measurements(console, recordings[:0], recordings)
        printed_results.show_comparison(console, compared.name, compared.comparison, compared.judgement)

    messages = () if out is None else (f"signals written to {out}",)
    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_comparison(compared, learnt=bool(learnt)),
        print_comparison,
        *messages,
    )
