"""`dynident diagnose`, `dynident changes` and `dynident series`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident.diagnosis.request import DiagnosisChoices
from dynident.encoding import encode_text
from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.options import Json, Measurements, ModelArgument, OutputOptions, Reading, file_option
from dynident_service.cli.request_options import RequestOptions, TypedValues


def series(
    model: ModelArgument,
    days: Annotated[
        list[Path],
        typer.Argument(metavar="MEASUREMENT…", help="One file per day, in order.", show_default=False),
        READABLE_FILE,
    ],
    reading: Reading,
    keep: Annotated[
        Path | None,
        file_option(
            "--keep",
            help="File that stores the days: it is read first, so that its days are not computed again; new days "
            "are added.",
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", metavar="FILE.svg", help="Plot of every parameter over the days.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, file_option("--out", help="Every parameter over the days, as .csv or .parquet.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find what has changed in a robot over many days, and since which day.

    The other days are compared with the first one; motions may differ from day to day.
    """
    from dynident.diagnosis.monitoring import days_to_bytes
    from dynident.diagnosis.monitoring import monitor_days as series_of
    from dynident.progress import scale_progress
    from dynident.reports.figures.changes import draw_parameter_tracks
    from dynident_service.adapters.diagnoses import describe_series
    from dynident_service.cli import files, inputs, output, result_tables, table_files, terminal
    from dynident_service.cli.series_days import load_continued_days

    identification = inputs.load_model(model)
    if out is not None:
        table_files.check_ending(out)
    with terminal.show_progress_bar("compare the days") as progress:
        measure, measured = load_continued_days(identification, days, reading, keep, scale_progress(progress, 0.0, 0.5))
        monitored = series_of(measure, measured, scale_progress(progress, 0.5, 1.0))
    if keep is not None:
        files.write_atomically(keep, days_to_bytes(measure, measured))
    if figure is not None:
        files.write_atomically(figure, encode_text(str(draw_parameter_tracks(monitored))))
    if out is not None:
        table_files.write_table(table_files.build_courses_table(monitored), out)
    outputs = ((keep, f"{len(measured)} days stored in"), (figure, "plot written to"), (out, "parameters written to"))
    output.print_result(
        as_json,
        lambda: describe_series(monitored),
        lambda console: result_tables.show_series(console, monitored, identification.model.robot),
        *(f"{label} {path}" for path, label in outputs if path is not None),
    )


def changes(
    model: ModelArgument,
    before: Annotated[list[Path], file_option("--before", help="Earlier measurement; may be repeated."), READABLE_FILE],
    after: Annotated[list[Path], file_option("--after", help="Later measurement; may be repeated."), READABLE_FILE],
    reading: Reading,
    result: OutputOptions,
) -> None:
    """Find what has changed in a robot between two sets of measurements.

    The motions may differ. --out writes the diagnosis with the changes as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, output, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    with inputs.read_recordings("compare the days", [*before, *after], robot, reading, share=0.3) as data:
        # All files are read together, so that equal names are told apart.
        earlier, later = data.recordings[: len(before)], data.recordings[len(before) :]
        diagnosis = advise(examine(identification, later, baseline=earlier, progress=data.progress))
    output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: result_tables.show_changes(console, diagnosis, robot),
    )


def diagnose(
    model: ModelArgument,
    measurements: Measurements,
    reading: Reading,
    request_options: Annotated[TypedValues, RequestOptions(DiagnosisChoices)],
    result: OutputOptions,
    why: Annotated[
        list[str] | None,
        typer.Option(
            "--why",
            metavar="EFFECT@JOINT",
            help="Print why this effect on this joint is a finding or not; may be repeated. Without @JOINT, its best "
            "place.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Name the physical effects that a model lacks.

    Give the measurements that the model was identified from. --out writes the diagnosis as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, output, parsing, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    questions = [parsing.parse_effect_place(text, robot.joint_names) for text in why or ()]
    choices = request_options.build_request(DiagnosisChoices)
    with inputs.read_recordings("diagnose", measurements, robot, reading, share=0.3) as data:
        examined = examine(
            identification,
            data.recordings,
            candidates=choices.candidates,
            most_effects=choices.max_effects,
            significance=choices.significance,
            progress=data.progress,
        )
        diagnosis = advise(examined)
    output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: result_tables.show_diagnosis(console, diagnosis, robot, questions),
    )
