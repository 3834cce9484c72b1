"""`dynident series`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident.encoding import encode_text
from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Json, ModelArgument, Reading, of_file


def series(
    model: ModelArgument,
    days: Annotated[
        list[Path],
        typer.Argument(metavar="MEASUREMENT…", help="One file a day, in their order.", show_default=False),
        TO_READ,
    ],
    reading: Reading,
    keep: Annotated[
        Path | None,
        of_file(
            "--keep", help="Where days are kept: those in it come first and are not read again, new ones are added."
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", metavar="FILE.svg", help="Every parameter's course, drawn.", show_default=False),
    ] = None,
    out: Annotated[Path | None, of_file("--out", help="Every parameter's course, as .csv or .parquet.")] = None,
    as_json: Json = False,
) -> None:
    """Say what has changed in a robot over many days, and from which day on.

    The first day is what the others are compared with; motions may differ from day to day.
    """
    from dynident.diagnosis.series import days_to_bytes
    from dynident.diagnosis.series import series as series_of
    from dynident.progress import part
    from dynident.reports.figures.courses import courses_figure
    from dynident_service.adapters.diagnoses import describe_series
    from dynident_service.cli import files, inputs, shown, tables, telling, terminal
    from dynident_service.cli.kept_days import days_of

    identification = inputs.model_of(model)
    if out is not None:
        tables.check_ending(out)
    with terminal.progress_bar("compare the days") as progress:
        measure, measured = days_of(identification, days, reading, keep, part(progress, 0.0, 0.5))
        monitored = series_of(measure, measured, part(progress, 0.5, 1.0))
    if keep is not None:
        files.write_whole(keep, days_to_bytes(measure, measured))
    if figure is not None:
        files.write_whole(figure, encode_text(str(courses_figure(monitored))))
    if out is not None:
        tables.write_table(tables.courses_table(monitored), out)
    outputs = ((keep, f"{len(measured)} days kept in"), (figure, "drawn in"), (out, "courses written to"))
    telling.say(
        as_json,
        lambda: describe_series(monitored),
        lambda console: shown.show_series(console, monitored, identification.model.robot),
        *(f"{label} {path}" for path, label in outputs if path is not None),
    )
