"""`"alternatives": true`: the same case under other laws, each computed and cached like any other case."""

import asyncio
from typing import Any

import httpx

from service.schemas import CriticalAngleAnswer, TrajectoryAnswer
from service.schemas.strike import PAPER, PAPER_AT_45

from .refused import refused_at

THEORIES = [
    ("obliquity_polynomial", "equation_9"),
    ("strength_power_law", "finite_elements"),
    ("published_tests", "equation_9"),
    ("strength_power_law", "constant"),
]
LAWS = [
    *(("elastic_plastic", *law) for law in THEORIES),
    *(("mohr_coulomb", *law) for law in THEORIES),
    *(("none", *law) for law in THEORIES if law[1] != "finite_elements"),
]

NEVER_YIELDS = PAPER["target"] | {"youngs_modulus_pa": 1e7}
"""Concrete whose modulus is too low for it to yield around an expanding cavity, which both decay theories assume."""


def strike(velocity: float, **more: Any) -> dict[str, Any]:
    """Return the paper's case at this velocity, with other fields changed."""
    return PAPER | {"impact": {"velocity_m_s": velocity}} | more


def under(body: dict[str, Any], alternative: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of the body with the laws of an alternative."""
    resistance: dict[str, Any] = {name: {"model": alternative[name]} for name in ("free_surface", "strength_factor")}
    if alternative.get("obliquity_shape") == "finite_elements":
        resistance["strength_factor"] |= {"coefficient": 8.469, "exponent": 0, "obliquity_shape": "finite_elements"}
    return body | {"resistance": resistance}


def test_alternative_equals_the_answer_to_its_own_query_which_is_then_cached(client: httpx.Client) -> None:
    body = strike(231.25)
    response = client.post("/cra", json=body | {"alternatives": True})
    assert response.headers["Cache-Status"] == "ricochet; fwd=miss"
    answer = CriticalAngleAnswer.model_validate(response.json())
    assert isinstance(answer.alternatives, list)
    assert [(each.free_surface, each.strength_factor, each.obliquity_shape) for each in answer.alternatives] == LAWS
    for each in response.json()["alternatives"]:
        own = client.post("/cra", json=under(body, each))
        assert own.headers["Cache-Status"] == "ricochet; hit"
        assert each["status"] == own.json()["status"]
        assert each["critical_angle_deg"] == own.json()["critical_angle_deg"]
        assert each["fitted_to"]


def test_outcome_is_found_under_each_law(client: httpx.Client) -> None:
    body = PAPER_AT_45 | {"impact": {"velocity_m_s": 231.25, "oblique_angle_deg": 45.0}}
    response = client.post("/trajectory", json=body | {"alternatives": True})
    answer = TrajectoryAnswer.model_validate(response.json())
    assert isinstance(answer.alternatives, list)
    assert [(each.free_surface, each.strength_factor, each.obliquity_shape) for each in answer.alternatives] == LAWS
    for each in response.json()["alternatives"]:
        own = client.post("/trajectory", json=under(body, each))
        assert own.headers["Cache-Status"] == "ricochet; hit"
        assert each["outcome"] == own.json()["outcome"]
        assert "status" not in each


def test_alternatives_change_neither_key_nor_answer_of_the_case(client: httpx.Client) -> None:
    for path, body in (("/cra", strike(232.25)), ("/trajectory", PAPER_AT_45)):
        answers = [
            client.post(path, json=body | extra).json()
            for extra in ({"alternatives": True}, {}, {"alternatives": False}, {"alternatives": True})
        ]
        others = [answer.pop("alternatives", None) for answer in answers]
        assert answers[0] == answers[1] == answers[2] == answers[3]
        assert others[1] is None
        assert others[2] is None
        assert others[0] == others[3]
        kept = client.get(f"/results/{answers[0]['key']}").json()
        assert kept == answers[0]


def test_cached_alternatives_are_not_computed_again(client: httpx.Client) -> None:
    def misses() -> float:
        lines = client.get("/metrics").text.splitlines()
        return sum(
            float(line.rpartition(" ")[2])
            for line in lines
            if line.startswith("ricochet_cases_total") and 'operation="cra"' in line and 'cache="miss"' in line
        )

    body = strike(233.25)
    client.post("/cra", json=under(body, {"free_surface": "none", "strength_factor": "published_tests"}))
    before = misses()
    first = client.post("/cra", json=body | {"alternatives": True})
    assert first.headers["Cache-Status"] == "ricochet; fwd=miss"
    assert misses() - before == len(LAWS) - 1  # One of them is cached.
    again = client.post("/cra", json=body | {"alternatives": True})
    assert again.headers["Cache-Status"] == "ricochet; hit"
    assert again.content == first.content
    assert misses() - before == len(LAWS) - 1


def test_law_without_an_answer_has_a_problem_and_the_others_their_angles(client: httpx.Client) -> None:
    body = strike(238.0, resistance={"free_surface": {"model": "none"}}, target=NEVER_YIELDS)
    answer = client.post("/cra", json=body | {"alternatives": True}).raise_for_status().json()
    CriticalAngleAnswer.model_validate(answer)
    for each in answer["alternatives"]:
        if each["free_surface"] == "none":
            assert each["critical_angle_deg"] > 0.0
        else:
            assert "status" not in each
            assert each["problem"]["errors"][0]["pointer"] == "/target/youngs_modulus_pa"
            assert each["problem"]["instance"] == "/cra"


def test_alternatives_without_an_angle_have_a_status(client: httpx.Client) -> None:
    body = strike(238.0, search={"lower_deg": 10.0, "upper_deg": 20.0}, alternatives=True)
    for each in client.post("/cra", json=body).json()["alternatives"]:
        assert each["status"] == "no_ricochet"
        assert "critical_angle_deg" not in each


def test_alternatives_over_http_keep_the_inertia_of_the_case(client: httpx.Client) -> None:
    body = strike(238.0)
    inertia = {"inertia_factor": 0.5, "free_surface": {"model": "mohr_coulomb", "inertia": True}}
    own = client.post("/cra", json=body | {"resistance": inertia, "alternatives": True}).json()
    plain = client.post("/cra", json=body | {"alternatives": True}).json()
    (same,) = [
        each
        for each in own["alternatives"]
        if (each["free_surface"], each["strength_factor"]) == ("mohr_coulomb", "obliquity_polynomial")
    ]
    assert same["critical_angle_deg"] == own["critical_angle_deg"]
    for one, other in zip(own["alternatives"], plain["alternatives"], strict=True):
        assert one["critical_angle_deg"] != other["critical_angle_deg"]


def test_equal_concurrent_requests_share_their_work(live_url: str) -> None:
    async def ask() -> list[httpx.Response]:
        async with httpx.AsyncClient(base_url=live_url, timeout=60.0, trust_env=False) as client:
            body = strike(234.25, alternatives=True)
            return list(await asyncio.gather(*(client.post("/cra", json=body) for _ in range(4))))

    responses = asyncio.run(ask())
    assert {response.status_code for response in responses} == {200}
    assert len({response.content for response in responses}) == 1


def test_invalid_case_is_refused_with_all_its_alternatives(client: httpx.Client) -> None:
    body = strike(238.0, alternatives=True) | {"target": NEVER_YIELDS}
    refused_at(client.post("/cra", json=body), "/target/youngs_modulus_pa")
