"""Every exception is answered with its problem. The exceptions are raised by routes added to the application."""

from typing import Any

import httpx
import pytest
from starlette.requests import Request
from starlette.responses import Response

from docs import generated
from service import errors
from service.api.app import create_app
from service.schemas.problems import Problem
from solver import IntegrationError, ParameterError, StepLimitError
from tests.conftest import ROOT

from .refused import TEXT

pytestmark = pytest.mark.anyio


class UnforeseenError(Exception):
    pass


async def answer_to(error: Exception) -> httpx.Response:
    app = create_app()

    async def fail(_: Request) -> Response:
        raise error

    app.add_route("/fail", fail)
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://service") as client:
        return await client.get("/fail")


@pytest.mark.parametrize(
    ("error", "status", "name"),
    [
        (ParameterError("projectile.length", "too short"), 422, "invalid-request"),
        (StepLimitError(10, 0.02), 422, "step-limit"),
        (IntegrationError("no longer finite"), 422, "not-integrable"),
        (errors.TaskTimeoutError("more than 60 s"), 422, "timeout"),
        (errors.WorkerCrashedError("gave up"), 500, "worker-crashed"),
        (errors.PoolUnavailableError("stopping"), 503, "unavailable"),
        (errors.QueriesWaitingError(7), 503, "busy"),
        (errors.QueueFullError(7), 429, "queue-full"),
        (errors.IdempotencyConflictError("other"), 422, "idempotency-conflict"),
        (errors.IdempotencyBusyError("wait"), 409, "idempotency-busy"),
        (errors.StorageError("full"), 507, "storage-full"),
        (errors.InvalidBodyError([{"pointer": "/17", "detail": "is empty"}], "line 18"), 422, "invalid-request"),
        (UnforeseenError("secret"), 500, "internal-error"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else None,
)
async def test_exception_becomes_its_problem(error: Exception, status: int, name: str) -> None:
    response = await answer_to(error)
    problem = Problem.model_validate_json(response.content)
    assert response.headers["Content-Type"] == "application/problem+json"
    assert (response.status_code, problem.status, problem.type) == (status, status, f"urn:ricochet:problem:{name}")
    assert response.headers.get("Retry-After") == (
        str(getattr(error, "retry_after", 5)) if status in {429, 503} else None
    )
    assert "secret" not in response.text


async def test_run_beyond_the_step_limit_states_the_time_it_reached() -> None:
    response = await answer_to(StepLimitError(10_000, 0.02))
    problem = Problem.model_validate_json(response.content)
    assert (problem.stopped_at_s, problem.detail) == (0.02, "more than 10,000 steps, stopped at 0.02 s")


async def test_names_of_problems_are_unique() -> None:
    found = {
        error for error in vars(errors).values() if isinstance(error, type) and issubclass(error, errors.ServiceError)
    }
    titles = {(error.type, error.title) for error in found}
    assert len(titles) == len({error.type for error in found}) > 10


@pytest.mark.parametrize(
    ("request_", "status", "name"),
    [
        (("POST", "/cra", {"content": "{", "headers": TEXT}), 400, "bad-request"),
        (("GET", "/nothing", {}), 404, "not-found"),
        (("GET", f"/results/{'0' * 64}", {"headers": {"Accept": "image/png"}}), 406, "not-acceptable"),
        (("PUT", "/cra", {}), 405, "method-not-allowed"),
        (("POST", "/cra", {"content": " " * 10_000_000, "headers": TEXT}), 413, "body-too-long"),
        (("POST", "/cra", {"content": "{}", "headers": {"Content-Type": "text/plain"}}), 415, "unsupported-media-type"),
        (("GET", "/jobs", {"headers": {"Host": "elsewhere.example"}}), 421, "unknown-host"),
        (("GET", "/jobs", {"params": {"cursor": "?"}}), 422, "invalid-request"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_each_status_has_a_problem_type(
    client: httpx.Client, request_: tuple[str, str, dict[str, Any]], status: int, name: str
) -> None:
    method, path, arguments = request_
    answer = client.request(method, path, **arguments)
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:ricochet:problem:{name}")
    assert answer.json()["title"] in {each.title for each in errors.problem_types() if each.status == status}


async def test_manual_lists_every_type_of_problem() -> None:
    page = generated.filled((ROOT / "docs/reference/http.md").read_text(encoding="utf-8"))
    types = errors.problem_types()
    assert [each for each in types if f"| `{each.type}` | {int(each.status)} | {each.title} |" not in page] == []
    assert "about:blank" not in {each.type for each in types}


async def test_problem_in_json_lines_names_the_line() -> None:
    found = (await answer_to(errors.InvalidBodyError([{"pointer": "/17", "detail": "is empty"}], "line 18"))).json()
    assert (found["detail"], found["errors"]) == ("line 18: /17: is empty", [{"pointer": "/17", "detail": "is empty"}])


@pytest.mark.parametrize(
    ("field", "pointer"),
    [
        ("projectile.length", "/projectile/length_m"),
        ("projectile.nose.points.3", "/projectile/nose/points/3"),
        ("target.youngs_modulus", "/target/youngs_modulus_pa"),
        ("velocity", "/impact/velocity_m_s"),
        ("search.lower", "/search/lower_deg"),
        ("numerics.relative_tolerance", "/numerics/relative_tolerance"),
    ],
)
async def test_parameter_is_named_as_in_the_request(field: str, pointer: str) -> None:
    response = await answer_to(ParameterError(field, "is wrong"))
    assert response.json()["errors"] == [{"pointer": pointer, "detail": "is wrong"}]


def test_wrong_method_is_answered_with_all_methods_of_the_path(client: httpx.Client) -> None:
    paths = {"/jobs/1": "DELETE, GET, HEAD, PATCH", "/cra": "POST", "/jobs/1/cancel": "POST", "/livez": "GET, HEAD"}
    for path, allowed in paths.items():
        answer = client.request("PUT", path)
        assert (answer.status_code, answer.headers["Allow"]) == (405, allowed)
