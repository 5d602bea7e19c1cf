"""Report on one strike: the queries behind it, and the report itself as HTML.

All numbers in a report come from the answers to ordinary queries, which are computed, cached and counted against quotas
like the queries of any client.
"""

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple

from pydantic import MISSING

from service.errors import ReportsMissingError
from service.operations import SCHEMA_VERSION
from service.schemas.requests import ReportRequest
from service.schemas.verdict import found_in, next_shot_advice_in, usual_inputs, verdict_in, verdict_steps
from service.version import VERSION
from solver import ENGINE_VERSION, ConstantStrengthFactor, mass_properties
from solver.checks import BOUNDS
from solver.strength_scatter import scatter_of_strength
from solver.uncertainty.verdict import HALF_WIDTH, SAMPLES, Question, probability_angles
from solver.units import written_in
from solver.warnings import RETENTION_DECIDES

EXTRA = ("jinja2", "markupsafe", "matplotlib")
"""Packages that reports import. The extra `reports` installs all of them."""
SPEEDS = tuple(round(0.5 + 0.1 * step, 1) for step in range(11))
"""Speeds at which the report shows the critical angle, relative to the speed of the case. [1]"""
# Half a degree to either side is far enough for the outcomes to differ, even where the retention energy decides the
# outcome, and close enough for the paths to show how the outcome changes.
ASIDE_DEG = 0.5
"""Angle between the critical angle and the runs drawn just below and just above it. [°]"""
# At 90° a projectile moves along the face and never strikes.
STEEPEST_DEG = 89.9
"""Largest oblique angle of the run just above the critical angle. [°]"""


class Query(NamedTuple):
    """A query whose answer the report shows: an operation and the body of its request."""

    operation: str
    body: dict[str, Any]


def require_extra() -> None:
    """Check that the packages in `EXTRA` are installed.

    Raises
    ------
    ReportsMissingError
        If one of them is missing.
    """
    for name in EXTRA:
        if find_spec(name) is None:
            raise ReportsMissingError(name)


def verdict_queries(request: ReportRequest) -> dict[str, Query]:
    """Return the queries on whose answers the verdict is based, keyed by name.

    There is no verdict if `cra` fails; any other query may fail. A wall is judged at the oblique angle of the request,
    or in normal impact if the request has none.
    """
    return {name: _query_of(request, question) for name, question in next(verdict_steps(request)).items()}


def weighing_queries(request: ReportRequest, found: Mapping[str, Any]) -> dict[str, Query]:
    """Return the additional searches that the verdict needs, keyed by name.

    They show how much the critical angle depends on the retention energy or on the strength factor that a warning is
    about, and on whether the strength factor is constant from 55° on instead of from 60° on. Any of them may fail.

    Parameters
    ----------
    found
        Answer to the query `cra`.
    """
    steps = verdict_steps(request)
    search = next(steps)["cra"]
    try:
        asked = steps.send({"cra": found_in(request, search, found)})
    except StopIteration:  # The verdict needs no additional searches.
        return {}
    return {name: _query_of(request, question) for name, question in asked.items()}


def first_queries(request: ReportRequest) -> dict[str, Query]:
    """Return the queries that depend on the case alone, keyed by name.

    There is no report if `cra` fails; any other query may fail.
    """
    case, angle, units = _search_of(request), _angle_of(request), _units_of(request)
    strike = _strike_of(case, 0.0 if angle is None else angle)
    plain = {name: strike[name] for name in ("projectile", "target", "impact")}
    wall = {name: value for name, value in strike["target"].items() if name != "thickness_m"}
    speed = case["impact"]["velocity_m_s"]
    return {
        **verdict_queries(request),
        "cra": Query("cra", case | {"alternatives": True} | units),
        "formulas": Query("formulas", plain | units),
        "thickness": Query("thickness", strike | {"target": wall} | units),
        **{
            f"speed {index}": Query("cra", case | {"impact": case["impact"] | {"velocity_m_s": speed * factor}})
            for index, factor in enumerate(SPEEDS)
            if BOUNDS["impact.velocity"].holds(speed * factor)
        },
    }


def strike_queries(request: ReportRequest, found: Mapping[str, Any]) -> dict[str, Query]:
    """Return the queries that depend on the answer to `cra`, keyed by name.

    They are the searches of `weighing_queries`, and the runs just below and just above the critical angle, which are
    drawn beside the run at the oblique angle of the request.

    Parameters
    ----------
    found
        Answer to the query `cra`. If it has no critical angle, there is a single run: at the lower end of the range if
        the status is `always_ricochet`, otherwise at the upper end.
    """
    case, search = _search_of(request), request.canonical()["search"]
    angles: dict[str, float] = {}
    if "critical_angle_deg" in found:
        critical = found["critical_angle_deg"]
        angles |= {"below": max(critical - ASIDE_DEG, 0.0), "above": min(critical + ASIDE_DEG, STEEPEST_DEG)}
    elif found["status"] == "always_ricochet":
        angles["lowest"] = search["lower_deg"]
    else:
        angles["highest"] = search["upper_deg"]
    units = _units_of(request)
    runs = {name: Query("trajectory", _strike_of(case, each) | units) for name, each in angles.items()}
    return weighing_queries(request, found) | runs


def write_page(given: Mapping[str, Any], answers: Mapping[str, Any], made: str, address: str | None) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    given
        The request as received.
    answers
        Answers, keyed by the names of their queries; an object with a `problem` for a query that failed.
    made
        Date and time of the report, as text.
    address
        Address of the service that computed the report; None if no service was involved.
    """
    from service.reports.assessment import Assessed, page  # noqa: PLC0415 (an extra, and slow to import)

    request = ReportRequest.model_validate(given)
    projectile, target = request.projectile.to_solver(), request.target.to_solver()
    properties = mass_properties(projectile)
    with written_in(request.units):
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
                scatter=usual_inputs(request),
                dispersion=scatter_of_strength(
                    projectile=projectile,
                    target=target,
                    resistance=request.resistance.to_solver(),
                    strength_scatter=request.strength_scatter.value,
                ).dispersion,
                verdict=verdict_in(request, answers),
                advice=next_shot_advice_in(answers.get("uncertainty", {})),
                projectile=projectile,
                answers=answers,
                speeds=[
                    (request.impact.velocity_m_s * factor, answers[f"speed {index}"])
                    for index, factor in enumerate(SPEEDS)
                    if f"speed {index}" in answers
                ],
                made=made,
                address=address,
                versions={"ricochet": VERSION, "engine": ENGINE_VERSION, "schema": SCHEMA_VERSION},
            )
        )


def _search_of(request: ReportRequest) -> dict[str, Any]:
    """Return the body of the query for the critical angle, without the field `units`."""
    case = request.model_dump(mode="json", exclude={"alternatives", "output", "flight", "units"})
    case["impact"].pop("oblique_angle_deg", None)
    return case


def _units_of(request: ReportRequest) -> dict[str, Any]:
    """Return the field `units`, for queries whose answers contain text that the report shows.

    Other queries omit the field, so that one cached result serves both systems of units.
    """
    return request.model_dump(mode="json", include={"units"})


def _query_of(request: ReportRequest, question: Question) -> Query:
    case, angle, units = _search_of(request), _angle_of(request), _units_of(request)
    if question.kind == "search":
        return Query("cra", _with_probe(case, *question.probe) if question.probe else case | units)
    if question.kind == "study":
        search = request.canonical()["search"]
        start, stop, count = probability_angles(angle, search["lower_deg"], search["upper_deg"])
        return Query(
            "cra_uncertainty",
            case
            | {
                "oblique_angles_deg": {"start": start, "stop": stop, "count": count},
                "sampling": {"max_samples": SAMPLES, "half_width": HALF_WIDTH},
                "uncertain": usual_inputs(request, theories=question.theories),
            },
        )
    strike = _strike_of(case, angle or 0.0) | units
    if question.kind == "wall":
        return Query("wall", strike)
    flight = {} if request.flight is MISSING else request.flight.model_dump(mode="json")
    return Query("trajectory", strike | {"flight": flight})


def _with_probe(case: Mapping[str, Any], code: str, value: float) -> dict[str, Any]:
    """Return the body of a search with one value changed, as the solver's `with_probe` changes an argument."""
    if code == RETENTION_DECIDES:
        return {**case, "numerics": case.get("numerics", {}) | {"retention_energy_fraction": value}}
    held = {"model": ConstantStrengthFactor.name, "value": value}
    return {**case, "resistance": case.get("resistance", {}) | {"strength_factor": held}}


def _strike_of(case: Mapping[str, Any], angle: float) -> dict[str, Any]:
    """Return the body of the query for a run at the oblique angle `angle`. [°]"""
    found = {name: part for name, part in case.items() if name != "search"}
    return found | {"impact": case["impact"] | {"oblique_angle_deg": angle}}


def _angle_of(request: ReportRequest) -> float | None:
    angle = request.impact.oblique_angle_deg
    return None if angle is MISSING else angle
