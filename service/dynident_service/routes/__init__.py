"""HTTP routes, a module for each kind of resource; the order of routers.

They import the science where they use it, not at their top: it takes seconds to load, and the service answers before.
"""

from dynident_service.routes import (
    batches,
    comparisons,
    current_models,
    designs,
    diagnoses,
    drive_gains,
    effects,
    health_and_metrics,
    identifications,
    imports,
    jobs,
    measurements,
    meshes,
    model_judgements,
    reports,
    robots,
    series,
    simulations,
    usage,
    validations,
)

# A path is held against one after the other: first those that are asked for most. Batches stand before identifications,
# one of which `batch` would be taken for.
ROUTERS = (
    health_and_metrics.router,
    batches.router,
    identifications.router,
    jobs.router,
    robots.router,
    robots.known_router,
    meshes.router,
    effects.router,
    designs.router,
    simulations.router,
    imports.router,
    measurements.router,
    measurements.revisions_router,
    model_judgements.router,
    comparisons.router,
    diagnoses.router,
    series.router,
    validations.router,
    drive_gains.router,
    current_models.router,
    reports.router,
    usage.router,
)

__all__ = ["ROUTERS"]
