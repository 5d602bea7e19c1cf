"""A service without a built manual says so."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx


def test_without_a_manual_the_page_says_what_to_do(tmp_path: Path, service_on: Callable[..., Any]) -> None:
    with service_on(tmp_path, manual_dir=str(tmp_path / "none")) as service:
        for address in ("/manual", "/manual/"):
            answer = httpx.get(f"{service.url}{address}", follow_redirects=True, trust_env=False)
            assert answer.status_code == 404
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
            assert "make docs" in answer.text
            assert "RICOCHET_MANUAL_DIR" in answer.text
        deep = httpx.get(f"{service.url}/manual/index.html", trust_env=False)
        assert (deep.status_code, deep.headers["Content-Type"]) == (404, "application/problem+json")
