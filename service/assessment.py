"""The report of one strike: the requests whose answers it shows, and its page.

Its numbers are those of requests that anyone may send: they are computed, kept and counted like any other.
"""

import math
from collections.abc import Mapping
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, NamedTuple

from pydantic import MISSING

from service.errors import ReportsMissingError
from service.operations import SCHEMA_VERSION
from service.schemas.requests import ReportRequest
from solver import ENGINE_VERSION, mass_properties

EXTRA = ("jinja2", "markupsafe", "matplotlib")
"""Packages of the extra `reports`."""
SAMPLES = 512
"""Samples at most of the spread, as the page takes at first: enough for quantiles, not for sensitivity indices."""
SPEEDS = tuple(round(0.5 + 0.1 * step, 1) for step in range(11))
"""Speeds of the curve over the speed of the case. [1]"""
SPEED_BOUNDS = (0.1, 1e4)
"""Bounds of the speed in the contract. [m/s]"""
ASIDE_DEG = 0.5
"""Distance of the runs just below and just above from the critical angle. [°]"""
STEEPEST_DEG = 89.9
"""Largest angle of these runs. [°]"""
STEP_DEG = 0.5
"""Distance of the angles at which the probability is computed. [°]"""


class Query(NamedTuple):
    """A request of the report."""

    operation: str
    body: dict[str, Any]


def require_extra() -> None:
    """Check that what draws reports is installed.

    Raises
    ------
    ReportsMissingError
        If it is not.
    """
    for name in EXTRA:
        if find_spec(name) is None:
            raise ReportsMissingError(name)


def first_queries(request: ReportRequest) -> dict[str, Query]:
    """Return the requests that depend on the case alone, by name.

    The answer to `cra` is needed; the others may be problems.
    """
    case, angle, search = _search_of(request), _angle_of(request), request.canonical()["search"]
    strike = _strike_of(case, 0.0 if angle is None else angle)
    plain = {name: strike[name] for name in ("projectile", "target", "impact")}
    wall = {name: value for name, value in strike["target"].items() if name != "thickness_m"}
    study = {
        "uncertain": request.usual_scatter(),
        "oblique_angles_deg": probability_range(angle, search["lower_deg"], search["upper_deg"]),
        "sampling": {"max_samples": SAMPLES},
    }
    speed = case["impact"]["velocity_m_s"]
    lowest, highest = SPEED_BOUNDS
    return {
        "cra": Query("cra", case | {"alternatives": True}),
        "formulas": Query("formulas", plain),
        "thickness": Query("thickness", strike | {"target": wall}),
        "uncertainty": Query("cra_uncertainty", case | study),
        **{
            f"speed {index}": Query("cra", case | {"impact": case["impact"] | {"velocity_m_s": speed * factor}})
            for index, factor in enumerate(SPEEDS)
            if lowest <= speed * factor <= highest
        },
    }


def strike_queries(request: ReportRequest, found: Mapping[str, Any]) -> dict[str, Query]:
    """Return the runs to draw, by name: on either side of the critical angle, and at the angle to judge.

    Parameters
    ----------
    found
        The answer to the search. Without an angle, the run is at the end of the range that is nearest to one.
    """
    case, angle = _search_of(request), _angle_of(request)
    search = request.canonical()["search"]
    angles: dict[str, float] = {} if angle is None else {"judged": angle}
    if "critical_angle_deg" in found:
        critical = found["critical_angle_deg"]
        angles |= {"below": max(critical - ASIDE_DEG, 0.0), "above": min(critical + ASIDE_DEG, STEEPEST_DEG)}
    elif found["status"] == "always_ricochet":
        angles["lowest"] = search["lower_deg"]
    else:
        angles["highest"] = search["upper_deg"]
    return {name: Query("trajectory", _strike_of(case, each)) for name, each in angles.items()}


def probability_range(angle: float | None, lower: float, upper: float) -> dict[str, Any]:
    """Return angles at which the probability is computed, the one to judge among them. [°]

    Parameters
    ----------
    angle
        To judge, if any. [°]
    lower, upper
        Range of the search: beyond it nothing is known. [°]
    """
    shift = 0.0 if angle is None or not lower <= angle <= upper else math.fmod(angle - lower, STEP_DEG)
    steps = math.floor((upper - lower - shift) / STEP_DEG + 1e-9)
    if steps < 1:
        return {"start": lower, "stop": upper, "count": 2}
    return {"start": lower + shift, "stop": lower + shift + steps * STEP_DEG, "count": steps + 1}


def write_page(given: Mapping[str, Any], answers: Mapping[str, Any], made: str, address: str | None) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    given
        The request as received.
    answers
        Answers, or objects with a `problem`, by the names of their requests.
    made
        Date and time, as text.
    address
        Address of the service that computed it; None if it was computed without one.
    """
    from service.reports.assessment import Assessed, page  # noqa: PLC0415 (an extra, and slow to import)

    request = ReportRequest.model_validate(given)
    projectile, target = request.projectile.to_solver(), request.target.to_solver()
    properties = mass_properties(projectile)
    return page(
        Assessed(
            given=given,
            case=request.canonical(),
            assumed={
                "projectile": {
                    "center_of_gravity_m": properties.center_of_gravity,
                    "moment_of_inertia_kg_m2": properties.moment_of_inertia,
                },
                "target": {"youngs_modulus_pa": target.elastic_modulus},
            },
            scatter=request.usual_scatter(),
            projectile=projectile,
            answers=answers,
            speeds=[
                (request.impact.velocity_m_s * factor, answers[f"speed {index}"])
                for index, factor in enumerate(SPEEDS)
                if f"speed {index}" in answers
            ],
            made=made,
            address=address,
            versions={"ricochet": version("ricochet"), "engine": ENGINE_VERSION, "schema": SCHEMA_VERSION},
        )
    )


def _search_of(request: ReportRequest) -> dict[str, Any]:
    """Return the body of the search."""
    case = request.model_dump(mode="json", exclude={"alternatives", "output"})
    case["impact"].pop("oblique_angle_deg", None)
    return case


def _strike_of(case: Mapping[str, Any], angle: float) -> dict[str, Any]:
    """Return the body of a run."""
    found = {name: part for name, part in case.items() if name != "search"}
    return found | {"impact": case["impact"] | {"oblique_angle_deg": angle}}


def _angle_of(request: ReportRequest) -> float | None:
    angle = request.impact.oblique_angle_deg
    return None if angle is MISSING else angle
