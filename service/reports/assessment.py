"""Report of one strike for an assessor: case, answer, scatter, other models, limits, formulas and sources."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from math import degrees
from typing import Any, Final, Literal, NamedTuple

import jinja2
from markupsafe import Markup, escape

from service.columns import shown_in
from service.names import FORMULAS, OUTCOMES, QUANTITIES, STATUSES
from service.reports import style
from service.reports.assessment_figures import SETTINGS, curves, side_views, sketch, svg
from service.reports.assessment_numbers import WORDS, Numbers, Row, lookup, rows, sentence
from service.reports.style import embedded
from solver.free_surface import NoFreeSurface
from solver.projectile import Projectile
from solver.resistance import (
    EQUATION_9_COEFFICIENTS,
    ConstantStrengthFactor,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    StrengthPowerLaw,
)
from solver.uncertainty import Verdict
from solver.uncertainty.verdict import probability_text
from solver.units import UnitSystem, interval, number, quantity, symbol, system_in_use, with_symbol
from solver.warnings import (
    EQUATION_9_DIAMETER,
    EQUATION_9_STRENGTH,
    RIGID_VELOCITY,
    SMALL_ATTACK,
    TESTED_STRENGTH,
)

ENDS: Final[Mapping[str, str]] = {
    "ricochet": "the projectile is turned away",
    "embedded": "the projectile digs in and stays",
    "in_motion": "the projectile still moves when the run is given up",
    "perforated": "the projectile goes through: the wall is perforated",
}
RUNS: Final = ("judged", "below", "above", "lowest", "highest")
"""Names of the runs in the order in which they are drawn."""
RUN_TITLES: Final[Mapping[str, str]] = {
    "judged": "To judge, ",
    "below": "Just below, ",
    "above": "Just above, ",
    "lowest": "Least angle searched, ",
    "highest": "Greatest angle searched, ",
}
UNSAID: Final = frozenset({"no_indices"})
"""Codes of warnings that the report omits: it does not show sensitivity indices."""
KEYS: Final[Mapping[str, str]] = {
    "cra": "critical angle",
    "uncertainty": "spread",
    "judged": "run at the angle to judge",
    "below": "run just below",
    "above": "run just above",
    "lowest": "run at the lower end",
    "highest": "run at the upper end",
    "wall": "verdict on the wall",
    "theories": "spread over the theories",
    "thickness": "least thickness",
    "formulas": "formulas",
}


@dataclass(frozen=True, kw_only=True)
class Assessed:
    """A strike and its answers, as plain data with the names and units of the contract."""

    given: Mapping[str, Any]
    """The request as received."""
    case: Mapping[str, Any]
    """The request with defaults filled in."""
    assumed: Mapping[str, Any]
    """Values that the model assumes for inputs without a default."""
    scatter: Sequence[Mapping[str, Any]]
    """Uncertain inputs with their distributions, as the study used them."""
    dispersion: float
    """Standard deviation of the logarithm of S at the given compressive strength. [1]"""
    verdict: Verdict
    advice: str
    """Sentence about how far the user's own shots would narrow the range; empty if that is not known."""
    projectile: Projectile
    answers: Mapping[str, Any]
    """Answers by name. A failed one is an object with the field `problem`."""
    speeds: Sequence[tuple[float, Mapping[str, Any]]]
    """Speed [m/s] and answer of each search, at the speed of the case and at others."""
    made: str
    """Date and time at which the report was made."""
    address: str | None
    """Address of the service that computed the answers; None if there was no service."""
    versions: Mapping[str, str]


class Limit(NamedTuple):
    """A limit of validity, and the value of the case that is compared with it."""

    label: str
    value: Any
    limit: str
    holds: bool


def page(strike: Assessed) -> str:
    """Return the report as self-contained HTML."""
    numbers = Numbers({**strike.answers, "case": strike.case, "assumed": strike.assumed})
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["sentence"] = sentence
    template = environment.from_string(files("service.reports").joinpath("assessment.html").read_text(encoding="utf-8"))
    search = strike.answers["cra"]
    study = _answered(strike, "uncertainty")
    formulas = _answered(strike, "formulas")
    warnings = _warnings(strike)
    return template.render(
        style=Markup(page_style()),  # noqa: S704 (a file of the package)
        title=_title(strike),
        headline=_headline(strike.verdict),
        mean_strength=_target_strength(strike, "compressive"),
        characteristic_strength=_target_strength(strike, "characteristic"),
        dispersion=strike.dispersion,
        n=numbers,
        at=partial(lookup, strike.answers),
        case=_groups(numbers, strike),
        search=search,
        angle=search.get("critical_angle_deg"),
        shots=lookup(strike.case, "/resistance/strength_factor/shots"),
        judged=lookup(strike.case, "/impact/oblique_angle_deg"),
        run=_answered(strike, "judged"),
        study=study,
        probability=_probability_at(strike, study),
        probability_text="" if strike.verdict.probability is None else probability_text(strike.verdict.probability),
        quantiles=_quantiles(study),
        range_name=strike.verdict.range_name,
        advice=strike.advice,
        scatter=_scatter(numbers, strike, study),
        problems={name: _problem(strike, name) for name in ("uncertainty", "formulas", "thickness", "judged")},
        laws=_laws(numbers, search),
        law_range=_law_range(search),
        formulas=formulas,
        formula_rows=_formula_rows(formulas),
        thickness=_answered(strike, "thickness"),
        wall=_answered(strike, "wall"),
        governed=_governed(_answered(strike, "wall")),
        limits=_limits(numbers, strike),
        warnings=[each for each, standing in warnings if not standing],
        standing=[each for each, standing in warnings if standing],
        keys=[(label, strike.answers[name]["key"]) for name, label in KEYS.items() if _answered(strike, name)],
        strike=strike,
        symbol=symbol,
        is_si=system_in_use() is UnitSystem.SI,
        words={"outcomes": OUTCOMES, "ends": ENDS, "statuses": STATUSES, "formulas": FORMULAS},
        pictures={name: embedded(picture) for name, picture in _pictures(strike, study).items()},
    )


def _headline(verdict: Verdict) -> Markup:
    """Return the verdict as HTML, with its range in bold and its first sentences on wall and strike in large type."""
    wall = verdict.wall.sentence if verdict.wall else verdict.sentence if verdict.wall_failed else ""
    leads = [verdict.sentence, wall, verdict.sentence.removeprefix(f"{_first_sentence(wall)} ")]
    text = escape(verdict.sentence)
    for lead in dict.fromkeys(escape(_first_sentence(each)) for each in leads if each):
        text = text.replace(lead, Markup('<span class="lead">{}</span>').format(lead), 1)
    if verdict.range_text:
        shown = escape(verdict.range_text)
        text = text.replace(shown, Markup("<strong>{}</strong>").format(shown), 1)
    return text


def _first_sentence(text: str) -> str:
    """Return the first sentence of a paragraph, which ends at a full stop before a capital letter."""
    return re.split(r"(?<=\.) (?=[A-Z])", text, maxsplit=1)[0]


def page_style() -> str:
    """Return the style sheet of the page."""
    return files("service.reports").joinpath("assessment.css").read_text(encoding="utf-8")


def _answered(strike: Assessed, name: str) -> Mapping[str, Any] | None:
    answer = strike.answers.get(name)
    return None if answer is None or "problem" in answer else answer


def _problem(strike: Assessed, name: str) -> str | None:
    problem = lookup(strike.answers, f"/{name}/problem")
    return None if problem is None else f"{problem['title']}: {problem['detail']}"


def _title(strike: Assessed) -> str:
    """Return the title of the report; browsers suggest it as the name of a saved file."""
    case = strike.case
    parts = [quantity(case["impact"]["velocity_m_s"], "m/s"), _target_strength(strike, "compressive")]
    if characteristic := _target_strength(strike, "characteristic"):
        parts[-1] += f" (characteristic {characteristic})"
    if (angle := lookup(case, "/impact/oblique_angle_deg")) is not None:
        parts.append(f"{angle:.4g}°")
    if (thickness := lookup(case, "/target/thickness_m")) is not None:
        parts.append(quantity(thickness, "mm"))
    return f"Ricochet assessment, {', '.join(parts)}"


def _target_strength(strike: Assessed, kind: Literal["compressive", "characteristic"]) -> str:
    """Format the mean or the characteristic compressive strength of the target; empty if the case has none."""
    strength = lookup(strike.case, f"/target/{kind}_strength_pa")
    return "" if strength is None else quantity(strength, "MPa")


def _governed(wall: Mapping[str, Any] | None) -> dict[str, str]:
    """Return, in words, which design values each formula gives, by the name of the formula."""
    if wall is None:
        return {}
    scabbing, perforation = (wall[name].get("formula", "") for name in ("scabbing", "perforation"))
    if scabbing == perforation:
        return {scabbing: "both design values"}
    return {scabbing: "the design value against scabbing", perforation: "the design value against perforation"}


def _groups(numbers: Numbers, strike: Assessed) -> Mapping[str, list[Row]]:
    return rows(numbers, strike.given, strike.case)


def _probability_at(strike: Assessed, study: Mapping[str, Any] | None) -> int | None:
    """Return the index of the strike's oblique angle among the angles of the study; None if it is not one of them."""
    angle = lookup(strike.case, "/impact/oblique_angle_deg")
    if study is None or angle is None:
        return None
    near = [i for i, each in enumerate(study["probability"]["oblique_angle_deg"]) if abs(each - angle) < 1e-9]
    return near[0] if near else None


def _quantiles(study: Mapping[str, Any] | None) -> Mapping[float, int]:
    """Return the index of each quantile by its level."""
    return {} if study is None else {each["level"]: i for i, each in enumerate(study["critical_angle"]["quantiles"])}


def _scatter(numbers: Numbers, strike: Assessed, study: Mapping[str, Any] | None) -> list[list[Any]]:
    """Return a row for each uncertain input: label, distribution, and 5 % and 95 % quantiles with the angle at each."""
    found = []
    for i, (each, given) in enumerate(zip((study or {}).get("sensitivity", ()), strike.scatter, strict=False)):
        unit = shown_in(each["field"])
        cells: list[Any] = [QUANTITIES[each["field"]], _spread(given["distribution"], unit)]
        for j, change in enumerate(each["swing"][:2]):
            place = f"/uncertainty/sensitivity/{i}/swing/{j}"
            if isinstance(change["value"], str):
                cells.append(WORDS[change["value"]])
            else:
                cells.append(numbers.short(f"{place}/value", unit=unit))
            cells.append(numbers.angle(f"{place}/critical_angle_deg") or "none")
        found.append(cells)
    return found


def _spread(distribution: Mapping[str, Any], unit: str) -> str:
    """Return a distribution in words; `unit` is the SI unit in which a report writes its values."""
    if distribution["type"] == "discrete":
        return " or ".join(f"{weight:g}" for weight in distribution["weights"])
    if "standard_deviation" in distribution:
        return f"{distribution['type']}, {with_symbol(number(distribution['standard_deviation'], unit, 6), unit)}"
    if "scale" in distribution:
        tails = f"{distribution['degrees_of_freedom']:g} degrees of freedom"
        return f"logarithm Student's, {100.0 * distribution['scale']:g} %, {tails}"
    share = distribution.get("coefficient_of_variation", distribution.get("dispersion"))
    return f"{distribution['type']}, {100.0 * share:g} %"


def _laws(numbers: Numbers, search: Mapping[str, Any]) -> list[list[Any]]:
    """Return a header and a row for each strength law: its name and the critical angle with each decay law."""
    alternatives = search.get("alternatives", ())
    decays = list(dict.fromkeys(each["free_surface"] for each in alternatives))
    found: dict[tuple[str, str], list[Any]] = {}
    for i, each in enumerate(alternatives):
        law, shape = each["strength_factor"], each["obliquity_shape"]
        name = WORDS[shape] if shape == "finite_elements" else WORDS[law]
        row = found.setdefault((law, shape), [name] + [""] * len(decays))
        shown = numbers.angle(f"/cra/alternatives/{i}/critical_angle_deg")
        ending = each["problem"]["title"] if "problem" in each else STATUSES.get(each.get("status", ""), "")
        row[1 + decays.index(each["free_surface"])] = shown or ending
    return [["", *(WORDS[decay] for decay in decays)], *found.values()] if found else []


def _law_range(search: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return the pointers of the smallest and the largest critical angle among the alternative laws.

    Alternatives without any decay near the free surface are not counted.
    """
    found = [
        (each["critical_angle_deg"], f"/cra/alternatives/{i}/critical_angle_deg")
        for i, each in enumerate(search.get("alternatives", ()))
        if "critical_angle_deg" in each and each["free_surface"] != NoFreeSurface.name
    ]
    return (min(found)[1], max(found)[1]) if found else None


def _formula_rows(answer: Mapping[str, Any] | None) -> list[tuple[int, Mapping[str, Any]]]:
    """Return the formulas with their indices, those in their range of validity first."""
    return sorted(enumerate(answer["formulas"] if answer else ()), key=lambda each: not each[1]["in_range"])


def _limits(numbers: Numbers, strike: Assessed) -> list[Limit]:
    impact, target = strike.case["impact"], strike.case["target"]
    speed, strength = impact["velocity_m_s"], target["compressive_strength_pa"]
    lowest, highest = TESTED_STRENGTH
    attack = degrees(SMALL_ATTACK)
    found = [
        Limit(
            "Speed below which noses of steel do not erode",
            _speed(numbers),
            f"up to {quantity(RIGID_VELOCITY, 'm/s')}",
            speed <= RIGID_VELOCITY,
        ),
        Limit(
            "Strength in the tests behind the resistance law",
            _strength(numbers),
            interval(lowest, highest, "MPa"),
            lowest <= strength <= highest,
        ),
        Limit(
            "Angle of attack of most tests",
            numbers.short("/case/impact/angle_of_attack_deg", digits=3, unit="°"),
            f"up to {attack:g}°",
            abs(impact["angle_of_attack_deg"]) <= attack,
        ),
    ]
    law = strike.case["resistance"]["strength_factor"]["model"]
    return [*found, *LAW_LIMITS[law](numbers, strike)]


def _no_limits(_: Numbers, __: Assessed) -> list[Limit]:
    """Return no limits, for laws that add none to those that `_limits` lists for all laws."""
    return []


def _polynomial_limits(numbers: Numbers, strike: Assessed) -> list[Limit]:
    found, search = [], strike.answers["cra"]
    codes = {warning["code"] for warning in search["warnings"]}
    if tuple(strike.case["resistance"]["strength_factor"]["coefficients"]) == EQUATION_9_COEFFICIENTS:
        found.append(
            Limit(
                "Concrete and projectile of the fit of S",
                Markup("{}, {}").format(_strength(numbers), _diameter(numbers)),
                f"{quantity(EQUATION_9_STRENGTH, 'MPa')}, {quantity(EQUATION_9_DIAMETER, 'mm')}",
                "strength_factor_of_other_concrete" not in codes,
            )
        )
    if "critical_angle_deg" in search:
        fitted = degrees(ObliquityPolynomial.fitted_to)
        found.append(
            Limit(
                "Critical angle in the range of the fit of S",
                numbers.angle("/cra/critical_angle_deg"),
                f"up to {fitted:g}°",
                search["critical_angle_deg"] <= fitted,
            )
        )
    return found


def _published_tests_limits(numbers: Numbers, strike: Assessed) -> list[Limit]:
    codes = {warning["code"] for warning in strike.answers["cra"]["warnings"]}
    tested = (
        interval(*PublishedTests.compressive_strengths, "MPa"),
        interval(*PublishedTests.diameters, "mm"),
        interval(*PublishedTests.velocities, "m/s"),
    )
    return [
        Limit(
            "Tests behind S",
            Markup("{}, {}, {}").format(_strength(numbers), _diameter(numbers), _speed(numbers)),
            ", ".join(tested),
            "published_tests_extrapolated" not in codes,
        )
    ]


def _speed(numbers: Numbers) -> Markup:
    return numbers.short("/case/impact/velocity_m_s", digits=4, unit="m/s")


def _strength(numbers: Numbers) -> Markup:
    return numbers.short("/case/target/compressive_strength_pa", digits=4, unit="MPa")


def _diameter(numbers: Numbers) -> Markup:
    return numbers.short("/case/projectile/diameter_m", digits=4, unit="mm")


LAW_LIMITS: Final[Mapping[str, Callable[[Numbers, Assessed], list[Limit]]]] = {
    ConstantStrengthFactor.name: _no_limits,
    ObliquityPolynomial.name: _polynomial_limits,
    StrengthPowerLaw.name: _no_limits,
    PublishedTests.name: _published_tests_limits,
    OwnTests.name: _no_limits,
}
"""Functions that return the limits of each law of the strength factor, by its name."""


def _warnings(strike: Assessed) -> list[tuple[tuple[str, str, str], bool]]:
    """Return the warnings of the verdict, and warnings with further codes from the other answers.

    Each item holds the code, the text and the label of the answer, and True for a standing note.
    """
    of_strike = {each["detail"] for each in (_answered(strike, "judged") or {}).get("warnings", ())}
    of_search = {each["detail"] for each in strike.answers["cra"]["warnings"]}
    of_wall = {each["detail"] for each in (_answered(strike, "wall") or {}).get("warnings", ())}

    def source(detail: str) -> str:
        if detail in of_strike - of_search:
            return "judged"
        return "wall" if detail in of_wall - of_search else "cra"

    found = [((each.code, each.detail, KEYS[source(each.detail)]), each.standing) for each in strike.verdict.warnings]
    codes = {each.code for each in strike.verdict.warnings}
    for name in (*RUNS, "wall", "uncertainty"):
        for warning in (_answered(strike, name) or {}).get("warnings", ()):
            if warning["code"] not in UNSAID | codes:
                codes.add(warning["code"])
                shown = warning["code"], warning["detail"], KEYS[name]
                found.append((shown, warning.get("standing", False)))
    return found


def _pictures(strike: Assessed, study: Mapping[str, Any] | None) -> dict[str, bytes]:
    """Draw the figures; runs that could not be computed are left out."""
    case, angle = strike.case, strike.answers["cra"].get("critical_angle_deg")
    judged, thickness = lookup(case, "/impact/oblique_angle_deg"), lookup(case, "/target/thickness_m")
    runs = []
    for name in RUNS:
        if answer := _answered(strike, name):
            start = answer["history"]["axis_angle_deg"][0] - case["impact"]["angle_of_attack_deg"]
            end = f"{OUTCOMES[answer['outcome']]} after {1e3 * answer['final']['time_s']:.2g} ms"
            runs.append((f"{RUN_TITLES[name]}{start:.2f}°:\n{end}", answer))
    drawn = next((each for each in (judged, angle, case["search"].get("upper_deg")) if each is not None), 45.0)
    speeds = [each for each in strike.speeds if "problem" not in each[1]]
    with style.styled(SETTINGS):
        found = {
            "sketch": sketch(
                strike.projectile,
                oblique_deg=drawn,
                attack_deg=case["impact"]["angle_of_attack_deg"],
                thickness=thickness,
            ),
            "curves": curves(speeds, study, speed=case["impact"]["velocity_m_s"], angle=angle, judged=judged),
        }
        if runs:
            found["runs"] = side_views(strike.projectile, runs, thickness=thickness)
        return {name: svg(figure) for name, figure in found.items()}
