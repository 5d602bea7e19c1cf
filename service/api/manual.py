"""The built manual at `/manual`: static files, with a policy that lets in exactly the scripts of each page."""

import base64
import hashlib
import os
import re
from functools import lru_cache
from http import HTTPStatus
from pathlib import Path

from anyio.to_thread import run_sync
from fastapi import APIRouter, Response
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.responses import RedirectResponse
from starlette.types import Scope

router = APIRouter(include_in_schema=False)

INLINE = re.compile(rb"<(script|style)>(.*?)</\1>", re.DOTALL)
"""Scripts and style sheets inside a page: the theme has two of them."""
HEADERS = {
    "Cache-Control": "no-cache",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
ABSENT = """<!doctype html>
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
    """Files of the manual.

    Parameters
    ----------
    folder
        Where the manual is, if it was built; looked at with each request.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, check_dir=False)

    async def check_config(self) -> None:
        """Let a folder be absent: its files are then not found."""

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """Return the file at a path, for the manual itself its first page."""
        return super().lookup_path("index.html" if path == "." else path)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a file, or that the browser has it; without a manual, that there is none."""
        try:
            response = await super().get_response(path, scope)
        except HTTPException as error:
            if path != "." or error.status_code != HTTPStatus.NOT_FOUND:
                raise
            return HTMLResponse(ABSENT, HTTPStatus.NOT_FOUND)
        file, status = await run_sync(self.lookup_path, path)
        response.headers.update(HEADERS)
        if status is not None and file.endswith(".html"):
            response.headers["Content-Security-Policy"] = await run_sync(policy_of, file, status.st_mtime_ns)
        return response


@lru_cache(maxsize=256)
def policy_of(file: str, _modified: int) -> str:
    """Return the content policy of a page: files of this service, and the scripts and styles inside the page."""
    scripts, styles = ["'self'"], ["'self'"]
    for kind, text in INLINE.findall(Path(file).read_bytes()):
        source = f"'sha256-{base64.b64encode(hashlib.sha256(text).digest()).decode()}'"
        (scripts if kind == b"script" else styles).append(source)
    return (
        f"default-src 'none'; script-src {' '.join(scripts)}; style-src {' '.join(styles)}; "
        "img-src 'self' data:; font-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )


@router.get("/manual")
async def manual() -> Response:
    """Lead to the first page, by an address that holds behind a prefix too."""
    return RedirectResponse("manual/", headers={"Cache-Control": "no-cache"})
