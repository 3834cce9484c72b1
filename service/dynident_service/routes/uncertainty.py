"""How sure an identified model is: its essential parameters, and what the motion determines only together."""

from __future__ import annotations

from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query, Request

from dynident_service.models.identifications import CorrelationView, EssentialQuery, EssentialView
from dynident_service.routes.common import succeeded
from dynident_service.services import Services, ServicesDep

AWAITED = "dynident_service.work.awaited"

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
