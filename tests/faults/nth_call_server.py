"""Services as forks of one process that has imported everything, so that a start takes a tenth of a second.

A line of JSON on standard input has the data folder, the port, the log, the call that is to fail and the fault. The
service runs in a fork. A line on standard output is its process id, and after its end the next line is its status. The
number of its calls is then in the file `count`, unless it was killed.
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
    """Run one service; return its exit status."""
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
    except (UnusableFolderError, ExecutorError, OSError) as error:  # like `ricochet serve`
        logging.getLogger(__name__).warning("not started: %s", error)
        status = NOT_STARTED
    library.nth_call_count.restype = ctypes.c_long
    Path(order["count"]).write_text(str(library.nth_call_count()))
    return status


def main() -> None:
    """Run the requested services one after the other."""
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
