"""`dynident report` (HTML or PDF) and `dynident export` (a model as URDF, MJCF, C, …)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dynident.export.export_request import ENDINGS, FORMATS, ExportChoices
from dynident.reports.report_request import MEDIA_TYPES, ReportChoices
from dynident.text_encoding import encode_text
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
)


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
    ] = Path("report.html"),
    as_json: Json = False,
) -> None:
    """Write a report about a model: one HTML file, or a PDF."""
    from dynident.identification import check_same_recordings
    from dynident.progress import scale_progress
    from dynident.reports import html_report, render_pdf
    from dynident_cli import argument_loading, command_output, input_checks_and_writes
    from dynident_cli.command_output import build_reported_runs
    from dynident_cli.commands.validate import load_validation
    from dynident_service.validations.adapters import build_reported_validation

    prints = out.suffix.lower() == ".pdf"
    choices = request_options.build_request(ReportChoices, format="pdf" if prints else "html")
    identification = argument_loading.load_model(model)
    diagnosis = argument_loading.load_diagnosis(extras.diagnosis) if extras.diagnosis is not None else None
    joints = identification.model.robot.joint_names
    validations = [build_reported_validation(load_validation(path), joints) for path in extras.validated or []]
    with argument_loading.read_recordings(
        "report", measurements, identification.model.robot, reading, validation, share=0.4
    ) as data:
        # Other recordings would be shown as those that the model was identified from.
        check_same_recordings(identification, data.recordings)
        runs = build_reported_runs(identification, data.loaded, data.others, scale_progress(data.progress, 0.0, 0.5))
        data.progress(0.5, "drawing")
        page = html_report(identification, runs, diagnosis=diagnosis, validations=validations, title=choices.name)
        content = render_pdf(page) if prints else encode_text(page)
    input_checks_and_writes.write_atomically(out, content)
    document = {"path": str(out), "size": len(content), "media_type": MEDIA_TYPES[choices.format]}
    message = f"report written to {out} ({len(content) / 1e6:.2f} MB)"
    command_output.print_result(as_json, lambda: document, lambda _: None, message)


def export(
    model: ModelArgument,
    request_options: Annotated[TypedValues, RequestOptions(ExportChoices, but=("format",))],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write; named after the robot by default."),
    ] = None,
    format: Annotated[
        str, typer.Option("--format", "-f", help=f"{FORMATS.format_help()}; by default from the ending of --out.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Write a model as URDF, MJCF, C, C++, CasADi or JSON."""
    from dynident.errors import DynidentError
    from dynident.export import export_model
    from dynident.verdict import explain_stop
    from dynident_cli import argument_loading, command_output, input_checks_and_writes

    format_name = format or ENDINGS.get(out.suffix.lower() if out is not None else "", "")
    if not format_name:
        detail = f"the format is missing; give --format, or --out with one of the endings {', '.join(ENDINGS)}"
        raise DynidentError(detail, pointer="--format", title="No such format")
    choices = request_options.build_request(ExportChoices)
    identification = argument_loading.load_model(model)
    reason = explain_stop(identification)
    if reason and not choices.anyway:
        raise DynidentError(f"{reason}. To write it anyway, add --anyway", pointer=str(model), title="Not fit for use")
    try:
        file = export_model(identification, format_name, nearest=choices.nearest)
    except DynidentError as error:
        detail = error.detail.replace("(nearest)", "(--nearest)")
        raise DynidentError(detail, pointer="--format", title=error.title) from error
    path = Path(file.name) if out is None else out
    input_checks_and_writes.write_atomically(path, file.content)
    document = {"path": str(path), "size": len(file.content), "media_type": file.media_type, "notes": list(file.notes)}
    notes, message = (f"note: {note}" for note in file.notes), f"{format_name} written to {path}"
    command_output.print_result(
        as_json, lambda: document, lambda _: None, *notes, f"{message} ({len(file.content) / 1e3:.1f} kB)"
    )
