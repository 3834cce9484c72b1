"""`create_app`: assemble the service's routes and middleware; CORS: which origins, and which headers they may read."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import astuple

from anyio import to_thread
from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware
from starlette.routing import compile_path
from starlette.types import Scope

from dynident.version import __version__
from dynident_service import service_routes, tracing
from dynident_service.api_keys import KeyRing
from dynident_service.campaigns import routes as campaigns
from dynident_service.comparisons import routes as comparisons
from dynident_service.designs import routes as designs
from dynident_service.diagnoses import routes as diagnoses
from dynident_service.docs_page import mount_docs_page as mount_documentation
from dynident_service.drive_gains import routes as drive_gains
from dynident_service.fair_queue import name_address_party
from dynident_service.identifications import batch_routes, judgement_routes
from dynident_service.identifications import routes as identifications
from dynident_service.jobs.child_pool import ForkServer
from dynident_service.measurements import import_routes, rows_routes
from dynident_service.measurements import routes as measurements
from dynident_service.middleware import AccessControl, AccessLog, AuditLog, Metrics, RequestTiming
from dynident_service.problem_responses import REQUEST_ID, SafeHeaders
from dynident_service.problem_responses import install_handlers as install_problems
from dynident_service.problems import MEDIA_TYPE, Problem
from dynident_service.reports import routes as reports
from dynident_service.request_limits import Admission, BodyLimit, UploadRoom, get_quota_limits, set_threads
from dynident_service.robots import routes as robots
from dynident_service.settings import Settings
from dynident_service.storage_and_engine import Services, open_services
from dynident_service.tracing import RequestTracing
from dynident_service.validations import routes as validations
from dynident_service.workbench import mount_workbench as mount_workbench

DESCRIPTION = """Identification of the dynamic parameters of robots: from a robot and its recordings the service
identifies a model, names the effects that the model lacks, and writes a report. Long work is a job: the answer 202 has
its resource and its `job_id`; `/v1/jobs/{id}/events` reports the progress. All units are SI; errors are
`application/problem+json`."""
PROBLEM = {
    "description": "A problem (RFC 9457)",
    "content": {MEDIA_TYPE: {"schema": {"$ref": f"#/components/schemas/{Problem.__name__}"}}},
}
log = logging.getLogger("dynident.service")

# A path is held against one after the other: first those that are asked for most. Batches stand before identifications,
# one of which `batch` would be taken for.
ROUTERS = (
    service_routes.router,
    batch_routes.router,
    identifications.router,
    service_routes.jobs_router,
    robots.router,
    robots.known_router,
    robots.meshes_router,
    service_routes.effects_router,
    campaigns.router,
    designs.router,
    designs.simulations_router,
    import_routes.router,
    measurements.router,
    measurements.revisions_router,
    rows_routes.router,
    judgement_routes.router,
    comparisons.router,
    diagnoses.router,
    diagnoses.experiment_router,
    diagnoses.series_router,
    validations.router,
    drive_gains.router,
    drive_gains.currents_router,
    reports.router,
    service_routes.usage_router,
)


def create_app(settings: Settings | None = None, fork_server: ForkServer | None = None) -> FastAPI:
    """Assemble the application; nothing is opened before it starts.

    Several applications of one process may share the fork server; whoever made it closes it.
    """
    settings = settings or Settings()
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        set_threads(settings)
        science = fork_server or ForkServer()
        # Opened and closed in a thread: migrations and the end of jobs take seconds, in which the event loop has to
        # live.
        opening = open_services(settings, science)
        services = await to_thread.run_sync(opening.__enter__)
        if settings.traces:
            tracing.begin_tracing()
        try:
            app.state.services = services
            app.state.keys = _open_key_ring(services)
            metrics.watch_jobs(services.job_queue.count_by_state, services.job_queue.measure_health, settings.data_dir)
            yield
        finally:
            await to_thread.run_sync(opening.__exit__, None, None, None)
            if fork_server is None:
                science.close()
            if settings.traces:
                await to_thread.run_sync(tracing.end_tracing)

    app = FastAPI(
        title="dynident",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        generate_unique_id_function=lambda route: route.name,
        responses={422: PROBLEM, "default": PROBLEM},
        # FastAPI's own tracing would record queries, which may hold credentials.
        telemetry={"auto_configure": False, "tracing": False, "metrics": False, "logs": False},
        docs_url=None,
        redoc_url=None,
    )
    app.state.metrics = metrics
    for router in ROUTERS:
        app.include_router(router)
    mount_documentation(app)
    mount_workbench(app)
    install_problems(app, _make_method_lookup(app))
    # Middleware runs in reverse order: the last one added is the first that a request meets. Ids and headers come
    # first so that refusals carry them too; bodies are read only after the key was checked.
    app.add_middleware(UploadRoom, settings=settings, database=lambda: app.state.services.database)
    app.add_middleware(BodyLimit, settings=settings)
    app.add_middleware(AccessControl, settings=settings, keys=lambda: app.state.keys)
    if settings.allowed_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.allowed_origins,
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=["Location", "X-Held-Out-Error", REQUEST_ID],
        )
    app.add_middleware(AuditLog)
    app.add_middleware(Admission, settings=settings, party_of=_make_party_lookup(app))
    app.add_middleware(RequestTiming, metrics=metrics)
    app.add_middleware(SafeHeaders)
    app.add_middleware(RequestTracing)
    app.add_middleware(AccessLog)
    return app


def _make_party_lookup(app: FastAPI) -> Callable[[Scope], str]:
    """Return a function that names the party of a request: its key, or its address before keys are loaded."""

    def find_party(scope: Scope) -> str:
        keys: KeyRing | None = getattr(app.state, "keys", None)
        return name_address_party(scope) if keys is None else keys.find_party(scope)

    return find_party


def _open_key_ring(services: Services) -> KeyRing:
    keys = KeyRing(services.settings, services.database)
    if services.settings.needs_keys and keys.is_empty():
        raise RuntimeError(
            f"the service does not listen on {services.settings.host} without an API key: make one with `python "
            "-m dynident_service.new_key NAME`, or listen on 127.0.0.1"
        )
    if any(astuple(get_quota_limits(services.settings))) and not services.settings.needs_keys:
        log.warning("quotas count per key, but the service requires no keys (DYNIDENT_REQUIRE_KEYS): nobody is limited")
    return keys


def _make_method_lookup(app: FastAPI) -> Callable[[str], list[str]]:
    def find_methods(path: str) -> list[str]:
        methods: set[str] = set()
        for template, operations in app.openapi()["paths"].items():
            # Starlette knows a path as found or not: the methods of an existing one are those of the contract.
            if compile_path(template)[0].match(path):
                methods |= {name.upper() for name in operations}
        return sorted(methods) or ["GET"]

    return find_methods
