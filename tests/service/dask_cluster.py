"""A Dask cluster of real processes, with supervisors that restart workers."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).parents[2]
SUPERVISED = """
import subprocess, sys, time
while True:
    subprocess.run(sys.argv[1:], check=False)
    time.sleep(0.2)
"""
START_LIMIT_S = 60.0


class DaskCluster:
    """A Dask scheduler on a free port, and workers of one thread each."""

    def __init__(self, folder: Path, settings: dict[str, str]) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self._folder = folder
        self._log = (folder / "cluster.log").open("ab")
        self._environment = os.environ | settings
        self._workers: list[subprocess.Popen[bytes]] = []

    def start_scheduler(self) -> None:
        """Start the scheduler, and wait until it listens."""
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port))
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self._port), 1.0):
                return
            time.sleep(0.1)
        raise TimeoutError("the scheduler does not listen")

    def kill_scheduler(self) -> None:
        assert self.scheduler is not None
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = None

    def start_workers(self, count: int, *, nanny: bool = True) -> None:
        """Start this many workers under one supervisor that restarts them, each with a nanny if requested."""
        command = self._command("worker", self.address, "--nworkers", str(count), "--nthreads", "1")
        command += ["--nanny" if nanny else "--no-nanny", "--host", "127.0.0.1", "--local-directory", str(self._folder)]
        self._workers.append(self._run([sys.executable, "-c", SUPERVISED, *command]))

    def start_odd_worker(self) -> None:
        """Start a worker whose solver reports another engine version."""
        script = "import solver; solver.ENGINE_VERSION = 'odd'; from distributed.cli.dask_worker import main; main()"
        options = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
        options += ["--local-directory", str(self._folder)]
        self._workers.append(self._run([sys.executable, "-c", script, self.address, *options]))

    def close(self) -> None:
        """End all processes of the cluster."""
        for process in (*self._workers, self.scheduler):
            if process is not None:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self._log.close()

    def _start(self, what: str, *options: str) -> "subprocess.Popen[bytes]":
        return self._run(self._command(what, *options))

    @staticmethod
    def _command(what: str, *options: str) -> list[str]:
        return [sys.executable, "-m", f"distributed.cli.dask_{what}", *options, "--no-dashboard"]

    def _run(self, command: list[str]) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            command,
            cwd=ROOT,
            env=self._environment,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


@contextmanager
def dask_cluster(folder: Path, workers: int, **settings: str) -> Iterator[DaskCluster]:
    """Run a cluster; `settings` are environment variables of Dask."""
    cluster = DaskCluster(folder, settings)
    try:
        cluster.start_scheduler()
        if workers:
            cluster.start_workers(workers)
        yield cluster
    finally:
        cluster.close()
