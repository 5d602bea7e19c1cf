"""Check that a test run left no test out: `python -m tests.completeness build/tests.xml`.

The file is a pytest report (`--junitxml`). Every test must have run, except those listed in `slow.csv`, and the
reason of each skipped test must be listed in `skips.csv`. With `--record`, the results are written to `slow.csv`.
"""

import argparse
import csv
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from solver import ENGINE_VERSION

HERE = Path(__file__).parent
SLOW, SKIPS = HERE / "slow.csv", HERE / "skips.csv"
COLUMNS = ("test", "result", "seconds", "date", "engine")


@dataclass(frozen=True)
class Result:
    """Outcome of a test (`passed`, `failed` or `skipped`), its time [s], and the reason if it was skipped."""

    outcome: str
    seconds: float
    reason: str = ""


def read_report(text: str) -> dict[str, Result]:
    """Return the results in a pytest report, by the name that `name_in_report` returns for each test."""
    found: dict[str, Result] = {}
    for case in ET.fromstring(text).iter("testcase"):  # noqa: S314 (a file that our own run wrote)
        skipped = case.find("skipped")
        bad = [case.find(kind) is not None for kind in ("failure", "error")]
        outcome = "failed" if any(bad) else "passed" if skipped is None else "skipped"
        reason = "" if skipped is None else skipped.get("message", "")
        name = f"{case.get('classname')}.{case.get('name')}"
        found[name] = Result(outcome, float(case.get("time", 0.0)), reason)
    return found


def name_in_report(test: str) -> str:
    """Return the name that a test has in a report, given its node id."""
    path, _, rest = test.partition("::")
    function, bracket, parameters = rest.partition("[")
    return ".".join([path.removesuffix(".py").replace("/", "."), *function.split("::")]) + bracket + parameters


def faults(
    tests: Iterable[str], results: Mapping[str, Result], slow: Iterable[str], skips: Iterable[tuple[str, str]]
) -> list[str]:
    """Return a line for each test that was left out or skipped without a listed reason, and for each invalid entry."""
    tests, slow, skips = list(tests), set(slow), list(skips)
    found = [f"{test} is in {SLOW.name}, and there is no such test" for test in sorted(slow - set(tests))]
    for test in tests:
        result = results.get(name_in_report(test))
        if test in slow:
            if result is not None:
                found.append(f"{test} is in {SLOW.name}, and is not marked slow")
        elif result is None:
            found.append(f"{test} was left out")
        elif result.outcome == "skipped" and not any(
            test.startswith(path) and re.search(reason, result.reason) for path, reason in skips
        ):
            found.append(f"{test} was skipped, for a reason that is not in {SKIPS.name}: {result.reason}")
    return found


def collected() -> list[str]:
    """Return the node ids of all tests, including slow ones."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "slow or not slow"]
    done = subprocess.run(command, cwd=HERE.parent, capture_output=True, text=True, check=True)
    return [line for line in done.stdout.splitlines() if "::" in line]


def read_table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def record(results: Mapping[str, Result], rows: Iterable[dict[str, str]]) -> list[dict[str, str]]:
    """Return the rows of `slow.csv`, updated with results."""
    date = datetime.now(UTC).date().isoformat()
    return [
        {
            "test": row["test"],
            "result": result.outcome,
            "seconds": f"{result.seconds:.0f}",
            "date": date,
            "engine": str(ENGINE_VERSION),
        }
        if (result := results.get(name_in_report(row["test"]))) and result.outcome != "skipped"
        else row
        for row in rows
    ]


def main() -> int:
    """Compare a report with the existing tests, or record it; return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=Path)
    parser.add_argument("--record", action="store_true", help=f"enter the results in {SLOW.name} instead")
    args = parser.parse_args()
    results, rows = read_report(args.report.read_text(encoding="utf-8")), read_table(SLOW)
    if args.record:
        with SLOW.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(record(results, rows))
        return 0
    skips = [(row["tests"], row["reason"]) for row in read_table(SKIPS)]
    wrong = faults(collected(), results, (row["test"] for row in rows), skips)
    print(*wrong, sep="\n")  # noqa: T201 (a command)
    tests = len(results) - sum(result.outcome == "skipped" for result in results.values())
    print(f"{tests} tests ran, {len(results) - tests} were skipped, {len(wrong)} are not accounted for")  # noqa: T201
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
