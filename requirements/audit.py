"""Look for known vulnerabilities in the packages of requirements/full.txt. Arguments are passed to pip-audit.

The exit status is 1 if there are any, and 0 if there are none. If the database cannot be reached, the script says so
and ends with status 0, because work must not depend on another server. With `--strict` the status is 1 in that case,
and also if a package is not in the database.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

LOCK = Path(__file__).with_name("full.txt")
"""Lock file to check; the other lock files of the service are subsets of it."""
STRICT = "--strict"
ANSWER_S, ALL_S = 10, 120
"""Time limits for an answer of the database, and for the whole audit. [s]"""
UNREACHABLE = ("requests.exceptions.", "ServiceError", "Could not connect")
"""Texts in the messages of pip-audit that show that the database did not answer, or that another server did."""


def ask(folder: Path, arguments: list[str]) -> tuple[list[dict[str, Any]] | None, str]:
    """Return the packages in the report of pip-audit, None if it wrote no report, and its standard error."""
    report = folder / "report.json"
    command = [sys.executable, "-m", "pip_audit", "--requirement", str(LOCK), "--require-hashes", "--disable-pip"]
    command += ["--timeout", str(ANSWER_S), "--progress-spinner", "off", "--format", "json", "--output", str(report)]
    try:
        said = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=ALL_S, check=False).stderr
    except subprocess.TimeoutExpired:
        return None, f"ServiceError: no answer in {ALL_S} s"
    return (json.loads(report.read_text())["dependencies"] if report.exists() else None), said


def main() -> int:
    """Print the known vulnerabilities; return the exit status."""
    strict = STRICT in sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="ricochet-") as folder:
        packages, said = ask(Path(folder), [argument for argument in sys.argv[1:] if argument != STRICT])
    if packages is None and not any(sign in said for sign in UNREACHABLE):
        print(said, file=sys.stderr)
        return 1
    known = [package for package in packages or [] if "skip_reason" not in package]
    if not known:
        reason = "it knows none of the packages" if packages else said.strip().rpartition("\n")[2][:200]
        print(f"audit skipped: the advisory database cannot be reached ({reason})")
        return 1 if strict else 0
    found = [(package, each) for package in known for each in package["vulns"]]
    for package, each in found:
        fixed = ", ".join(each["fix_versions"]) or "no version yet"
        print(f"{package['name']} {package['version']}: {each['id']}, fixed in {fixed}", file=sys.stderr)
    unknown = (
        f"; {len(packages or []) - len(known)} are not in the database" if len(known) < len(packages or []) else ""
    )
    print(f"{len(found)} known vulnerabilities in {len(known)} packages{unknown}")
    return 1 if found or (strict and unknown) else 0


if __name__ == "__main__":
    sys.exit(main())
