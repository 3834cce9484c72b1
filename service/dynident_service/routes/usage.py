"""What is used of the quotas."""

from __future__ import annotations

from dataclasses import astuple

from fastapi import APIRouter, Request

from dynident_service.keys import Holder, list_keys
from dynident_service.middleware import HOLDER
from dynident_service.models.usage import KeyUsage, Quota, UsageView
from dynident_service.quotas import limits_of
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.quotas import Limits, Use, acting, use_of, uses

router = APIRouter(prefix="/v1/usage", tags=["service"])


@router.get("")
def get_usage(request: Request, services: ServicesDep) -> UsageView:
    """Tell what a key has stored and under way, and how much it may; one that allows everything sees all of them."""
    account, holder = acting(), request.scope.get(HOLDER)
    if account is None or not isinstance(holder, Holder) or holder.scope == "admin":
        return _all(services)
    with services.database.read() as session:
        return UsageView(items=[_show(account.name, use_of(session, account.name), account.limits)])


def _all(services: Services) -> UsageView:
    defaults = limits_of(services.settings)
    limits: dict[str | None, Limits] = {key.name: key.limits.or_else(defaults) for key in list_keys(services.database)}
    limits[None] = Limits()
    if (account := acting()) is not None:
        limits[account.name] = account.limits
    with services.database.read() as session:
        used_by_name = uses(session)
    names = sorted(used_by_name.keys() | limits.keys(), key=lambda name: (name is None, name or ""))
    return UsageView(items=[_show(name, used_by_name.get(name, Use()), limits.get(name, defaults)) for name in names])


def _show(name: str | None, use: Use, limits: Limits) -> KeyUsage:
    of_bytes, recordings, jobs = (
        Quota(used=number, allowed=limit or None) for number, limit in zip(astuple(use), astuple(limits), strict=True)
    )
    return KeyUsage(key=name, bytes=of_bytes, recordings=recordings, jobs=jobs)
