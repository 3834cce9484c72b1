"""`dynident diagnose`, `dynident changes` and `dynident series`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from dynident.diagnosis.monitoring import Day, Measure, build_measure, find_free_name, load_days, reduce_day
from dynident.diagnosis.request import DiagnosisChoices
from dynident.encoding import encode_text
from dynident.identification import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings.recording_files import compute_digest
from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.inputs import load_recordings
from dynident_service.cli.options import Json, Measurements, ModelArgument, OutputOptions, Reading, file_option
from dynident_service.cli.request_options import RequestOptions, TypedValues


def load_continued_days(
    identification: Identification,
    paths: Sequence[Path],
    reading: Reading,
    keep: Path | None,
    progress: Progress,
) -> tuple[Measure, tuple[Day, ...]]:
    """Estimate the parameters of each day.

    Parameters
    ----------
    identification : Identification
        The model whose parameters are followed.
    paths : sequence of Path
        One file a day, in their order.
    reading : Reading
        How the files are read.
    keep : Path, optional
        The file that stores earlier days.
    progress : callable
        Reports progress.

    Returns
    -------
    measure : Measure
        Which parameters may differ from day to day.
    days : tuple of Day
        The stored days in their order, then the new ones.
    """
    robot = identification.model.robot
    days: tuple[Day, ...] = ()
    content = keep.read_bytes() if keep is not None and keep.exists() else None
    with load_recordings(paths, robot, reading, scale_progress(progress, 0.0, 0.6)) as (measurements, _):
        recordings = [item.recording for item in measurements]
        if content is None:
            # The first files decide whether temperature is a regressor: all later days have to be comparable.
            warm = all(recording.has_temperature for recording in recordings)
            measure = build_measure(identification, with_temperature=warm)
        else:
            measure, days = load_days(identification, content)
        all_days = list(days)
        # A digest of its file is what a day is known by.
        sources = [compute_digest(path) for path in paths]
        for number, (recording, source) in enumerate(zip(recordings, sources, strict=True)):
            # A file that is stored already is known by its hash, whatever it is called now.
            if any(day.source == source for day in all_days):
                continue
            day_progress = scale_progress(
                progress, 0.6 + 0.4 * number / len(paths), 0.6 + 0.4 * (number + 1) / len(paths)
            )
            all_days.append(
                reduce_day(measure, find_free_name(recording.name, all_days), [recording], day_progress, source)
            )
    return measure, tuple(all_days)


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
) -> None:
    """Name the physical effects that a model lacks.

    Give the measurements that the model was identified from. --out writes the diagnosis as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, output, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    choices = request_options.build_request(DiagnosisChoices)
    with inputs.read_recordings("diagnose", measurements, robot, reading, share=0.3) as data:
        examined = examine(
            identification,
            data.recordings,
            candidates=choices.candidates,
            most_effects=choices.max_effects,
            progress=data.progress,
        )
        diagnosis = advise(examined)
    output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: result_tables.show_diagnosis(console, diagnosis, robot),
    )
