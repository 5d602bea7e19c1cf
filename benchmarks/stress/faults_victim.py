"""A service that is killed, started again on the same folder, and looked at from outside."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx

ROOT = Path(__file__).parents[2]
WORKERS = 2
START_SECONDS = 120.0
"""For a server to be ready; the first ever on a machine compiles the solver."""
STOP_SECONDS = 20.0
JOB_SECONDS = 120.0
"""For a job to end."""
BUSY_SECONDS = 0.3
"""In which a process that computes gets some of the processor, on a busy machine too, and one that waits takes none."""
JSONL = "application/jsonl"
UNDERWAY = {"accepted", "running"}


class Victim:
    """A server with a folder of its own. A context manager, which leaves no process behind.

    Parameters
    ----------
    folder
        For the log and, if it is not said otherwise, the data.
    data
        Data folder.
    settings
        Of the service.
    """

    def __init__(self, folder: Path, *, data: Path | None = None, **settings: str) -> None:
        self.data = data or folder / "data"
        self.log = folder / "log"
        folder.mkdir(parents=True, exist_ok=True)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port: int = probe.getsockname()[1]
        names = {"host": "127.0.0.1", "port": str(port), "data_dir": str(self.data), "workers": str(WORKERS)}
        names |= {"log_level": "warning"} | settings
        self._settings = {f"RICOCHET_{name.upper()}": value for name, value in names.items()}
        self._process: subprocess.Popen[bytes] | None = None
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False)

    def __enter__(self) -> "Victim":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.client.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        for process in self.processes():
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)

    @property
    def pid(self) -> int:
        """Process id of the server."""
        if self._process is None:
            raise RuntimeError("the server was not started")
        return self._process.pid

    def spawn(self) -> None:
        """Start the server, without waiting for it."""
        command = [sys.executable, "-m", "service.cli", "serve"]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                command, cwd=ROOT, env=os.environ | self._settings, stdout=log, stderr=subprocess.STDOUT
            )

    def start(self) -> None:
        """Start the server; return when it is ready.

        Raises
        ------
        RuntimeError
            If it ends instead.
        """
        self.spawn()
        self.wait_until("/readyz")

    def wait_until(self, path: str) -> None:
        """Wait until this path is answered well."""
        deadline = time.monotonic() + START_SECONDS
        while time.monotonic() < deadline:
            if self._process is None or self._process.poll() is not None:
                raise RuntimeError(f"the server has ended: {self.log.read_text(errors='replace')[-2000:]}")
            with suppress(httpx.TransportError):
                if self.client.get(path).is_success:
                    return
            time.sleep(0.02)
        raise RuntimeError(f"{path} is not answered")

    def kill(self) -> None:
        """End the server process as a crash would: with nothing said, and its workers left to themselves."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> int:
        """End the server as an operator would; return its exit status."""
        if self._process is None:
            return 0
        self._process.terminate()
        return self._process.wait(STOP_SECONDS)

    def processes(self) -> list[int]:
        """All processes of this service that run, whoever their parent is now."""
        mark = f"RICOCHET_DATA_DIR={self.data}".encode()
        return [process for process in _all_processes() if mark in _environment(process)]

    def workers(self) -> list[int]:
        """Processes that compute: children of the fork server, which is a child of the server."""
        parents = {process: _parent(process) for process in self.processes()}
        return [process for process, parent in parents.items() if parents.get(parent) == self.pid]

    def busy(self, workers: Sequence[int]) -> bool:
        """Tell whether these processes compute."""
        workers = [process for process in workers if process in self.processes()]
        before = sum(map(_ticks, workers))
        time.sleep(BUSY_SECONDS)
        return sum(map(_ticks, workers)) > before

    def orphans(self, seconds: float) -> list[int]:
        """Processes of a server that has been killed which are still there after this time."""
        deadline = time.monotonic() + seconds
        while (left := self.processes()) and time.monotonic() < deadline:
            time.sleep(0.01)
        return left

    def submit(self, body: bytes | Iterator[bytes], token: str = "", path: str = "/cra/batch") -> dict[str, Any]:
        """Send a batch of JSON lines; return its job."""
        headers = {"Content-Type": JSONL, "Prefer": "respond-async"} | ({"Idempotency-Key": token} if token else {})
        job: dict[str, Any] = self.client.post(path, content=body, headers=headers).raise_for_status().json()
        return job

    def job(self, job: dict[str, Any]) -> dict[str, Any]:
        """The job as it is now."""
        state: dict[str, Any] = self.client.get(job["links"]["self"]).raise_for_status().json()
        return state

    def jobs(self) -> list[dict[str, Any]]:
        """The latest jobs."""
        jobs: list[dict[str, Any]] = self.client.get("/jobs").raise_for_status().json()["jobs"]
        return jobs

    def finished(self, job: dict[str, Any]) -> dict[str, Any]:
        """The job at its end, or as it is when it does not come to one."""
        deadline = time.monotonic() + JOB_SECONDS
        while job["status"] in UNDERWAY and time.monotonic() < deadline:
            time.sleep(0.03)
            job = self.job(job)
        return job

    def until_done(self, job: dict[str, Any], count: int) -> dict[str, Any]:
        """The job when so many of its cases are done, or it has ended."""
        while job["status"] in UNDERWAY and job["counts"]["done"] < count:
            time.sleep(0.01)
            job = self.job(job)
        return job

    def results(self, job: dict[str, Any]) -> list[bytes]:
        """Results that are there, as they are sent: a line of JSON each."""
        answer = self.client.get(job["links"]["results"], headers={"Accept": JSONL}).raise_for_status()
        return answer.content.splitlines()

    def computed(self) -> int:
        """Cases whose answer was made since the server started."""
        lines = self.client.get("/metrics").raise_for_status().text.splitlines()
        made = [line for line in lines if line.startswith("ricochet_cases_total") and 'cache="miss"' in line]
        return round(sum(float(line.rpartition(" ")[2]) for line in made))

    def complaints(self) -> list[str]:
        """Lines of the log that tell of failures of the service itself."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [line for line in lines if "Traceback" in line or '"level": "error"' in line]


def _all_processes() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]


def _environment(process: int) -> list[bytes]:
    with suppress(OSError):  # it has ended, or belongs to somebody else
        return Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    return []


def _parent(process: int) -> int:
    status = _status(process)
    return int(status[1]) if status else 0


def _ticks(process: int) -> int:
    """Processor time it has taken, in hundredths of a second."""
    status = _status(process)
    return int(status[11]) + int(status[12]) if status else 0


def _status(process: int) -> list[str]:
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return []
