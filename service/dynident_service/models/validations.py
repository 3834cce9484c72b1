"""Validations on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.models.common import Asked, Computed, Identifier, Name, Shown
from dynident_service.models.identifications import ErrorsView

ValidationKind = Literal["direct", "cross", "inertia_matrix", "payload", "methods", "simulation"]
AVAILABLE: tuple[ValidationKind, ...] = ("direct", "cross", "inertia_matrix")


class ValidationRequest(Asked):
    """Which model is to be tried, and how."""

    identification_id: Identifier
    kind: ValidationKind
    measurement_ids: list[Identifier] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="For cross validation: data the model has not seen; else its validation data",
    )
    name: Name | None = None


class MeasurementErrors(Shown):
    """Errors of the model on one measurement."""

    measurement_id: str
    name: str
    errors: ErrorsView


class ValidationResult(Shown):
    """What the model is worth by one test."""

    kind: ValidationKind
    measurements: list[MeasurementErrors] = Field(default=[])
    inertia_matrix_positive_definite: bool | None = None
    smallest_eigenvalue: float | None = Field(
        default=None, description="Of the inertia matrix scaled to a unit diagonal, over random postures"
    )


class ValidationView(Computed[ValidationRequest, ValidationResult]):
    """A validation."""
