"""`dynident export`: a model as URDF, MJCF, C, …."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident.export.export_request import ENDINGS, FORMATS, ExportChoices
from dynident_service.cli.request_options import RequestOptions, TypedValues
from dynident_service.cli.shared_options import Json, ModelArgument


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
    from dynident_service.cli import argument_loading, command_output, input_checks_and_writes

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
