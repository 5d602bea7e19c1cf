"""A service that tests kill, stop and start again with the same data folder."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx

from tests.conftest import START_LIMIT_S

from .data_folder import faults_of
from .processes import kill, processes_of, workers_of

ROOT = Path(__file__).parents[2]
RICOCHET = Path(sys.executable).with_name("ricochet")
STOP_SECONDS = 20.0
JOB_SECONDS = 120.0
JSONL = "application/jsonl"
UNFINISHED = {"accepted", "running"}


class RestartableServer:
    """`ricochet serve` with two workers, as a context manager that leaves no process behind.

    Parameters
    ----------
    folder
        Folder of the log and, unless `data` is given, of the data folder.
    data
        Data folder, by default a subfolder of `folder`.
    cwd
        Working directory of the service and its commands.
    **settings
        Settings of the service, as RICOCHET_ variables in lower case and without the prefix.
    """

    def __init__(self, folder: Path, *, data: Path | None = None, cwd: Path = ROOT, **settings: str) -> None:
        self.data = data or folder / "data"
        self.log = folder / "log"
        self._cwd = cwd
        folder.mkdir(parents=True, exist_ok=True)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port: int = probe.getsockname()[1]
        names = {"host": "127.0.0.1", "port": str(port), "data_dir": str(self.data), "workers": "2"}
        names |= {"log_level": "warning"} | settings
        self.environment = os.environ | {f"RICOCHET_{name.upper()}": value for name, value in names.items()}
        self._process: subprocess.Popen[bytes] | None = None
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False)

    def __enter__(self) -> "RestartableServer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.client.close()
        self.kill()
        for process in processes_of(self.data):
            kill(process)

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def spawn(self) -> None:
        """Start the server without waiting for it."""
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [RICOCHET, "serve"],
                cwd=self._cwd,
                env=self.environment,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def start(self) -> None:
        """Start the server and wait until it is ready."""
        self.spawn()
        self.wait_until("/readyz")

    def wait_until(self, path: str) -> None:
        """Wait until a GET request for this path succeeds."""
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline:
            assert self._process is not None
            assert self._process.poll() is None, self.log.read_text(errors="replace")[-2000:]
            with suppress(httpx.TransportError):
                if self.client.get(path).is_success:
                    return
            time.sleep(0.02)
        raise TimeoutError(path)

    def kill(self) -> None:
        """Kill the server process with SIGKILL, but not its workers."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> None:
        """Stop the server with SIGTERM, and require a clean exit."""
        assert self._process is not None
        self._process.terminate()
        assert self._process.wait(STOP_SECONDS) == 0, self.log.read_text(errors="replace")[-2000:]

    def command(self, *arguments: str) -> str:
        """Run a `ricochet` command with the settings of this service; return its output."""
        return subprocess.run(
            [RICOCHET, *arguments], cwd=ROOT, env=self.environment, capture_output=True, text=True, check=True
        ).stdout

    def workers(self) -> list[int]:
        """Return the process ids of the workers."""
        return workers_of(self.data, self.pid)

    def orphans(self, seconds: float) -> list[int]:
        """Wait up to `seconds` for the processes of a killed server to end; return the ids of those still running."""
        deadline = time.monotonic() + seconds
        while (left := processes_of(self.data)) and time.monotonic() < deadline:
            time.sleep(0.01)
        return left

    def submit(self, body: bytes | Iterator[bytes], token: str = "", path: str = "/cra/batch") -> dict[str, Any]:
        """Submit a batch of JSON lines, optionally with an idempotency key; return the job."""
        headers = {"Content-Type": JSONL, "Prefer": "respond-async"} | ({"Idempotency-Key": token} if token else {})
        job: dict[str, Any] = self.client.post(path, content=body, headers=headers).raise_for_status().json()
        return job

    def job(self, job: dict[str, Any]) -> dict[str, Any]:
        state: dict[str, Any] = self.client.get(job["links"]["self"]).raise_for_status().json()
        return state

    def jobs(self) -> list[dict[str, Any]]:
        """Return the latest jobs, newest first."""
        jobs: list[dict[str, Any]] = self.client.get("/jobs").raise_for_status().json()["jobs"]
        return jobs

    def finished(self, job: dict[str, Any]) -> dict[str, Any]:
        """Wait for the end of a job, at most `JOB_SECONDS`; return its state."""
        deadline = time.monotonic() + JOB_SECONDS
        while job["status"] in UNFINISHED and time.monotonic() < deadline:
            time.sleep(0.03)
            job = self.job(job)
        return job

    def until_done(self, job: dict[str, Any], count: int) -> dict[str, Any]:
        """Wait until this many cases of a job are done, or until it has ended; return its state."""
        while job["status"] in UNFINISHED and job["counts"]["done"] < count:
            time.sleep(0.01)
            job = self.job(job)
        return job

    def results(self, job: dict[str, Any]) -> list[bytes]:
        """Return the results that are ready, as lines of JSON."""
        answer = self.client.get(job["links"]["results"], headers={"Accept": JSONL}).raise_for_status()
        return answer.content.splitlines()

    def computed(self) -> int:
        """Return the number of cases computed, not read from the cache, since the server started."""
        lines = self.client.get("/metrics").raise_for_status().text.splitlines()
        misses = [line for line in lines if line.startswith("ricochet_cases_total") and 'cache="miss"' in line]
        return round(sum(float(line.rpartition(" ")[2]) for line in misses))

    def folder_faults(self) -> list[str]:
        """Return a line for each error in the files or the index of the data folder."""
        return faults_of(self.data, self.command("cache", "stat"))

    def logged_errors(self) -> list[str]:
        """Return the lines of the log that report a failure of the service itself."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [line for line in lines if "Traceback" in line or '"level": "error"' in line]
