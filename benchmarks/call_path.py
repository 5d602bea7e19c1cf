"""Number of files of `service` and `solver` whose functions the server process calls to answer a request.

    python benchmarks/call_path.py [--paths]

Counts the files in which a function is called, by `sys.setprofile` on every thread of the server and its event loop,
for a `POST /cra` that is not cached and for a job of three cases, from its submission to its results. Each request is
made once with other numbers, so that imports are not counted, and then three times. The run with the fewest
files is reported, because the others may include periodic work of the server. Each line of the table is a file, in the
order of first calls, with the number of times that a call in it followed a call in another file. `--paths` prints the
file at each of these switches. Workers are other processes and are not counted, so a server that leaves the solver to
them calls no file of `solver`. Takes a few seconds.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from pathlib import Path
from types import FrameType
from typing import Any

import httpx

from benchmarks.clients import JSONL, to_request
from benchmarks.machine import print_machine, print_table
from benchmarks.random_cases import one_by_one, study_cases
from benchmarks.servers import START_SECONDS, free_port

ROOT = Path(__file__).parents[1]
PACKAGES = (f"{ROOT}/service/", f"{ROOT}/solver/")


class Recorder:
    """Records the files of `service` and `solver` in which functions are called during `recording`."""

    def __init__(self) -> None:
        self.files: list[str] = []
        self._on = False

    def profile(self, frame: FrameType, event: str, _: object) -> None:
        """Record the file of a called function, unless it is the last one recorded.

        `sys.setprofile` registers this method. `on_tick`, which uvicorn calls periodically, is left out.
        """
        code = frame.f_code
        if not self._on or event != "call" or code.co_name == "on_tick":
            return
        if code.co_filename.startswith(PACKAGES) and self.files[-1:] != [code.co_filename]:
            self.files.append(code.co_filename)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Delete earlier records, and record during the block."""
        self.files.clear()
        self._on = True
        yield
        self._on = False


def case(number: int) -> dict[str, Any]:
    """Return a case whose speed depends on the number, so that each number needs a new computation."""
    [paper] = one_by_one(study_cases(1, 0))
    return to_request({**paper, "velocity": 230.0 + number})


def send(port: int, method: str, path: str, body: bytes = b"", **headers: str) -> bytes:
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    url = f"http://127.0.0.1:{port}{path}"
    return httpx.request(method, url, content=body, headers=sent, trust_env=False).raise_for_status().content


def query(port: int, number: int) -> None:
    send(port, "POST", "/cra", json.dumps(case(number)).encode(), Content_Type="application/json")


def job(port: int, number: int) -> None:
    """Submit a job of three cases, wait a second without sending requests, and read its results."""
    lines = b"\n".join(json.dumps(case(number + index)).encode() for index in range(3))
    answer = send(port, "POST", "/cra/batch", lines, Content_Type=JSONL, Prefer="respond-async")
    links = json.loads(answer)["links"]
    time.sleep(1.0)
    state = json.loads(send(port, "GET", links["self"]))
    if state["status"] != "successful":
        raise RuntimeError(f"the job is {state['status']}")
    send(port, "GET", links["results"], Accept=JSONL)


REQUESTS: dict[str, Callable[[int, int], None]] = {"cold POST /cra": query, "job of three cases": job}


def measure(port: int, recorder: Recorder, found: dict[str, list[str]]) -> None:
    """Wait until the server in this process is ready, record each request, and end the server."""
    try:
        deadline = time.monotonic() + START_SECONDS
        while True:
            try:
                send(port, "GET", "/readyz")
                break
            except httpx.HTTPError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        for number, (name, request) in enumerate(REQUESTS.items(), 1):
            request(port, 100 * number)
            paths = []
            for repetition in range(1, 4):
                with recorder.recording():
                    request(port, 100 * number + 10 * repetition)
                paths.append([str(Path(file).relative_to(ROOT)) for file in recorder.files])
            found[name] = min(paths, key=lambda path: len(set(path)))
    finally:
        os.kill(os.getpid(), signal.SIGTERM)


def serve(recorder: Recorder) -> None:
    """Run `ricochet serve` in this thread, and profile it with all threads that it starts."""
    command, *_ = entry_points(group="console_scripts", name="ricochet")
    main = command.load()
    sys.argv = [command.name, "serve"]
    threading.setprofile(recorder.profile)
    sys.setprofile(recorder.profile)
    with suppress(SystemExit):
        main()
    sys.setprofile(None)
    threading.setprofile(None)


def main() -> None:
    parser = argparse.ArgumentParser(description="Count the files whose functions a request calls.")
    parser.add_argument("--paths", action="store_true", help="print every switch from file to file")
    options = parser.parse_args()
    print_machine()
    recorder, found, port = Recorder(), dict[str, list[str]](), free_port()
    with tempfile.TemporaryDirectory() as folder:
        settings = {"HOST": "127.0.0.1", "PORT": str(port), "DATA_DIR": folder, "WORKERS": "2", "LOG_LEVEL": "error"}
        os.environ |= {f"RICOCHET_{name}": value for name, value in settings.items()}
        # The client starts before the profiler is set, so that its calls are not recorded.
        client = threading.Thread(target=measure, args=(port, recorder, found))
        client.start()
        serve(recorder)
        client.join()
    for name, path in found.items():
        print(f"{name}:")
        for file in path if options.paths else ():
            print(f"    {file}")
        print_table(["file", "entered"], Counter(path).items())
    rows = []
    for name, path in found.items():
        of_service = {file for file in path if file.startswith("service/")}
        rows.append([name, len(of_service), len(path) - 1, len(set(path) - of_service)])
    print_table(["request", "files of service", "switches between files", "files of solver"], rows)


if __name__ == "__main__":
    main()
