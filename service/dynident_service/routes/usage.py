"""Route of what keys use of their quotas."""

from __future__ import annotations

from dataclasses import astuple

from fastapi import APIRouter, Request

from dynident_service.api_keys import KeyHolder, list_keys
from dynident_service.middleware import HOLDER
from dynident_service.storage.quotas import QuotaLimits, Usage, compute_all_usage, compute_usage, get_account
from dynident_service.storage_and_engine import Services, ServicesDep
from dynident_service.upload_quotas import get_quota_limits
from dynident_service.wire_types.jobs_and_usage import KeyUsage, Quota, UsageView

router = APIRouter(prefix="/v1/usage", tags=["service"])


@router.get("")
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
