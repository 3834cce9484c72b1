"""Identified models as files, on the wire."""

from __future__ import annotations

import json
from collections.abc import Sequence

from fastapi import Response

from dynident.errors import DynidentError
from dynident.export import ExportedFile, ExportFormat, export_model, model_document
from dynident.identification import Identification

NOTES_HEADER = "Dynident-Notes"
# Proxies refuse answers with long headers; the file has all notes.
_LONGEST = 3000


def exported_file(model: Identification, format: ExportFormat, nearest: bool, shown: dict[str, object]) -> ExportedFile:
    """Write a model; as JSON together with what the service shows of it.

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
    content = json.dumps({**shown, "model": model_document(model)}, indent=1, allow_nan=False)
    return ExportedFile(file.name, file.media_type, content.encode(), file.notes)


def file_response(file: ExportedFile) -> Response:
    """Answer with a file to be saved; what the format could not hold is in a header, as a JSON list of sentences."""
    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers[NOTES_HEADER] = _notes(file.notes)
    return Response(file.content, media_type=file.media_type, headers=headers)


def _notes(notes: Sequence[str]) -> str:
    """JSON in ASCII, of as many notes as a header may hold."""
    for count in range(len(notes), 0, -1):
        shortened = list(notes[:count])
        if count < len(notes):
            shortened.append(f"{len(notes) - count} more in the file")
        if len(text := json.dumps(shortened)) <= _LONGEST:
            return text
    return json.dumps([f"{len(notes)} notes in the file"])
