"""Routes of comparisons: create, signals, residual map, spectra, autocorrelation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from fastapi import APIRouter, Query

from dynident_service.comparisons.wire_types import (
    AutocorrelationView,
    ComparisonRequest,
    ComparisonResult,
    ComparisonView,
    ResidualMap,
    Series,
    Spectrum,
)
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import depend_on, require_measurements, require_model
from dynident_service.shared.resource_routes import PagesDep, SubmissionDep, require_succeeded, show_with_tables
from dynident_service.shared.wire_types import Page, Table, ViewModel
from dynident_service.storage.repository_values import NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

ShownT = TypeVar("ShownT", bound=ViewModel)

if TYPE_CHECKING:
    from dynident.diagnosis.comparison.comparison_files import StoredComparison

router = APIRouter(prefix="/v1/comparisons", tags=["comparisons"])
JOB = NewJob("comparison", "dynident_service.comparisons.jobs:compare_model")


def _build_tables(_: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.comparisons.adapters import build_tables

    return build_tables(ComparisonResult.model_validate(resource.result))


@router.post("", status_code=202)
def create_comparison(body: ComparisonRequest, services: ServicesDep, submit: SubmissionDep) -> ComparisonView:
    """Compare a model with a measurement."""
    model = require_model(services, body.identification_id)
    # A measurement fits if it is of the model's robot, or of one with the same drives.
    robot = services.resources.get("robot", model.get_dependency("robot"))
    (measurement,) = require_measurements(services, robot, [body.measurement_id], "measurement", "/measurement_id")
    return submit(ComparisonView, "comparison", body, JOB, [depend_on(model), measurement])


@router.get("")
def list_comparisons(pages: PagesDep, identification_id: str | None = None) -> Page[ComparisonView]:
    """List the comparisons, newest first; those of one identification if requested."""
    return pages.show("comparison", ComparisonView.show, identification_id)


@router.get("/{comparison_id}")
def get_comparison(comparison_id: str, services: ServicesDep) -> ComparisonView:
    """Show a comparison, with its result once there is one."""
    return show_with_tables(ComparisonView, services, "comparison", comparison_id, _build_tables)


@router.delete("/{comparison_id}", status_code=204)
def delete_comparison(comparison_id: str, services: ServicesDep) -> None:
    """Delete a comparison."""
    services.resources.delete("comparison", comparison_id)


@router.get("/{comparison_id}/series")
def get_series(
    comparison_id: str,
    services: ServicesDep,
    joint: Annotated[str, Query(description="Name")],
    start: Annotated[float | None, Query(alias="from", allow_inf_nan=False, description="s")] = None,
    end: Annotated[float | None, Query(alias="to", allow_inf_nan=False, description="s")] = None,
    points: Annotated[int, Query(ge=12, le=100_000, description="Approximate number of points")] = 2000,
) -> Series:
    """Give a joint's measured and predicted torque and residual over time, thinned; extremes are kept."""
    with hold_import_lock():
        from dynident_service.comparisons.adapters import thin_signals

    comparison = _open_comparison(services, comparison_id)
    signals = comparison.read_signals(joint, start, end)
    unit = comparison.get_unit(joint)
    return _to_view(Series, thin_signals(signals, points), joint=joint, effort_unit=unit, n_samples=len(signals.t))


@router.get("/{comparison_id}/residual_map")
def get_residual_map(
    comparison_id: str,
    services: ServicesDep,
    joint: Annotated[str, Query(description="Name")],
    x: Annotated[str, Query(description="t, or q_, dq_, ddq_, load_, tau_ or temperature_ and a joint's name")],
    y: Annotated[str | None, Query(description="Like x; without it, the map has one dimension")] = None,
    bins: Annotated[int, Query(ge=2, le=200, description="Number of bins in each direction")] = 30,
) -> ResidualMap:
    """Give mean, standard deviation and count of a joint's residual over one or two signals."""
    comparison = _open_comparison(services, comparison_id)
    residual_map = comparison.compute_residual_map(joint, x, y, bins)
    return _to_view(ResidualMap, residual_map, joint=joint, effort_unit=comparison.get_unit(joint), x=x, y=y)


@router.get("/{comparison_id}/spectrum")
def get_spectrum(
    comparison_id: str,
    services: ServicesDep,
    joint: Annotated[str, Query(description="Name")],
    over: Annotated[Literal["angle", "time"], Query(description="The joint's own position, or time")] = "time",
) -> Spectrum:
    """Give the amplitude spectrum of a joint's residual: gears appear over the angle, vibration over time."""
    comparison = _open_comparison(services, comparison_id)
    return _to_view(
        Spectrum,
        comparison.compute_spectrum(joint, over),
        joint=joint,
        effort_unit=comparison.get_unit(joint),
        over=over,
    )


@router.get("/{comparison_id}/autocorrelation")
def get_autocorrelation(
    comparison_id: str,
    services: ServicesDep,
    joint: Annotated[str, Query(description="Name")],
    longest: Annotated[float, Query(gt=0, le=60, description="Longest lag, s")] = 5.0,
) -> AutocorrelationView:
    """Give the autocorrelation of a joint's residual, and its effective number of independent samples."""
    return _to_view(
        AutocorrelationView,
        _open_comparison(services, comparison_id).compute_autocorrelation(joint, longest),
        joint=joint,
    )


def _open_comparison(services: Services, identifier: str) -> StoredComparison:
    with hold_import_lock():
        from dynident.diagnosis.comparison.comparison_files import StoredComparison

    resource = require_succeeded(services.resources.get("comparison", identifier))
    return StoredComparison(services.objects.fetch_file(resource.objects["signals"].key))


def _to_view(view: type[ShownT], result: object, **more: object) -> ShownT:
    with hold_import_lock():
        from dynident_service.shared.field_by_field import to_view

    return to_view(view, result, **more)
