"""Routes `/healthz`, `/readyz` and `/metrics`."""

from __future__ import annotations

from typing import Literal

from anyio import to_thread
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from dynident.version import __version__
from dynident_service.prometheus_metrics import CONTENT_TYPE_LATEST
from dynident_service.storage_and_engine import ServicesDep

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
    """Report that the service answers."""
    return Health()


@router.get("/readyz", responses={503: {"model": Readiness}})
async def readiness(services: ServicesDep, response: Response) -> Readiness:
    """Report whether the service works and its stored data are complete; 503 if not.

    The check reads the database, stores an object and calls a child process, as for any request; the answers are at
    most a second old. While the engine starts, it accepts jobs already; while it drains, it accepts none, because the
    service ends.
    """
    checks = await services.readiness.collect_states()
    checks["engine"] = services.engine.condition
    checks["stored"] = services.housekeeping.condition
    ready = all(value in ("ok", "starting", "ready") for value in checks.values())
    response.status_code = 200 if ready else 503
    return Readiness(status="ready" if ready else "not_ready", checks=checks)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request) -> Response:
    """Give metrics for Prometheus."""
    figures = request.app.state.metrics
    text = await to_thread.run_sync(figures.render_text, limiter=figures.thread)
    return Response(text, media_type=CONTENT_TYPE_LATEST)
