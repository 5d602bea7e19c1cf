"""Check that no name or phrase that has been replaced comes back. `make check` runs it.

Names in code, tests and documents; phrases in the solver, the service and the documents.
"""

import re
import subprocess
import sys
from pathlib import Path

REPLACED = {
    "AbandonedError": "ComputationCancelled",
    "ANYONE": "ANONYMOUS",
    "Arrival": "BodyTimeout",
    "asked": "args, request",
    "AskedVisit": "ReadContext, RunContext",
    "asker": "client",
    "Backlog": "TaskQueue",
    "Dispatcher": "Scheduler",
    "Gate": "AuthMiddleware",
    "KeyRing": "ApiKeyStore",
    "Lane": "WorkerSupervisor",
    "own_service": "local_server, dedicated_service",
    "Runner": "JobManager",
    "Marks": "CaseUpdates",
    "Pace": "ChunkSizer",
    "Shot": "PreparedCase",
    "Slots": "FairSemaphore",
    "SmallWork": "CaseRunner",
    "Turns": "FairQueue",
    "Usages": "QuotaStore",
    "Visit": "RequestContext",
    "Wanted": "PendingCase",
    "_underway": "_in_flight",
    "admission": "backpressure",
    "is_tame": "is_smooth",
    "service.access": "service.auth",
    "warnings_told": "warning_texts",
}
OF = '"""Of'
PHRASES = {
    '"""Tell': "return, report",
    "told": "given, called with, named",
    "tells": "gives, shows, says",
    "asked for": "requested",
    "ask for": "request, require",
    "asks for": "requests, requires",
    "likewise": "the same, in the same way",
    "whoever": "the caller, the owner",
    "of its own": "separate",
    OF: "the quantity, then `of`",
}
WORDED = ("solver/", "service/", "docs/", "README.md", "CONTRIBUTING.md", "examples/")
SUFFIXES = (".py", ".md", ".js", ".toml", ".yaml")
EXEMPT = {"CHANGELOG.md", "docs/vocabulary.py"}
PATTERN = re.compile(r"(?<![\w])(" + "|".join(map(re.escape, REPLACED)) + r")(?![\w])")
PHRASE = re.compile("|".join(rf"(?<!\w){re.escape(phrase)}(?!\w)" for phrase in PHRASES), re.IGNORECASE)
BARE = re.compile(r"\s+Of ")
"""Beginning of the description of a parameter that leaves its noun out."""


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
            if name.endswith(".py") and name.startswith(WORDED) and BARE.match(line):
                print(f"{name}:{number}: `Of`: {PHRASES[OF]}")
                found += 1
            for match in PHRASE.finditer(line) if name.startswith(WORDED) else ():
                print(f"{name}:{number}: `{match[0]}`: {PHRASES.get(match[0].lower(), PHRASES[OF])}")
                found += 1
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
