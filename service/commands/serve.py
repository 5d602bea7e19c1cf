"""`ricochet serve`: run the service."""

import argparse
import logging
import signal
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from service.commands.environment import read_settings
from service.commands.errors import FAILED, CommandError
from service.commands.parsers import examples

if TYPE_CHECKING:
    from service.access.keyring import KeyRing
    from service.settings import Settings

NOT_STARTED = 3

log = logging.getLogger(__name__)


class NoKeysError(Exception):
    """Others than this machine would reach the service, and nobody has been told who may."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its help."""
    parser.description = (
        "Run the service until SIGTERM or Ctrl-C, as RICOCHET_HOST, RICOCHET_PORT, RICOCHET_DATA_DIR, RICOCHET_WORKERS "
        "and more of service/settings.py say."
    )
    parser.epilog = examples("RICOCHET_PORT=9000 ricochet serve")


def run(_: argparse.Namespace) -> int:
    """Run the service until SIGTERM or SIGINT; return 0 if it could be started."""
    settings = read_settings()

    from service.access.keyring import KeysUnreadableError
    from service.api.app import create_app
    from service.api.telemetry import MissingExtraError
    from service.commands.server import Server
    from service.logs import configure

    configure(settings.log_level)
    try:
        app = create_app(settings)
        require_access(settings, app.state.services.keys)
    except MissingExtraError as error:
        raise CommandError(str(error), FAILED) from None
    except (KeysUnreadableError, NoKeysError) as error:
        log.error("not started: %s", error)
        return NOT_STARTED
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # uvicorn raises it again once it has stopped
    server = Server(app, settings)
    with suppress(KeyboardInterrupt):
        server.run()
    return 0 if server.started else NOT_STARTED


def require_access(settings: "Settings", keys: "KeyRing") -> None:
    """See that it has been decided who may ask.

    Raises
    ------
    NoKeysError
        If keys are asked for and there is none that is good.
    """
    if settings.access == "open":
        if not settings.on_loopback:
            log.warning("whoever reaches %s may ask: RICOCHET_ACCESS is open", settings.host)
        return
    if (settings.access == "keys" or not settings.on_loopback) and not keys.usable:
        raise NoKeysError(
            f"there is no key, and {settings.host} asks for one: make it with `ricochet keys add --owner NAME`, or let "
            "everybody in with RICOCHET_ACCESS=open"
        )
    if not settings.on_loopback and settings.tls_certificate is None:
        log.warning(
            "keys travel in the clear: set RICOCHET_TLS_CERTIFICATE and RICOCHET_TLS_KEY, or have a proxy do it"
        )
