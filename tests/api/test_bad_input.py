"""Whatever is sent, the answer is a problem that names what is wrong, never a 500."""

import json
from typing import Any

import httpx
import pytest

from service.operations import OPERATIONS, Operation
from service.schemas.strike import PAPER, PAPER_AT_45

from .many import LINES
from .refused import LITERALS, TEXT, changed, problem_of, refused_at
from .test_bad_calibrations import CALIBRATIONS

USUAL = CALIBRATIONS | {"/trajectory": PAPER_AT_45, "/cra": PAPER}
BELOW_ZERO = {"model": "obliquity_polynomial", "coefficients": [8.0, -2.0]}
"""From 4° on, below where searches begin."""
EXAMPLES = {each.path: each.request.model_json_schema()["examples"][0] for each in OPERATIONS.values()}


@pytest.mark.parametrize("literal", LITERALS, ids=[literal[:10] for literal in LITERALS])
@pytest.mark.parametrize(
    ("path", "pointer"),
    [
        ("/trajectory", "/projectile/mass_kg"),
        ("/trajectory", "/projectile/nose/caliber_radius_head"),
        ("/trajectory", "/impact/oblique_angle_deg"),
        ("/cra", "/target/poissons_ratio"),
        ("/cra", "/search/tolerance_deg"),
        ("/calibration/depth", "/tests/3/depth_m"),
        ("/calibration/motion", "/history/rotation_deg/2"),
        ("/calibration/obliquity", "/points/2/strength_factor"),
    ],
)
def test_value_that_is_no_finite_number_is_named(client: httpx.Client, path: str, pointer: str, literal: str) -> None:
    body = json.dumps(changed(USUAL[path], pointer, "HERE"))
    answer = client.post(path, content=body.replace('"HERE"', literal), headers=TEXT)
    if literal == "null" and pointer.endswith(("poissons_ratio", "tolerance_deg")):  # An optional field is absent then.
        assert answer.json() == client.post(path, json=PAPER).json()
        return
    refused_at(answer, pointer)


@pytest.mark.parametrize(
    ("pointer", "value", "named"),
    [
        ("/projectile/mas_kg", 13.0, "/projectile/mas_kg"),
        ("/projectile/nose", {"shape": "flat", "a/b~c": 1.0}, "/projectile/nose/a~1b~0c"),
        ("/projectile/nose/points", [[0.0, 0.0]], "/projectile/nose/points"),
        ("/projectile/mass_kg", ..., "/projectile/mass_kg"),
        ("/projectile/mass_kg", -13.0, "/projectile/mass_kg"),
        ("/projectile/mass_kg", 0.0, "/projectile/mass_kg"),
        ("/projectile/mass_kg", 1e30, "/projectile/mass_kg"),
        ("/projectile/length_m", 0.1, "/projectile/length_m"),
        ("/projectile/center_of_gravity_m", 0.6, "/projectile/center_of_gravity_m"),
        ("/projectile/nose", ..., "/projectile/nose"),
        ("/projectile/nose", {"shape": "blunt"}, "/projectile/nose"),
        ("/projectile/nose", {"caliber_radius_head": 3.0}, "/projectile/nose"),
        ("/projectile/nose", {"shape": "ogive"}, "/projectile/nose/caliber_radius_head"),
        ("/projectile/nose", {"shape": "ogive", "caliber_radius_head": 0.4}, "/projectile/nose/caliber_radius_head"),
        (
            "/projectile/nose",
            {"shape": "profile", "points": [[0.0, 0.0], [0.05, 0.01], [0.1, 0.04]]},
            "/projectile/nose/points/2",
        ),
        ("/projectile/nose", {"shape": "profile", "points": [[0.0, 0.0], [0.1]]}, "/projectile/nose/points/1"),
        ("/projectile/nose", {"shape": "profile", "points": [[0.0, 0.0], [0.1, 0.03]]}, "/projectile/nose/points"),
        ("/projectile/nose", {"shape": "profile", "points": [[0.0, 0.0]] * 1001}, "/projectile/nose/points"),
        ("/target/poissons_ratio", 0.6, "/target/poissons_ratio"),
        ("/target/youngs_modulus_pa", 1e6, "/target/youngs_modulus_pa"),
        ("/impact/velocity_m_s", 0.0, "/impact/velocity_m_s"),
        ("/impact/oblique_angle_deg", 90.0, "/impact/oblique_angle_deg"),
        ("/impact/oblique_angle_deg", -1.0, "/impact/oblique_angle_deg"),
        ("/impact/oblique_angle_deg", ..., "/impact/oblique_angle_deg"),
        ("/resistance/strength_factor", BELOW_ZERO, "/resistance/strength_factor"),
        ("/resistance/strength_factor", {"model": "constant", "value": -1.0}, "/resistance/strength_factor/value"),
        ("/resistance/strength_factor", {"model": "constant"}, "/resistance/strength_factor/value"),
        (
            "/resistance/strength_factor",
            {"model": "obliquity_polynomial", "coefficients": [8.0, "x"]},
            "/resistance/strength_factor/coefficients/1",
        ),
        ("/resistance/free_surface", {"inertia": True}, "/resistance/free_surface/model"),
        ("/resistance/free_surface", {"model": "elastic_plastic", "inertia": 1}, "/resistance/free_surface/inertia"),
        ("/numerics/panels", 12000.5, "/numerics/panels"),
        ("/numerics/panels", True, "/numerics/panels"),
        ("/numerics/panels", 10**400, "/numerics/panels"),
        ("/numerics/method", "euler", "/numerics/method"),
        ("/output/sample_interval_s", 1e-7, "/output/sample_interval_s"),
        ("/output/history", "yes", "/output/history"),
        ("/search", {"method": "outcome"}, "/search"),
    ],
)
def test_trajectory_problem_names_the_field(client: httpx.Client, pointer: str, value: Any, named: str) -> None:
    refused_at(client.post("/trajectory", json=changed(PAPER_AT_45, pointer, value)), named)


@pytest.mark.parametrize(
    ("pointer", "value", "named"),
    [
        ("/impact/oblique_angle_deg", 45.0, "/impact/oblique_angle_deg"),
        ("/search/method", "newton", "/search/method"),
        ("/search", {"lower_deg": 50.0, "upper_deg": 50.0}, "/search/lower_deg"),
        ("/search", {"lower_deg": 86.0}, "/search/lower_deg"),
        ("/search", {"lower_deg": 60.0, "upper_deg": 50.0}, "/search/lower_deg"),
        ("/resistance/strength_factor", BELOW_ZERO, "/resistance/strength_factor"),
        ("/search/tolerance_deg", 0.0, "/search/tolerance_deg"),
        ("/projectile/length_m", 0.1, "/projectile/length_m"),
    ],
)
def test_cra_problem_names_the_field(client: httpx.Client, pointer: str, value: Any, named: str) -> None:
    refused_at(client.post("/cra", json=changed(PAPER, pointer, value)), named)


PAPER_TEXT = json.dumps(PAPER).encode()


@pytest.mark.parametrize(
    ("content", "status"),
    [
        (b"", 422),
        (b"null", 422),
        (b"[]", 422),
        (b"3", 422),
        (b'"text"', 422),
        (b"{", 400),
        (PAPER_TEXT + b"}", 400),
        (PAPER_TEXT.replace(b'"', b"'"), 400),
        (PAPER_TEXT.replace(b"ogive", b"og\xffive"), 400),
        (PAPER_TEXT.replace(b"ogive", b"og\\ud800ive"), 400),
        (b"\xff\xfe" + json.dumps(PAPER).encode("utf-16-le"), 400),
        (b"[" * 10_000, 400),
        (b"[" * 10_000 + b"]" * 10_000, 400),
        (b'{"a":' * 10_000 + b"1" + b"}" * 10_000, 400),
        (b'{"projectile": ' + b"1" * 5000 + b"}", 400),
        (PAPER_TEXT + b" " * 5_000_000, 413),
        (b'{"a": "' + b"x" * 5_000_000 + b'"}', 413),
    ],
    ids=lambda value: repr(value[:16]) if isinstance(value, bytes) else str(value),
)
@pytest.mark.parametrize("path", ["/trajectory", "/cra"])
def test_body_that_is_no_request_is_refused_whole(client: httpx.Client, path: str, content: bytes, status: int) -> None:
    found = problem_of(client.post(path, content=content, headers=TEXT), status)
    assert "" in [error.pointer for error in found.errors]


def test_long_body_without_a_declared_length_is_refused(client: httpx.Client) -> None:
    problem_of(client.post("/cra", content=(b" " * 65_536 for _ in range(80)), headers=TEXT), 413)


@pytest.mark.parametrize(
    "headers",
    [
        {"Content-Type": "text/plain"},
        {"Content-Type": "application/x-www-form-urlencoded"},
        {"Content-Type": "application/jsonl"},
        {"Content-Type": "multipart/form-data; boundary=x"},
        {"Content-Type": "\xff"},
        {"Content-Type": ""},
        TEXT | {"Content-Encoding": "gzip"},
    ],
)
def test_other_content_type_is_refused(client: httpx.Client, headers: dict[str, str]) -> None:
    encoded = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    found = problem_of(client.post("/cra", content=PAPER_TEXT, headers=encoded), 415)
    assert [error.pointer for error in found.errors] == [""]


def test_content_type_is_read_as_the_standard_says(client: httpx.Client) -> None:
    headers = {"Content-Type": 'Application/JSON ; charset="utf-8"'}
    assert client.post("/cra", content=PAPER_TEXT, headers=headers).status_code == 200


@pytest.mark.parametrize("path", ["/nothing", "/cra/", "/trajectory/1", "/results", "/results/", "/docs/assets/x"])
def test_unknown_path_is_not_found(client: httpx.Client, path: str) -> None:
    problem_of(client.get(path), 404)


@pytest.mark.parametrize("key", ["0" * 64, "0", "x" * 64, "..%2F..%2Fetc%2Fpasswd", "%00", "%FF", "A" * 5000])
def test_unknown_key_is_not_found(client: httpx.Client, key: str) -> None:
    problem_of(client.get(f"/results/{key}"), 404)


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("GET", "/cra", "POST"),
        ("DELETE", "/trajectory", "POST"),
        ("POST", "/results/" + "0" * 64, "GET, HEAD"),
        ("PUT", "/livez", "GET, HEAD"),
        ("POST", "/version", "GET, HEAD"),
        ("PATCH", "/cra", "POST"),
    ],
)
def test_unknown_method_is_answered_with_those_that_are_known(
    client: httpx.Client, method: str, path: str, allowed: str
) -> None:
    response = client.request(method, path)
    problem_of(response, 405)
    assert response.headers["Allow"] == allowed


@pytest.mark.parametrize("body_encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
@pytest.mark.parametrize("path", ["/trajectory", "/trajectory/batch"])
def test_encoding_that_json_does_not_have_is_named(client: httpx.Client, path: str, body_encoding: str) -> None:
    text = json.dumps(PAPER_AT_45)
    lines = {"Content-Type": "application/jsonl"} if path.endswith("batch") else TEXT
    problem = problem_of(
        client.post(path, content=text.encode(body_encoding), headers=lines), 422 if "batch" in path else 400
    )
    assert "byte order mark" in problem.detail or "UTF-16" in problem.detail
    assert "send UTF-8" in problem.detail


@pytest.mark.parametrize(
    ("path", "pointer", "value", "detail"),
    [
        ("/trajectory", "/impact/velocity_m_s", 2e4, "m/s, got 20000 m/s"),
        ("/trajectory", "/projectile/diameter_m", 80.0, "must be 0.001 to 5 m, got 80 m; give metres, 0.08 for 80 mm"),
        (
            "/cra",
            "/target/compressive_strength_pa",
            39.0,
            "must be 100000 to 1e+09 Pa, got 39 Pa; give pascals, 39e6 for 39 MPa",
        ),
        ("/trajectory", "/impact/oblique_angle_deg", 90.0, "must be less than 90°, got 90°"),
        ("/trajectory", "/numerics/termination_time_s", -1.0, " s"),
        ("/trajectory", "/impact/velocity", 238.0, "did you mean `impact.velocity_m_s`?"),
        ("/trajectory", "/impact/velocty_m_s", 238.0, "did you mean `impact.velocity_m_s`?"),
        (
            "/cra",
            "/projectile/nose/crh",
            3.0,
            "did you mean `projectile.nose.caliber_radius_head`?",
        ),
        ("/cra", "/velocity_m_s", 238.0, "did you mean `impact.velocity_m_s`?"),
        (
            "/cra",
            "/impact/oblique_angle_deg",
            45.0,
            "unknown field; the angle is what is searched for here: `/trajectory` takes a strike at one angle",
        ),
        ("/calibration/depth", "/tests/0/velocity", 238.0, "did you mean `tests.velocity_m_s`?"),
        ("/calibration/depth", "/tests/0/velocity_m_s", -1.0, "m/s"),
    ],
)
def test_message_has_the_bound_the_unit_and_what_may_be_meant(
    client: httpx.Client, path: str, pointer: str, value: float, detail: str
) -> None:
    body = changed(EXAMPLES[path], pointer, value)
    for sent, headers, where in ((json.dumps(body), TEXT, ""), (json.dumps(body), LINES, "/0")):
        if where and path.startswith("/calibration"):
            continue
        found = problem_of(client.post(f"{path}/batch" if where else path, content=sent, headers=headers), 422)
        assert {error.pointer: error.detail for error in found.errors}[where + pointer].endswith(detail)


def with_nulls(schema: dict[str, Any], node: dict[str, Any], part: Any) -> Any:
    """A part of a request as some generated clients send it: null for each optional field that is not given."""
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    if isinstance(part, list):
        return [with_nulls(schema, node.get("items", {}), each) for each in part]
    if not isinstance(part, dict):
        return part
    if "discriminator" in node:
        tag = node["discriminator"]
        node = schema["$defs"][tag["mapping"][part[tag["propertyName"]]].rpartition("/")[2]]
    fields = node.get("properties", {})
    absent = dict.fromkeys(fields.keys() - part.keys())
    return {**absent, **{name: with_nulls(schema, fields.get(name, {}), value) for name, value in part.items()}}


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda each: each.name)
def test_null_is_absent_in_optional_fields(operation: Operation) -> None:
    schema = operation.request.model_json_schema()
    for example in schema["examples"]:
        filled = with_nulls(schema, schema, example)
        assert operation.request.model_validate(filled) == operation.request.model_validate(example)


@pytest.mark.parametrize("pointer", ["/projectile/mass_kg", "/projectile/nose", "/impact/velocity_m_s", "/target"])
def test_null_in_a_required_field_is_named(client: httpx.Client, pointer: str) -> None:
    refused_at(client.post("/trajectory", json=changed(PAPER_AT_45, pointer, None)), pointer)


def test_null_is_absent_in_the_base_of_a_sweep(client: httpx.Client) -> None:
    axes = [{"field": "resistance.inertia_factor", "values": [1.0, 1.1]}]
    bases = (PAPER_AT_45, PAPER_AT_45 | {"resistance": None, "numerics": None, "output": None})
    with_null, without = (client.post("/trajectory/sweep", json={"base": base, "axes": axes}) for base in bases)
    assert with_null.raise_for_status().json() == without.json()
