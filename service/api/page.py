"""Static files: the page at `/`, Swagger UI at `/docs` and the built manual at `/manual`.

The service serves all of them itself, so that it works without access to other sites.
"""

import gzip
import json
import os
import re
from base64 import b64encode
from functools import lru_cache
from hashlib import sha256
from http import HTTPStatus
from importlib.util import find_spec
from pathlib import Path

import fastapi_offline
import orjson
from anyio.to_thread import run_sync
from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, RedirectResponse
from starlette.types import Scope

from service import names
from service.api.negotiation import coding_of
from service.schemas.verdict import usual_scatter_of_page

router = APIRouter(include_in_schema=False)
NAMES = ("choices", "quantities", "formulas", "outcomes", "statuses", "warnings", "operations", "job_statuses")
"""Names of the mappings in `service.names` that the page uses, in lower case."""

FOLDER = Path(__file__).parents[1] / "page"
NO_STYLE = "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='"
"""Hash of the empty style sheet that Plotly adds. A policy does not apply to rules that a script inserts afterwards."""
MAP_STYLE = "'sha256-ji27qzEtxXZW+7dun6UwjHXJ18e6WAin1VvNtkzIE/o='"
"""Hash of the style sheet for geographic maps, which Plotly's bundle adds when it is loaded."""
REPORT_SHEET = (Path(__file__).parents[1] / "reports" / "assessment.css").read_bytes()
REPORT_STYLE = f"'sha256-{b64encode(sha256(REPORT_SHEET).digest()).decode()}'"
"""Hash of the style sheet of a report. The page opens a report in a new tab, which inherits the policy of the page."""
REPORT_POLICY = (
    f"default-src 'none'; style-src {REPORT_STYLE}; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Content security policy of a report, which runs no script and loads no file."""
POLICY = (
    f"default-src 'none'; script-src 'self'; style-src 'self' {NO_STYLE} {MAP_STYLE} {REPORT_STYLE}; "
    "img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of the page: scripts, styles and connections of this service only, so that text injected into
the page could neither run nor send anything."""
HEADERS = {
    "Cache-Control": "no-cache",  # Browsers keep the files but revalidate them, so that a new version shows at once.
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

IMMUTABLE = "public, max-age=31536000, immutable"
"""Cache-Control of files at an address with a version, which never change; a year is the usual maximum."""
VERSION = re.compile("[0-9a-f]{16}")
"""Pattern of the version of the page, which is the first folder in the addresses of its files."""
OWN_FILE = re.compile(rb'"page/(?!contract\.json)')
"""Pattern of the address of a file of the page in index.html, except for contract.json, which has no version."""


class Assets(StaticFiles):
    """Static files with the headers of the page, compressed for clients that accept it."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file, or 304 if the browser has it. A file under the current version may be cached for a year."""
        version, _, rest = path.partition("/")
        is_versioned = VERSION.fullmatch(version) is not None
        response = await super().get_response(rest if is_versioned else path, scope)
        response.headers.update(HEADERS | {"Vary": "Accept-Encoding"})
        # A page that stays open while the service is upgraded requests files of its own, older version. It gets the
        # current files, which must not be cached under the older address.
        if is_versioned and version == await run_sync(page_version):
            response.headers["Cache-Control"] = IMMUTABLE
        plain = coding_of(Headers(scope=scope).get("Accept-Encoding", ""), ("gzip",)) != "gzip"
        if not isinstance(response, FileResponse) or scope["method"] != "GET" or plain:
            return response
        content = await run_sync(compressed, Path(response.path))
        kept = {name: value for name, value in response.headers.items() if name != "content-length"}
        return Response(content, headers=kept | {"etag": f"W/{kept['etag']}", "content-encoding": "gzip"})


def page_version() -> str:
    """Return a digest of the current files of the page."""
    return _page_version(tuple(sorted((str(path), path.stat().st_mtime_ns) for path in FOLDER.rglob("*.*"))))


@lru_cache(maxsize=1)
def _page_version(files: tuple[tuple[str, int], ...]) -> str:
    """Return a digest of the names and contents of files; their modification times only make up the cache key."""
    digest = sha256()
    for path, _ in files:
        digest.update(Path(path).name.encode() + b"\0" + Path(path).read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def index_content() -> tuple[bytes, bytes, str]:
    """Return index.html, plain and compressed, and its ETag.

    The addresses of its files contain a version, so that a browser that has the files need not request any: each
    request takes a round trip, and on a slow line fifty of them take seconds.
    """
    content = (FOLDER / "index.html").read_bytes()
    content = OWN_FILE.sub(f'"page/{page_version()}/'.encode(), content)
    return content, gzip.compress(content, mtime=0), f'W/"{sha256(content).hexdigest()[:32]}"'


def compressed(path: Path) -> bytes:
    """Return the compressed content of a file."""
    return compress(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def compress(path: Path, mtime_ns: int) -> bytes:  # noqa: ARG001 (cache key: a changed file is compressed again)
    """Compress a file, once per modification, because Plotly's file takes a third of a second."""
    return gzip.compress(path.read_bytes(), mtime=0)


def plotly_folder() -> Path:
    """Return the folder of Plotly's bundle, without importing the package, which is slow."""
    spec = find_spec("plotly")
    assert spec is not None  # noqa: S101 (a dependency)
    assert spec.origin is not None  # noqa: S101
    return Path(spec.origin).parent / "package_data"


DOCS_ASSETS = StaticFiles(directory=Path(fastapi_offline.__file__).parent / "static")
"""Swagger UI from an installed package, since FastAPI would load it from another site."""

DOCS_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
)
"""Content security policy of Swagger UI, which keeps it from connecting to other sites. Its page contains an inline
script and inline styles, hence `unsafe-inline`."""
DOCS_DARK = """<style>
@media (prefers-color-scheme: dark) {
  html { background: #14171b; color-scheme: dark; }
  .swagger-ui { filter: invert(0.9) hue-rotate(180deg); }
  .swagger-ui :is(.microlight, img) { filter: invert(1) hue-rotate(180deg); }
}
</style>
"""
"""Style sheet that inverts the colours of Swagger UI, which has only a light theme, on systems with a dark theme."""
ASSETS = Assets(directory=FOLDER)
PLOTLY = Assets(directory=plotly_folder())


@router.get("/")
async def page(request: Request) -> Response:
    """Serve index.html, or 304 if the browser has the current version."""
    plain, packed, tag = await run_sync(index_content)
    headers = HEADERS | {"ETag": tag, "Vary": "Accept-Encoding"}
    if tag in request.headers.get("If-None-Match", ""):
        return Response(status_code=304, headers=headers)
    if coding_of(request.headers.get("Accept-Encoding", ""), ("gzip",)) != "gzip":
        return HTMLResponse(plain, headers=headers)
    return HTMLResponse(packed, headers=headers | {"Content-Encoding": "gzip"})


@router.get("/page/plotly/plotly.min.js")
async def plotly(request: Request) -> Response:
    """Serve Plotly, which draws the plots of the page."""
    return await PLOTLY.get_response("plotly.min.js", request.scope)


@router.get("/page/contract.json")
async def contract(request: Request) -> Response:
    """Serve the schemas, the usual scatter and the display names, so that the page need not repeat them."""
    content, tag = await run_sync(contract_content, request.app)
    headers = HEADERS | {"ETag": tag, "Content-Encoding": "gzip"}
    if tag in request.headers.get("If-None-Match", ""):
        return Response(status_code=304, headers=headers)
    return Response(content, media_type="application/json", headers=headers)


@router.get("/openapi.json")
async def openapi(request: Request) -> Response:
    """Serve the OpenAPI document."""
    return Response(await run_sync(openapi_content, request.app), media_type="application/json")


@lru_cache(maxsize=1)
def openapi_content(app: FastAPI) -> bytes:
    """Return the OpenAPI document as JSON, encoded once."""
    return orjson.dumps(app.openapi())


@lru_cache(maxsize=1)
def contract_content(app: FastAPI) -> tuple[bytes, str]:
    """Return the schemas, the usual scatter and the display names as compressed JSON, and their entity tag."""
    parts = {
        "schemas": app.openapi()["components"]["schemas"],
        "usual_scatter": usual_scatter_of_page(),
        "names": {name: getattr(names, name.upper()) for name in NAMES},
    }
    content = json.dumps(parts, separators=(",", ":")).replace('"x-default":', '"default":').encode()
    return gzip.compress(content, mtime=0), f'W/"{sha256(content).hexdigest()[:32]}"'


@router.get("/docs")
async def docs() -> HTMLResponse:
    """Serve Swagger UI."""
    response = get_swagger_ui_html(
        openapi_url="openapi.json",
        title="ricochet",
        swagger_js_url="docs/assets/swagger-ui-bundle.js",
        swagger_css_url="docs/assets/swagger-ui.css",
        swagger_favicon_url="data:,",  # An empty image, since FastAPI's icon would be loaded from another site.
        swagger_ui_parameters={"validatorUrl": None, "tryItOutEnabled": True},
    )
    content = bytes(response.body).replace(b"</head>", DOCS_DARK.encode() + b"</head>")
    return HTMLResponse(content, headers={"Content-Security-Policy": DOCS_POLICY})


INLINE = re.compile(rb"<(script|style)>(.*?)</\1>", re.DOTALL)
"""Pattern of the inline scripts and style sheets in a page of the manual."""
MANUAL_HEADERS = {
    "Cache-Control": "no-cache",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
NO_MANUAL = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>No manual here</title>
<h1>No manual here</h1>
<p>This service has no built manual. In a copy of the repository, <code>make docs</code> builds it into
<code>build/manual</code>, and a service started there serves it at this address. Elsewhere,
<code>RICOCHET_MANUAL_DIR</code> names a folder with a built manual.</p>
<p><a href="docs">The routes of this service</a></p>
</html>
"""


class Manual(StaticFiles):
    """Static files of the built manual, or an explanation if it has not been built.

    Parameters
    ----------
    folder
        Folder of the manual. It may be created or removed while the service runs.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, check_dir=False)

    async def check_config(self) -> None:
        """Accept a missing folder, for which Starlette would raise an error."""

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """Find the file at a path. The path of the manual itself is resolved to its first page."""
        return super().lookup_path("index.html" if path == "." else path)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file, 304 if the browser has it, or an explanation if there is no manual."""
        try:
            response = await super().get_response(path, scope)
        except HTTPException as error:
            if path != "." or error.status_code != HTTPStatus.NOT_FOUND:
                raise
            return HTMLResponse(NO_MANUAL, HTTPStatus.NOT_FOUND)
        file, status = await run_sync(self.lookup_path, path)
        response.headers.update(MANUAL_HEADERS)
        if status is not None and file.endswith(".html"):
            response.headers["Content-Security-Policy"] = await run_sync(policy_of, file, status.st_mtime_ns)
        return response


@lru_cache(maxsize=256)
def policy_of(file: str, _modified: int) -> str:
    """Return the content security policy of a page of the manual, with the hashes of its inline scripts and styles."""
    scripts, styles = ["'self'"], ["'self'"]
    for kind, text in INLINE.findall(Path(file).read_bytes()):
        source = f"'sha256-{b64encode(sha256(text).digest()).decode()}'"
        (scripts if kind == b"script" else styles).append(source)
    return (
        f"default-src 'none'; script-src {' '.join(scripts)}; style-src {' '.join(styles)}; "
        "img-src 'self' data:; font-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )


@router.get("/manual")
async def manual() -> Response:
    """Redirect to the first page. The relative address also works behind the path prefix of a proxy."""
    return RedirectResponse("manual/", headers={"Cache-Control": "no-cache"})
