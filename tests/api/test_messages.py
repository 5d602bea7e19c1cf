"""Messages of refused requests match `messages.txt`, which covers all routes.

A line of `CHANGES` has a path, a JSON pointer into a valid body and the new value, or no value to leave the field out.
Messages must not contain internal names.
After rewording a message, regenerate the file with `.venv/bin/python -m tests.api.test_messages`, and read the
differences before you commit them.
"""

import json
import re
import tempfile
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.operations import OPERATIONS
from service.schemas.calibration_depth import TABLE_1
from service.schemas.calibration_motion import AT_30
from service.schemas.problems import Problem
from service.schemas.strike import BOAT_TAIL, PAPER, PAPER_AT_45, SPHERE
from tests.conftest import running_service

from .many import LINES
from .refused import TEXT, changed

MESSAGES = Path(__file__).with_name("messages.txt")
EQ_9 = {"model": "obliquity_polynomial", "coefficients": [8.469, 0.0149, -0.0013]}
RUN = {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0}, "history": AT_30}
SHARED = {"projectile": PAPER["projectile"], "target": PAPER["target"]}
VELOCITY = {"field": "impact.velocity_m_s", "values": [230.0, 240.0]}
STRENGTH = {"field": "target.compressive_strength_pa", "start": 35e6, "stop": 45e6, "count": 3}
USUAL: dict[str, Any] = {each.path: each.request.model_json_schema()["examples"][0] for each in OPERATIONS.values()}
USUAL |= {
    "/calibration/motion runs": SHARED | {"runs": [RUN, deepcopy(RUN)]},
    "/cra/batch": {"cases": [PAPER]},
    "/cra/sweep": {"base": PAPER, "axes": [VELOCITY, STRENGTH]},
    "/thickness/batch": {"cases": [USUAL["/thickness"]]},
    "/thickness/sweep": {"base": USUAL["/thickness"], "axes": [STRENGTH]},
    "/limit-speed/sweep": {"base": USUAL["/limit-speed"], "axes": [STRENGTH]},
    "/verdict": PAPER_AT_45,
    "/report": PAPER_AT_45,
}
CHANGES = """\
/trajectory /projectile/mass_kg
/trajectory /projectile/mass_kg -13.0
/trajectory /projectile/mass_kg 0.0
/trajectory /projectile/mass_kg 1e30
/trajectory /projectile/mass_kg NaN
/trajectory /projectile/mass_kg -Infinity
/trajectory /projectile/mass_kg 1e999
/trajectory /projectile/mass_kg "13"
/trajectory /projectile/mass_kg "13 kg"
/trajectory /projectile/mass_kg "13,0"
/trajectory /projectile/mass_kg true
/trajectory /projectile/mass_kg null
/trajectory /projectile/mass_kg [13]
/trajectory /projectile/mass_kg {}
/trajectory /projectile/mas_kg 13.0
/trajectory /projectile null
/trajectory /projectile/nose
/trajectory /projectile/nose null
/trajectory /projectile/nose "ogive"
/trajectory /projectile/nose {"shape": "blunt"}
/trajectory /projectile/nose {"caliber_radius_head": 3.0}
/trajectory /projectile/nose {"shape": "ogive"}
/trajectory /projectile/nose {"shape": "ogive", "caliber_radius_head": 0.4}
/trajectory /projectile/nose {"shape": "flat", "a/b~c": 1.0}
/trajectory /projectile/nose {"shape": "sphere"}
/trajectory /projectile/nose/points [[0.0, 0.0]]
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.05, 0.01], [0.1, 0.04]]}
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.1]]}
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.1, 0.03]]}
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.05, NaN]]}
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.1, 0.04], [0.2, 0.03]]}
/trajectory /projectile/nose {"shape": "profile", "points": [[0.0, 0.0], [0.05, 0.03], [0.05, 0.03], [0.12, 0.04]]}
/trajectory /projectile/length_m 0.1
/trajectory /projectile/diameter_m 80.0
/trajectory /projectile/center_of_gravity_m 0.6
/trajectory /projectile/boat_tail 0.1
/trajectory /projectile/boat_tail {"length_m": 0.1}
/trajectory /projectile/boat_tail {"length_m": 0.5, "base_diameter_m": 0.06}
/trajectory /projectile/boat_tail {"length_m": 0.1, "base_diameter_m": 0.09}
/trajectory /projectile/inner_diameter_m 0.09
/trajectory /projectile/yield_strength_pa 900
/trajectory /target
/trajectory /target "concrete"
/trajectory /target/poissons_ratio 0.6
/trajectory /target/youngs_modulus_pa 1e6
/trajectory /target/youngs_modulus_pa 1e7
/trajectory /target/thickness_m 0.0
/trajectory /target/thickness_m -0.2
/trajectory /target/thickness_m 0.0079
/trajectory /target/reinforcement_ratio_percent 10.5
/trajectory /impact/velocity_m_s 0.0
/trajectory /impact/velocity_m_s 2e4
/trajectory /impact/velocity 238.0
/trajectory /impact/velocty_m_s 238.0
/trajectory /impact/oblique_angle_deg
/trajectory /impact/oblique_angle_deg 90.0
/trajectory /impact/oblique_angle_deg -1.0
/trajectory /resistance/strength_factor 8.5
/trajectory /resistance/strength_factor {"model": "polynomial"}
/trajectory /resistance/strength_factor {"value": 8.5}
/trajectory /resistance/strength_factor {"model": "obliquity_polynomial", "coefficients": [8.0, -2.0]}
/trajectory /resistance/strength_factor {"model": "obliquity_polynomial", "coefficients": [8.0, "x"]}
/trajectory /resistance/strength_factor {"model": "obliquity_polynomial", "held_from_deg": -1}
/trajectory /resistance/strength_factor {"model": "obliquity_polynomial", "held_from_deg": 90.1}
/trajectory /resistance/strength_factor {"model": "constant", "value": -1.0}
/trajectory /resistance/strength_factor {"model": "constant"}
/trajectory /resistance/strength_factor {"model": "published_tests", "obliquity_shape": "cosine"}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": []}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": [{"velocity_m_s": 238.1}]}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": [{"velocity_m_s": -1.0, "depth_m": 0.3}]}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": [{"velocity_m_s": 238.1, "depth_m": 0.0}]}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": [{"velocity_m_s": 238.1, "depth_m": 30.0}]}
/trajectory /resistance/strength_factor {"model": "own_tests", "shots": [{"velocity_m_s": 0.1, "depth_m": 1e-6}]}
/trajectory /resistance/free_surface "none"
/trajectory /resistance/free_surface {"inertia": true}
/trajectory /resistance/free_surface {"model": "elastic_plastic", "inertia": 1}
/trajectory /resistance/rear_plug {"cone_angle_deg": 9.0}
/trajectory /resistance/rear_plug {"height_m": 0.1}
/trajectory /resistance/crater 2.0
/trajectory /resistance/crater {"depth_diameters": 0.0}
/trajectory /numerics/panels 12000.5
/trajectory /numerics/panels true
/trajectory /numerics/method "euler"
/trajectory /numerics/termination_time_s -1.0
/trajectory /output/sample_interval_s 1e-7
/trajectory /output/history "yes"
/trajectory /flight {"face_tilt_deg": 91.0}
/trajectory /flight {"height_m": -1.0}
/trajectory /flight {"incidence_plane": "sideways"}
/trajectory /search {"method": "outcome"}
/cra /impact/oblique_angle_deg 45.0
/cra /velocity_m_s 238.0
/cra /projectile/nose/crh 3.0
/cra /target/compressive_strength_pa 39.0
/cra /target 3
/cra /target/thickness_m 0.0079
/cra /search/method "newton"
/cra /search {"lower_deg": 50.0, "upper_deg": 50.0}
/cra /search {"lower_deg": 86.0}
/cra /search {"lower_deg": 60.0, "upper_deg": 50.0}
/cra /search/tolerance_deg 0.0
/cra /alternatives 1
/cra /alternatives "true"
/cra /strength_scatter "paper"
/cra /strength_scatter 1
/cra /strength_scatter ["law"]
/verdict /flight {"face_tilt_deg": 91.0}
/report /flight {"height_m": -0.1}
/formulas /impact/velocity_m_s -1.0
/formulas /impact {}
/formulas /impact/oblique_angle_deg 90.0
/formulas /resistance {}
/flight /height_m -0.1
/flight /speed_m_s 0.0
/flight /elevation_deg 90.5
/flight /elevation_deg
/thickness /target/thickness_m 0.2
/thickness /impact/oblique_angle_deg
/limit-speed /target/thickness_m
/limit-speed /target/thickness_m 0.0
/limit-speed /impact/velocity_m_s 238.0
/cra/uncertainty /uncertain []
/cra/uncertainty /uncertain {}
/cra/uncertainty /uncertain/0/field "velocity"
/cra/uncertainty /uncertain/0/field "impact"
/cra/uncertainty /uncertain/1/field "impact.velocity_m_s"
/cra/uncertainty /uncertain/0/distribution "normal"
/cra/uncertainty /uncertain/0/distribution {"type": "gauss"}
/cra/uncertainty /uncertain/0/distribution {"type": "normal", "mean": 238.0}
/cra/uncertainty /uncertain/0/distribution {"type": "normal", "mean": 238.0, "standard_deviation": -2.0}
/cra/uncertainty /uncertain/0/distribution {"type": "uniform", "lower": 240.0, "upper": 230.0}
/cra/uncertainty /uncertain/0/distribution {"type": "lognormal", "median": 0.0, "dispersion": 0.1}
/cra/uncertainty /sampling {"max_samples": 3}
/cra/uncertainty /sampling {"half_width": 2.0}
/cra/uncertainty /sampling/seed -1
/trajectory/uncertainty /flight {"face_tilt_deg": 91.0}
/trajectory/uncertainty /flight {"drag_coefficient": -1.0}
/cra/batch /cases []
/cra/batch /cases {}
/cra/batch /cases
/cra/batch /name "x"
/cra/batch /cases/0 null
/cra/batch /cases/0 {}
/cra/batch /cases/0/impact/velocity_m_s -1.0
/cra/batch /cases/0/custom_id ""
/cra/batch /cases/0/custom_id 17
/cra/batch /cases/0/extra 1
/cra/batch /cases/0/alternatives true
/thickness/batch /cases/0/target/thickness_m 0.2
/cra/sweep /axes/0/field "impact.speed"
/cra/sweep /axes/0/field ""
/cra/sweep /axes/0/field "impact"
/cra/sweep /axes/0/field "search.method"
/cra/sweep /axes/0/field "output.history"
/cra/sweep /axes/0/field "impact.velocity_m_s.x"
/cra/sweep /axes/0/field "projectile.nose.length_to_diameter"
/cra/sweep /axes/0/field "resistance.strength_factor.value"
/cra/sweep /axes/1/field "impact.velocity_m_s"
/cra/sweep /axes/0/start 1.0
/cra/sweep /axes/1/count
/cra/sweep /axes/0/values []
/cra/sweep /axes/0/values [230.0, "240"]
/cra/sweep /axes/0/values [230.0, -1.0]
/cra/sweep /axes/1/count 0
/cra/sweep /axes/1/count 2.5
/cra/sweep /axes/1/count 100000
/cra/sweep /axes/1/stop 1e15
/cra/sweep /axes []
/cra/sweep /axes [1, 2, 3, 4, 5]
/cra/sweep /axes/1 {"field": "numerics.panels", "start": 100, "stop": 101, "count": 3}
/cra/sweep /base []
/cra/sweep /base/extra 1
/cra/sweep /base/target
/cra/sweep /base/impact 3
/cra/sweep /base/impact {}
/cra/sweep /base/alternatives true
/thickness/sweep /axes/0 {"field": "target.thickness_m", "values": [0.2, 0.3]}
/thickness/sweep /base/impact/velocity_m_s
/limit-speed/sweep /base/target/thickness_m
/limit-speed/sweep /axes/0 {"field": "impact.velocity_m_s", "values": [200.0]}
/calibration/depth /tests
/calibration/depth /tests []
/calibration/depth /tests/3/velocity_m_s 0.0
/calibration/depth /tests/3/velocity_m_s -238.0
/calibration/depth /tests/2/depth_m 0.0
/calibration/depth /tests/2/depth_m 450.0
/calibration/depth /tests/1/mass_kg 0.0
/calibration/depth /tests/1/weight 0.0
/calibration/depth /tests/1/velocity 275.7
/calibration/depth /tests/0/group "one"
/calibration/depth /tests/0/group ""
/calibration/depth /projectile/length_m 0.1
/calibration/depth /target
/calibration/depth /resistance {"strength_factor": {"model": "constant", "value": 8.5}}
/calibration/depth /resistance {"crater": {"depth_diameters": 0.0}}
/calibration/depth /numerics {"method": "panels", "panels": 10}
/calibration/depth /numerics {"method": "panels", "panels": 100000, "time_step_s": 1e-7}
/calibration/depth /confidence_level 1.0
/calibration/depth /compare_strength_factors [0.0]
/calibration/depth /target/compressive_strength_pa 1e5
/calibration/motion /history {"time_s": [0.0, 0.001]}
/calibration/motion /history/time_s
/calibration/motion /history/time_s [0.0]
/calibration/motion /history/time_s/3 0.0005
/calibration/motion /history/time_s/3 0.001
/calibration/motion /history/time_s/0 -0.001
/calibration/motion /history/rotation_deg [0.0, 1.0, 2.0]
/calibration/motion /history/rotation_deg/3 "11"
/calibration/motion /history/rotation_deg/3 1100.0
/calibration/motion /history/depth_displacement_m/3 226.0
/calibration/motion /history/velocity_m_s [0.0, 1.0]
/calibration/motion /impact
/calibration/motion /impact/oblique_angle_deg
/calibration/motion /impact/velocity_m_s 0.0
/calibration/motion /until_s 0.0
/calibration/motion /until_s 1e-4
/calibration/motion /until_greatest_depth 1
/calibration/motion /weights {"depth": 0.0, "lateral": 0.0, "rotation": 0.0}
/calibration/motion /weights/depth -1.0
/calibration/motion runs /runs []
/calibration/motion runs /history {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 1.0]}
/calibration/motion runs /impact {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0}
/calibration/motion runs /until_s 1e-4
/calibration/motion runs /runs/1/impact
/calibration/motion runs /runs/1/history/time_s/3 0.0005
/calibration/motion runs /runs/1/history/rotation_deg/3 1100.0
/calibration/motion runs /runs/1/history/depth_displacement_m/3 226.0
/calibration/motion runs /runs/1/weights {"depth": 0.0, "lateral": 0.0, "rotation": 0.0}
/calibration/motion runs /runs/1/until_s 1e-4
/calibration/motion runs /runs/1/velocity_m_s 238.0
/calibration/motion runs /target/compressive_strength_pa 1e5
/calibration/obliquity /points []
/calibration/obliquity /points [{"oblique_angle_deg": 0.0, "strength_factor": 8.5}]
/calibration/obliquity /points/1/oblique_angle_deg 90.0
/calibration/obliquity /points/1/strength_factor 0.0
/calibration/obliquity /points/1/standard_error 0.0
/calibration/obliquity /points/0/standard_error 0.1
/calibration/obliquity /order 4
/calibration/obliquity /order 10
/calibration/obliquity /order -1
/calibration/obliquity /order 1.5
"""
"""Changes of one field of a valid body: path, pointer and new value."""

POWER_LAW = {"model": "strength_power_law", "coefficient": 82.6, "exponent": -0.544}
SHOT = {"velocity_m_s": 238.1, "depth_m": 0.30}
OWN_TESTS = {"model": "own_tests", "shots": [SHOT]}
LONG: list[tuple[str, str, Any]] = [
    ("/trajectory", "/projectile/mass_kg", 10**400),
    ("/trajectory", "/numerics/panels", 10**400),
    ("/trajectory", "/projectile/nose", {"shape": "profile", "points": [[0.0, 0.0]] * 1001}),
    (
        "/cra",
        "/resistance/strength_factor",
        {"model": "own_tests", "shots": [SHOT] * 1001},
    ),
    *(
        ("/cra", "/resistance/strength_factor", POWER_LAW | wrong)
        for wrong in ({"reference_strength_pa": 0.0}, {"reference_diameter_m": -1.0}, {"diameter_exponent": 11.0})
    ),
    ("/cra", "/resistance/strength_factor", {"model": "own_tests", "shots": [SHOT | {"weight": 1.0}]}),
    ("/cra/uncertainty", "/uncertain/1", USUAL["/cra/uncertainty"]["uncertain"][0]),
    ("/cra", "/projectile", PAPER["projectile"] | {"nose": SPHERE, "length_m": 0.08, "boat_tail": BOAT_TAIL}),
    ("/cra", "", PAPER | {"resistance": {"strength_factor": OWN_TESTS}, "strength_scatter": "paper_table_1"}),
    ("/cra/batch", "/cases", [PAPER] * 2000),
    ("/cra/batch", "/cases/0", {"x": "y" * 140_000}),
    ("/cra/batch", "/cases/0/custom_id", "x" * 129),
    ("/cra/sweep", "/base", PAPER | {"x": "y" * 140_000}),
    ("/calibration/depth", "/tests", TABLE_1 * 251),
    ("/calibration/depth", "/compare_strength_factors", [8.0] * 21),
    ("/calibration/motion", "/history/lateral_displacement_m", [0.0] * 20_001),
    ("/calibration/motion", "/history", {name: ["x"] * 20_000 for name in AT_30}),
    ("/calibration/motion runs", "/runs", [RUN] * 21),
]
"""Changes whose new value is too long for a line of `CHANGES`."""

MATRIX = [[0.05, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-8]]
"""A valid covariance matrix for the three coefficients of eq. 9."""
COVARIANCES: list[Any] = [
    [],
    MATRIX[:2],
    [MATRIX[0], MATRIX[1], [0.0, 0.0]],
    [MATRIX[0], [0.0, -1e-4, 0.0], MATRIX[2]],
    [[0.05, 0.01, 0.0], MATRIX[1], MATRIX[2]],
    [[0.05, 0.0, 1.0], MATRIX[1], [1.0, 0.0, 1e-8]],
    [MATRIX[0], [0.0, 1e-4, "0"], MATRIX[2]],
    [MATRIX[0], [0.0, 1e-4, 1e7], MATRIX[2]],
]

LAW = "resistance.strength_factor.model"
DECAY = "resistance.free_surface.model"
SCATTER: list[list[tuple[str, dict[str, Any]]]] = [
    [("impact.velocity_m_s", {"type": "normal", "mean": "fast", "standard_deviation": 2.0})],
    [("impact.velocity_m_s", {"type": "normal", "mean": -3.0, "standard_deviation": 2.0})],
    [("impact.velocity_m_s", {"type": "truncated_normal", "mean": 238.0, "standard_deviation": 2.0, "lower": 240})],
    [("impact.velocity_m_s", {"type": "truncated_normal", "mean": 238.0, "standard_deviation": 2.0, "upper": 2e4})],
    [("impact.velocity_m_s", {"type": "lognormal", "median": 1e5, "dispersion": 0.1})],
    [("impact.velocity_m_s", {"type": "lognormal", "median": 238.0, "dispersion": 430.0})],
    [("impact.velocity_m_s", {"type": "discrete", "values": [238.0, -5.0]})],
    [("projectile.nose", {"type": "uniform", "lower": 1.0, "upper": 2.0})],
    [("target.thickness_m", {"type": "normal", "standard_deviation": 0.01})],
    [("impact.oblique_angle_deg", {"type": "normal", "standard_deviation": 1.0})],
    [("impact.angle_of_attack_deg", {"type": "normal", "coefficient_of_variation": 0.1})],
    [("resistance.theory", {"type": "normal", "standard_deviation": 1.0})],
    [("target.density_kg_m3", {"type": "uniform", "lower": -500.0, "upper": -100.0})],
    [("target.density_kg_m3", {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"]})],
    [(DECAY, {"type": "discrete", "values": ["a", "b"], "weights": [0.8, 0.3]})],
    [(DECAY, {"type": "discrete", "values": ["elastic_plastic", "cubic"]})],
    [(LAW, {"type": "discrete", "values": ["constant", "published_tests"]})],
    [
        (LAW, {"type": "discrete", "values": ["strength_power_law", "published_tests"]}),
        ("resistance.strength_factor.coefficient", {"type": "normal", "mean": 72.0, "standard_deviation": 5.0}),
    ],
]
"""Invalid uncertain inputs for `/cra/uncertainty`: pairs of field and distribution."""

TEXTS = [
    b"",
    b"null",
    b"[]",
    b"3",
    b'"text"',
    b"{",
    b'{"projectile": }',
    b"{'projectile': 1}",
    b'{"projectile": 1, "projectile": 2}',
    b'{"projectile": "\xff"}',
    b'{"projectile": "\\ud800"}',
    b"\xff\xfe{\x00}\x00",
    b"\xef\xbb\xbf{}",
    b"[" * 10_000,
    b'{"a":' * 10_000 + b"1" + b"}" * 10_000,
    b'{"projectile": ' + b"1" * 5000 + b"}",
    b" " * 5_000_000,
    json.dumps(dict.fromkeys(map(str, range(100_000)), 1)).encode(),
    json.dumps(dict.fromkeys(map(str, range(31)), 1)).encode(),
]
"""Bodies for `/cra` that are not a JSON object, or not valid JSON."""

CASE = json.dumps(PAPER).encode()
BODIES_OF_LINES = [
    b"",
    CASE + b"\n" + CASE.replace(b"238.0", b"-1"),
    CASE + b"\n" + CASE.replace(b"238.0", b"NaN"),
    CASE + b"\n" + CASE.replace(b"238.0", b'"238"'),
    CASE + b"\n{\n" + CASE,
    CASE + b"\n\n" + CASE,
    CASE + b"\n \n",
    CASE + b"\nnull\n",
    CASE + b"\n" + b"[" * 10_000,
    CASE + b"\n" + b" " * 140_000 + CASE,
    b"\xff\n",
    (CASE + b"\n") * 450 + b"{}x",
]
"""Invalid JSON lines for `/cra/batch`."""

REQUESTS: list[tuple[str, str, dict[str, Any]]] = [
    ("GET", "/nothing", {}),
    ("GET", "/cra/", {}),
    ("GET", "/results/0", {}),
    ("GET", f"/results/{'0' * 64}", {"Accept": "image/png"}),
    ("GET", "/jobs/1", {}),
    ("GET", "/jobs?limit=0", {}),
    ("GET", "/jobs?limit=many", {}),
    ("GET", "/jobs?cursor=x", {}),
    ("GET", "/jobs?limit=2&Cursor=", {}),
    ("GET", "/jobs/1/results?offset=3", {}),
    ("GET", "/jobs/1/events?since=3", {}),
    ("GET", "/results/1?format=csv", {}),
    ("GET", "/jobs", {"Host": "elsewhere.example"}),
    ("GET", "/cra", {}),
    ("PUT", "/livez", {}),
    ("DELETE", "/jobs/1?force=true", {}),
    ("PATCH", "/jobs/1", TEXT),
    ("PATCH", "/jobs/1?title=a", TEXT),
    ("POST", "/jobs/1/cancel", {}),
    ("POST", "/cra?wait=3", TEXT),
    ("POST", "/cra/batch?respond=async", TEXT),
    ("POST", "/cra/uncertainty?samples=3", TEXT),
    ("POST", "/verdict?x", TEXT),
    ("POST", "/cra", {"Content-Type": "text/plain"}),
    ("POST", "/cra", {"Content-Type": ""}),
    ("POST", "/cra", {"Content-Type": "application/jsonl"}),
    ("POST", "/cra", TEXT | {"Content-Encoding": "gzip"}),
    ("POST", "/cra", TEXT | {"Sec-Fetch-Site": "cross-site"}),
    ("POST", "/cra/batch", {"Content-Type": "text/plain"}),
    ("POST", "/cra/batch", LINES | {"Accept": "image/png"}),
    ("POST", "/cra/batch", LINES | {"Idempotency-Key": "x" * 256}),
    ("POST", "/calibration/depth", {"Content-Type": "text/csv"}),
]
"""Method, path with query, and headers of other invalid requests; the body is `{}` if the method has one."""

INTERNAL = re.compile(
    r"Input should|Extra inputs|Field required|pydantic|instance of|Traceback|None\b|NoneType|dict\b|"
    r"\w+(Base|Request|Model|Error)\b|String should|List should|valid (integer|number|boolean|list)"
)
"""Words of the implementation that no message may contain."""


def changes() -> Iterator[tuple[str, str, str]]:
    """Yield path, pointer and new value of each change; the value is JSON text, or "" to leave the field out."""
    for line in CHANGES.splitlines():
        path, place, value = re.fullmatch(r"(\S+(?: runs)?) (\S+) ?(.*)", line).groups()  # type: ignore[union-attr]
        yield path, place, value
    for path, place, value in LONG:
        yield path, place, json.dumps(value)
    for matrix in COVARIANCES:
        yield "/cra", "/resistance/strength_factor", json.dumps(EQ_9 | {"covariance": matrix})
    for inputs in SCATTER:
        uncertain = [{"field": field, "distribution": distribution} for field, distribution in inputs]
        yield "/cra/uncertainty", "/uncertain", json.dumps(uncertain)


def body_with(path: str, place: str, value: str) -> str:
    if not place:
        return value
    if not value:
        return json.dumps(changed(USUAL[path], place, ...))
    return json.dumps(changed(USUAL[path], place, "HERE")).replace('"HERE"', value, 1)


def shortened(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:160]} ({len(text):,} characters)"


def refusals(client: httpx.Client) -> Iterator[tuple[str, httpx.Response]]:
    """Send every invalid request; yield its description and the answer."""
    for path, place, value in changes():
        answer = client.post(path.partition(" ")[0], content=body_with(path, place, value), headers=TEXT)
        yield f"POST {path} {place or 'as a whole'} {shortened(value) or 'left out'}", answer
    for content in TEXTS:
        yield f"POST /cra {shortened(repr(content)[2:-1])}", client.post("/cra", content=content, headers=TEXT)
    for content in BODIES_OF_LINES:
        words = repr(content)[2:-1].replace(repr(CASE)[2:-1], "CASE").replace(json.dumps(PAPER), "CASE")
        answer = client.post("/cra/batch", content=content, headers=LINES)
        yield f"POST /cra/batch as lines {shortened(words)}", answer
    for method, path, headers in REQUESTS:
        sent = b"{}" if method in {"POST", "PATCH"} else None
        words = shortened("".join(f" {name}: {value}" for name, value in headers.items() if headers is not TEXT))
        yield f"{method} {path}{words}", client.request(method, path, content=sent, headers=headers)


def described(request: str, answer: httpx.Response) -> str:
    """Return the lines of `messages.txt` for an answer: the request, then status and title, then the detail."""
    problem = Problem.model_validate_json(answer.content)
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert answer.status_code == problem.status < 500, request
    assert problem.instance == answer.request.url.path, request
    text = "\n".join(f"{each.pointer}: {each.detail}" if each.pointer else each.detail for each in problem.errors[:5])
    assert all(each.detail in problem.detail or problem.detail.endswith("(and more)") for each in problem.errors)
    detail = problem.detail if problem.detail != text else ""
    return "\n".join(filter(None, [f"> {request}", f"{problem.status} {problem.title}", detail or text]))


def messages(client: httpx.Client) -> str:
    return "\n\n".join(described(*each) for each in refusals(client)) + "\n"


def test_messages_match_the_reviewed_file(client: httpx.Client) -> None:
    assert messages(client) == MESSAGES.read_text(encoding="utf-8")


def test_messages_name_the_place_and_have_no_internal_names() -> None:
    blocks = MESSAGES.read_text(encoding="utf-8").rstrip("\n").split("\n\n")
    assert len(blocks) >= 200
    for block in blocks:
        request, *answer = block.splitlines()
        assert not INTERNAL.search("\n".join(answer)), request


@pytest.mark.parametrize("path", ["/trajectory", "/cra"])
def test_case_in_a_batch_is_refused_like_a_single_one(client: httpx.Client, path: str) -> None:
    """The pointer to the error begins with the index of the case.

    Errors that only the solver detects do not refuse the batch, but become the result of the case.
    """
    for of, place, value in changes():
        if of != path or place.endswith(("alternatives", "sample_interval_s")):  # Batches lack these fields.
            continue
        body = body_with(of, place, value)
        alone = client.post(path, content=body, headers=TEXT).json()["errors"]
        for content, headers, case in ((f'{{"cases": [{body}]}}', TEXT, "/cases/0"), (body, LINES, "/0")):
            among = client.post(f"{path}/batch", content=content, headers=headers).json()
            if "results" in among:
                assert among["results"][0]["problem"]["errors"] == alone, (place, value)
            else:
                assert among["errors"] == [each | {"pointer": case + each["pointer"]} for each in alone], (place, value)


if __name__ == "__main__":
    with (
        tempfile.TemporaryDirectory() as folder,
        running_service(Path(folder)) as service,
        httpx.Client(base_url=service.url, timeout=180.0, trust_env=False) as session,
    ):
        MESSAGES.write_text(messages(session), encoding="utf-8")
