"""The routes, one module a resource."""

from dynident_service.routes import (
    comparisons,
    designs,
    diagnoses,
    effects,
    identifications,
    jobs,
    measurements,
    robots,
    simulations,
    system,
)

ROUTERS = (
    system.router,
    robots.router,
    effects.router,
    designs.router,
    simulations.router,
    measurements.router,
    identifications.router,
    comparisons.router,
    diagnoses.router,
    jobs.router,
)

__all__ = ["ROUTERS"]
