"""The routes, one module a resource."""

from dynident_service.routes import (
    comparisons,
    designs,
    diagnoses,
    effects,
    identifications,
    jobs,
    measurements,
    reports,
    robots,
    simulations,
    system,
    validations,
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
    validations.router,
    reports.router,
    jobs.router,
)

__all__ = ["ROUTERS"]
