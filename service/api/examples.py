"""Examples of answers in the contract: the answer to the first example of each request, except for studies.

`python -m service.api.examples` computes them and writes `examples.json`; a test compares the file with the answers of
a service.
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
"""Fields whose lists are shortened in the examples, since they would fill pages of the contract."""
SHOWN = 2
"""Number of items shown of a shortened list or column: the fewest that show that there can be several."""
DIGITS = 6
"""Number of significant digits of the numbers in the examples. Later digits differ between processors."""


@cache
def computed() -> dict[str, Any]:
    """Return the stored examples, keyed by operation."""
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def declare_examples(schemas: dict[str, Any], operations: Iterable[Operation]) -> None:
    """Add the computed answers to the models of single answers and of batches, as their first examples."""
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
    """Return an answer, or a part of it, with rounded numbers and shortened lists."""
    if isinstance(value, dict):
        return {name: shortened(each, cut=cut or name in LONG) for name, each in value.items()}
    if isinstance(value, list):
        return [shortened(each, cut=cut) for each in (value[:SHOWN] if cut else value)]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def write() -> None:
    """Compute the examples and write them. Studies are left out, since they take seconds to minutes."""
    found = {each.name: example_of(each) for each in OPERATIONS.values() if each.study is None}
    FILE.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write()
