"""Random JSON lines, valid and invalid. The contract declares them as bytes, so Schemathesis generates few of them."""

import json

import httpx
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from service.schemas.strike import PAPER, PAPER_AT_45

from .many import LINES, ROUGH
from .refused import LITERALS, changed

CASES = {"/cra/batch": PAPER | {"search": ROUGH}, "/trajectory/batch": PAPER_AT_45}
POINTERS = [
    *(f"/projectile/{name}" for name in ("nose", "nose/caliber_radius_head", "diameter_m", "length_m", "mass_kg")),
    *(f"/target/{name}" for name in ("compressive_strength_pa", "density_kg_m3", "poissons_ratio")),
    *(f"/impact/{name}" for name in ("velocity_m_s", "angle_of_attack_deg", "oblique_angle_deg")),
    *("/resistance", "/numerics", "/search", "/output", "/custom_id", "/unknown"),
]
values = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20) | st.lists(st.floats())


@st.composite
def changed_cases(draw: st.DrawFn) -> bytes:
    """A case in which one value is replaced by another, or by a literal that is not a finite number."""
    case = draw(st.sampled_from(list(CASES.values())))
    text = json.dumps(changed(case, draw(st.sampled_from(POINTERS)), "HERE"))
    return text.replace('"HERE"', draw(st.sampled_from(LITERALS) | values.map(json.dumps))).encode()


lines = st.one_of(
    st.sampled_from(list(CASES.values())).map(lambda case: json.dumps(case).encode()),
    changed_cases(),
    values.map(lambda value: json.dumps(value).encode()),
    st.binary(max_size=100),
)
bodies = st.builds(
    lambda end, body: end.join(body), st.sampled_from([b"\n", b"\r\n", b"\n\n", b""]), st.lists(lines, max_size=8)
)


@pytest.mark.parametrize(
    "examples", [100, pytest.param(5_000, marks=[pytest.mark.slow, pytest.mark.timeout(900)])], ids=str
)
@pytest.mark.parametrize("path", list(CASES))
def test_lines_are_answered_or_refused_with_a_problem(client: httpx.Client, path: str, examples: int) -> None:
    case = json.dumps(CASES[path]).encode()

    @given(body=bodies)
    @example(body=case)
    @settings(max_examples=examples, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    def send(body: bytes) -> None:
        answer = client.post(path, content=body, headers=LINES)
        assert answer.status_code in {200, 202, 400, 422}, answer.text
        if answer.is_error:
            assert answer.headers["Content-Type"] == "application/problem+json"
            assert answer.json()["errors"]

    send()
    assert client.post(path, content=case, headers=LINES).json()["results"][0]["result"]
