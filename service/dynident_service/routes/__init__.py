"""The routes, one module a resource."""

from dynident_service.routes import effects, identifications, jobs, measurements, robots, system

ROUTERS = (system.router, robots.router, effects.router, measurements.router, identifications.router, jobs.router)

__all__ = ["ROUTERS"]
