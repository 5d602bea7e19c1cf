"""Routes for operators: liveness, readiness, versions, and metrics for Prometheus."""

from enum import StrEnum
from functools import cache
from http import HTTPStatus
from importlib.metadata import version as installed_version

from anyio.to_thread import run_sync
from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import MISSING

from service.api.contract import problems
from service.api.services import services_of
from service.auth.dependencies import READ
from service.errors import StorageError
from service.operations import SCHEMA_VERSION
from service.schemas.quantities import Part, with_examples
from service.version import VERSION
from solver import ENGINE_VERSION

router = APIRouter(tags=["health"])

LIBRARIES = ("fastapi", "h5py", "numba", "numpy", "pydantic", "scipy", "uvicorn")
MOST_NAMES = 5
"""Largest number of damaged files that the readiness probe names; there may be thousands."""


class HealthStatus(StrEnum):
    """State of the service: `ok`, or `busy` if the readiness probe found all workers computing."""

    OK = "ok"
    BUSY = "busy"


class ChunkPlace(StrEnum):
    """Place where chunks of batches and jobs run: this machine (`pool`) or the Dask cluster (`cluster`)."""

    POOL = "pool"
    CLUSTER = "cluster"


class Health(Part):
    """State of the service."""

    model_config = with_examples({"status": "ok", "chunks_on": "pool"})

    status: HealthStatus
    chunks_on: ChunkPlace | MISSING = MISSING
    warnings: list[str] | MISSING = MISSING
    """Faults that an operator should look into, although the service works."""


class Version(Part):
    """Versions of the solver, the contract and the main libraries."""

    model_config = with_examples({"engine_version": "1", "schema_version": "1", "libraries": {"numpy": "2.4.6"}})

    engine_version: str
    """Version of the solver; raised whenever results change."""
    schema_version: str
    """Version of the contract; raised whenever its meaning changes."""
    libraries: dict[str, str]
    """Versions of this package and of the main libraries that it depends on."""


@router.get("/livez", response_description="The service is alive.", responses=problems(500))
async def livez() -> Health:
    """Report that the service is alive, without using workers or the disk."""
    return Health(status=HealthStatus.OK)


@router.get("/readyz", response_description="The service is ready.", responses=problems(500, 503))
async def readyz(request: Request) -> Health:
    """Report whether the service is ready: a worker answers or all are busy, and results and jobs can be stored."""
    services = services_of(request)
    idle = await services.executor.probe(services.settings.probe_seconds)
    if not idle and not services.executor.busy:
        raise HTTPException(HTTPStatus.SERVICE_UNAVAILABLE, services.executor.last_error)
    if not await run_sync(services.cache.writable):
        raise HTTPException(HTTPStatus.SERVICE_UNAVAILABLE, f"results cannot be written: {services.cache.last_error}")
    try:
        await services.jobs.check()
    except StorageError as error:
        raise HTTPException(HTTPStatus.SERVICE_UNAVAILABLE, f"jobs cannot be stored: {error}") from error
    status = HealthStatus.OK if idle else HealthStatus.BUSY
    place = ChunkPlace.CLUSTER if services.executor.on_cluster else ChunkPlace.POOL
    warnings = [services.jobs.warning] if services.jobs.warning else []
    if damaged := await run_sync(services.cache.set_aside):
        names = ", ".join(damaged[-MOST_NAMES:])
        warnings.append(f"{names}: damaged, {len(damaged)} in all; see the log and the folder damaged")
    return Health(status=status, chunks_on=place, warnings=warnings or MISSING)


@router.get("/version", response_description="The versions.", responses=problems(500))
async def version() -> Version:
    """Return the versions of the solver, the contract and the libraries."""
    return Version(engine_version=ENGINE_VERSION, schema_version=SCHEMA_VERSION, libraries=library_versions())


@cache
def library_versions() -> dict[str, str]:
    """Return the versions of the package and its libraries. They are read from the disk once and then cached."""
    return {"ricochet": VERSION} | {name: installed_version(name) for name in LIBRARIES}


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    response_description="The metrics.",
    responses=problems(500),
    dependencies=[READ],
)
async def metrics(request: Request) -> Response:
    """Return the metrics of the service in the text format of Prometheus."""
    services = services_of(request)
    services.metrics.look_up(services.jobs, services.queries, await services.jobs.tally())
    # The metrics of a busy service have thousands of lines, and formatting them would block the event loop.
    content = await run_sync(generate_latest, services.metrics.registry)
    return Response(content, media_type=CONTENT_TYPE_LATEST)
