"""`dynident report` (HTML or PDF) and `dynident export` (a model as URDF, MJCF, C, …)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.export.export_request import ENDINGS, FORMATS, ExportChoices
from dynident.reports.reported_data import MEDIA_TYPES, ReportChoices
from dynident_cli.option_parsers import FILE_IN_FOLDER, READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Json,
    Measurements,
    ModelArgument,
    Reading,
    SomeFile,
    SomeFiles,
    Validation,
    file_option,
    repeatable_file_option,
)

if TYPE_CHECKING:
    from dynident.recordings import Recording


@dataclass(frozen=True)
class _ReportExtras:
    """What else the report shows."""

    diagnosis: Annotated[
        SomeFile, file_option("--diagnosis", help="Diagnosis that `dynident diagnose --out` wrote.")
    ] = None
    validated: Annotated[
        SomeFiles, file_option("--validated", help="Validation that `dynident validate --out` wrote; may be repeated.")
    ] = None


def report(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    extras: _ReportExtras,
    request_options: Annotated[TypedValues, RequestOptions(ReportChoices)],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="The HTML file to write, or a PDF if the name ends in .pdf."),
        FILE_IN_FOLDER,
    ] = Path("report.html"),
    as_json: Json = False,
) -> None:
    """Write a report about a model: one HTML file, or a PDF."""
    from dynident.api.model_identification import load_model
    from dynident.api.model_report import report as write_report
    from dynident_cli import argument_loading, command_output, contract_documents

    choices = request_options.build_request(ReportChoices, format="pdf" if out.suffix.lower() == ".pdf" else "html")
    identified = load_model(model)
    diagnosis = contract_documents.load_diagnosis(extras.diagnosis) if extras.diagnosis is not None else None
    joints = identified.robot.joint_names
    validations = [contract_documents.load_reported_validation(path, joints) for path in extras.validated or []]
    with argument_loading.read_recordings(
        "report", measurements, identified.robot, reading, validation, share=0.4
    ) as data:
        recordings, held_out, progress = data
        whole = replace(identified.with_data(recordings), validation=held_out)
        page = write_report(whole, diagnosis=diagnosis, validations=validations, title=choices.name, progress=progress)
        page.save(out)
    size = out.stat().st_size
    document = {"path": str(out), "size": size, "media_type": MEDIA_TYPES[choices.format]}
    message = f"report written to {out} ({size / 1e6:.2f} MB)"
    command_output.print_result(as_json, lambda: document, lambda _: None, message)


def export(
    model: ModelArgument,
    validation: Annotated[
        list[Path],
        repeatable_file_option(
            "--validation", "-v", help="Held-out recording without contacts, for the thresholds in a C or C++ header."
        ),
        READABLE_FILE,
    ],
    reading: Reading,
    request_options: Annotated[TypedValues, RequestOptions(ExportChoices, but=("format",))],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write; named after the robot by default."),
        FILE_IN_FOLDER,
    ] = None,
    format: Annotated[
        str, typer.Option("--format", "-f", help=f"{FORMATS.format_help()}; by default from the ending of --out.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Write a model as URDF, SDF, MJCF, USD, C, C++ and more.

    The ending of --out tells the format; an --out without an ending is the folder of a ROS 2 package.
    """
    from dynident.api.model_identification import load_model
    from dynident.errors import DynidentError
    from dynident.export import export_model, unpack_files
    from dynident.file_output import write_atomically
    from dynident.verdict import explain_stop
    from dynident_cli import argument_loading, command_output

    is_folder = out is not None and (out.is_dir() or not out.suffix)
    # Only one format is a folder; a name without an ending, and without a format, means it.
    format_name = format or ("ros2" if is_folder else ENDINGS.get(out.suffix.lower() if out is not None else "", ""))
    if not format_name:
        detail = f"the format is missing; give --format, or --out with one of the endings {', '.join(ENDINGS)}"
        raise DynidentError(detail, pointer="--format", title="No such format")
    choices = request_options.build_request(ExportChoices)
    identified = load_model(model)
    reason = explain_stop(identified.identification)
    if reason and not choices.anyway:
        raise DynidentError(f"{reason}. To write it anyway, add --anyway", pointer=str(model), title="Not fit for use")
    held_out: Sequence[Recording] = ()
    if validation:
        with argument_loading.read_recordings("export", [], identified.robot, reading, validation) as data:
            held_out = data[1].recordings
    try:
        file = export_model(identified.identification, format_name, nearest=choices.nearest, held_out=held_out)
    except DynidentError as error:
        detail = error.detail.replace("(nearest)", "(--nearest)")
        raise DynidentError(detail, pointer="--format", title=error.title) from error
    path = Path(file.name) if out is None else out
    if format_name == "ros2" and is_folder:
        for name, content in unpack_files(file.content).items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path / name, content)
    else:
        write_atomically(path, file.content)
    document = {"path": str(path), "size": len(file.content), "media_type": file.media_type, "notes": list(file.notes)}
    notes, message = (f"note: {note}" for note in file.notes), f"{format_name} written to {path}"
    command_output.print_result(
        as_json, lambda: document, lambda _: None, *notes, f"{message} ({len(file.content) / 1e3:.1f} kB)"
    )
