"""Answers of every route, format and kind of error match the text files in `golden/`.

The tests detect unintended changes. Words are compared exactly. Numbers are stored to six digits and compared within
`TOLERANCE`, because processors differ in their instructions. In a trial near the critical angle rounding errors grow
until they affect the first digits, so numbers of such trials have the wider tolerance `SENSITIVE`.
After an intended change, `.venv/bin/python -m tests.api.test_golden_answers URL` writes the files
from the service at that address; read their differences before you commit them.
"""

import difflib
import io
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import h5py
import httpx

GOLDEN = Path(__file__).with_name("golden")
CONTRACT = json.loads((Path(__file__).parents[2] / "openapi/openapi.json").read_text())
FORMATS = ("application/json", "application/jsonl", "text/csv", "application/x-hdf5", "application/vnd.apache.parquet")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+(?:[eE][-+]?\d+)?|[eE][-+]?\d+)(?![\w.]\w)")
VOLATILE = {"id", "created", "started", "finished", "expires", "progress", "libraries", "engine_version"}
"""Fields that differ between two runs of the same requests, or between versions of the engine."""
TOLERANCE = 2e-3
"""Relative tolerance of numbers. The results of code compiled for other processors (`NUMBA_CPU_NAME=generic` and
`haswell`) differed by at most half of it."""
SENSITIVE = 0.3
"""Relative tolerance of numbers from trials next to the critical angle, of loads at the end of a motion, and of small
differences."""
SENSITIVE_FIELD = re.compile(
    r"\b(?:exit|energy_fraction_\w+|iterations|bracket_\w+|\w*_error\w*|confidence_interval"
    r"|final\.\w+_force_n|final\.angular_velocity_rad_s)\b"
)
NOT_COMPARED = re.compile(r"\bfinal\.moment_n_m\b|^-?\d.*,")
"""Numbers that are not compared: the moment on a body at rest, which is a small difference of large loads, and the
rows of tables, whose numbers are compared in the JSON answers."""
ZERO = 1e-9
"""Absolute tolerance, which matters only for numbers near 0."""
SHOWN = 3
"""Number of items recorded from a list of numbers, from the trials of a search and from the rows of a table. The length
is recorded too, except the number of trials, which may differ between processors."""
NAMES = re.compile(r"/jobs/[\w-]+|\b[0-9a-f]{64}\b")
"""Paths of jobs and keys of results, which are replaced: both differ between runs or engines."""


def examples(path: str) -> list[Any]:
    """Return the example bodies of a route in the contract."""
    content = CONTRACT["paths"][path]["post"]["requestBody"]["content"]["application/json"]["schema"]
    found: list[Any] = CONTRACT["components"]["schemas"][content["$ref"].rpartition("/")[2]]["examples"]
    return found


def broken(body: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield a name and a body for each faulty field: missing, of the wrong type, misspelt, negative or unknown."""
    for name, part in body.items():
        yield f"without {name}", {key: value for key, value in body.items() if key != name}
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
            continue  # The report contains the time of its creation.
        bodies = examples(path)
        many = path.endswith(("batch", "sweep"))
        for number, body in enumerate(bodies):
            for kind in FORMATS[:3] if many else FORMATS[:1]:
                yield f"{path} example {number} {kind}", "POST", path, {"json": body, "headers": {"Accept": kind}}
        for name, body in broken(bodies[0]):
            yield f"{path} {name}", "POST", path, {"json": body}
        for text in ("", "{", "[]", "null", '{"a": NaN}', "[" * 200):
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


def leaves(value: Any, path: str = "") -> Iterator[str]:
    """Yield a line with path and value for each value in a JSON document."""
    name = path.rpartition(".")[2]
    if name in VOLATILE:
        yield f"{path}: volatile"
    elif isinstance(value, dict) and value:
        for key, each in value.items():
            yield from leaves(each, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list) and value:
        numbers = name == "iterations" or isinstance(value[0], int | float)
        for index, each in enumerate(value[: SHOWN if numbers else None]):
            yield from leaves(each, f"{path}.{index}".lstrip("."))
        if numbers and len(value) > SHOWN:
            yield f"{path}: {'more' if name == 'iterations' else len(value)} in all"
    elif isinstance(value, float):
        yield f"{path}: {float(f'{value:.5e}')}"
    else:
        yield f"{path}: {NAMES.sub('NAME', json.dumps(value, ensure_ascii=False))}"


def as_text(value: Any) -> str:
    return "\n".join(leaves(value))


def rows(text: str) -> str:
    """Return the first lines of a table with rounded numbers, and the number of lines."""
    lines = NUMBER.sub(lambda number: f"{float(f'{float(number[0]):.5e}')}", text).splitlines()
    return "\n".join([*lines[: SHOWN + 1], f"{len(lines)} lines"])


def plain(response: httpx.Response) -> str:
    """Return an answer as text without anything that differs between runs."""
    kind = response.headers.get("content-type", "").partition(";")[0]
    if kind == "application/x-hdf5":
        found: list[str] = []
        with h5py.File(io.BytesIO(response.content)) as file:
            file.visititems(
                lambda name, item: found.append(
                    f"{name} {item.dtype if name in file and hasattr(item, 'dtype') else ''}"
                )
            )
            found += [f"{name} = {value}" for name, value in sorted(file.attrs.items())]
        text = "\n".join(found)
    elif kind == "application/jsonl":  # Lines are written in the order in which their cases finish.
        lines = sorted((json.loads(line) for line in response.text.splitlines()), key=lambda line: int(line["index"]))
        text = as_text(lines)
    elif kind.endswith("json"):
        text = as_text(response.json())
    else:
        text = rows(response.text)
    return f"{response.status_code} {kind} {response.headers.get('allow', '')}".rstrip() + f"\n{text}\n"


def answers(client: httpx.Client) -> Iterator[tuple[str, str]]:
    """Send the requests, then request one stored result of each path in every format; yield name and answer."""
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
            yield f"/results of {path} as {kind}", plain(response)


def files(found: Mapping[str, str]) -> dict[str, str]:
    """Return the text of each file, one for each route; repeated answers refer to the first of them."""
    by_route = groupby(sorted(found, key=route), key=route)
    texts = {}
    for name, group in by_route:
        first: dict[str, str] = {}
        parts = []
        for each in group:
            same = first.setdefault(found[each], each)
            parts.append(f"## {each}\n" + (found[each] if same == each else f"as {same}\n"))
        texts[name] = "\n".join(parts)
    return texts


def route(name: str) -> str:
    first = name.split(maxsplit=1)[0].strip("/")
    return first.replace("/", "-") if f"/{first}" in CONTRACT["paths"] and " " in name else "others"


def differences(kept: str, found: str) -> list[str]:
    """Return the lines in which two texts differ in words, or in numbers beyond the tolerance."""
    before, after = kept.splitlines(), found.splitlines()
    words = [[NUMBER.sub("#", line) for line in lines] for lines in (before, after)]
    if words[0] != words[1]:
        return list(difflib.unified_diff(words[0], words[1], n=2, lineterm=""))
    return [f"{old} | {new}" for old, new in zip(before, after, strict=True) if not close(old, new)]


def close(old: str, new: str) -> bool:
    if NOT_COMPARED.search(old):
        return True
    tolerance = SENSITIVE if SENSITIVE_FIELD.search(old) else TOLERANCE
    pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=tolerance, abs_tol=ZERO) for a, b in pairs)


def test_answers_match_the_golden_files(client: httpx.Client) -> None:
    found = dict(answers(client))
    assert len(found) >= 500
    texts = files(found)
    kept = {file.stem: file.read_text() for file in GOLDEN.glob("*.txt")}
    assert texts.keys() == kept.keys()
    assert {name: lines for name in kept if (lines := differences(kept[name], texts[name]))} == {}


if __name__ == "__main__":
    with httpx.Client(base_url=sys.argv[1], timeout=60) as service:
        written = files(dict(answers(service)))
    for old in GOLDEN.glob("*.txt"):
        old.unlink()
    GOLDEN.mkdir(exist_ok=True)
    for name, text in written.items():
        (GOLDEN / f"{name}.txt").write_text(text)
