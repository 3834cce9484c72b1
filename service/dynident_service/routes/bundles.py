"""A robot with all that belongs to it in one file, for another service."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask

from dynident_service.limits import take_long
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.bundle import export_robot

router = APIRouter(prefix="/v1/robots", tags=["robots"])

ZIP = "application/zip"
FILE: dict[int | str, dict[str, Any]] = {200: {"content": {ZIP: {}}, "description": "For `dynident import-robot`"}}


@router.get("/{robot_id}/bundle", response_class=FileResponse, responses=FILE)
async def get_robot_bundle(robot_id: str, request: Request, services: ServicesDep) -> FileResponse:
    """Give a robot with its recordings, models, diagnoses and reports as one ZIP, but for what is still computed."""
    take_long(request.scope)
    path = await to_thread.run_sync(_write, services, robot_id, limiter=CapacityLimiter(1))
    return FileResponse(
        path, media_type=ZIP, filename=f"{robot_id}.zip", background=BackgroundTask(shutil.rmtree, path.parent)
    )


def _write(services: Services, robot_id: str) -> Path:
    services.resources.get("robot", robot_id)
    folder = services.settings.uploads_dir
    folder.mkdir(parents=True, exist_ok=True)
    path = Path(tempfile.mkdtemp(dir=folder)) / "bundle.zip"
    try:
        export_robot(services.database, services.objects, robot_id, path)
    except BaseException:
        shutil.rmtree(path.parent)
        raise
    return path
