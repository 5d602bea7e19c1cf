"""Clients of the soak, each of which asks in its own way, all at the same time."""

import itertools
import random
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import h5py
import orjson

from benchmarks.stress.clients import JSONL
from benchmarks.stress.faults_found import Found
from benchmarks.stress.soak_answers import RESULT, Answers
from benchmarks.stress.soak_session import UNDERWAY, Session
from benchmarks.stress.soak_work import Work, asked, invalid_bodies
from service.schemas.examples import PAPER

LOOK_SECONDS = 0.3
QUERY_SECONDS = 0.1
DOWNLOAD_SECONDS = 5.0
LATEST_CANCEL_SECONDS = 1.0
PAGE = 500
CSV, HDF5 = "text/csv", "application/x-hdf5"
FIRST_QUERY = 20_000_000
"""Search of single queries."""
HOT_OF = 5
"""Single queries: one in so many is a new one, the others are known."""


@dataclass(slots=True)
class Scene:
    """What the clients share.

    Parameters
    ----------
    tokens
        Of the keys of all owners.
    ended
        Jobs that have ended well, with the token of their owner.
    cancelled
        Jobs that were cancelled, likewise, as they were then.
    asked
        What was asked for, by kind.
    """

    url: str
    tokens: list[str]
    found: Found
    answers: Answers
    ended: list[tuple[Work, dict[str, Any], str]] = field(default_factory=list)
    cancelled: list[tuple[Work, dict[str, Any], str]] = field(default_factory=list)
    asked: Counter[str] = field(default_factory=Counter)
    answered: Counter[str] = field(default_factory=Counter)
    numbers: "itertools.count[int]" = field(default_factory=itertools.count)
    over: threading.Event = field(default_factory=threading.Event)

    def session(self, token: str) -> Session:
        """A client of the owner with this token."""
        return Session(self.url, token, self.found, self.answered)


def submit(session: Session, work: Work) -> dict[str, Any]:
    """Make a job; again with the same idempotency key if nobody answered."""
    headers = {"Content-Type": work.media_type, "Prefer": "respond-async", "Idempotency-Key": work.token}
    job: dict[str, Any] = session.ask("POST", work.path, {202}, content=work.body, headers=headers).json()
    return job


def run_job(scene: Scene, token: str, work: Work, way: int) -> None:
    """Make a job and see it to its end: page by page, by its events, or by looking now and then."""
    with scene.session(token) as session:
        job = submit(session, work)
        name, follow = FOLLOWING[way % len(FOLLOWING)]
        follow(scene, session, work, job)
        while (job := session.get(job["links"]["self"]).json())["status"] in UNDERWAY:
            time.sleep(LOOK_SECONDS)
        counts, total = job["counts"], len(work.names)
        scene.found.claim(job["status"] == "successful", f"{work.token} ended {job['status']}")
        scene.found.claim((counts["total"], counts["done"], counts["failed"]) == (total, total, 0), f"counted {counts}")
        scene.ended.append((work, job, token))
        scene.asked[f"jobs {name}"] += 1
        scene.asked["cases of jobs"] += total
        scene.asked["cases of jobs that were known"] += counts["cached"]


def read_pages(scene: Scene, session: Session, work: Work, job: dict[str, Any]) -> None:
    """Read the results while they are made, by cursor."""
    cursor, index = "", 0
    while True:
        answer = session.get(f"{job['links']['results']}?cursor={cursor}&limit={PAGE}").content
        page = orjson.loads(answer)
        index = scene.answers.hold_results(work, [orjson.dumps(item) for item in page["results"]], first=index)
        if "next" not in page:
            break
        if page["next"] == cursor:
            time.sleep(LOOK_SECONDS)
        cursor = page["next"]
    scene.found.claim(index == len(work.names), f"{work.token}: {index} of {len(work.names)} results by cursor")


def follow_events(scene: Scene, session: Session, work: Work, job: dict[str, Any]) -> None:
    """Follow the events to the end."""
    for state in session.events(job["links"]["events"]):
        scene.found.claim(state["counts"]["total"] == len(work.names), f"{work.token}: events of another job")
        scene.asked["events"] += 1


def look_now_and_then(scene: Scene, session: Session, work: Work, job: dict[str, Any]) -> None:
    """Leave it to the one who looks at the end."""


Follow = Callable[[Scene, Session, Work, dict[str, Any]], None]
FOLLOWING: tuple[tuple[str, Follow], ...] = (
    ("read by cursor", read_pages),
    ("followed by events", follow_events),
    ("looked at", look_now_and_then),
)


def query(scene: Scene, token: str) -> None:
    """Ask for single critical angles and histories, most of them known ones, and for files of the latter."""
    with scene.session(token) as session:
        for turn in itertools.count():
            if scene.over.wait(QUERY_SECONDS):
                return
            number = next(scene.numbers)
            name = f"search {FIRST_QUERY + number if turn % HOT_OF == 0 else FIRST_QUERY}"
            answer = session.ask("POST", "/cra", json=asked(name))
            scene.answers.hold(name, answer.content)
            strike = PAPER | {"impact": {"velocity_m_s": 200.0 + 0.25 * (number // HOT_OF), "oblique_angle_deg": 45.0}}
            motion = session.ask("POST", "/trajectory", json=strike)
            scene.answers.hold(f"motion {number // HOT_OF}", motion.content)
            scene.asked["single queries"] += 2
            if turn % HOT_OF == 0:
                read_files(scene, session, motion.json())


def read_files(scene: Scene, session: Session, motion: dict[str, Any]) -> None:
    """Read a result again by its key, in every form."""
    path = f"/results/{motion['key']}"
    rows = len(motion["history"]["time_s"])
    table = session.get(path, CSV)
    scene.found.claim(table.content.count(b"\n") == rows + 1, f"{path} as CSV has other rows")
    with h5py.File(BytesIO(session.get(path, HDF5).content)) as file:
        scene.found.claim(len(file["summary"]) == 1, f"{path} as HDF5 holds {len(file['summary'])} results")
    headers = {"Accept": CSV, "If-None-Match": table.headers["ETag"]}
    session.ask("GET", path, {304}, headers=headers)
    scene.asked["files of results"] += 3


def download(scene: Scene, token: str) -> None:
    """Download the job that has ended last, as CSV and as HDF5 in turn."""
    with scene.session(token) as session:
        for turn in itertools.count():
            mine = [(work, job) for work, job, owner in list(scene.ended) if owner == token]
            if mine:
                work, job = mine[-1]
                count = rows_of(session, job, (CSV, HDF5)[turn % 2])
                scene.found.claim(count == len(work.names), f"{work.token}: {count} results in a download")
                scene.asked["downloads of jobs"] += 1
            if scene.over.wait(DOWNLOAD_SECONDS):
                return


def rows_of(session: Session, job: dict[str, Any], form: str) -> int:
    """Download a job in this form, and count its results."""
    content = session.get(job["links"]["results"], form).content
    if form == CSV:
        return sum(not line.startswith(b"#") for line in content.splitlines()) - 1
    with h5py.File(BytesIO(content)) as file:
        return len(file["summary"])


def send_nonsense(scene: Scene, token: str, seed: int) -> None:
    """Send bodies that do not fit the contract: each is told so."""
    with scene.session(token) as session:
        for path, body in invalid_bodies(seed):
            if scene.over.wait(QUERY_SECONDS):
                return
            headers = {"Content-Type": "application/json"}
            session.ask("POST", path, set(range(400, 500)), content=body, headers=headers)
            scene.asked["invalid bodies"] += 1


def cancel_job(scene: Scene, token: str, work: Work, seed: int) -> None:
    """Make a job and cancel it soon; what is ready of it is there, each case once."""
    dice = random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
    with scene.session(token) as session:
        job = submit(session, work)
        time.sleep(dice.uniform(0.0, LATEST_CANCEL_SECONDS))
        job = session.ask("POST", job["links"]["cancel"]).json()
        scene.found.claim(job["status"] not in UNDERWAY, f"{work.token} goes on though it was cancelled")
        scene.cancelled.append((work, job, token))
        scene.asked["jobs cancelled"] += 1


def read_ended(scene: Scene, session: Session, work: Work, job: dict[str, Any], chosen: dict[str, bytes]) -> None:
    """Read a job once more, long after its end; note the answers to those cases that are chosen."""
    see_unchanged(scene, session, work, job)
    lines = session.get(job["links"]["results"], JSONL).content.splitlines()
    index = scene.answers.hold_results(work, lines)
    scene.found.claim(index == len(work.names), f"{work.token}: {index} of {len(work.names)} results at the end")
    scene.asked["results read at the end"] += index
    for name, line in zip(work.names, lines, strict=False):
        if name in chosen:
            chosen[name] = line.partition(RESULT)[2][:-1]


def read_cancelled(scene: Scene, session: Session, work: Work, job: dict[str, Any]) -> None:
    """Read what was ready of a job when it was cancelled: each case once, in order."""
    see_unchanged(scene, session, work, job)
    lines = session.get(job["links"]["results"], JSONL).content.splitlines()
    told = [orjson.loads(line) for line in lines]
    indices = [item["index"] for item in told]
    scene.found.claim(len(lines) == job["counts"]["done"], f"{work.token}: {len(lines)} results, {job['counts']}")
    scene.found.claim(indices == sorted(set(indices)), f"{work.token}: results out of order")
    right = [work.custom_id(index) for index in indices]
    scene.found.claim([item["custom_id"] for item in told] == right, f"{work.token}: results of other cases")


def see_unchanged(scene: Scene, session: Session, work: Work, job: dict[str, Any]) -> None:
    """See that a job is as it was at its end."""
    again = session.get(job["links"]["self"]).json()
    scene.found.claim(again == job, f"{work.token} changed after its end: {job} became {again}")
