"""Run services as forks of a process that has imported everything, so that a start takes a tenth of a second.

Each JSON line on standard input starts a service. The line contains the data folder, the port, the log file, the file
`count`, the number of the call that is to fail, and the fault. For each service two lines are printed: its process id
and, after its end, its exit status. A service that ends without being killed writes the number of its calls to `count`.
"""

import ctypes
import json
import logging
import os
import signal
import sys
from pathlib import Path
from typing import Any

from service.api.app import create_app
from service.cli.server import Server
from service.errors import ExecutorError, UnusableFolderError
from service.settings import Settings
from service.telemetry import configure_log
from solver import warm_up

NOT_STARTED = 3


def serve(order: dict[str, Any]) -> int:
    """Run a service in this process until it is stopped; return its exit status."""
    log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for stream in (1, 2):
        os.dup2(log, stream)
    library = ctypes.CDLL(None)
    library.nth_call_arm(order["data"].encode(), ctypes.c_long(order["number"]), order["fault"])
    configure_log("warning")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    settings = Settings(
        data_dir=Path(order["data"]), port=order["port"], executor="in-process", log_level="warning", access="open"
    )
    status = 0
    try:
        Server(create_app(settings), settings).run()
    except SystemExit:
        pass
    except (UnusableFolderError, ExecutorError, OSError) as error:  # `ricochet serve` catches the same errors.
        logging.getLogger(__name__).warning("not started: %s", error)
        status = NOT_STARTED
    library.nth_call_count.restype = ctypes.c_long
    Path(order["count"]).write_text(str(library.nth_call_count()))
    return status


def main() -> None:
    """Read requests from standard input, and run a service for each in a fork."""
    warm_up()
    for line in sys.stdin:
        order = json.loads(line)
        process = os.fork()
        if not process:
            status = 1
            try:
                status = serve(order)
            finally:
                os._exit(status)
        print(process, flush=True)  # noqa: T201
        _, ended = os.waitpid(process, 0)
        print(os.waitstatus_to_exitcode(ended), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
