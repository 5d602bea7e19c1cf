"""Examples of answers in the contract: what the service answers to the first example of each request.

`python -m service.api.examples` computes them and writes `examples.json`; a test compares that file with a service.
"""

import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from service.operations import OPERATIONS, KeyedRequest, Operation
from service.workers.worker import compute_single

FILE = Path(__file__).with_name("examples.json")
LONG = frozenset({"formulas", "history", "iterations"})
"""Fields whose lists are shortened."""
SHOWN = 2
"""Items that are shown of such a list, and of each column of a history."""
DIGITS = 6
"""Digits of a number: more differ between processors."""


@cache
def computed() -> dict[str, Any]:
    """Return the examples by the names of their operations."""
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def declare_examples(schemas: dict[str, Any], operations: Iterable[Operation]) -> None:
    """Show what was computed as the first example of each answer, and of each answer to many cases."""
    for operation in operations:
        if (answer := computed().get(operation.name)) is None:
            continue
        schema = schemas[operation.answer.__name__]
        schema["examples"] = [answer, *schema["examples"][1:]]
        if operation.many is not None:
            item = {"index": 0, "result": answer}
            results = schemas[operation.many.models.results.__name__]
            results["examples"] = [{"results": [item]}]
            name = results["properties"]["results"]["items"]["$ref"].rpartition("/")[2]
            schemas[name]["examples"] = [item, *schemas[name]["examples"][1:]]


def first_request(operation: Operation) -> dict[str, Any]:
    """Return the first example of a request."""
    found: dict[str, Any] = operation.request.model_json_schema()["examples"][0]
    return found


def example_of(operation: Operation) -> Any:
    """Compute the answer to the first example of a request."""
    case: Any = operation.request.model_validate(first_request(operation))
    query = KeyedRequest.of(operation.name, case)
    answer, _ = compute_single(operation.compute, operation.name, query.key, query.json)
    return shortened(json.loads(answer))


def shortened(value: Any, *, cut: bool = False) -> Any:
    """Return a part of an answer with rounded numbers, and with the first items of its long lists."""
    if isinstance(value, dict):
        return {name: shortened(each, cut=cut or name in LONG) for name, each in value.items()}
    if isinstance(value, list):
        return [shortened(each, cut=cut) for each in (value[:SHOWN] if cut else value)]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def write() -> None:
    """Compute the examples of all operations but studies, and write them."""
    found = {each.name: example_of(each) for each in OPERATIONS.values() if each.study is None}
    FILE.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write()
