"""How sure an identified model is: its essential parameters, what the motion determines only together, its verdict."""

from __future__ import annotations

import json
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request

from dynident_service.models.identifications import CorrelationView, EssentialQuery, EssentialView, IdentificationResult
from dynident_service.models.verdicts import VerdictView
from dynident_service.problems import ProblemError
from dynident_service.routes.common import succeeded
from dynident_service.science import importing
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import Resource

AWAITED = "dynident_service.work.awaited"
MOST_OUTCOMES = 100
"""Validations of a model that are looked through, the newest first."""
JUDGE = "dynident_service.work.verdicts:judge"

router = APIRouter(prefix="/v1/identifications", tags=["identifications"])


@router.get("/{identification_id}/essential")
async def get_essential_parameters(
    identification_id: str,
    request: Request,
    services: ServicesDep,
    asked: Annotated[EssentialQuery, Query()],
) -> EssentialView:
    """Find the essential parameters by backward elimination, with the errors along the way."""
    sent = {"model": await model_file(services, identification_id), "ratio": asked.ratio}
    return EssentialView.model_validate(await services.awaited.call(request, f"{AWAITED}:essential", dict, sent))


@router.get("/{identification_id}/correlation")
async def get_correlation(identification_id: str, request: Request, services: ServicesDep) -> CorrelationView:
    """Show the correlation of the estimates, and say in words which of them the motion determines only together."""
    asked = {"model": await model_file(services, identification_id)}
    return CorrelationView.model_validate(await services.awaited.call(request, f"{AWAITED}:correlation", dict, asked))


async def model_file(services: Services, identifier: str) -> str:
    """Give the path of the file that holds an identified model; it must have succeeded."""

    def find() -> str:
        found = succeeded(services.resources.get("identification", identifier))
        return str(services.objects.path(found.objects["model"].key))

    return await to_thread.run_sync(find)


@router.get("/{identification_id}/verdict")
async def get_verdict(identification_id: str, request: Request, services: ServicesDep) -> VerdictView:
    """Say for which uses a model is fit and why or why not; `stop` names the most probable cause of a gross mistake."""

    def find() -> dict[str, Any]:
        found = succeeded(services.resources.get("identification", identification_id))
        return {
            "fitted": [_measurement(services, one) for one in found.all("training")],
            "held_out": [_measurement(services, one) for one in found.all("validation")],
            "outcomes": _outcomes(services, identification_id),
        }

    asked = {"model": await model_file(services, identification_id), **await to_thread.run_sync(find)}
    # A model and its measurements never change: what is said of them changes with its validations alone.
    key = f"{identification_id} {json.dumps(asked['outcomes'])}"
    if (known := services.verdicts.get(key)) is not None:
        return known
    judged = await services.awaited.call(request, JUDGE, dict, asked)
    found = VerdictView.model_validate(judged)
    services.verdicts.keep(key, found)
    return found


def _outcomes(services: Services, identification_id: str) -> list[dict[str, Any]]:
    """How the newest validation of every kind ended."""
    page = services.resources.page("validation", MOST_OUTCOMES, on_id=identification_id)
    newest = {one.request["kind"]: one.result for one in reversed(page.items) if one.result is not None}
    return [
        {"kind": kind, "verdict": result["verdict"], "reason": result["reason"]}
        for kind, result in sorted(newest.items())
        if result is not None
    ]


def refuse_stopped(found: Resource) -> None:
    """Raise a problem 409 for a model that its error, or held-out data of the fit, say not to use."""
    with importing():
        from dynident.identification.thresholds import STOP

    result = IdentificationResult.model_validate(found.result)
    errors = [one.relative_total for one in (result.validation, result.residual) if one is not None]
    worst = max((one for one in errors if one is not None), default=0.0)
    if result.copied:
        detail = (
            f"The held-out data of this model ({', '.join(result.copied)}) hold samples that it was fitted to: nothing "
            "has tried it. Hold out another measurement. To export it all the same, say anyway=true."
        )
        raise ProblemError(409, detail, title="Not fit for use")
    if worst > STOP:
        detail = (
            f"The error of this model is {worst:.0%}, above {STOP:.0%}: something else is wrong than a missing effect "
            f"(GET /v1/identifications/{found.id}/verdict says what it may be). To export it all the same, say "
            "anyway=true."
        )
        raise ProblemError(409, detail, title="Not fit for use")


def _measurement(services: Services, identifier: str) -> dict[str, Any]:
    found = services.resources.get("measurement", identifier)
    path = services.objects.path(found.objects["recording"].key)
    checks = [] if found.result is None else found.result["checks"]
    return {"id": found.id, "recording": str(path), "request": dict(found.request), "checks": checks}
