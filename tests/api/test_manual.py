"""`/manual` without a built manual is a page that says how to build it."""

from pathlib import Path

from fastapi.testclient import TestClient

from service.api.app import create_app
from service.settings import Settings


def test_page_in_place_of_an_unbuilt_manual_says_how_to_build_it(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", manual_dir=tmp_path / "none")
    client = TestClient(create_app(settings), "http://127.0.0.1")
    for address in ("/manual", "/manual/"):
        answer = client.get(address)
        assert answer.status_code == 404
        assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        assert "make docs" in answer.text
        assert "RICOCHET_MANUAL_DIR" in answer.text
    deep = client.get("/manual/index.html")
    assert (deep.status_code, deep.headers["Content-Type"]) == (404, "application/problem+json")
