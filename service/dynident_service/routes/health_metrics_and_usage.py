"""Routes `/healthz`, `/readyz` and `/metrics`, and of what keys use of their quotas."""

from __future__ import annotations

from dataclasses import astuple
from typing import Literal

from anyio import to_thread
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from dynident.version import __version__
from dynident_service.api_keys import KeyHolder, list_keys
from dynident_service.middleware import HOLDER
from dynident_service.prometheus_metrics import CONTENT_TYPE_LATEST
from dynident_service.storage.quotas import QuotaLimits, Usage, compute_all_usage, compute_usage, get_account
from dynident_service.storage_and_engine import Services, ServicesDep
from dynident_service.upload_quotas import get_quota_limits
from dynident_service.wire_types.jobs_and_usage import KeyUsage, Quota, UsageView

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


usage_router = APIRouter(prefix="/v1/usage", tags=["service"])


@usage_router.get("")
def get_usage(request: Request, services: ServicesDep) -> UsageView:
    """Show what a key stores and computes, and its limits; a key that allows everything sees all keys."""
    account, holder = get_account(), request.scope.get(HOLDER)
    if account is None or not isinstance(holder, KeyHolder) or holder.scope == "admin":
        return _show_all_keys(services)
    with services.database.read() as session:
        return UsageView(items=[_show_key(account.name, compute_usage(session, account.name), account.limits)])


def _show_all_keys(services: Services) -> UsageView:
    defaults = get_quota_limits(services.settings)
    limits: dict[str | None, QuotaLimits] = {
        key.name: key.limits.fill_from(defaults) for key in list_keys(services.database)
    }
    # Resources without an owner are from a time without keys, and have no limit.
    limits[None] = QuotaLimits()
    if (account := get_account()) is not None:
        limits[account.name] = account.limits
    with services.database.read() as session:
        used_by_name = compute_all_usage(session)
    names = sorted(used_by_name.keys() | limits.keys(), key=lambda name: (name is None, name or ""))
    return UsageView(
        items=[_show_key(name, used_by_name.get(name, Usage()), limits.get(name, defaults)) for name in names]
    )


def _show_key(name: str | None, use: Usage, limits: QuotaLimits) -> KeyUsage:
    of_bytes, recordings, jobs = (
        Quota(used=number, allowed=limit or None) for number, limit in zip(astuple(use), astuple(limits), strict=True)
    )
    return KeyUsage(key=name, bytes=of_bytes, recordings=recordings, jobs=jobs)
