"""How sure an identified model is: its essential parameters, and what the motion determines only together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Query

from dynident_service.models.identifications import CorrelationView, EssentialView
from dynident_service.routes.common import succeeded
from dynident_service.services import Services, ServicesDep

if TYPE_CHECKING:
    from dynident.identification import Identification

router = APIRouter(prefix="/v1/identifications", tags=["identifications"])


@router.get("/{identification_id}/essential")
def get_essential_parameters(
    identification_id: str,
    services: ServicesDep,
    ratio: Annotated[
        float, Query(gt=1, le=1e6, description="Largest over smallest relative standard deviation to end at (§12.7)")
    ] = 10.0,
) -> EssentialView:
    """Find the essential parameters by backward elimination, with the errors along the way."""
    from dynident.identification.essential import essential_parameters
    from dynident_service.adapters.identifications import describe_essential

    return describe_essential(essential_parameters(_model(services, identification_id), ratio))


@router.get("/{identification_id}/correlation")
def get_correlation(identification_id: str, services: ServicesDep) -> CorrelationView:
    """Show the correlation of the estimates, and say in words which of them the motion determines only together."""
    from dynident.identification.dependence import parameter_dependence
    from dynident_service.adapters.identifications import describe_correlation

    return describe_correlation(parameter_dependence(_model(services, identification_id)))


def _model(services: Services, identifier: str) -> Identification:
    from dynident.identification import from_bytes

    found = succeeded(services.resources.get("identification", identifier))
    return from_bytes(services.objects.get(found.objects["model"].key))
