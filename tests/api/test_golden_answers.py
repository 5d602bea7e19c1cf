"""Answers over every route, format and kind of error are those kept in `golden_answers.json`.

A change of code that is meant to move no answer shows here if it moves one. Of each answer two digests are kept: of
its words, and of words and numbers to six digits. Numbers are compared on the processor that they come from: another
has other instructions, and in a trial near the critical angle last bits grow into the second digit. After a change that
is meant to move answers, `.venv/bin/python -m tests.api.test_golden_answers URL` writes the file from a service there.
"""

import hashlib
import io
import json
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import httpx
from llvmlite.binding import get_host_cpu_name

GOLDEN = Path(__file__).with_name("golden_answers.json")
CONTRACT = json.loads((Path(__file__).parents[2] / "openapi/openapi.json").read_text())
FORMATS = ("application/json", "application/jsonl", "text/csv", "application/x-hdf5", "application/vnd.apache.parquet")
READ = ("/cra", "/cra/batch", "/cra/sweep", "/cra/uncertainty", "/calibration/motion", "/verdict")
"""Routes of each kind: what is no request is sent to one of a kind."""
NUMBER = re.compile(r"-?\d+\.\d+(?:[eE][-+]?\d+)?|-?\d+[eE][-+]?\d+")
VOLATILE = re.compile(
    r'"(?:id|created_at|started_at|finished_at|ended_at|expires_at|trace_id|progress|elapsed_s)":[^,}]*'
)
"""Fields that differ between two runs of the same requests."""
LENGTH = re.compile(r"^answers \(\d+,\)", re.MULTILINE)
"""Bytes of the answers in HDF5, which depend on how many digits the numbers have."""
JOB = re.compile(r"/jobs/[\w-]+")


def examples(path: str) -> list[Any]:
    """Return the examples of the body of a route."""
    content = CONTRACT["paths"][path]["post"]["requestBody"]["content"]["application/json"]["schema"]
    found: list[Any] = CONTRACT["components"]["schemas"][content["$ref"].rpartition("/")[2]]["examples"]
    return found


def broken(body: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the body with one part of another kind, misspelt, which leaves it out too, or added."""
    for name, part in body.items():
        yield f"{name} as text", body | {name: "text"}
        yield f"{name} misspelt", {("x" + key if key == name else key): value for key, value in body.items()}
        if isinstance(part, dict):
            for inner in part:
                yield f"{name}.{inner} negative", body | {name: part | {inner: -1}}
    yield "with more", body | {"unknown": 1}


def requests() -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """Yield name, method, path and arguments of every request."""
    posts = [path for path, routes in CONTRACT["paths"].items() if "requestBody" in routes.get("post", {})]
    for path in posts:
        if path == "/report":
            continue  # a page with the time of day
        bodies = examples(path)
        many = path.endswith(("batch", "sweep"))
        for number, body in enumerate(bodies):
            for kind in FORMATS[:3] if many else FORMATS[:1]:
                yield f"{path} example {number} {kind}", "POST", path, {"json": body, "headers": {"Accept": kind}}
        for name, body in broken(bodies[0]) if path in READ or not many else ():
            yield f"{path} {name}", "POST", path, {"json": body}
        for text in ("", "{", "[]", "null", '{"a": NaN}', "[" * 200) if path in READ else ("{",):
            yield f"{path} body {text[:9]!r}", "POST", path, {"content": text, "headers": {"Content-Type": FORMATS[0]}}
        yield f"{path} of text", "POST", path, {"content": "a", "headers": {"Content-Type": "text/plain"}}
        yield f"{path} by GET", "GET", path, {}
    for path in (
        "/version",
        "/livez",
        "/jobs/none",
        "/jobs/none/results",
        "/results/none",
        f"/results/{'0' * 64}",
        "/x",
    ):
        yield path, "GET", path, {}
        yield f"{path} deleted", "DELETE", path, {}


def plain(response: httpx.Response) -> str:
    """Return an answer as text that is the same in every run."""
    kind = response.headers.get("content-type", "")
    if kind == FORMATS[3]:
        found: list[str] = []
        with h5py.File(io.BytesIO(response.content)) as file:
            file.visititems(lambda name, item: found.append(f"{name} {getattr(item, 'shape', '')} {dict(item.attrs)}"))
        text = "\n".join(found)
    else:
        text = JOB.sub("/jobs/ID", VOLATILE.sub('"volatile"', response.text))
    return f"{response.status_code} {kind} {response.headers.get('allow', '')}\n{text}"


def answers(client: httpx.Client) -> Iterator[tuple[str, str]]:
    """Send the requests; yield name and answer."""
    keys: dict[str, str] = {}
    for name, method, path, arguments in requests():
        response = client.request(method, path, **arguments)
        yield name, plain(response)
        if response.status_code == 200 and method == "POST" and response.headers["content-type"] == FORMATS[0]:
            key = response.json().get("key")
            if key:
                keys.setdefault(path, key)
    for path, key in keys.items():
        for kind in FORMATS:
            response = client.get(f"/results/{key}", headers={"Accept": kind})
            yield f"result of {path} as {kind}", plain(response)


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def digests(client: httpx.Client) -> dict[str, str]:
    """Return the digests of every answer: of its words, and of all."""
    found = {}
    for name, text in answers(client):
        words = NUMBER.sub("#", LENGTH.sub("answers", text))
        found[name] = f"{digest(words)} {digest(NUMBER.sub(lambda number: f'{float(number[0]):.5e}', text))}"
    return found


def differing(kept: Mapping[str, str], found: Mapping[str, str], part: int) -> set[str]:
    """Return the names of the answers one digest of which differs, and of those that are only on one side."""
    shared = kept.keys() & found.keys()
    different = {name for name in shared if kept[name].split()[part] != found[name].split()[part]}
    return (kept.keys() ^ found.keys()) | different


def test_answers_are_those_kept(client: httpx.Client) -> None:
    golden = json.loads(GOLDEN.read_text())
    found = digests(client)
    assert len(found) > 300
    assert differing(golden["answers"], found, 0) == set()
    if golden["processor"] == get_host_cpu_name():
        assert differing(golden["answers"], found, 1) == set()


if __name__ == "__main__":
    with httpx.Client(base_url=sys.argv[1], timeout=60) as service:
        written = {"processor": get_host_cpu_name(), "answers": digests(service)}
        GOLDEN.write_text(json.dumps(written, indent=0) + "\n")
