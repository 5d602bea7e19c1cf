"""Ask a server again and again until standard input closes; write how long each answer took.

    python -m benchmarks.stress.poller livez 8000 4711
    python -m benchmarks.stress.poller trajectory 8000 4711

The last number is the process of the server: where the kernel tells (Linux), it is also written how long each answer
took but for the time in which client or server were ready to run and no core was free, which other work decides.

A process of its own for each kind, so that what is measured is the server and not the client that keeps it busy.
"""

import json
import select
import sys
import time
from http.client import HTTPConnection
from pathlib import Path

from service.schemas.examples import PAPER_AT_45

LIVEZ_SECONDS = 0.01
TRAJECTORY_SECONDS = 0.2


def ask(connection: HTTPConnection, kind: str, number: int) -> None:
    """Ask once; no two trajectories are alike."""
    if kind == "livez":
        connection.request("GET", "/livez")
    else:
        impact = {"velocity_m_s": 150.0 + 1.37 * (number % 400) + 1e-6 * number, "oblique_angle_deg": 45.0}
        body = json.dumps(PAPER_AT_45 | {"impact": impact})
        connection.request("POST", "/trajectory", body, {"Content-Type": "application/json"})
    answer = connection.getresponse()
    content = answer.read()
    if answer.status != 200:
        sys.exit(f"{kind} answered {answer.status}: {content!r}")


def waited(tasks: list[Path]) -> float:
    """Seconds that these threads have waited for a core so far."""
    return sum(int(task.read_text().split()[1]) for task in tasks) * 1e-9


def main(kind: str, port: int, server: int) -> None:
    interval = LIVEZ_SECONDS if kind == "livez" else TRAJECTORY_SECONDS
    connection = HTTPConnection("127.0.0.1", port, timeout=60.0)
    loop = Path(f"/proc/{server}/task/{server}/schedstat")
    tasks = [loop, Path("/proc/self/schedstat")] if loop.exists() else []
    taken: list[float] = []
    running: list[float] = []
    while True:
        if select.select([sys.stdin], [], [], interval)[0]:
            break
        before, begin = waited(tasks), time.perf_counter()
        ask(connection, kind, len(taken))
        taken.append(time.perf_counter() - begin)
        running.append(max(0.0, taken[-1] - (waited(tasks) - before)))
    json.dump({"seconds": taken, "running_seconds": running}, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
