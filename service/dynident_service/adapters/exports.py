"""Identified models as files to download."""

from __future__ import annotations

import json
from collections.abc import Sequence

from fastapi import Response

from dynident.errors import DynidentError
from dynident.export import ExportedFile, ExportFormat, export_model, model_to_document
from dynident.identification import Identification

NOTES_HEADER = "Dynident-Notes"
# Many proxies refuse headers above 4 or 8 kB in total. The file itself has all notes.
_LONGEST = 3000


def export_file(model: Identification, format: ExportFormat, nearest: bool, shown: dict[str, object]) -> ExportedFile:
    """Export a model.

    Parameters
    ----------
    model : Identification
        The model.
    format : str
        The format; "json" includes what the service shows of the model.
    nearest : bool
        Whether to export the nearest physically feasible parameters where the format needs feasible ones.
    shown : dict
        What the service shows of the model.

    Returns
    -------
    ExportedFile
        The file, with notes on what the format cannot hold.

    Raises
    ------
    DynidentError
        Where the format cannot hold the model; its pointer is the query's parameter.
    """
    try:
        file = export_model(model, format, nearest=nearest)
    except DynidentError as error:
        raise DynidentError(error.detail, pointer=error.pointer.removeprefix("/"), title=error.title) from error
    if format != "json":
        return file
    # What the service shows stands beside the model, so that `model_from_json` reads the file, too.
    content = json.dumps({**shown, "model": model_to_document(model)}, indent=1, allow_nan=False)
    return ExportedFile(file.name, file.media_type, content.encode(), file.notes)


def build_file_response(file: ExportedFile) -> Response:
    """Build the response with a file to be saved; its notes are a JSON list of sentences in a header."""
    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers[NOTES_HEADER] = _shorten_notes(file.notes)
    return Response(file.content, media_type=file.media_type, headers=headers)


def _shorten_notes(notes: Sequence[str]) -> str:
    """Return as many notes as a header may hold, as JSON in ASCII."""
    # Whole sentences: as many from the front as fit.
    for count in range(len(notes), 0, -1):
        shortened = list(notes[:count])
        if count < len(notes):
            shortened.append(f"{len(notes) - count} more in the file")
        if len(text := json.dumps(shortened)) <= _LONGEST:
            return text
    return json.dumps([f"{len(notes)} notes in the file"])
