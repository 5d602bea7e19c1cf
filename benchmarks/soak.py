"""Soak test: under a mixed load with kills and restarts, no result is lost or changed, and memory does not grow.

    python benchmarks/soak.py [--minutes 20]

Two owners submit batches and sweeps, partly of cached cases, read them by cursor, by events and as files, cancel jobs,
and send single queries and invalid bodies, all at the same time. In the first half of the time, one after another, the
server is killed, a worker is killed, the server is stopped, and the server is killed and its index removed. In the
second half nothing is disturbed: rounds of load end with a pause, in which memory (without mapped files) and open files
are measured.

Every JSON answer to a case must be the same for every reader and at any time; CSV and HDF5 files must have a row for
each case. At the end every job is read once more, a sample is computed by the solver, and `ricochet cache verify` reads
the files. Exits with 1 if anything was wrong or if, in a run of at least `JUDGED_MINUTES`, memory grew by more than
10 % from the median of the first third of the rounds to the median of the last third. A single round may end while the
C library still holds memory of a download or a chunk, which is not growth; the largest deviation of a round is printed
as well. Needs Linux (/proc).
"""

import argparse
import hashlib
import itertools
import math
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import httpx
import orjson

from benchmarks.clients import JSONL
from benchmarks.machine import print_machine, print_table
from benchmarks.servers import RICOCHET, Server, service
from solver import Search, critical_angle, warm_up
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET

OWNERS = ("anna", "boris")
DISTURBANCES = ("server killed", "worker killed", "server stopped", "index removed")
JUDGED_MINUTES = 10.0
GROWTH = 0.1
MALLOC = {"MALLOC_ARENA_MAX": "2", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""Settings of malloc, the same as in the container image and the systemd unit."""
WARM_UP_SHARE = 0.2
"""Fraction of the undisturbed rounds that are a warm-up; memory is compared from the last of these on. [1]"""
ROUND_SECONDS, SETTLE_SECONDS = 30.0, 3.0
PATIENCE_SECONDS = 120.0
"""Time allowed for an answer while the server restarts on a busy machine. [s]"""
CASES_PER_SECOND = 20
"""Number of cases in a job, per second of the duration of a round."""
NEW_SHARE = 0.4
"""Fraction of the cases in a batch that are new. [1]"""
SAMPLE = 300
PAUSE_SECONDS = 0.1
UNFINISHED = {"accepted", "running"}
MEMORY_CACHE_BYTES = 4 * 1024 * 1024
"""Size of the memory cache. It is so small that the cache is full before memory is compared. [bytes]"""
STRIKE: dict[str, Any] = {
    "projectile": {"nose": {"shape": "ogive", "caliber_radius_head": 3.0}, "diameter_m": 0.08, "length_m": 0.53}
    | {"mass_kg": 13.0},
    "target": {"compressive_strength_pa": 39e6, "density_kg_m3": 2250.0},
}
REFUSED = (
    b"{",
    b"[]",
    b"null",
    b'{"projectile": NaN}',
    b"\xff",
    b"[" * 1000,
    orjson.dumps(STRIKE),
    b'{"impact": 1e999}',
)


def search(number: int) -> dict[str, Any]:
    """Return the request with this number; every fourth one has the default search, the others a rougher one."""
    rough = {"lower_deg": 40.0, "upper_deg": 80.0, "tolerance_deg": 1.0}
    return STRIKE | {"impact": {"velocity_m_s": 230.0 + 1e-3 * number}} | ({"search": rough} if number % 4 else {})


def solve(number: int) -> float | None:
    """Return the critical angle that the solver gives for the request with this number. [rad]"""
    rough = Search(lower=math.radians(40.0), upper=math.radians(80.0), tolerance=math.radians(1.0))
    velocity, chosen = 230.0 + 1e-3 * number, rough if number % 4 else Search()
    return critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=velocity, search=chosen).angle


@dataclass(slots=True)
class Job:
    """A request for a job, the names of its cases in order, and the state of the job."""

    path: str
    body: bytes
    media_type: str
    names: list[str]
    state: dict[str, Any] = field(default_factory=dict)


class Record:
    """Counts, faults, and a digest of the first answer to each case, with which later answers are compared."""

    def __init__(self) -> None:
        self.faults: list[str] = []
        self.counts: Counter[str] = Counter()
        self.digests: dict[str, bytes] = {}
        self.jobs: list[tuple[Owner, Job]] = []
        self._lock = threading.Lock()

    def expect(self, holds: object, fault: str) -> None:
        """Record and print a fault, unless a condition holds."""
        if not holds:
            self.faults.append(fault)
            print(f"fault: {fault}", file=sys.stderr)

    def compare(self, name: str, answer: Any) -> None:
        """Compare an answer with the first one for the same case."""
        text = orjson.dumps(answer, option=orjson.OPT_SORT_KEYS)
        digest = hashlib.blake2b(text, digest_size=16).digest()
        with self._lock:
            self.expect(self.digests.setdefault(name, digest) == digest, f"{name} has two answers")

    def compare_results(self, job: Job, results: list[dict[str, Any]], first: int = 0) -> int:
        """Compare results of a job, which must have each case once and in order; return the next index."""
        for index, result in enumerate(results, first):
            in_place = result["index"] == index and "result" in result
            self.expect(in_place, f"{job.path}: result {result['index']} in place of {index}, {sorted(result)}")
            if index < len(job.names):
                self.compare(job.names[index], result.get("result"))
        return first + len(results)


class Owner:
    """A client with an API key. It repeats requests that are not answered, or are answered with 429 or 503.

    Parameters
    ----------
    number
        Number of the owner, which makes its cases and choices differ from those of other owners.
    """

    def __init__(self, url: str, token: str, number: int, cases: int, record: Record) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        self.client = httpx.Client(base_url=url, headers=headers, timeout=60.0, trust_env=False)
        self.record, self.cases = record, cases
        self._choice = random.Random(number)  # noqa: S311
        self._first, self._new = 1_000_000 * number, 0
        self._number, self._sweeps = number, 0

    def send(self, method: str, path: str, expected: frozenset[int] = frozenset({200}), **more: Any) -> httpx.Response:
        """Repeat a request until its status is neither 429 nor 503. Any other status not in `expected` is a fault."""
        deadline = time.monotonic() + PATIENCE_SECONDS
        while time.monotonic() < deadline:
            with suppress(httpx.TransportError):
                answer = self.client.request(method, path, **more)
                if answer.status_code not in {429, 503}:
                    said = f"{method} {path} answered {answer.status_code}: {answer.content[:200]!r}"
                    self.record.expect(answer.status_code in expected, said)
                    return answer
            time.sleep(PAUSE_SECONDS)
        raise TimeoutError(f"{method} {path}")

    def get(self, path: str, accept: str = "application/json") -> httpx.Response:
        """Request a resource in the media type `accept`."""
        return self.send("GET", path, headers={"Accept": accept})

    def batch(self) -> Job:
        """Return a batch of new and cached critical angles in random order."""
        known = min(self._new, round(self.cases * (1.0 - NEW_SHARE)))
        new = range(self._new, self._new + self.cases - known)
        numbers = [*self._choice.sample(range(self._new), known), *new]
        self._choice.shuffle(numbers)
        self._new = new.stop
        numbers = [self._first + number for number in numbers]
        body = b"".join(orjson.dumps(search(number)) + b"\n" for number in numbers)
        return Job("/cra/batch", body, JSONL, [f"search {number}" for number in numbers])

    def sweep(self) -> Job:
        """Return a sweep over velocity and angle; every second one repeats the previous one."""
        number, count = self._sweeps // 2, max(1, self.cases // 20)
        self._sweeps += 1
        target = STRIKE["target"] | {"compressive_strength_pa": 35e6 + 1e4 * (2 * number + self._number % 2)}
        angles = [55.0 + 1.25 * column for column in range(20)]
        velocities = [200.0 + 150.0 * row / count for row in range(count)]
        impact = {"velocity_m_s": 200.0, "oblique_angle_deg": 55.0}
        axes = [{"field": "impact.velocity_m_s", "values": velocities}]
        axes += [{"field": "impact.oblique_angle_deg", "values": angles}]
        body = orjson.dumps({"base": STRIKE | {"target": target, "impact": impact}, "axes": axes})
        names = [f"sweep {self._number} {number} {index}" for index in range(20 * count)]
        return Job("/trajectory/sweep", body, "application/json", names)

    def submit(self, job: Job) -> None:
        """Submit a job with an idempotency key, so that a repeated request returns the same job."""
        token = f"{self._number}-{next(tokens)}"
        headers = {"Content-Type": job.media_type, "Prefer": "respond-async", "Idempotency-Key": token}
        job.state = self.send("POST", job.path, frozenset({202}), content=job.body, headers=headers).json()
        self.record.jobs.append((self, job))

    def wait(self, job: Job) -> None:
        """Poll the state of a job until it has ended."""
        while job.state["status"] in UNFINISHED:
            time.sleep(3 * PAUSE_SECONDS)
            job.state = self.get(job.state["links"]["self"]).json()

    def read_pages(self, job: Job) -> None:
        """Read and compare results by cursor while they are computed."""
        cursor, index = "", 0
        while True:
            page = self.get(f"{job.state['links']['results']}?cursor={cursor}&limit=500").json()
            index = self.record.compare_results(job, page["results"], index)
            if "next" not in page:
                break
            if page["next"] == cursor:
                time.sleep(3 * PAUSE_SECONDS)
            cursor = page["next"]
        self.record.expect(index == len(job.names), f"{index} of {len(job.names)} results by cursor")

    def read_events(self, job: Job) -> None:
        """Read the events of a job until the stream ends, and count them."""
        path, headers = job.state["links"]["events"], {"Accept": "text/event-stream"}
        with suppress(httpx.TransportError), self.client.stream("GET", path, headers=headers) as stream:
            self.record.counts["events"] += sum(line.startswith("data:") for line in stream.iter_lines())

    def read_lines(self, job: Job) -> list[dict[str, Any]]:
        """Read, as JSON lines, all results that are ready."""
        content = self.get(job.state["links"]["results"], JSONL).content
        return [orjson.loads(line) for line in content.splitlines()]

    def read_files(self, job: Job) -> None:
        """Download a finished job as CSV and as HDF5, and check the number of rows."""
        path = job.state["links"]["results"]
        table = self.get(path, "text/csv").text
        rows = sum(not line.startswith("#") for line in table.splitlines()) - 1
        with h5py.File(BytesIO(self.get(path, "application/x-hdf5").content)) as file:
            found = rows, len(file["summary/index"])
        self.record.expect(found == (len(job.names),) * 2, f"{found} rows for {len(job.names)} cases")

    def run_jobs(self, stop: threading.Event) -> None:
        """Run batches and sweeps in turn, follow each in one of three ways in turn, and cancel every third job."""
        follow: Iterator[Callable[[Job], None]] = itertools.cycle([self.read_pages, self.read_events, self.wait])
        while not stop.is_set():
            for job in (self.batch(), self.sweep()):
                self.submit(job)
                next(follow)(job)
                self.wait(job)
                counts, total = job.state["counts"], len(job.names)
                complete = (counts["total"], counts["done"], counts["failed"]) == (total, total, 0)
                self.record.expect(job.state["status"] == "successful" and complete, f"job ended {job.state}")
                self.record.counts["cases of jobs"] += total
                self.read_files(job)
            self.cancel()

    def cancel(self) -> None:
        """Submit a batch and cancel it after a random time of up to a second."""
        job = self.batch()
        self.submit(job)
        time.sleep(self._choice.uniform(0.0, 1.0))
        job.state = self.send("POST", job.state["links"]["cancel"]).json()
        self.record.expect(job.state["status"] not in UNFINISHED, "a cancelled job goes on")
        self.record.counts["jobs cancelled"] += 1

    def query(self, stop: threading.Event) -> None:
        """Send single queries (most of them cached), read histories by their key, and send invalid bodies."""
        for turn in itertools.count():
            if stop.wait(PAUSE_SECONDS):
                return
            number = self._first + 500_000 + (turn if turn % 5 == 0 else 0)
            self.record.compare(f"search {number}", self.send("POST", "/cra", json=search(number)).json())
            impact = {"velocity_m_s": 200.0 + 0.25 * (turn // 5), "oblique_angle_deg": 45.0}
            answer = self.send("POST", "/trajectory", json=STRIKE | {"impact": impact}).json()
            self.record.compare(f"trajectory {turn // 5}", answer)
            self.record.counts["single queries"] += 2
            self.get(f"/results/{answer['key']}", ("text/csv", "application/x-hdf5")[turn % 2])
            headers = {"Content-Type": "application/json"}
            body = REFUSED[turn % len(REFUSED)]
            self.send("POST", "/cra", frozenset({400, 422}), content=body, headers=headers)
            self.record.counts["bodies refused"] += 1


tokens = itertools.count()


def processes_of(data: Path) -> dict[int, int]:
    """Return the processes of the service with this data folder, and their parents."""
    found = {}
    for path in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):  # It has ended, or belongs to another user.
            if f"RICOCHET_DATA_DIR={data}".encode() in (path / "environ").read_bytes().split(b"\0"):
                found[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
    return found


def footprint(data: Path, server: int) -> tuple[float, float, int]:
    """Return the memory, without mapped files, of the server and of all processes [MiB], and the open files."""
    sizes, files = Counter[int](), 0
    for process in processes_of(data):
        with suppress(OSError):
            lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
            own = (line for line in lines if line.startswith(("Pss_Anon:", "Pss_Shmem:", "SwapPss:")))
            sizes[process] = sum(int(line.split()[1]) for line in own)
            files += len(list(Path(f"/proc/{process}/fd").iterdir()))
    return sizes[server] / 1024.0, sizes.total() / 1024.0, files


def disturb(server: Server, data: Path, choice: random.Random, record: Record, kind: str) -> None:
    """Disturb the service in one of the ways in `DISTURBANCES`, and restart the server if that ended it."""
    record.counts[kind] += 1
    if kind == "worker killed":
        parents = processes_of(data)
        workers = [process for process, parent in parents.items() if parents.get(parent) == server.pid]
        if workers:
            with suppress(ProcessLookupError):
                os.kill(choice.choice(workers), signal.SIGKILL)
        return
    if kind == "server stopped":
        record.expect(server.stop() == 0, "the server did not stop with status 0")
    else:
        server.kill()
    deadline = time.monotonic() + 10.0
    while (left := processes_of(data)) and time.monotonic() < deadline:
        time.sleep(0.05)
    record.expect(not left, "a process outlived the server")
    if kind == "index removed":
        for path in (data / "results").glob("index.sqlite*"):
            path.unlink()
    server.start()


def run_round(owners: list[Owner], seconds: float, disturbances: list[Callable[[], None]]) -> None:
    """Load the service for a time, with these disturbances at random instants."""
    stop = threading.Event()
    with ThreadPoolExecutor(2 * len(owners)) as threads:
        running = [threads.submit(task, stop) for owner in owners for task in (owner.run_jobs, owner.query)]
        try:
            for disturbance in disturbances:
                time.sleep(random.uniform(0.0, seconds / len(disturbances)))  # noqa: S311
                disturbance()
            time.sleep(0.0 if disturbances else seconds)
        finally:
            stop.set()
        for each in running:
            each.result()


def misses(owner: Owner) -> float:
    """Return the number of cases that were computed, not read from the cache, since the server started."""
    lines = owner.get("/metrics").text.splitlines()
    found = [line for line in lines if line.startswith("ricochet_cases_total") and 'cache="miss"' in line]
    return sum(float(line.split()[-1]) for line in found)


def read_everything(owners: list[Owner], record: Record) -> None:
    """Read every job once more, check that no job is missing or new, and compare a sample with the solver."""
    before = misses(owners[0])
    for owner, job in record.jobs:
        state = owner.get(job.state["links"]["self"]).json()
        record.expect(state == job.state, f"a job changed after its end: {job.state} to {state}")
        results = owner.read_lines(job)
        record.expect(len(results) == job.state["counts"]["done"], f"{len(results)} results, {job.state['counts']}")
        if job.state["status"] == "successful":
            record.compare_results(job, results)
        indices = [result["index"] for result in results]
        record.expect(indices == sorted(set(indices)), "results out of order")
    for owner in owners:
        listed = {job["id"] for job in owner.get("/jobs?limit=1000").json()["jobs"]}
        made = {job.state["id"] for other, job in record.jobs if other is owner}
        record.expect(listed == made, f"{len(listed)} jobs listed, {len(made)} made")
    names = sorted(name for name in record.digests if name.startswith("search"))
    for name in random.Random(0).sample(names, min(SAMPLE, len(names))):  # noqa: S311
        number = int(name.split()[1])
        found, angle = owners[0].send("POST", "/cra", json=search(number)).json(), solve(number)
        record.compare(name, found)
        degrees = found.get("critical_angle_deg")
        same = angle is not None and math.isclose(degrees or 0.0, math.degrees(angle), rel_tol=1e-15)
        record.expect(same or degrees is angle is None, f"{name} is {degrees}° over HTTP and {angle} rad without it")
    record.expect(misses(owners[0]) == before, "results were lost and computed again")


def run(folder: Path, minutes: float, record: Record) -> list[tuple[float, float, int]]:
    """Load the service with disturbances, then without, and read everything again; return the footprints."""
    half, data = 30.0 * minutes, folder / "data"
    seconds = min(ROUND_SECONDS, half / 3.0)
    environment = os.environ | {"RICOCHET_DATA_DIR": str(data)}
    make = [str(RICOCHET), "keys", "add", "--owner"]
    keys = [subprocess.check_output([*make, owner], env=environment, text=True).strip() for owner in OWNERS]
    settings = {"memory_cache_bytes": str(MEMORY_CACHE_BYTES), "audit_log": str(folder / "audit.log")}
    kinds, choice, prints = itertools.cycle(DISTURBANCES), random.Random(0), list[tuple[float, float, int]]()  # noqa: S311
    with service(folder, **settings) as server:
        cases = max(20, round(CASES_PER_SECOND * seconds))
        owners = [Owner(server.url, key, number, cases, record) for number, key in enumerate(keys, 1)]
        disturbed = partial(disturb, server, data, choice, record)
        begin = time.monotonic()
        while time.monotonic() - begin < half:
            run_round(owners, seconds, [partial(disturbed, next(kinds)) for _ in range(2)])
        while time.monotonic() - begin < 2.0 * half or len(prints) < 2:
            run_round(owners, seconds, [])
            time.sleep(SETTLE_SECONDS)
            prints.append(footprint(data, server.pid))
        read_everything(owners, record)
        record.expect(server.stop() == 0, "the server did not stop with status 0")
        log = server.log.read_text(errors="replace")
    record.expect("Traceback" not in log and '"level": "error"' not in log, "the log has errors")
    verified = subprocess.run([RICOCHET, "cache", "verify"], env=environment, capture_output=True, check=False)
    record.expect(verified.returncode == 0, f"cache verify: {verified.stdout!r}")
    return prints


def growth(sizes: list[float]) -> float:
    """Return the relative growth from the median of the first third to the median of the last third. [1]"""
    third = max(1, len(sizes) // 3)
    return statistics.median(sizes[-third:]) / statistics.median(sizes[:third]) - 1.0


def main() -> int:
    parser = argparse.ArgumentParser(description="Test the service under load, kills and restarts.")
    parser.add_argument("--minutes", type=float, default=20.0)
    options = parser.parse_args()
    print_machine()
    os.environ.update(MALLOC)
    warm_up()
    record = Record()
    with tempfile.TemporaryDirectory() as folder:
        prints = run(Path(folder), options.minutes, record)
    warm = prints[max(0, round(WARM_UP_SHARE * len(prints)) - 1) :]
    judged, worst = options.minutes >= JUDGED_MINUTES, 0.0
    rows: list[tuple[str, object]] = [*sorted(record.counts.items()), ("different cases", len(record.digests))]
    for what, sizes in (("server", [each[0] for each in warm]), ("server and workers", [each[1] for each in warm])):
        farthest, grown = max(abs(size / sizes[0] - 1.0) for size in sizes), growth(sizes)
        worst = max(worst, grown)
        said = f"{sizes[0]:.0f} MiB, {sizes[-1]:.0f} at the end, growth {grown:+.1%}, farthest {farthest:.1%}"
        rows += [(f"memory, {what}", said)]
    rows += [("open files", f"{warm[0][2]}, {warm[-1][2]} at the end"), ("faults", len(record.faults))]
    if not judged:
        rows += [("too short to judge memory", "")]
    print_table([f"{options.minutes:g} minutes, {len(warm)} rounds after the warm-up", ""], rows)
    return 1 if record.faults or (judged and worst > GROWTH) else 0


if __name__ == "__main__":
    sys.exit(main())
