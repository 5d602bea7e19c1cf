"""Audit log of requests that may change something: sender, effect and status."""

import logging
import logging.handlers
from collections.abc import Mapping
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import orjson
from structlog.contextvars import get_contextvars

from service.auth.dependencies import RequestContext
from service.private_files import open_private
from service.telemetry import route_of


class PrivateFileHandler(logging.handlers.WatchedFileHandler):
    """Handler that writes to a private file, and reopens it after log rotation has moved it."""

    def _open(self) -> TextIOWrapper:
        return TextIOWrapper(open_private(Path(self.baseFilename), "ab"), encoding="utf-8")


class AuditLog:
    """Audit log in a file or on standard error, one line of JSON for each entry.

    Parameters
    ----------
    path
        File to append to; None for standard error.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._log = logging.Logger("ricochet.audit")  # noqa: LOG001 (each application has its own)

    def open(self) -> None:
        """Open the file, or use standard error if there is none.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        if not self._log.handlers:
            self._log.addHandler(logging.StreamHandler() if self._path is None else PrivateFileHandler(self._path))

    def close(self) -> None:
        """Close the file, if there is one."""
        for handler in list(self._log.handlers):
            self._log.removeHandler(handler)
            handler.close()

    def record(self, scope: Mapping[str, Any], context: RequestContext, status: int) -> None:
        """Write the entry of a finished request."""
        principal, client = context.principal, scope.get("client")
        line = {
            "event": "audit",
            "timestamp": datetime.now(UTC).isoformat(),
            "request_id": get_contextvars().get("request_id"),
            # A request without a valid key has the owner `local` by default, who did not send it.
            "owner": principal.owner if status != 401 else None,
            "key": principal.key.id if principal.key else None,
            "client": client[0] if client else None,
            "method": scope["method"],
            "route": route_of(dict(scope)),
            "cases": context.cases,
            "job": context.job or None,
            "status": status,
        }
        self._log.info(orjson.dumps({name: value for name, value in line.items() if value is not None}).decode())
