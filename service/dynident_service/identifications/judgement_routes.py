"""Routes that judge or use a model: essential parameters, correlation, verdict, torque; refusal of bad models."""

from __future__ import annotations

import json
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request

from dynident.number_format import format_percent
from dynident_service.identifications.wire_types import (
    CorrelationView,
    EssentialQuery,
    EssentialView,
    IdentificationResult,
    PredictedTorqueView,
    PredictionRequest,
    VerdictView,
)
from dynident_service.problems import ProblemError
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.resource_routes import require_succeeded
from dynident_service.storage.repository_values import Resource
from dynident_service.storage_and_engine import Services, ServicesDep

FUNCTIONS = "dynident_service.identifications.jobs"
"""Module of what child processes compute of models."""
MOST_OUTCOMES = 100
"""Validations of a model that are looked through, the newest first."""

router = APIRouter(prefix="/v1/identifications", tags=["identifications"])


@router.get("/{identification_id}/essential")
async def get_essential_parameters(
    identification_id: str,
    request: Request,
    services: ServicesDep,
    query: Annotated[EssentialQuery, Query()],
) -> EssentialView:
    """Find the essential parameters by backward elimination, with the errors along the way."""
    sent = {"model": await find_model_file(services, identification_id), "ratio": query.ratio}
    return EssentialView.model_validate(await services.interactive.call(request, f"{FUNCTIONS}:essential", dict, sent))


@router.get("/{identification_id}/correlation")
async def get_correlation(identification_id: str, request: Request, services: ServicesDep) -> CorrelationView:
    """Show the correlation of the estimates, and which parameters the motion determines only together."""
    arguments = {"model": await find_model_file(services, identification_id)}
    return CorrelationView.model_validate(
        await services.interactive.call(request, f"{FUNCTIONS}:correlation", dict, arguments)
    )


@router.post("/{identification_id}/predictions")
async def predict_torque(
    identification_id: str, body: PredictionRequest, request: Request, services: ServicesDep
) -> PredictedTorqueView:
    """Predict the torque of states, or along a motion, with intervals if asked for."""
    sent = {"model": await find_model_file(services, identification_id), "request": body.model_dump()}
    return PredictedTorqueView.model_validate(
        await services.interactive.call(request, f"{FUNCTIONS}:predict_torque", dict, sent)
    )


async def find_model_file(services: Services, identifier: str) -> str:
    """Give the path of the file that holds an identified model; it must have succeeded."""

    def find_path() -> str:
        identification = require_succeeded(services.resources.get("identification", identifier))
        return str(services.objects.fetch_file(identification.objects["model"].key))

    return await to_thread.run_sync(find_path)


@router.get("/{identification_id}/verdict")
async def get_verdict(identification_id: str, request: Request, services: ServicesDep) -> VerdictView:
    """Say for which uses a model is fit and why or why not; `stop` names the most probable cause of a large error."""

    def collect_arguments() -> dict[str, Any]:
        identification = require_succeeded(services.resources.get("identification", identification_id))
        return {
            "fitted": [
                _describe_measurement(services, identifier)
                for identifier in identification.get_dependencies("training")
            ],
            "held_out": [
                _describe_measurement(services, identifier)
                for identifier in identification.get_dependencies("validation")
            ],
            "outcomes": _newest_outcomes(services, identification_id),
        }

    arguments = {
        "model": await find_model_file(services, identification_id),
        **await to_thread.run_sync(collect_arguments),
    }
    # A model and its measurements never change: what is said of them changes with its validations alone.
    key = f"{identification_id} {json.dumps(arguments['outcomes'])}"
    if (cached := services.verdicts.get(key)) is not None:
        return VerdictView.model_validate(cached)
    answer = await services.interactive.call(request, f"{FUNCTIONS}:judge_model", dict, arguments)
    services.verdicts.put(key, answer)
    return VerdictView.model_validate(answer)


def _newest_outcomes(services: Services, identification_id: str) -> list[dict[str, Any]]:
    """Return how the newest validation of every kind ended."""
    page = services.resources.list_page("validation", MOST_OUTCOMES, on_id=identification_id)
    newest = {
        validation.request["kind"]: validation.result
        # The list has the newest first: reversed, the newest of each kind is the one that stays.
        for validation in reversed(page.items)
        if validation.result is not None
    }
    return [
        {"kind": kind, "verdict": result["verdict"], "reason": result["reason"]}
        for kind, result in sorted(newest.items())
        if result is not None
    ]


def refuse_stopped(identification: Resource) -> None:
    """Raise a problem 409 for a model that its error, or held-out data of the fit, say not to use."""
    with hold_import_lock():
        from dynident.identification.thresholds import STOP

    result = IdentificationResult.model_validate(identification.result)
    errors = [figures.relative_total for figures in (result.validation, result.residual) if figures is not None]
    # Of held-out data and of the fit, whichever is worse; a model without either is not refused.
    worst = max((error for error in errors if error is not None), default=0.0)
    if result.copied:
        detail = (
            f"The held-out data of this model ({', '.join(result.copied)}) contain samples of the fit, so they do "
            "not test the model. Hold out another measurement. To export it anyway, add anyway=true."
        )
        raise ProblemError(409, detail, title="Not fit for use")
    if worst > STOP:
        detail = (
            f"The error of this model is {format_percent(worst, decimals=0)}, above "
            f"{format_percent(STOP, decimals=0)}: too large for a missing effect (GET "
            f"/v1/identifications/{identification.id}/verdict names the probable cause). To export it anyway, add "
            "anyway=true."
        )
        raise ProblemError(409, detail, title="Not fit for use")


def _describe_measurement(services: Services, identifier: str) -> dict[str, Any]:
    measurement = services.resources.get("measurement", identifier)
    path = services.objects.fetch_file(measurement.objects["recording"].key)
    checks = [] if measurement.result is None else measurement.result["checks"]
    return {"id": measurement.id, "recording": str(path), "request": dict(measurement.request), "checks": checks}
