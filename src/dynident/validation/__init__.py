"""Validations of a model (§12.7); pass levels stand in each module, shared ones in identification/thresholds.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.identification.thresholds import LARGEST_ERROR, ValidationOutcome, Verdict, combine_verdicts
from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.validation.bootstrap_validation import BootstrapValidation, DrawnParameter, validate_bootstrap
    from dynident.validation.contact_detection import CollisionValidation, ContactDetection, validate_collision
    from dynident.validation.direct_and_cross_validation import (
        RecordingErrors,
        TorqueValidation,
        validate_cross,
        validate_direct,
    )
    from dynident.validation.filter_choice import (
        FiltersBySimulation,
        FilterTrial,
        SensorNoise,
        filters_by_simulation,
        sensor_noise,
    )
    from dynident.validation.inertia_matrix import InertiaMatrixValidation, validate_inertia_matrix
    from dynident.validation.known_load_validation import PayloadValidation, validate_payload
    from dynident.validation.method_comparison import MethodResult, MethodsValidation, validate_methods
    from dynident.validation.momentum_observer import MomentumObserver, ObservedContacts
    from dynident.validation.open_loop_drift import Drift, DriftValidation, compute_open_loop_drift, validate_drift
    from dynident.validation.simulated_response import SimulationValidation, validate_simulation
    from dynident.validation.validation_request import Method, available_methods, get_method

__all__ = [
    "LARGEST_ERROR",
    "BootstrapValidation",
    "CollisionValidation",
    "ContactDetection",
    "DrawnParameter",
    "Drift",
    "DriftValidation",
    "FilterTrial",
    "FiltersBySimulation",
    "InertiaMatrixValidation",
    "Method",
    "MethodResult",
    "MethodsValidation",
    "MomentumObserver",
    "ObservedContacts",
    "PayloadValidation",
    "RecordingErrors",
    "SensorNoise",
    "SimulationValidation",
    "TorqueValidation",
    "ValidationOutcome",
    "Verdict",
    "available_methods",
    "combine_verdicts",
    "compute_open_loop_drift",
    "filters_by_simulation",
    "get_method",
    "sensor_noise",
    "validate_bootstrap",
    "validate_collision",
    "validate_cross",
    "validate_direct",
    "validate_drift",
    "validate_inertia_matrix",
    "validate_methods",
    "validate_payload",
    "validate_simulation",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too: reading one must not wait for the imports of the computation.
    __getattr__, __dir__ = make_lazy_exports(__name__)
