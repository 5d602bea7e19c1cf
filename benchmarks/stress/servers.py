"""Servers of their own to be measured: the service with a temporary folder, and one that does nothing."""

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORKERS = 2
START_SECONDS = 120.0
"""For a server to answer; the first ever on a machine compiles the solver."""
STOP_SECONDS = 20.0
SAMPLE_SECONDS = 0.25


@dataclass(frozen=True, slots=True)
class Server:
    """A server that runs on this machine."""

    port: int
    pid: int

    def connect(self, seconds: float = 60.0) -> HTTPConnection:
        """A connection that waits this long for an answer."""
        return HTTPConnection("127.0.0.1", self.port, timeout=seconds)

    @property
    def resident(self) -> int:
        """Resident memory of the process, without its workers. [bytes]"""
        with suppress(OSError):
            return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        return 1024 * int(subprocess.check_output(["ps", "-o", "rss=", "-p", str(self.pid)]))  # noqa: S607


@contextmanager
def service(**settings: str) -> Iterator[Server]:
    """The service with two workers and an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        names = {"workers": str(WORKERS), "data_dir": str(Path(folder) / "data")} | settings
        with running(["-m", "service.cli", "serve"], "/readyz", Path(folder) / "log", names) as server:
            yield server


@contextmanager
def empty_service() -> Iterator[Server]:
    """FastAPI with one route that does nothing, served as the service is."""
    command = ["-m", "benchmarks.stress.empty"]
    with (
        tempfile.TemporaryDirectory() as folder,
        running(command, "/empty", Path(folder) / "log", {}) as server,
    ):
        yield server


@contextmanager
def running(arguments: list[str], ready: str, log: Path, settings: dict[str, str]) -> Iterator[Server]:
    """A Python process that serves HTTP on a free port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    names = {"host": "127.0.0.1", "port": str(port)} | settings
    environment = os.environ | {f"RICOCHET_{name.upper()}": value for name, value in names.items()}
    with (
        log.open("wb") as output,
        subprocess.Popen(
            [sys.executable, *arguments], cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT
        ) as process,
    ):
        try:
            _wait_until_ready(process, port, ready, log)
            yield Server(port, process.pid)
        finally:
            process.terminate()
            process.wait(STOP_SECONDS)


def _wait_until_ready(process: "subprocess.Popen[bytes]", port: int, path: str, log: Path) -> None:
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise RuntimeError(f"the server has ended: {log.read_text(errors='replace')}")
        with suppress(OSError), closing(HTTPConnection("127.0.0.1", port, timeout=START_SECONDS)) as connection:
            connection.request("GET", path)
            if connection.getresponse().status == 200:
                return
        time.sleep(0.1)
    raise RuntimeError("the server does not answer")


@contextmanager
def memory_of(server: Server) -> Iterator[list[int]]:
    """Resident memory of a server over time. [bytes]"""
    samples, stop = [server.resident], threading.Event()

    def sample() -> None:
        while not stop.wait(SAMPLE_SECONDS):
            samples.append(server.resident)

    thread = threading.Thread(target=sample)
    thread.start()
    try:
        yield samples
    finally:
        stop.set()
        thread.join()
