"""The routes, one module a resource."""

from dynident_service.routes import (
    comparisons,
    diagnoses,
    effects,
    identifications,
    jobs,
    measurements,
    robots,
    system,
)

ROUTERS = (
    system.router,
    robots.router,
    effects.router,
    measurements.router,
    identifications.router,
    comparisons.router,
    diagnoses.router,
    jobs.router,
)

__all__ = ["ROUTERS"]
