"""`make audit` with an advisory database that answers, fails or cannot be reached."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
ADVISORY = {
    "id": "TEST-2026-1",
    "summary": "made up",
    "affected": [
        {
            "package": {"name": "numpy", "ecosystem": "PyPI"},
            "ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "99.0"}]}],
        }
    ],
}


@contextmanager
def database(status: int, vulnerable: str = "") -> Iterator[str]:
    """Run a server with the interface of OSV that answers with this status and knows one vulnerable package."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            found = {"vulns": [ADVISORY]} if request["package"]["name"] == vulnerable else {}
            body = json.dumps(found).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 (its name there)
            """Discard the log line that the base class would print."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/v1/query"
        finally:
            server.shutdown()


def audited(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "requirements/audit.py", *arguments]
    environment = {"NO_PROXY": "*", "HOME": "/nonexistent"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_vulnerability_fails_the_audit_and_is_named_with_its_fix() -> None:
    with database(200, vulnerable="numpy") as url:
        ended = audited("-s", "osv", "--osv-url", url)
    assert ended.returncode == 1
    assert ended.stderr.startswith("numpy ")
    assert "TEST-2026-1, fixed in 99.0" in ended.stderr
    assert ended.stdout.startswith("1 known vulnerabilities in ")


def test_every_locked_package_is_looked_up_in_a_strict_audit() -> None:
    with database(200) as url:
        ended = audited("--strict", "-s", "osv", "--osv-url", url)
    locked = [line for line in (ROOT / "requirements" / "full.txt").read_text().splitlines() if "==" in line]
    here = [line for line in locked if not re.search("sys_platform == '(win32|emscripten)'", line)]
    assert ended.returncode == 0
    assert ended.stdout == f"0 known vulnerabilities in {len(here)} packages\n"
    assert "requirements/audit.py --strict" in (ROOT / "Makefile").read_text().partition("\naudit:")[2]


def test_unreachable_database_is_distinguished_from_one_without_findings() -> None:
    with database(503) as url:
        failing = audited("-s", "osv", "--osv-url", url)
    missing = audited("--strict", "-s", "osv", "--osv-url", url)
    assert (failing.returncode, missing.returncode) == (0, 1)
    for ended in (failing, missing):
        assert ended.stdout.startswith("audit skipped: the advisory database cannot be reached")


def test_local_error_is_not_mistaken_for_an_unreachable_database() -> None:
    ended = audited("--nonsense")
    assert ended.returncode == 1
    assert "--nonsense" in ended.stderr
