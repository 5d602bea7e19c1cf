"""Servers to measure: `ricochet serve` with its own data folder, or another program, on a free loopback port."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

RICOCHET = Path(sys.executable).with_name("ricochet")
START_SECONDS = 180.0
"""Time allowed for a start, which may compile the solver. [s]"""
STOP_SECONDS = 20.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


@dataclass
class Server:
    """A process that serves HTTP on the loopback interface. It can be killed and started again."""

    command: Sequence[str | Path]
    port: int
    log: Path
    """File for standard output and standard error of the server."""
    environment: dict[str, str]
    """Environment variables in addition to those of this process."""
    ready: str
    """Path that the server answers with 200 when it is ready."""
    _process: "subprocess.Popen[bytes] | None" = None

    @property
    def url(self) -> str:
        """URL of the server, without a path."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """Process id of the server."""
        if self._process is None:
            raise RuntimeError("the server is not started")
        return self._process.pid

    def start(self) -> None:
        """Start the server and wait until it is ready.

        Raises
        ------
        RuntimeError
            If the server ends, or is not ready within `START_SECONDS`.
        """
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                self.command, env=os.environ | self.environment, stdout=log, stderr=subprocess.STDOUT
            )
        deadline = time.monotonic() + START_SECONDS
        while self._process.poll() is None and time.monotonic() < deadline:
            with suppress(OSError):
                connection = HTTPConnection("127.0.0.1", self.port, timeout=START_SECONDS)
                connection.request("GET", self.ready)
                if connection.getresponse().status == 200:
                    return
            time.sleep(0.1)
        raise RuntimeError(f"the server is not ready: {self.log.read_text(errors='replace')[-2000:]}")

    def kill(self) -> None:
        """Kill the server with SIGKILL."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> int:
        """Stop the server with SIGTERM; return its exit status, or 0 if it was never started."""
        if self._process is None:
            return 0
        self._process.terminate()
        return self._process.wait(STOP_SECONDS)


@contextmanager
def service(folder: Path | None = None, **settings: str) -> Iterator[Server]:
    """Run the service during the block, with two workers and a new data folder, or with the folder `folder`/data.

    `settings` are RICOCHET_... variables in lower case, without the prefix.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder, port = folder or Path(temporary), free_port()
        names = {"host": "127.0.0.1", "port": str(port), "data_dir": str(folder / "data"), "workers": "2"}
        names |= {"log_level": "warning"} | settings
        environment = {f"RICOCHET_{name.upper()}": value for name, value in names.items()}
        server = Server([RICOCHET, "serve"], port, folder / "log", environment, "/readyz")
        try:
            server.start()
            yield server
        finally:
            server.stop()
