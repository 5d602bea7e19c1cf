"""The audit log: who had what done, a JSON object a line. Rotating it is left to the operator's tools."""

import logging
import logging.handlers
from collections.abc import Mapping
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import orjson
from structlog.contextvars import get_contextvars

from service.access.keyring import open_private
from service.access.visit import Visit
from service.logs import route_of


class PrivateFile(logging.handlers.WatchedFileHandler):
    """A file that nobody else may read, opened anew once it has been moved away."""

    def _open(self) -> TextIOWrapper:
        return TextIOWrapper(open_private(Path(self.baseFilename), "ab"), encoding="utf-8")


class AuditLog:
    """Writes the log.

    Parameters
    ----------
    path
        Of its file; None for standard error.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._log = logging.Logger("ricochet.audit")  # noqa: LOG001 (each application has its own)

    def open(self) -> None:
        """Make sure that it can be written.

        Raises
        ------
        OSError
            If it cannot be.
        """
        if not self._log.handlers:
            self._log.addHandler(logging.StreamHandler() if self._path is None else PrivateFile(self._path))

    def close(self) -> None:
        """Let go of the file."""
        for handler in list(self._log.handlers):
            self._log.removeHandler(handler)
            handler.close()

    def note(self, scope: Mapping[str, Any], visit: Visit, status: int) -> None:
        """Write who asked for what, and what became of it."""
        caller, client = visit.caller, scope.get("client")
        line = {
            "event": "audit",
            "timestamp": datetime.now(UTC).isoformat(),
            "request_id": get_contextvars().get("request_id"),
            "owner": caller.owner if status != 401 else None,
            "key": caller.key.id if caller.key else None,
            "client": client[0] if client else None,
            "method": scope["method"],
            "operation": route_of(dict(scope)),
            "cases": visit.cases,
            "job": visit.job or None,
            "status": status,
        }
        self._log.info(orjson.dumps({name: value for name, value in line.items() if value is not None}).decode())
