"""Each system call that changes the data folder is made to fail, or the service is killed during the call.

A preloaded library counts the calls of the C library that open, write, flush, truncate, rename, link or remove a file
or make a folder. Requests and answers before and after a restart are recorded. Every acknowledged case must be
answered once, with the same bytes as by an undisturbed service.
"""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from service.cache.maintenance import stat
from tests.conftest import free_port

from .cases import jsonl, searches
from .data_folder import faults_of
from .server import JSONL, ROOT, UNFINISHED

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD"),
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
]
CASES = 24
KILLED, TORN = -1, -2
FAULTS = {"killed before": KILLED, "killed amid": TORN, "input/output error": errno.EIO, "disk full": errno.ENOSPC}
EXAMPLES = 8
"""Approximate number of calls that are made to fail, evenly distributed, in the test that does not try every call."""
START_SECONDS, JOB_SECONDS, STOP_SECONDS = 30.0, 60.0, 20.0
REFUSALS = {500, 503, 507}
"""Error statuses that an answer may have after a failed call."""
IDEMPOTENCY_KEY = "batch"
EXAMPLES_ONLY = pytest.param(False, id="examples", marks=pytest.mark.timeout(300))
EVERY = pytest.param(True, id="every", marks=[pytest.mark.slow, pytest.mark.timeout(3600)])


@dataclass(frozen=True)
class Exchange:
    """Name of a request, and status and body of its answer; the status is None if the connection broke."""

    name: str
    status: int | None
    content: bytes = b""
    cached: bool = False
    """Whether the answer came from the cache."""


@dataclass
class Forks:
    """Starts services one after another, each as a fork of a process that has preloaded the library."""

    process: subprocess.Popen[str]
    folder: Path
    numbers: int = field(default=0)

    @contextmanager
    def service(self, data: Path, number: int = 0, fault: int = 0) -> Iterator["Service"]:
        """Run a service in which call `number` has the fault `fault`, one of `FAULTS`; 0 is none. Stop it on exit."""
        self.numbers += 1
        order = {name: str(self.folder / f"{self.numbers}.{name}") for name in ("log", "count")}
        port = free_port()
        settings = {"data": str(data), "port": port, "number": number, "fault": fault}
        print(json.dumps(order | settings), file=self.process.stdin)
        assert self.process.stdin is not None
        self.process.stdin.flush()
        service = Service(int(self._line()), port, Path(order["log"]), Path(order["count"]))
        try:
            yield service
        finally:
            with suppress(ProcessLookupError):
                os.kill(service.pid, signal.SIGTERM)
            service.status = int(self._line())
            service.client.close()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()


@dataclass
class Service:
    """A service on a port of this machine."""

    pid: int
    port: int
    log: Path
    count: Path
    status: int | None = None

    def __post_init__(self) -> None:
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=JOB_SECONDS, trust_env=False)

    @property
    def is_running(self) -> bool:
        """Whether the process is running; a zombie is not."""
        with suppress(OSError):
            return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        return False

    @property
    def calls(self) -> int:
        """Number of counted calls, available after the service has ended normally."""
        return int(self.count.read_text())

    def exchange(self, name: str, method: str, path: str, **request: object) -> Exchange:
        """Send a request; return its name and answer."""
        try:
            answer = self.client.request(method, path, **request)  # type: ignore[arg-type]
        except httpx.TransportError:
            return Exchange(name, None)
        cached = answer.headers.get("Cache-Status", "").endswith("; hit")
        return Exchange(name, answer.status_code, answer.content, cached)

    def session(self) -> list[Exchange]:
        """Send a query and a batch, follow the batch to its end, read its results, and send another query."""
        deadline = time.monotonic() + START_SECONDS
        while self.exchange("alive", "GET", "/livez").status is None:
            if not self.is_running or time.monotonic() > deadline:
                return []
            time.sleep(0.01)
        first, *cases, last = searches(CASES + 2)
        history = [self.exchange("first", "POST", "/cra", json=first)]
        headers = {"Content-Type": JSONL, "Prefer": "respond-async", "Idempotency-Key": IDEMPOTENCY_KEY}
        history.append(self.exchange("batch", "POST", "/cra/batch", content=jsonl(cases), headers=headers))
        if history[-1].status in {200, 202}:
            path = json.loads(history[-1].content)["links"]["self"]
            history += self.follow(path)
            history.append(self.exchange("results", "GET", f"{path}/results", headers={"Accept": JSONL}))
        history.append(self.exchange("last", "POST", "/cra", json=last))
        return history

    def follow(self, path: str) -> list[Exchange]:
        """Follow a job to its end, or until the connection breaks."""
        deadline = time.monotonic() + JOB_SECONDS
        while time.monotonic() < deadline:
            job = self.exchange("job", "GET", path)
            if job.status != 200 or json.loads(job.content)["status"] not in UNFINISHED:
                return [job]
            time.sleep(0.01)
        raise TimeoutError(path)


@pytest.fixture(scope="module")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    folder = tmp_path_factory.mktemp("calls")
    shim = folder / "nth_call.so"
    source = Path(__file__).with_name("nth_call.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(shim), str(source), "-ldl"], check=True)  # noqa: S607
    command = [sys.executable, "-m", "tests.faults.nth_call_server"]
    environment = os.environ | {"LD_PRELOAD": str(shim)}
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield Forks(process, folder)
        assert process.stdin is not None
        process.stdin.close()


@pytest.fixture(scope="module")
def undisturbed(forks: Forks, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], int]:
    """Answers of a service without faults, by name of the request, and the number of calls that were counted in it."""
    with forks.service(tmp_path_factory.mktemp("undisturbed") / "data") as service:
        history = service.session()
    assert service.status == 0, service.log.read_text()
    assert [exchange.status for exchange in history] == [200, 202, 200, 200, 200]
    return {exchange.name: exchange.content for exchange in history}, service.calls


@pytest.mark.parametrize("every", [EXAMPLES_ONLY, EVERY])
@pytest.mark.parametrize("name", FAULTS)
def test_fault_of_the_nth_call_loses_no_acknowledged_case(
    name: str, every: bool, forks: Forks, undisturbed: tuple[dict[str, bytes], int], tmp_path: Path
) -> None:
    expected, calls = undisturbed
    assert calls > 50
    numbers = range(1, calls + 1) if every else range(1 + len(name) % 5, calls + 1, calls // EXAMPLES)
    found, reached = [], 0
    for number in numbers:
        data = tmp_path / f"{number}"
        first, wrong = check(forks, data, number, FAULTS[name], expected)
        reached += first.status == -signal.SIGKILL or (first.count.exists() and first.calls >= number)
        found += [f"call {number}: {text}" for text in wrong]
        shutil.rmtree(data, ignore_errors=True)
    print(f"{reached} of {len(numbers)} calls failed")  # noqa: T201
    assert found == []
    assert reached > 0.8 * len(numbers)  # The number of calls varies a little, because timers cause some.


def check(forks: Forks, data: Path, number: int, fault: int, expected: dict[str, bytes]) -> tuple[Service, list[str]]:
    """Run a session with a fault and, after a restart, one without; return the first service and all errors found."""
    with forks.service(data, number, fault) as first:
        before = first.session()
    with forks.service(data) as second:
        after = second.session()
        listed = second.exchange("jobs", "GET", "/jobs")
    wrong = [f"after the restart: {each.name} is {each.status}" for each in after if each.status not in {200, 202}]
    if fault > 0 and first.status not in {0, 3}:
        wrong.append(f"the service ended in {first.status}: {first.log.read_text()[-1500:]}")
    if second.status != 0 or not after:
        wrong.append(f"it did not start again or ended in {second.status}: {second.log.read_text()[-1500:]}")
        return first, wrong
    wrong += disagreements(before, expected, "before") + disagreements(after, expected, "after")
    jobs = {
        json.loads(each.content)["id"]
        for each in before + after
        if each.name == "batch" and each.content[:1] == b"{" and each.status in {200, 202}
    }
    if len(jobs) != 1 or [job["id"] for job in json.loads(listed.content)["jobs"]] != list(jobs):
        wrong.append(f"the batch became the jobs {jobs}, and there are {listed.content!r}")
    wrong += losses(before, after)
    there = stat(data)
    return first, wrong + faults_of(data, f"{there.cases} results, {there.segments} files,")


def losses(before: list[Exchange], after: list[Exchange]) -> list[str]:
    """Return a line for everything that was acknowledged before the restart and is missing after it."""
    later = {each.name: each for each in after}
    wrong = [
        f"the result of {each.name} was acknowledged as stored, and computed again"
        for each in before
        if each.name in {"first", "last"} and each.status == 200 and b"result_not_cached" not in each.content
        if not later[each.name].cached
    ]
    for each in before:
        if each.name == "results" and each.status == 200:
            lost = set(each.content.splitlines()) - set(later["results"].content.splitlines())
            wrong += [f"{len(lost)} results of the job are gone after the restart"] if lost else []
        if each.name == "job" and each.status == 200 and (job := json.loads(each.content))["status"] == "failed":
            wrong += [] if job.get("problem", {}).get("detail") else ["the job failed without a reason"]
    return wrong


def disagreements(history: list[Exchange], expected: dict[str, bytes], when: str) -> list[str]:
    """Return a line for each answer that is neither an allowed refusal nor equal to the undisturbed answer."""
    wrong = []
    failed = any(each.name == "job" and json.loads(each.content or b"{}").get("status") == "failed" for each in history)
    for each in history:
        if each.status is None or each.name in {"batch", "job"}:
            continue
        if each.status in REFUSALS:
            continue
        content = each.content
        if each.name == "results":
            lines, whole = content.splitlines(), expected["results"].splitlines()
            if lines != whole and not (failed and len(set(lines)) == len(lines) and set(lines) <= set(whole)):
                wrong.append(f"{when}: {len(lines)} results, of which {len(set(lines) & set(whole))} are right")
        elif content != expected[each.name] and b"result_not_cached" not in content:
            wrong.append(f"{when}: {each.name} is {each.status} {content[:300]!r}")
    return wrong
