"""HTTP routes, a module for each kind of resource; the order of routers.

They import the science where they use it, not at their top: it takes seconds to load, and the service answers before.
"""

from dynident_service.routes import (
    batches,
    comparisons,
    designs,
    diagnoses,
    drive_gains,
    effects,
    health_metrics_and_usage,
    identifications,
    imports,
    jobs,
    measurements,
    meshes,
    model_judgements,
    reports,
    robots,
    series,
    validations,
)

# A path is held against one after the other: first those that are asked for most. Batches stand before identifications,
# one of which `batch` would be taken for.
ROUTERS = (
    health_metrics_and_usage.router,
    batches.router,
    identifications.router,
    jobs.router,
    robots.router,
    robots.known_router,
    meshes.router,
    effects.router,
    designs.router,
    designs.simulations_router,
    imports.router,
    measurements.router,
    measurements.revisions_router,
    model_judgements.router,
    comparisons.router,
    diagnoses.router,
    series.router,
    validations.router,
    drive_gains.router,
    drive_gains.currents_router,
    reports.router,
    health_metrics_and_usage.usage_router,
)

__all__ = ["ROUTERS"]
