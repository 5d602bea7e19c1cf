"""Bodies that are wrong in every way one can think of, made of good ones at random; the same ones for the same seed."""

import copy
import itertools
import json
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from service.schemas.examples import PAPER

JSON, JSONL = "application/json", "application/jsonl"
ROUGH = {"lower_deg": 40.0, "upper_deg": 80.0, "tolerance_deg": 1.0}
SEARCH = PAPER | {
    "impact": {"velocity_m_s": 240.0, "angle_of_attack_deg": 0.5},
    "resistance": {"strength_factor": {"model": "constant", "value": 8.5}, "free_surface": {"model": "mohr_coulomb"}},
    "numerics": {"method": "adaptive", "relative_tolerance": 1e-3, "termination_time_s": 0.02},
    "search": ROUGH,
    "output": {"history": False},
}
STRIKE = {name: part for name, part in SEARCH.items() if name != "search"} | {
    "impact": {"velocity_m_s": 240.0, "oblique_angle_deg": 50.0},
    "output": {"history": True, "sample_interval_s": 1e-4},
}
AXES = [
    {"field": "impact.velocity_m_s", "values": [240.0, 250.0]},
    {"field": "target.density_kg_m3", "start": 2200.0, "stop": 2300.0, "count": 2},
]
TESTS = [{"velocity_m_s": 238.1, "depth_m": 0.3}, {"velocity_m_s": 314.0, "depth_m": 0.45, "mass_kg": 12.91}]
MODEL = {name: PAPER[name] for name in ("projectile", "target")}
MOTION = MODEL | {
    "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0},
    "history": {
        "time_s": [0.0, 1e-3, 2e-3],
        "depth_displacement_m": [0.0, 0.173, 0.252],
        "rotation_deg": [0, 7.1, 11.6],
    },
    "weights": {"rotation": 0.5},
    "until_s": 0.002,
}
POINTS = [{"oblique_angle_deg": angle, "strength_factor": 8.5 - 0.05 * angle} for angle in (0.0, 15.0, 30.0, 45.0)]
NUMBERS = (0, -0.0, -1, 1, 1e-320, 1e-9, 1e9, 1e308, -1e308, 2**63, 10**30, 89.999, 90, 0.5, 100_000)
OTHERS: tuple[Any, ...] = (
    None,
    True,
    False,
    "",
    "1",
    "NaN",
    "ogive",
    "\ud800",
    "\0",
    "x" * 20_000,
    [],
    {},
    [1.0],
    {"model": "none"},
)
RAW = (
    "[" * 3_000,
    "[" * 150 + "]" * 150,
    "[" * 3_000 + "]" * 3_000,
    "NaN",
    "Infinity",
    "-Infinity",
    "1e999",
    "-1e999",
    "1" * 5_000,
    "01",
    "1.",
    "+1",
    "0x1",
    "'a'",
)
"""What is no JSON, or no number, as text."""
MARK = "\x01raw\x01"
BYTES = (b"\0", b"\xff", b"\xef\xbb\xbf", b"{", b"}", b"[", b"]", b'"', b",", b":", b"\n", b"\r\n", b"\\u", b"-", b"e9")


@dataclass(frozen=True, slots=True)
class Mutant:
    """A request that may be wrong."""

    path: str
    media_type: str
    body: bytes
    background: bool
    """Whether to ask for a job."""


def mutants(count: int, seed: int) -> Iterator[Mutant]:
    """So many requests, over all routes that take a body."""
    chance = random.Random(seed)  # noqa: S311 (not for secrets)
    for path, media_type in itertools.islice(itertools.cycle(ROUTES), count):
        make = ROUTES[path, media_type]
        text = _of_content(chance, make, media_type) if chance.random() < 0.7 else _to_body(make(), media_type)
        if not text or chance.random() < 0.4:
            text = _of_bytes(chance, text)
        wrong_type = chance.random() < 0.01
        yield Mutant(path, "text/plain" if wrong_type else media_type, text, chance.random() < 0.05)


def _batch(case: dict[str, Any]) -> dict[str, Any]:
    return {"cases": [case | {"custom_id": "a"}, case | {"impact": case["impact"] | {"velocity_m_s": 250.0}}]}


def _sweep(case: dict[str, Any]) -> dict[str, Any]:
    return {"base": case, "axes": AXES}


ROUTES: dict[tuple[str, str], Callable[[], Any]] = {
    ("/trajectory", JSON): lambda: STRIKE,
    ("/cra", JSON): lambda: SEARCH,
    ("/trajectory/batch", JSON): lambda: _batch(STRIKE),
    ("/cra/batch", JSON): lambda: _batch(SEARCH),
    ("/trajectory/batch", JSONL): lambda: _batch(STRIKE)["cases"],
    ("/cra/batch", JSONL): lambda: _batch(SEARCH)["cases"],
    ("/trajectory/sweep", JSON): lambda: _sweep(STRIKE),
    ("/cra/sweep", JSON): lambda: _sweep(SEARCH),
    ("/calibration/depth", JSON): lambda: MODEL | {"tests": TESTS, "compare_strength_factors": [8.0]},
    ("/calibration/motion", JSON): lambda: MOTION,
    ("/calibration/obliquity", JSON): lambda: {"points": POINTS, "order": 2},
}


def _to_body(content: Any, media_type: str) -> bytes:
    if media_type == JSONL and isinstance(content, list):
        return b"\n".join(json.dumps(line).encode() for line in content)
    return json.dumps(content).encode()


def _of_content(chance: random.Random, make: Callable[[], Any], media_type: str) -> bytes:
    """Change one to three things in what the body says."""
    content = copy.deepcopy(make())
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        places = list(_places(content))
        if places:
            _change(chance, *chance.choice(places))
    text = _to_body(content, media_type)
    mark = json.dumps(MARK).encode()
    while mark in text:
        text = text.replace(mark, chance.choice(RAW).encode(), 1)
    return text


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Every object or array, with every name or index in it."""
    found = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for name, value in list(found):
        yield content, name
        yield from _places(value)


def _change(chance: random.Random, owner: Any, name: Any) -> None:
    value = owner[name]
    ways: list[Callable[[], Any]] = [
        lambda: owner.pop(name),
        lambda: owner.__setitem__(name, chance.choice(NUMBERS)),
        lambda: owner.__setitem__(name, copy.deepcopy(chance.choice(OTHERS))),
        lambda: owner.__setitem__(name, MARK),
        lambda: owner.__setitem__(name, [value]),
        lambda: owner.__setitem__(name, {"value": value}),
    ]
    if isinstance(value, float | int):
        ways += 3 * [lambda: owner.__setitem__(name, value * chance.choice((-1.0, 0.0, 1e-3, 0.5, 2.0, 1e3, 1e12)))]
    if isinstance(owner, dict):
        ways += [
            lambda: owner.__setitem__(f"{name}_", owner.pop(name)),
            lambda: owner.__setitem__(chance.choice(("", "~/", "constructor", "x" * 1_000, "é")), value),
        ]
    else:
        ways += [lambda: owner.append(value), lambda: owner.extend([value] * chance.choice((10, 1_100)))]
    chance.choice(ways)()


def _of_bytes(chance: random.Random, text: bytes) -> bytes:
    """Change one to three places of the text."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        start, end = sorted(chance.randrange(len(text) + 1) for _ in range(2))
        piece = text[start : min(end, start + 200)]
        text = chance.choice(
            (
                text[:start],
                text[:start] + text[end:],
                text[:start] + chance.choice(BYTES) + text[start:],
                text[:start] + chance.randbytes(chance.choice((1, 4, 100))) + text[start:],
                text[:start] + piece + text[start:],
                text[:start] + bytes([chance.randrange(256)]) + text[start + 1 :],
            )
        )
    return text
