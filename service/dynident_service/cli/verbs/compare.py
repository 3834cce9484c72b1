"""`dynident compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Json, ModelArgument, Out, Reading, several


def compare(
    model: ModelArgument,
    measurement: Annotated[
        Path, typer.Argument(metavar="MEASUREMENT", help="CSV or Parquet file.", show_default=False), TO_READ
    ],
    reading: Reading,
    learnt: Annotated[
        list[Path],
        several(
            "--learnt",
            metavar="FILE",
            help="What the model was identified from; repeat it for more. Tells whether the motion only repeats that.",
        ),
        TO_READ,
    ],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Hold predicted torque against a measurement.

    --out writes the signals as .csv or .parquet.
    """
    from dynident.diagnosis import compare as compare_model
    from dynident.diagnosis import judge
    from dynident.progress import part
    from dynident_service.adapters.comparisons import describe_comparison
    from dynident_service.cli import inputs, shown, tables, terminal
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    if out is not None:
        tables.check_ending(out)
    with (
        terminal.progress_bar("compare") as progress,
        inputs.loaded([measurement], identification.model.robot, reading, part(progress, 0.0, 0.5), learnt) as (
            given,
            others,
        ),
    ):
        recording = given[0].recording
        found = compare_model(identification, recording, part(progress, 0.5, 0.9))
        judged = judge(found, recording, identification.preprocessing, inputs.recordings_of(others))
    if out is not None:
        tables.write_table(tables.comparison_table(found), out)
    if as_json:
        terminal.print_json(plain(describe_comparison(found, judged, True if learnt else None)))
        return
    console = terminal.out()
    shown.show_measurements(console, (), given)
    shown.show_comparison(console, given[0].recording.name, found, judged)
    if out is not None:
        console.print(f"signals written to {out}", markup=False)
