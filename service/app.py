"""The application: settings in, routes, handlers and what lives as long as it runs out."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI

from service.cache import ResultCache
from service.engine import Engine
from service.executor import PoolExecutor
from service.keys import SCHEMA_VERSION
from service.problems import MEDIA_TYPE, install_problem_handlers
from service.routes import cra, docs, health, results, trajectory
from service.settings import Settings

DESCRIPTION = """
Critical ricochet angles of rigid projectiles on concrete.

Angles are in degrees from the inward normal of the face: 0° is normal impact. Depth is positive inside the target.
Fields are named with their units and never null: what is not given is absent.
"""
STOP_SECONDS = 1
"""Of the grace time, for the workers to end after the last request has been answered or given up."""
OPERATIONS = {"trajectory": trajectory.TRAJECTORY, "cra": cra.CRITICAL_ANGLE}


class Application(FastAPI):
    """FastAPI, with errors declared as the problems they are answered as."""

    def openapi(self) -> dict[str, Any]:
        """Return the contract."""
        contract = super().openapi()
        for path in contract["paths"].values():
            for operation in path.values():
                declare_problems(operation["responses"])
        return contract


def declare_problems(responses: dict[str, Any]) -> None:
    """Give the errors among these responses their media type, which FastAPI takes from the route."""
    for status, response in responses.items():
        if status >= "400" and "application/json" in response["content"]:
            response["content"] = {MEDIA_TYPE: response["content"]["application/json"]}


def create_app(settings: Settings | None = None) -> FastAPI:
    """Build the application; nothing runs until it is started."""
    app = Application(
        title="ricochet",
        version=SCHEMA_VERSION,
        summary="Critical ricochet angles of rigid projectiles on concrete",
        description=DESCRIPTION,
        license_info={"name": "BSD-3-Clause", "identifier": "BSD-3-Clause"},
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.settings = settings or Settings()
    install_problem_handlers(app)
    for resource in (trajectory, cra, results, health, docs):
        app.include_router(resource.router)
    app.mount("/docs/assets", docs.ASSETS)
    return app


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Bring the workers up, and end them at last."""
    state, settings = app.state, app.state.settings
    state.cache = ResultCache(settings.data_dir, memory_bytes=settings.memory_cache_bytes)
    state.executor = PoolExecutor(workers=settings.workers, task_seconds=settings.task_seconds)
    state.engine = Engine(state.cache, state.executor, OPERATIONS)
    await state.executor.start()
    try:
        yield
    finally:
        await state.executor.stop(STOP_SECONDS)
