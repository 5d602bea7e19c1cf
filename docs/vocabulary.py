"""Check that no name that has been replaced comes back: in code, tests and documents. `make check` runs it."""

import re
import subprocess
import sys
from pathlib import Path

REPLACED = {
    "AbandonedError": "ComputationCancelled",
    "ANYONE": "ANONYMOUS",
    "Arrival": "BodyTimeout",
    "AskedVisit": "ReadContext, RunContext",
    "Backlog": "TaskQueue",
    "Dispatcher": "Scheduler",
    "Gate": "AuthMiddleware",
    "KeyRing": "ApiKeyStore",
    "Lane": "WorkerSupervisor",
    "own_service": "local_server, dedicated_service",
    "Runner": "JobManager",
    "SmallWork": "InlineBatch",
    "Usages": "QuotaStore",
    "Visit": "RequestContext",
    "is_tame": "is_smooth",
    "service.access": "service.auth",
    "warnings_told": "warning_texts",
}
SUFFIXES = (".py", ".md", ".js", ".toml", ".yaml")
EXEMPT = {"CHANGELOG.md", "docs/vocabulary.py"}
PATTERN = re.compile(r"(?<![\w])(" + "|".join(map(re.escape, REPLACED)) + r")(?![\w])")


def main() -> int:
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout  # noqa: S607
    found = 0
    for name in listed.splitlines():
        if not name.endswith(SUFFIXES) or name in EXEMPT or not Path(name).exists():
            continue
        for number, line in enumerate(Path(name).read_text(encoding="utf-8").splitlines(), 1):
            for match in PATTERN.finditer(line):
                print(f"{name}:{number}: `{match[1]}` is now `{REPLACED[match[1]]}`")
                found += 1
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
