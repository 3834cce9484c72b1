"""`dynident diagnose`, `changes` (two sets of recordings) and `series` (many days)."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.diagnosis.diagnosis_request import DiagnosisChoices
from dynident.text_encoding import encode_text
from dynident_cli.input_checks_and_writes import READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import Json, Measurements, ModelArgument, OutputOptions, Reading, file_option

if TYPE_CHECKING:
    from dynident.diagnosis import Diagnosis
    from dynident.effects import EffectChoice


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
    """Find what has changed over many days, and since when.

    The other days are compared with the first one; motions may differ from day to day.
    """
    from dynident.diagnosis.monitoring import days_to_bytes
    from dynident.diagnosis.monitoring import monitor_days as series_of
    from dynident.progress import scale_progress
    from dynident.reports.figures.changes import draw_parameter_tracks
    from dynident_cli import (
        argument_loading,
        command_output,
        csv_and_parquet_output,
        input_checks_and_writes,
        printed_results,
        terminal,
    )
    from dynident_cli.argument_loading import load_continued_days
    from dynident_service.diagnoses.adapters import describe_series

    identification = argument_loading.load_model(model)
    if out is not None:
        csv_and_parquet_output.check_ending(out)
    with terminal.show_progress_bar("compare the days") as progress:
        measure, measured = load_continued_days(identification, days, reading, keep, scale_progress(progress, 0.0, 0.5))
        monitored = series_of(measure, measured, scale_progress(progress, 0.5, 1.0))
    if keep is not None:
        input_checks_and_writes.write_atomically(keep, days_to_bytes(measure, measured))
    if figure is not None:
        input_checks_and_writes.write_atomically(figure, encode_text(str(draw_parameter_tracks(monitored))))
    if out is not None:
        csv_and_parquet_output.write_table(csv_and_parquet_output.build_courses_table(monitored), out)
    outputs = ((keep, f"{len(measured)} days stored in"), (figure, "plot written to"), (out, "parameters written to"))
    command_output.print_result(
        as_json,
        lambda: describe_series(monitored),
        lambda console: printed_results.show_series(console, monitored, identification.model.robot),
        *(f"{label} {path}" for path, label in outputs if path is not None),
    )


def changes(
    model: ModelArgument,
    before: Annotated[list[Path], file_option("--before", help="Earlier measurement; may be repeated."), READABLE_FILE],
    after: Annotated[list[Path], file_option("--after", help="Later measurement; may be repeated."), READABLE_FILE],
    reading: Reading,
    result: OutputOptions,
) -> None:
    """Find what has changed between two sets of recordings.

    The motions may differ. --out writes the diagnosis with the changes as JSON.
    """
    from dynident.diagnosis import diagnose
    from dynident_cli import argument_loading, command_output, printed_results
    from dynident_service.diagnoses.adapters import describe_diagnosis

    identification = argument_loading.load_model(model)
    robot = identification.model.robot
    with argument_loading.read_recordings("compare the days", [*before, *after], robot, reading, share=0.3) as data:
        # All files are read together, so that equal names are told apart.
        earlier, later = data.recordings[: len(before)], data.recordings[len(before) :]
        diagnosis = diagnose(identification, later, baseline=earlier, progress=data.progress)
    command_output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: printed_results.show_changes(console, diagnosis, robot),
    )


def diagnose(
    model: ModelArgument,
    measurements: Measurements,
    reading: Reading,
    request_options: Annotated[TypedValues, RequestOptions(DiagnosisChoices)],
    result: OutputOptions,
    next_experiment: Annotated[
        bool | None,
        typer.Option(
            "--next-experiment/--no-next-experiment",
            help="Look also for the motion that decides what the measurements leave open, for `dynident design "
            "--diagnosis`. By default only for --out and --json.",
            show_default=False,
        ),
    ] = None,
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
    from dynident.diagnosis import examine
    from dynident_cli import argument_loading, command_output, option_parsers, printed_results
    from dynident_service.diagnoses.adapters import describe_diagnosis

    identification = argument_loading.load_model(model)
    robot = identification.model.robot
    questions = [option_parsers.parse_effect_place(text, robot.joint_names) for text in why or ()]
    choices = request_options.build_request(DiagnosisChoices)
    with argument_loading.read_recordings("diagnose", measurements, robot, reading, share=0.3) as data:
        examined = examine(
            identification,
            data.recordings,
            candidates=choices.candidates,
            most_effects=choices.max_effects,
            significance=choices.significance,
            hardware=choices.hardware,
            progress=data.progress,
        )
        if next_experiment or (next_experiment is None and (result.out is not None or result.as_json)):
            from dynident.advice import advise

            diagnosis: Diagnosis = advise(examined)
            n_open = 0
        else:
            diagnosis = examined.diagnosis
            n_open = len(examined.doubts)
    extend_command = _write_extend_command(diagnosis.recommended, model, measurements, reading, result.out)
    command_output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: printed_results.show_diagnosis(console, diagnosis, robot, extend_command, questions, n_open),
    )


def _write_extend_command(
    recommended: Sequence[EffectChoice], model: Path, measurements: Sequence[Path], reading: Reading, out: Path | None
) -> str:
    """Write the command that adds the recommended effects, with measurements read as they were here."""
    from dynident.effects.effect_text_format import format_effect
    from dynident_cli.request_options import list_option_words

    # Effects of some runs alone can only be given by the file of the diagnosis.
    if out is not None or any(choice.runs for choice in recommended):
        added = ["--diagnosis", "FILE" if out is None else str(out)]
    else:
        added = ["--effects", ",".join(map(format_effect, recommended))]
    input_checks_and_writes = [str(path) for path in (model, *measurements)]
    command = shlex.join(["dynident", "extend", *input_checks_and_writes, *list_option_words(reading), *added])
    return command if "FILE" not in added else f"{command} (FILE: diagnose again with --out FILE)"
