"""`dynident compare`: measured against predicted torque."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_cli.input_checks_and_writes import READABLE_FILE
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
    from dynident.diagnosis import compare as compare_model
    from dynident.diagnosis import judge
    from dynident.identification import check_same_recordings
    from dynident.progress import scale_progress
    from dynident_cli import argument_loading, command_output, csv_and_parquet_output, printed_results
    from dynident_service.comparisons.adapters import describe_comparison

    identification = argument_loading.load_model(model)
    if out is not None:
        csv_and_parquet_output.check_ending(out)
    with argument_loading.read_recordings(
        "compare", [measurement], identification.model.robot, reading, learnt
    ) as data:
        (recording,) = data.recordings
        if learnt:
            check_same_recordings(identification, data.other_recordings)
        comparison = compare_model(identification, recording, scale_progress(data.progress, 0.0, 0.8))
        judgement = judge(comparison, recording, identification.preprocessing, data.other_recordings)
    if out is not None:
        csv_and_parquet_output.write_table(csv_and_parquet_output.build_comparison_table(comparison), out)

    def print_comparison(console: Console) -> None:
        printed_results.show_measurements(console, (), data.loaded)
        printed_results.show_comparison(console, recording.name, comparison, judgement)

    messages = () if out is None else (f"signals written to {out}",)
    command_output.print_result(
        as_json,
        lambda: describe_comparison(comparison, judgement, True if learnt else None),
        print_comparison,
        *messages,
    )
