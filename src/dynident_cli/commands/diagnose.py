"""`dynident compare`, `diagnose`, `changes` (two sets of recordings) and `series` (many days)."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.diagnosis.diagnosis_request import DiagnosisChoices
from dynident_cli.option_parsers import READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Json,
    Measurements,
    ModelArgument,
    Out,
    OutputOptions,
    Reading,
    file_option,
    repeatable_file_option,
)

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.diagnosis import Diagnosis
    from dynident.effects import EffectChoice


def series(
    model: ModelArgument,
    days: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING", help="One file per day, in order.", show_default=False),
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
    from dynident.api.changes_over_time import series as follow_days
    from dynident.api.model_identification import load_model
    from dynident.file_output import TABLE_ENDINGS, check_ending
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    identified = load_model(model)
    if out is not None:
        check_ending(out, TABLE_ENDINGS)
    with argument_loading.read_recordings("compare the days", days, identified.robot, reading, share=0.3) as data:
        recordings, _, progress = data
        followed = follow_days(identified, list(recordings), keep=keep, progress=progress)
    if figure is not None:
        followed.plot().save(figure)
    if out is not None:
        followed.save(out)
    outputs = (
        (keep, f"{len(followed.days)} days stored in"),
        (figure, "plot written to"),
        (out, "parameters written to"),
    )
    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_series(followed.series),
        lambda console: printed_results.show_series(console, followed.series, identified.robot),
        *(f"{label} {path}" for path, label in outputs if path is not None),
    )


def changes(
    model: ModelArgument,
    before: Annotated[list[Path], file_option("--before", help="Earlier recording; may be repeated."), READABLE_FILE],
    after: Annotated[list[Path], file_option("--after", help="Later recording; may be repeated."), READABLE_FILE],
    reading: Reading,
    result: OutputOptions,
) -> None:
    """Find what has changed between two sets of recordings.

    The motions may differ. --out writes the diagnosis with the changes as JSON.
    """
    from dynident.api.changes_over_time import changes as find_changes
    from dynident.api.model_identification import load_model
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    identified = load_model(model)
    robot = identified.robot
    with argument_loading.read_recordings("compare the days", before, robot, reading, after, share=0.3) as data:
        earlier, later, progress = data
        diagnosis = find_changes(identified, before=earlier, after=later, progress=progress).diagnosis
    command_output.write_result(
        result,
        "diagnosis",
        lambda: contract_documents.describe_diagnosis(diagnosis, robot),
        lambda console: printed_results.show_changes(console, diagnosis, robot),
    )


@dataclass(frozen=True)
class DiagnosisOptions:
    """Held-out recordings, and what is told beyond the findings."""

    validation: Annotated[
        list[Path],
        repeatable_file_option(
            "--validation",
            "-v",
            help="Held-out recording: a finding that it does not confirm is not named. It proposes nothing; may be "
            "repeated.",
        ),
        READABLE_FILE,
    ]
    next_experiment: Annotated[
        bool | None,
        typer.Option(
            "--next-experiment/--no-next-experiment",
            help="Also find the motion that decides the open questions, for `dynident design --diagnosis`. "
            "By default only for --out and --json.",
            show_default=False,
        ),
    ] = None
    why: Annotated[
        list[str] | None,
        typer.Option(
            "--why",
            metavar="EFFECT@JOINT",
            help="Print why this effect on this joint is a finding or not; may be repeated. Without @JOINT, the joint "
            "where it explains most.",
            show_default=False,
        ),
    ] = None
    limits: Annotated[
        bool,
        typer.Option(
            "--limits/--no-limits",
            help="Print for each effect on each joint the smallest size that these recordings would have shown.",
            show_default=False,
        ),
    ] = False


def diagnose(
    model: ModelArgument,
    measurements: Measurements,
    reading: Reading,
    request_options: Annotated[TypedValues, RequestOptions(DiagnosisChoices)],
    result: OutputOptions,
    further: DiagnosisOptions,
) -> None:
    """Name the physical effects that a model lacks.

    Give the recordings from which the model was identified. --out writes the diagnosis as JSON.
    """
    from dynident.api.model_diagnosis import diagnose as diagnose_model
    from dynident.api.model_identification import load_model
    from dynident_cli import argument_loading, command_output, contract_documents, option_parsers, printed_results

    identified = load_model(model)
    robot = identified.robot
    questions = [option_parsers.parse_effect_place(text, robot.joint_names) for text in further.why or ()]
    choices = request_options.build_request(DiagnosisChoices)
    with argument_loading.read_recordings(
        "diagnose", measurements, robot, reading, further.validation, share=0.3
    ) as data:
        recordings, held_out, progress = data
        diagnosed = diagnose_model(
            identified,
            recordings,
            validation=held_out,
            candidates=choices.candidates,
            max_effects=choices.max_effects,
            significance=choices.significance,
            hardware=choices.hardware,
            progress=progress,
        )
        is_kept = result.out is not None or result.as_json
        advises = is_kept if further.next_experiment is None else further.next_experiment
        diagnosis: Diagnosis = diagnosed.advised_diagnosis if advises else diagnosed.diagnosis
    n_open = 0 if advises else len(diagnosed.examination.doubts)
    validation_words = [word for path in further.validation for word in ("--validation", str(path))]
    extend_command = _write_extend_command(
        diagnosis.recommended, [*map(str, (model, *measurements)), *validation_words], reading, result.out
    )
    command_output.write_result(
        result,
        "diagnosis",
        lambda: contract_documents.describe_diagnosis(diagnosis, robot, diagnosed.examination.doubts),
        lambda console: printed_results.show_diagnosis(
            console, diagnosis, robot, extend_command, questions, n_open, further.limits
        ),
    )


def _write_extend_command(
    recommended: Sequence[EffectChoice], files: Sequence[str], reading: Reading, out: Path | None
) -> str:
    """Write the command that adds the recommended effects, with files (and their options) read as they were here."""
    from dynident.effects.effect_text_format import format_effect
    from dynident_cli.request_options import list_option_words

    # Effects of some runs alone can only be given by the file of the diagnosis.
    if out is not None or any(choice.runs for choice in recommended):
        added = ["--diagnosis", "FILE" if out is None else str(out)]
    else:
        added = ["--effects", ",".join(map(format_effect, recommended))]
    command = shlex.join(["dynident", "extend", *files, *list_option_words(reading), *added])
    return command if "FILE" not in added else f"{command} (FILE: diagnose again with --out FILE)"


def compare(
    model: ModelArgument,
    measurement: Annotated[
        Path,
        typer.Argument(metavar="RECORDING", help="A file as for `dynident identify`.", show_default=False),
        READABLE_FILE,
    ],
    reading: Reading,
    fit: Annotated[
        list[Path],
        repeatable_file_option(
            "--fit",
            help="Recording that the model was fitted to; may be repeated. Shows whether RECORDING only "
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
    with argument_loading.read_recordings("compare", [measurement], identified.robot, reading, fit) as data:
        recordings, others, progress = data
        (compared,) = compare_model(identified, recordings, fit=others or None, progress=progress)
    if out is not None:
        compared.save(out)

    def print_comparison(console: Console) -> None:
        printed_results.show_measurements(console, recordings[:0], recordings)
        printed_results.show_comparison(console, compared.name, compared.comparison, compared.judgement)

    messages = () if out is None else (f"signals written to {out}",)
    command_output.print_result(
        as_json,
        lambda: contract_documents.describe_comparison(compared, fit=bool(fit)),
        print_comparison,
        *messages,
    )
