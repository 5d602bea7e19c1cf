"""`ricochet serve`: run the service."""

import argparse
import signal
import sys
from contextlib import suppress

from service.commands.environment import read_settings
from service.commands.errors import FAILED, CommandError
from service.commands.parsers import examples

NOT_STARTED = 3


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

    from service.app import create_app
    from service.commands.server import Server
    from service.logs import configure
    from service.telemetry import MissingExtraError

    configure(settings.log_level)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # uvicorn raises it again once it has stopped
    try:
        server = Server(create_app(settings), settings)
    except MissingExtraError as error:
        raise CommandError(str(error), FAILED) from None
    with suppress(KeyboardInterrupt):
        server.run()
    return 0 if server.started else NOT_STARTED
