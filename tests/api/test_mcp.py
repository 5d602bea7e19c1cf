"""Tools of the Model Context Protocol, called with the client of the MCP SDK over HTTP, and over standard streams."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import anyio
import httpx
import httpx2
import pytest
from anyio import to_thread
from mcp import Client, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client
from mcp.types import CallToolResult, Tool

from service.schemas.strike import PAPER, PAPER_AT_45
from tests.cli.commands import environment
from tests.conftest import NO_TLS, RunService, Service, until

from .many import SPEED
from .owners import bearer, key_in
from .refused import TEXT

MODELS = ("CriticalAngleRequest", "TrajectoryRequest", None, "ThicknessRequest", "WallRequest")
NAMES = ["critical_angle", "trajectory", "uncertainty", "thickness", "judge_wall"]
UNCERTAIN = [SPEED]
OPENING = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}


class Conversation(NamedTuple):
    """Tools that a server lists, and the results of calls."""

    tools: list[Tool]
    results: list[CallToolResult]


def converse(server: Any, *calls: tuple[str, dict[str, Any]], mode: str = "auto") -> Conversation:
    """List the tools, then call some; the client validates results against the schemas in the list."""

    async def run() -> Conversation:
        async with Client(server, mode=mode) as client:
            tools = (await client.list_tools()).tools
            return Conversation(tools, [await client.call_tool(name, arguments) for name, arguments in calls])

    return anyio.run(run)


@asynccontextmanager
async def over_http(url: str, token: str | None = None) -> AsyncIterator[Any]:
    """Connect to the MCP endpoint of a service; yield the streams for a client."""
    headers = bearer(token) if token else {}
    async with (
        httpx2.AsyncClient(headers=headers, timeout=180.0, trust_env=False) as http,
        streamable_http_client(f"{url}/mcp", http_client=http) as streams,
    ):
        yield streams


def text_of(result: CallToolResult) -> str:
    content, *_ = result.content
    assert content.type == "text"
    return content.text


def problem_of(result: CallToolResult) -> dict[str, Any]:
    """Check that a call was refused without structured content; return the problem."""
    assert result.is_error
    assert result.structured_content is None
    _, document = result.content
    assert document.type == "text"
    problem: dict[str, Any] = json.loads(document.text)
    return problem


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_tools_are_listed_with_the_fields_of_the_routes(live_url: str, client: httpx.Client, mode: str) -> None:
    tools = converse(over_http(live_url), mode=mode).tools
    assert [tool.name for tool in tools] == NAMES
    contract = client.get("/openapi.json").json()["components"]["schemas"]
    for tool, model in zip(tools, MODELS, strict=True):
        assert tool.input_schema["type"] == "object"
        if model is not None:
            properties = tool.input_schema["properties"]
            assert tool.input_schema["required"] == contract[model]["required"]
            assert properties.keys() == contract[model]["properties"].keys() - {"units"}, "all texts are in SI"
            assert properties["projectile"]["required"] == contract["Projectile"]["required"]
    [projectile, *again] = (tool.input_schema["properties"]["projectile"] for tool in (*tools[:2], *tools[3:]))
    assert projectile["properties"].keys() == contract["Projectile"]["properties"].keys()
    # The list of tools leaves out the reason for the bounds.
    described = "Diameter of the shank, or the largest diameter of a body without a shank. [m]"
    assert projectile["properties"]["diameter_m"]["description"] == described
    shapes = [each["shape"] for each in projectile["properties"]["nose"]["examples"]]
    assert set(shapes) == contract["Nose"]["discriminator"]["mapping"].keys()
    assert [each["examples"] for each in again] == [contract["Projectile"]["examples"][:1]] * 3


def test_examples_of_the_schemas_are_answered(live_url: str) -> None:
    """Cases assembled from the examples in the list of tools are answered without an error."""
    [angle, *_] = converse(over_http(live_url)).tools
    properties = angle.input_schema["properties"]
    projectile = {"diameter_m": 0.08, "length_m": 0.53, "mass_kg": 13.0}
    noses = [projectile | {"nose": nose} for nose in properties["projectile"]["properties"]["nose"]["examples"]]
    for body in noses:
        if body["nose"] == {"shape": "sphere"}:  # A sphere is a whole body, whose length is its diameter.
            body["length_m"] = body["diameter_m"]
    cases = [PAPER | {"projectile": each} for each in noses]
    cases += [PAPER | {part: each} for part in ("resistance", "search") for each in properties[part]["examples"]]
    results = converse(over_http(live_url), *(("critical_angle", case) for case in cases)).results
    assert [text_of(result) for result in results if result.is_error] == []


def test_list_of_tools_is_small_enough_for_the_context_of_a_model(client: httpx.Client) -> None:
    message = {"jsonrpc": "2.0", "id": 1, "method": "tools/list"}
    response = client.post("/mcp", json=message, headers={"Accept": "application/json, text/event-stream"})
    assert [tool["name"] for tool in response.json()["result"]["tools"]] == NAMES
    assert len(response.content) < 15_600


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_structured_content_fits_the_schema_of_its_tool_even_in_a_refusal(live_url: str, mode: str) -> None:
    """Clients validate structured content against the schema, and would reject a refusal that does not fit it."""
    jsonschema = import_module("jsonschema")  # The import takes two seconds.
    short = PAPER | {"projectile": PAPER["projectile"] | {"length_m": 0.1}}
    study = PAPER | {"uncertain": UNCERTAIN, "sampling": {"max_samples": 131072}}
    calls: list[tuple[str, dict[str, Any]]] = [
        ("critical_angle", PAPER),
        ("trajectory", PAPER_AT_45),
        ("critical_angle", {}),
        ("critical_angle", short),
        ("trajectory", PAPER),
        ("uncertainty", {}),
        ("uncertainty", {"critical_angle": study}),
        ("thickness", PAPER_AT_45 | {"more": 1}),
    ]
    tools, results = converse(over_http(live_url), *calls, mode=mode)
    schemas = {tool.name: tool.output_schema for tool in tools}
    assert [result.is_error for result in results] == [False, False] + [True] * 6
    for (name, _), result in zip(calls, results, strict=True):
        if result.structured_content is not None:
            jsonschema.validate(result.structured_content, schemas[name])
        if result.is_error:
            assert problem_of(result)["status"] == 422
            assert len(text_of(result)) > 20
    [error] = problem_of(results[6])["errors"]
    assert error["pointer"] == "/critical_angle/sampling/max_samples"
    assert "at most 16384" in error["detail"]  # Larger studies have to be jobs.


SAMPLES = 16384


def long_study(name: str) -> dict[str, Any]:
    """Return a long study with a seed that depends on `name`, so that it is not cached."""
    seed = {"auto": 1, "legacy": 2, "pipes": 3}[name]
    sampling = {"max_samples": SAMPLES, "half_width": 1e-4, "method": "direct", "seed": seed}
    return PAPER | {"uncertain": UNCERTAIN, "sampling": sampling, "sensitivity": False}


class Keyed(NamedTuple):
    """Address of a service that requires keys, and tokens with different scopes and quotas."""

    url: str
    reads: str
    runs: str
    studies: str


@pytest.fixture(scope="module")
def keyed(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Keyed]:
    folder = tmp_path_factory.mktemp("keyed")
    reads = key_in(folder / "data", "anna", "read")
    runs = key_in(folder / "data", "anna", "run", cases_per_hour=2)
    studies = key_in(folder / "data", "bert", "run")
    with service_on(folder, access="keys", metrics_open="true") as service:
        yield Keyed(service.url, reads, runs, studies)


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_study_stops_when_its_client_disconnects(keyed: Keyed, mode: str) -> None:
    before = measured(keyed.url, "ricochet_cases_total")

    async def leave() -> None:
        async with Client(over_http(keyed.url, keyed.studies), mode=mode) as client, anyio.create_task_group() as calls:
            await client.list_tools()
            calls.start_soon(client.call_tool, "uncertainty", {"critical_angle": long_study(mode)})
            await to_thread.run_sync(until, lambda: measured(keyed.url, "ricochet_cases_total") > before)
            calls.cancel_scope.cancel()

    anyio.run(leave)
    check_that_it_has_ended(keyed.url, before)


def test_study_over_pipes_stops_when_the_input_closes(keyed: Keyed, tmp_path: Path) -> None:
    before = measured(keyed.url, "ricochet_cases_total")
    command = [sys.executable, "-W", "error", "-m", "service.cli", "mcp", "--url", keyed.url]
    study = {"name": "uncertainty", "arguments": {"critical_angle": long_study("pipes")}}
    messages: list[dict[str, Any]] = [
        {"id": 0, "method": "initialize", "params": OPENING},
        {"method": "notifications/initialized"},
        {"id": 1, "method": "tools/call", "params": study},
    ]
    own = environment(RICOCHET_API_KEY=keyed.studies)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=tmp_path, env=own) as process:
        assert process.stdin is not None
        for message in messages:
            process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
        process.stdin.flush()
        until(lambda: measured(keyed.url, "ricochet_cases_total") > before)
        process.stdin.close()
        assert process.wait(60.0) == 0
    check_that_it_has_ended(keyed.url, before)


def check_that_it_has_ended(url: str, before: float) -> None:
    """Check that a study has been stopped: nothing is queued, and part of its samples was never computed."""
    until(lambda: measured(url, "ricochet_queued_cases") == 0)
    assert measured(url, "ricochet_cases_total") - before < 0.9 * SAMPLES


def measured(url: str, name: str) -> float:
    """Return a metric of a service, summed over its labels."""
    lines = httpx.get(f"{url}/metrics", trust_env=False, verify=NO_TLS).text.splitlines()
    return sum(float(line.split()[-1]) for line in lines if line.startswith((f"{name} ", f"{name}{{")))


def test_tool_gives_the_answer_of_the_route_with_warnings_and_limits(live_url: str, client: httpx.Client) -> None:
    [result] = converse(over_http(live_url), ("critical_angle", PAPER)).results
    response = client.post("/cra", json=PAPER)
    assert response.headers["Cache-Status"] == "ricochet; hit"
    assert not result.is_error
    assert result.structured_content["answer"] == response.json()
    assert f"critical_angle_deg: {response.json()['critical_angle_deg']}" in text_of(result)
    check_caveats(result)


def check_caveats(result: CallToolResult) -> None:
    """Check that the text lists the warnings (or `none`), the notes marked `standing`, and the limits of validity."""
    answer, limits = (result.structured_content[name] for name in ("answer", "validity_limits"))
    details, standing = (
        [each["detail"] for each in answer["warnings"] if each.get("standing", False) is kind] for kind in (False, True)
    )
    assert len(limits) >= 5
    listed = [line for line in text_of(result).splitlines() if line.startswith("- ")]
    assert listed == [f"- {line}" for line in (*(details or ["none"]), *standing, *limits)]


def test_trajectory_tool_returns_a_summary_and_a_key_for_the_columns(live_url: str, client: httpx.Client) -> None:
    [result] = converse(over_http(live_url), ("trajectory", PAPER_AT_45)).results
    answer = result.structured_content["answer"]
    assert "history" not in answer
    assert answer["outcome"]
    check_caveats(result)
    whole = client.get(f"/results/{answer['key']}").json()
    assert len(whole.pop("history")["time_s"]) > 100
    assert whole == answer


def test_walls_and_uncertainty_are_answered(live_url: str, client: httpx.Client) -> None:
    study = PAPER | {"uncertain": UNCERTAIN, "sampling": {"max_samples": 256, "half_width": 0.2}, "sensitivity": False}
    wall = PAPER_AT_45 | {"numerics": {"relative_tolerance": 1e-3}}
    least, angle, both = converse(
        over_http(live_url),
        ("thickness", wall),
        ("uncertainty", {"critical_angle": study}),
        ("uncertainty", {"critical_angle": study, "trajectory": study}),
    ).results
    assert least.structured_content["answer"] == client.post("/thickness", json=wall).json()
    assert angle.structured_content["answer"] == client.post("/cra/uncertainty", json=study).json()
    assert "mean_deg: " in text_of(angle)
    assert least.structured_content["answer"]["warnings"]
    check_caveats(least)
    check_caveats(angle)
    assert both.is_error


def test_uncertainty_of_a_trajectory_lists_probabilities_of_zero_too(live_url: str, client: httpx.Client) -> None:
    normal = PAPER_AT_45 | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": 0.0}}
    study = normal | {"uncertain": UNCERTAIN, "sampling": {"max_samples": 256}}
    outcomes, one = converse(
        over_http(live_url), ("uncertainty", {"trajectory": study}), ("trajectory", normal)
    ).results
    answer = outcomes.structured_content["answer"]
    assert answer == client.post("/trajectory/uncertainty", json=study).json()
    values = {each["outcome"]: each["value"] for each in answer["outcomes"]}
    assert values["ricochet"] == 0.0
    for outcome, value in values.items():
        assert f"{outcome}: {value}\n" in text_of(outcomes)
    check_caveats(outcomes)
    assert one.structured_content["answer"]["final"]["axis_angle_deg"] == 0.0
    assert "final_axis_angle_deg: 0.0\n" in text_of(one)


@pytest.mark.parametrize(
    ("tool", "before"), [("critical_angle", ""), ("thickness", ""), ("trajectory", ""), ("uncertainty", "/trajectory")]
)
def test_missing_quantity_is_named_in_the_error(live_url: str, tool: str, before: str) -> None:
    projectile = {name: value for name, value in PAPER["projectile"].items() if name != "mass_kg"}
    body = PAPER_AT_45 | {"projectile": projectile} | ({"uncertain": UNCERTAIN} if before else {})
    if tool == "critical_angle":
        body |= {"impact": PAPER["impact"]}
    [result] = converse(over_http(live_url), (tool, {before[1:]: body} if before else body)).results
    assert result.is_error
    problem = problem_of(result)
    assert problem["type"] == "urn:ricochet:problem:invalid-request"
    assert [error["pointer"] for error in problem["errors"]] == [f"{before}/projectile/mass_kg"]
    assert f"{before}/projectile/mass_kg: is missing" in text_of(result)


def test_unknown_tool_is_answered_with_a_problem_type(live_url: str) -> None:
    [result] = converse(over_http(live_url), ("ballistics", {})).results
    assert result.is_error
    problem = problem_of(result)
    assert (problem["type"], problem["status"]) == ("urn:ricochet:problem:not-found", 404)
    assert "no tool 'ballistics'" in text_of(result)


def test_keys_scopes_and_quotas_apply_as_on_the_routes(keyed: Keyed) -> None:
    message = {"jsonrpc": "2.0", "id": 1, "method": "ping"}
    with httpx.Client(base_url=keyed.url, trust_env=False, timeout=60.0) as client:
        assert client.post("/mcp", json=message).status_code == 401
        reads = bearer(keyed.reads)
        assert client.post("/mcp", json=message, headers=reads).status_code == 403
        assert client.get("/mcp", headers=reads).status_code == 405
    short = PAPER | {"projectile": PAPER["projectile"] | {"length_m": 0.1}}  # Refused requests do not count.
    calls = [("critical_angle", short)] * 2 + [("critical_angle", PAPER)] * 3
    results = converse(over_http(keyed.url, keyed.runs), *calls).results
    assert [result.is_error for result in results] == [True, True, False, False, True]
    problem = problem_of(results[4])
    assert problem["type"] == "urn:ricochet:problem:quota"
    assert problem["retry_after_s"] > 0


def test_too_long_message_is_refused(client: httpx.Client) -> None:
    message = {"jsonrpc": "2.0", "id": 1, "method": "ping", "params": {"_meta": {"x": "y" * 200_000}}}
    headers = {"Accept": "application/json, text/event-stream"}
    assert client.post("/mcp", json=message, headers=headers).status_code == 413


def test_client_that_disconnects_while_sending_causes_no_failure(dedicated_service: Service) -> None:
    """The fixture checks that the log has no traceback."""
    port = int(dedicated_service.url.rpartition(":")[2])
    paths = ["/mcp", "/umbridge/Evaluate", "/cra", "/cra/batch", "/cra/sweep", "/calibration/depth", "/verdict"]
    for path in paths:
        with socket.create_connection(("127.0.0.1", port)) as connection:
            head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            connection.sendall(
                f"{head}Accept: application/json, text/event-stream\r\nContent-Length: 999\r\n\r\n{{".encode()
            )
    for path in paths:
        route = path.replace("Evaluate", "{endpoint}")
        count = f'ricochet_request_seconds_count{{method="POST",route="{route}",status="400"}}'
        until(lambda: measured(dedicated_service.url, count) == 1)  # noqa: B023 (called at once)


def test_messages_are_limited_like_other_bodies(client: httpx.Client) -> None:
    message = {"jsonrpc": "2.0", "id": 1, "method": "ping", "params": {"_meta": {str(n): n for n in range(1000)}}}
    headers = {"Accept": "application/json, text/event-stream"}
    assert client.post("/mcp", json=message, headers=headers).status_code == 422
    assert client.post("/mcp", content=b'{"jsonrpc":"2.0","id":1,"id":2}', headers=TEXT | headers).status_code == 400


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("where", ["service", "here"])
def test_command_ends_on_signals_while_its_input_is_open(
    live_url: str, tmp_path: Path, where: str, signum: signal.Signals
) -> None:
    arguments = ["--url", live_url] if where == "service" else []
    command = [sys.executable, "-W", "error", "-m", "service.cli", "mcp", *arguments]
    own = environment(RICOCHET_EXECUTOR="in-process")
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=tmp_path, env=own, **pipes) as process:
        assert process.stdin
        assert process.stdout
        assert process.stderr
        process.stdin.write(json.dumps({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": OPENING}).encode())
        process.stdin.write(b"\n")
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["id"] == 0
        process.send_signal(signum)
        status = process.wait(60.0)
        told = process.stderr.read().decode()
    assert status in ({130} if signum == signal.SIGINT else {143, -signal.SIGTERM}), told
    assert "Traceback" not in told


@pytest.mark.parametrize("ending", [b"\n", b""])
def test_command_reads_messages_from_a_file(live_url: str, tmp_path: Path, ending: bytes) -> None:
    """An event loop cannot wait for a regular file, unlike a pipe. The last line may lack a newline."""
    message = json.dumps({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": OPENING}).encode()
    (tmp_path / "messages").write_bytes(message + ending)
    command = [sys.executable, "-W", "error", "-m", "service.cli", "mcp", "--url", live_url]
    with (tmp_path / "messages").open("rb") as file:
        done = subprocess.run(command, stdin=file, capture_output=True, cwd=tmp_path, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["id"] == 0


@pytest.mark.parametrize("where", ["service", "here"])
def test_command_offers_the_same_tools_over_pipes(
    live_url: str, client: httpx.Client, tmp_path: Path, where: str
) -> None:
    arguments = ["--url", live_url] if where == "service" else []
    parameters = StdioServerParameters(
        command=sys.executable,
        args=["-W", "error", "-m", "service.cli", "mcp", *arguments],
        env=environment(RICOCHET_EXECUTOR="in-process"),
        cwd=tmp_path,
    )
    study = PAPER | {"uncertain": UNCERTAIN, "sampling": {"max_samples": 131072}}
    calls = ("critical_angle", PAPER), ("critical_angle", {"impact": {"velocity_m_s": 238.0}})
    tools, (result, missing, large) = converse(parameters, *calls, ("uncertainty", {"critical_angle": study}))
    assert [tool.name for tool in tools] == NAMES
    assert result.structured_content["answer"] == client.post("/cra", json=PAPER).json()
    assert missing.is_error
    pointers = [error["pointer"] for error in problem_of(missing)["errors"]]
    assert pointers == ["/projectile", "/target"]
    problem = problem_of(large)
    assert problem["type"] == "urn:ricochet:problem:invalid-request"
    assert [error["pointer"] for error in problem["errors"]] == ["/critical_angle/sampling/max_samples"]
