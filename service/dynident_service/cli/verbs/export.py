"""`dynident export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.options import Json, ModelArgument

FORMAT_OF = {".json": "json", ".urdf": "urdf", ".xml": "mjcf", ".mjcf": "mjcf", ".c": "c", ".casadi": "casadi"}


def export(
    model: ModelArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Where to write; named after the robot otherwise."),
    ] = None,
    format: Annotated[
        str, typer.Option("--format", "-f", help="json, urdf, mjcf, c or casadi; by the ending of --out otherwise.")
    ] = "",
    nearest: Annotated[
        bool,
        typer.Option(
            "--nearest",
            help="urdf, mjcf: where no bodies that can exist have the identified parameters, write the nearest that "
            "have.",
        ),
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write a model whose error says that it is not to be used, too.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write a model for other programs: URDF, MJCF, C, CasADi, JSON."""
    from dynident.errors import DynidentError
    from dynident.export import export_model
    from dynident.identification.thresholds import STOP
    from dynident.verdict import is_stopped
    from dynident_service.cli import inputs, terminal

    chosen = format or FORMAT_OF.get(out.suffix.lower() if out is not None else "", "")
    if not chosen:
        detail = f"say the format: --format, or --out with one of the endings {', '.join(FORMAT_OF)}"
        raise DynidentError(detail, pointer="--format", title="No such format")
    identification = inputs.model_of(model)
    if is_stopped(identification) and not anyway:
        detail = (
            f"the error of this model is above {STOP:.0%}: something else is wrong than a missing effect, and "
            "`dynident identify` says what it may be. To write it all the same: --anyway"
        )
        raise DynidentError(detail, pointer=str(model), title="Not fit for use")
    try:
        file = export_model(identification, chosen, nearest=nearest)
    except DynidentError as error:
        detail = error.detail.replace("(nearest)", "(--nearest)")
        raise DynidentError(detail, pointer="--format", title=error.title) from error
    path = Path(file.name) if out is None else out
    inputs.write_whole(path, file.content)
    if as_json:
        document = {"path": str(path), "size": len(file.content), "media_type": file.media_type}
        terminal.print_json({**document, "notes": list(file.notes)})
        return
    console = terminal.out()
    for note in file.notes:
        console.print(f"note: {note}", markup=False)
    console.print(f"{chosen} written to {path} ({len(file.content) / 1e3:.1f} kB)", markup=False)
