"""Imports: a file is looked at and kept for a day, so that it need not be uploaded again to be used."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, File, Form, Request, Response, UploadFile

from dynident_service.jobs.confinement import Limits
from dynident_service.models.common import plain
from dynident_service.models.imports import ImportMetadata, ImportView
from dynident_service.routes.common import RetryKeyDep, again, make, stated
from dynident_service.routes.forms import FormRoute
from dynident_service.routes.kept import Kept, keep
from dynident_service.routes.needs import needed
from dynident_service.routes.uploads import FURTHER, MOST_FILES, media_type_of, receive, sha256_of
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewResource, Resource, RestsOn, Retry
from dynident_service.storage.retention import KEPT

router = APIRouter(prefix="/v1/imports", tags=["imports"], route_class=FormRoute)

LOOK = "dynident_service.work.awaited:look_at_file"


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
    """Look at a file: metadata that are proposed for it, why, and what has to be answered before it can be used."""
    stated_metadata = stated(ImportMetadata, metadata, "/metadata")
    if stated_metadata.name is None and file.filename:
        stated_metadata = stated_metadata.model_copy(update={"name": Path(file.filename).stem[:200] or None})
    with services.scratch() as folder:
        source = folder / "source"
        sha256 = await to_thread.run_sync(_receive, services, [file, *(further or ())], source)
        key = retry.of(stated_metadata, sha256)
        existing = await to_thread.run_sync(services.resources.known, key)
        if existing is not None:
            return show(again(existing, response))
        robot = await to_thread.run_sync(needed, services, "robot", stated_metadata.robot_id, "/metadata/robot_id")
        arguments = {
            "source": str(source),
            "robot": dict(robot.request),
            "metadata": plain(stated_metadata),
            "sha256": sha256,
        }
        limits = Limits.for_files(source.stat().st_size)
        result = await services.awaited.call(request, LOOK, dict, arguments, limits, is_long=True)
        return await to_thread.run_sync(lambda: show(_store(services, stated_metadata, source, result, key, response)))


def show(resource: Resource) -> ImportView:
    """Show a stored import."""
    expires_at = resource.created_at + timedelta(seconds=KEPT)
    return ImportView.model_validate({**vars(resource), **(resource.result or {}), "expires_at": expires_at})


keep(
    router,
    Kept(
        "import",
        ImportView,
        show=show,
        listed="List the imports that are still kept, newest first.",
        shown="Show an import.",
        deleted="Delete an import; 409 while a measurement rests on it.",
    ),
)


def _receive(services: Services, files: Sequence[UploadFile], source: Path) -> str:
    receive(services, files, source)
    return sha256_of(source)


def _store(
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
        plain(metadata),
        name=metadata.name,
        result=result,
        rests_on=(RestsOn(metadata.robot_id, "robot", "robot", "/metadata/robot_id"),),
        objects=(services.resources.put_as("original", source, media_type_of(source)),),
        retry=retry,
    )
    return make(services, new, response)
