"""The routes, one module a resource."""

from dynident_service.routes import effects, jobs, robots, system

ROUTERS = (system.router, robots.router, effects.router, jobs.router)

__all__ = ["ROUTERS"]
