"""Links in answers of a service behind a proxy that removes a path prefix."""

from collections.abc import Iterator

import httpx
import pytest
from pydantic import ValidationError

from service.schemas.strike import PAPER
from service.settings import Settings
from tests.conftest import RunService

from .many import SPEED
from .owners import bearer, key_in

PREFIX = "/ricochet_1"
STUDY = PAPER | {
    "uncertain": [SPEED],
    "sampling": {"max_samples": 256, "half_width": 0.2},
    "sensitivity": False,
}
JOB = {"Prefer": "respond-async"}
WAIT = {"Prefer": "respond-async, wait=60"}


@pytest.fixture(scope="module")
def below(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """Client with a key that sends requests as the proxy would, without the prefix."""
    folder = tmp_path_factory.mktemp("below")
    token = key_in(folder / "data", "anna")
    settings = {"access": "keys", "metrics_open": "true", "allowed_hosts": "a.example,127.0.0.1", "root_path": PREFIX}
    with (
        service_on(folder, executor="in-process", **settings) as service,
        httpx.Client(base_url=service.url, headers=bearer(token), trust_env=False, timeout=180.0) as client,
    ):
        yield client


def passed_on(address: str) -> str:
    """Return the path that the proxy would request for a link, which must begin with the prefix."""
    assert address.startswith(f"{PREFIX}/")
    return address.removeprefix(PREFIX)


def test_links_of_a_job_are_below_the_prefix(below: httpx.Client) -> None:
    accepted = below.post("/cra/batch", json={"cases": [PAPER, {}]}, headers=JOB | {"Idempotency-Key": "one"})
    assert accepted.status_code == 422
    accepted = below.post("/cra/batch", json={"cases": [PAPER]}, headers=JOB)
    assert accepted.status_code == 202
    job = below.get(passed_on(accepted.headers["Location"])).json()
    assert job["links"] == accepted.json()["links"]
    for name in ("self", "results", "events"):
        assert below.get(passed_on(job["links"][name])).status_code == 200
    assert below.post(passed_on(job["links"]["cancel"])).json()["links"] == job["links"]
    assert job["links"] in [each["links"] for each in below.get("/jobs").json()["jobs"]]
    assert job["links"]["cancel"] in below.get(passed_on(job["links"]["events"])).text


def test_content_location_is_below_the_prefix(below: httpx.Client) -> None:
    batch = below.post("/cra/batch", json={"cases": [PAPER]}, headers=WAIT)
    study = below.post("/cra/uncertainty", json=STUDY, headers=WAIT)
    for answer in (batch, study):
        assert answer.status_code == 200
        assert below.get(passed_on(answer.headers["Content-Location"])).json() == answer.json()


def test_problems_and_the_contract_name_the_prefix(below: httpx.Client) -> None:
    assert below.post("/cra", json={}).json()["instance"] == f"{PREFIX}/cra"
    assert below.get("/jobs/none").json()["instance"] == f"{PREFIX}/jobs/none"
    assert below.get("/openapi.json").json()["servers"] == [{"url": PREFIX}]
    assert below.put("/cra").headers["Allow"] == "POST"


def test_only_the_open_paths_are_open_below_the_prefix(below: httpx.Client) -> None:
    with httpx.Client(base_url=below.base_url, trust_env=False, headers={"Host": "a.example"}) as nobody:
        assert nobody.get("/livez", headers={"Host": "other.example"}).status_code == 200
        assert nobody.get("/metrics").status_code == 200
        assert nobody.get("/jobs").status_code == 401
        assert nobody.get("/jobs", headers={"Authorization": below.headers["Authorization"]}).status_code == 200
        token = below.headers["Authorization"].removeprefix("Bearer ")
        shown = nobody.get(f"/jobs/{token}")
        assert shown.status_code == 400
        assert token not in shown.text


@pytest.mark.parametrize("path", ["ricochet", "/ricochet/", "/", "//a.example", "/a b", "https://a.example/ricochet"])
def test_prefix_is_a_path_without_a_trailing_slash(monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    monkeypatch.setenv("RICOCHET_ROOT_PATH", path)
    with pytest.raises(ValidationError, match="root_path"):
        Settings()
