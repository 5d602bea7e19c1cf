"""The contract for people: Swagger UI, all of it served from here."""

from pathlib import Path

import fastapi_offline
from fastapi import APIRouter
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

router = APIRouter(include_in_schema=False)

ASSETS = StaticFiles(directory=Path(fastapi_offline.__file__).parent / "static")
"""Swagger UI as an installed package brings it."""

POLICY = "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
"""A browser asks no address outside the service, whatever the page holds."""


@router.get("/docs")
async def docs() -> HTMLResponse:
    """Serve Swagger UI."""
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title="ricochet",
        swagger_js_url="docs/assets/swagger-ui-bundle.js",
        swagger_css_url="docs/assets/swagger-ui.css",
        swagger_favicon_url="data:,",
        swagger_ui_parameters={"validatorUrl": None, "tryItOutEnabled": True},
    )
    page.headers["Content-Security-Policy"] = POLICY
    return page
