"""Routes of imports: inspect an uploaded file that is kept for a day."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, File, Form, Request, Response, UploadFile

from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.measurements.wire_types import ImportMetadata, ImportView
from dynident_service.shared.required_resources import require_resource
from dynident_service.shared.resource_routes import (
    PagesDep,
    RetryKeyDep,
    create_or_replay,
    parse_json_body,
    replay_response,
)
from dynident_service.shared.upload_forms import (
    FURTHER,
    MOST_FILES,
    FormRoute,
    detect_media_type,
    hash_file,
    receive_files,
)
from dynident_service.shared.wire_types import Page, to_plain_json
from dynident_service.storage.deletion_and_expiry import IMPORT_LIFETIME
from dynident_service.storage.repository_values import Dependency, NewResource, Resource, Retry
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/imports", tags=["imports"], route_class=FormRoute)

LOOK = "dynident_service.measurements.jobs:inspect_file"


@router.post("", status_code=201)
async def import_file(
    request: Request,
    services: ServicesDep,
    retry: RetryKeyDep,
    response: Response,
    file: Annotated[UploadFile, File(description="A recording as a robot or a logger wrote it")],
    metadata: Annotated[str, Form(description="A JSON object: see ImportMetadata")],
    further: Annotated[list[UploadFile] | None, File(description=FURTHER, max_length=MOST_FILES - 1)] = None,
) -> ImportView:
    """Inspect a file: its proposed metadata, the reasons, and the questions to answer before it can be used."""
    stated_metadata = parse_json_body(ImportMetadata, metadata, "/metadata")
    if stated_metadata.name is None and file.filename:
        stated_metadata = stated_metadata.model_copy(update={"name": Path(file.filename).stem[:200] or None})
    with services.create_scratch_folder() as folder:
        source = folder / "source"
        sha256 = await to_thread.run_sync(_receive_files, services, [file, *(further or ())], source)
        # The file belongs to the request: the same metadata with another file are no retry.
        key = retry.bind_to_body(stated_metadata, sha256)
        existing = await to_thread.run_sync(services.resources.find_retried, key)
        if existing is not None:
            return show_import(replay_response(existing, response))
        robot = await to_thread.run_sync(
            require_resource, services, "robot", stated_metadata.robot_id, "/metadata/robot_id"
        )
        arguments = {
            "source": str(source),
            "robot": dict(robot.request),
            "metadata": to_plain_json(stated_metadata),
            "sha256": sha256,
        }
        limits = ComputationLimits.from_file_sizes(source.stat().st_size)
        result = await services.interactive.call(request, LOOK, dict, arguments, limits, is_long=True)
        return await to_thread.run_sync(
            lambda: show_import(_store_import(services, stated_metadata, source, result, key, response))
        )


def show_import(resource: Resource) -> ImportView:
    """Show a stored import."""
    expires_at = resource.created_at + timedelta(seconds=IMPORT_LIFETIME)
    return ImportView.model_validate({**vars(resource), **(resource.result or {}), "expires_at": expires_at})


@router.get("")
def list_imports(pages: PagesDep) -> Page[ImportView]:
    """List the stored imports, newest first."""
    return pages.show("import", show_import)


@router.get("/{import_id}")
def get_import(import_id: str, services: ServicesDep) -> ImportView:
    """Show an import."""
    return show_import(services.resources.get("import", import_id))


@router.delete("/{import_id}", status_code=204)
def delete_import(import_id: str, services: ServicesDep) -> None:
    """Delete an import; 409 while a measurement needs it."""
    services.resources.delete("import", import_id)


def _receive_files(services: Services, files: Sequence[UploadFile], source: Path) -> str:
    receive_files(services, files, source)
    return hash_file(source)


def _store_import(
    services: Services,
    metadata: ImportMetadata,
    source: Path,
    result: dict[str, object],
    retry: Retry | None,
    response: Response,
) -> Resource:
    services.resources.check_room("import", (source,))
    new = NewResource(
        "import",
        to_plain_json(metadata),
        name=metadata.name,
        result=result,
        rests_on=(Dependency(metadata.robot_id, "robot", "robot", "/metadata/robot_id"),),
        objects=(services.resources.put_with_role("original", source, detect_media_type(source)),),
        retry=retry,
    )
    return create_or_replay(services, new, response)
