"""Is it there, is it ready, what does it do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from dynident.version import __version__
from dynident_service.metrics import CONTENT_TYPE_LATEST
from dynident_service.services import ServicesDep

router = APIRouter(tags=["service"])


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok"] = "ok"
    version: str = __version__


class Readiness(BaseModel):
    """Whether the service can do its work, part by part."""

    status: Literal["ready", "not_ready"]
    checks: dict[str, str]


@router.get("/healthz")
async def health() -> Health:
    """Tell that the service answers."""
    return Health()


@router.get("/readyz", responses={503: {"model": Readiness}})
async def readiness(services: ServicesDep, response: Response) -> Readiness:
    """Tell whether database, object store and job engine work, and what is stored is whole; 503 if one does not.

    While the engine starts, jobs are accepted already; one that is draining takes none, as the service ends.
    """
    # In threads of their own: those of other requests may all be busy.
    checks = {
        "database": await _checked(services.database.ping),
        "objects": await _checked(services.objects.ping),
    }
    checks["engine"] = services.engine.condition
    checks["stored"] = services.housekeeping.condition
    ready = all(value in ("ok", "starting", "ready") for value in checks.values())
    response.status_code = 200 if ready else 503
    return Readiness(status="ready" if ready else "not_ready", checks=checks)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request) -> Response:
    """Give figures for Prometheus."""
    text = await to_thread.run_sync(request.app.state.metrics.text, limiter=_own_threads())
    return Response(text, media_type=CONTENT_TYPE_LATEST)


def _own_threads() -> CapacityLimiter:
    return CapacityLimiter(1)


async def _checked(check: Callable[[], object]) -> str:
    try:
        await to_thread.run_sync(check, limiter=_own_threads())
    except Exception as error:
        return f"failed: {type(error).__name__}"
    return "ok"
