"""Hours of mixed load in minutes: what many clients ask at the same time, while server and workers are killed.

First come the rough rounds: in each of them a worker is killed, the server is killed or stopped and started again, or
the index is lost. Then the calm ones, without a restart: after each of them the clients leave, and memory and open
files are looked at when the service has been idle for some seconds.
"""

import itertools
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.stress.faults_folder import faults_of
from benchmarks.stress.faults_found import Found
from benchmarks.stress.faults_losses import lose_index
from benchmarks.stress.faults_victim import UNDERWAY, Victim
from benchmarks.stress.lines import Line
from benchmarks.stress.soak_answers import Answers, is_right
from benchmarks.stress.soak_clients import (
    Scene,
    cancel_job,
    download,
    query,
    read_cancelled,
    read_ended,
    run_job,
    send_nonsense,
)
from benchmarks.stress.soak_footprint import Footprint, footprint
from benchmarks.stress.soak_lines import as_lines, not_measured
from benchmarks.stress.soak_work import Mix
from service.access.key import make_key
from service.access.keyring import add_key

OWNERS = ("anna", "boris")
MEMORY_CACHE_BYTES = 4 * 1024 * 1024
"""Full before the memory is looked at: some hundred histories."""
GONE_SECONDS = 10.0
"""For workers to follow their server: they give way to all else on a machine that is busy."""
MOST_JOBS = 1_000
"""That the service lists."""
Hurt = Callable[[Victim, random.Random, Found], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """How much to ask for.

    Parameters
    ----------
    rough, calm
        Rounds.
    cases
        Of a job; in each round every owner has a batch and a sweep.
    hurts
        In a rough round.
    idle
        Before memory and open files are looked at. [s]
    sample
        Answers that are computed anew.
    """

    rough: int
    calm: int
    cases: int
    hurts: int
    idle: float
    sample: int


QUICK = Sizes(rough=2, calm=3, cases=60, hurts=2, idle=0.5, sample=20)
FULL = Sizes(rough=24, calm=25, cases=1_050, hurts=2, idle=3.0, sample=500)


def measure_soak(sizes: Sizes) -> list[Line]:
    """Line 11."""
    if not Path("/proc/self/smaps_rollup").exists():
        return [not_measured()]
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, beginning(Path(folder)) as (victim, tokens):
        found = Found()
        scene = Scene(str(victim.client.base_url), tokens, found, Answers(found))
        mix = Mix(sizes.cases)
        play_rough(victim, scene, mix, sizes)
        before = scene.asked["cases of jobs"]
        calm = play_calm(victim, scene, mix, sizes)
        calm_cases = scene.asked["cases of jobs"] - before
        sampled = see_the_end(victim, scene, sizes.sample)
        found.faults += victim.complaints()
    details = {
        "asked": dict(scene.asked),
        "answered": dict(scene.answered),
        "calm_cases": calm_cases,
        "different_cases": len(scene.answers),
        "computed_anew": sampled,
        "seconds": time.monotonic() - begin,
        "footprints": [asdict(each) for each in calm],
    }
    return as_lines(found, details, calm)


def play_rough(victim: Victim, scene: Scene, mix: Mix, sizes: Sizes) -> None:
    """The rounds in which the service is hurt, at any instant; behind them it is started once more."""
    dice, kinds = random.Random(0), itertools.cycle(HURTS)  # noqa: S311 (nothing is to be kept secret)
    typical = 1.0
    for number in range(sizes.rough):
        begin = time.monotonic()
        with clients(scene, number):
            jobs = begin_jobs(scene, mix, number)
            for kind in itertools.islice(kinds, sizes.hurts):
                time.sleep(dice.uniform(0.0, typical / sizes.hurts))
                hurt(victim, kind, dice, scene.found)
            for job in jobs:
                job.result()
        typical = time.monotonic() - begin
        tell(scene, f"rough round {number + 1}, {typical:.1f} s")
    if sizes.rough:
        stop_server(victim, dice, scene.found)


def play_calm(victim: Victim, scene: Scene, mix: Mix, sizes: Sizes) -> list[Footprint]:
    """The rounds in which the service is left alone; return what it held after each."""
    prints: list[Footprint] = []
    for number in range(sizes.calm):
        begin = time.monotonic()
        with clients(scene, sizes.rough + number):
            for job in begin_jobs(scene, mix, number):
                job.result()
        scene.found.kinds["calm rounds"] += 1
        seconds = time.monotonic() - begin
        time.sleep(sizes.idle)
        prints.append(footprint(victim, number + 1))
        held = f"{prints[-1].all_bytes / 1e6:.0f} MB, {prints[-1].all_handles} open files"
        tell(scene, f"calm round {number + 1}, {seconds:.1f} s; {held}")
    return prints


def tell(scene: Scene, what: str) -> None:
    """Tell how far it is."""
    print(f"soak: {what}; {scene.asked['cases of jobs']:,} cases", file=sys.stderr)


@contextmanager
def beginning(folder: Path) -> Iterator[tuple[Victim, list[str]]]:
    """A service that asks for keys, and one of each owner."""
    data, tokens = folder / "data", list[str]()
    for owner in OWNERS:
        key, token = make_key(owner, frozenset({"read", "run"}))
        add_key(data, key)
        tokens.append(token)
    settings = {"memory_cache_bytes": str(MEMORY_CACHE_BYTES), "audit_log": str(folder / "audit.log")}
    with Victim(folder, data=data, **settings) as victim:
        victim.client.headers.update({"Authorization": f"Bearer {tokens[0]}", "Connection": "close"})
        victim.start()
        yield victim, tokens


@contextmanager
def clients(scene: Scene, number: int) -> Iterator[None]:
    """Single queries, downloads and nonsense of both owners, as long as the block lasts."""
    scene.over.clear()
    with ThreadPoolExecutor(3 * len(scene.tokens)) as threads:
        going = [threads.submit(ask, scene, token) for token in scene.tokens for ask in (query, download)]
        going += [
            threads.submit(send_nonsense, scene, token, 2 * number + turn) for turn, token in enumerate(scene.tokens)
        ]
        try:
            yield
        finally:
            scene.over.set()
        for each in going:
            each.result()


def begin_jobs(scene: Scene, mix: Mix, number: int) -> list["Future[None]"]:
    """A batch, a sweep and a job that is cancelled of each owner."""
    threads = ThreadPoolExecutor(3 * len(scene.tokens))
    jobs = []
    for turn, token in enumerate(scene.tokens):
        jobs.append(threads.submit(run_job, scene, token, mix.batch(), number + turn))
        jobs.append(threads.submit(run_job, scene, token, mix.sweep(), number + turn + 1))
        jobs.append(threads.submit(cancel_job, scene, token, mix.cancelled(), 2 * number + turn))
    threads.shutdown(wait=False)
    return jobs


def hurt(victim: Victim, kind: str, dice: random.Random, found: Found) -> None:
    """Do this to the service, and see it come back."""
    found.kinds[kind] += 1
    begin = time.monotonic()
    HURTS[kind](victim, dice, found)
    found.note("back_s", time.monotonic() - begin)


def kill_worker(victim: Victim, dice: random.Random, _: Found) -> None:
    """Kill a worker."""
    if workers := victim.workers():
        with suppress(ProcessLookupError):
            os.kill(dice.choice(workers), signal.SIGKILL)


def kill_server(victim: Victim, _: random.Random, found: Found) -> None:
    """Kill the server and start it again."""
    victim.kill()
    leave_no_worker(victim, found)
    victim.start()


def stop_server(victim: Victim, _: random.Random, found: Found) -> None:
    """Stop the server as an operator does, and start it again."""
    found.claim(victim.stop() == 0, "the server did not end well")
    leave_no_worker(victim, found)
    victim.start()


def lose_the_index(victim: Victim, dice: random.Random, found: Found) -> None:
    """Kill the server, lose the index of results, and start it again."""
    victim.kill()
    leave_no_worker(victim, found)
    lose_index(victim.data, dice)
    victim.start()


def leave_no_worker(victim: Victim, found: Found) -> None:
    """See that the workers have gone with their server."""
    found.claim(not victim.orphans(GONE_SECONDS), "a process outlived the service")


HURTS: dict[str, Hurt] = {
    "server killed": kill_server,
    "worker killed": kill_worker,
    "server stopped": stop_server,
    "index lost": lose_the_index,
}


def see_the_end(victim: Victim, scene: Scene, sample: int) -> int:
    """Read every result of every job once more; compute some anew, and return how many; look at what is on disk."""
    found, computed, told = scene.found, victim.computed(), dict[str, str]()
    chosen = choose({name for work, _, _ in scene.ended for name in work.names}, sample)
    for token in scene.tokens:
        with scene.session(token) as session:
            told |= {job["id"]: job["status"] for job in session.get(f"/jobs?limit={MOST_JOBS}").json()["jobs"]}
            for work, job, _ in (each for each in scene.ended if each[2] == token):
                read_ended(scene, session, work, job, chosen)
            for work, job, _ in (each for each in scene.cancelled if each[2] == token):
                read_cancelled(scene, session, work, job)
    jobs = {job["id"] for _, job, _ in scene.ended + scene.cancelled}
    found.claim(told.keys() == jobs, f"{len(told)} jobs are there, {len(jobs)} were made")
    found.claim(not UNDERWAY & set(told.values()), "a job is still running")
    found.claim(victim.computed() == computed, f"{victim.computed() - computed} results were lost, and computed again")
    found.claim(victim.stop() == 0, "the server did not end well")
    leave_no_worker(victim, found)
    found.faults += faults_of(victim.data)
    for name, answer in chosen.items():
        found.claim(is_right(name, answer), f"{name} is answered otherwise by the solver")
    return len(chosen)


def choose(names: set[str], count: int) -> dict[str, bytes]:
    """Some of these cases, whose answers are not there yet."""
    dice = random.Random(0)  # noqa: S311 (likewise)
    return dict.fromkeys(dice.sample(sorted(names), min(count, len(names))), b"")
