"""Models of the empirical formulas: request and answer."""

from functools import partial
from typing import Annotated, Any

from pydantic import MISSING, Field

from service.schemas.answers import VERSIONED, EngineVersion, Key, ModelWarning
from service.schemas.fields import GIVEN, NOT_TABLED, walk
from service.schemas.problems import pointer_of_parameter
from service.schemas.quantities import Num, Of, Part, Units, solver_arguments, with_examples
from service.schemas.strike import PAPER, STRIKE, Impact, Projectile, Target
from solver.formulas import PERFORATION_MARGIN, SCABBING_MARGIN, Limit, formulas, nose_class, spread
from solver.units import UnitSystem
from solver.warnings import NORMAL_COMPONENT_ONLY, body_warnings, reinforcement_warnings

REQUEST = {name: PAPER[name] for name in ("projectile", "target")} | {"impact": STRIKE}
NOT_FITTED = {
    "pointer": "/impact/velocity_m_s",
    "detail": "fitted from 20 m/s to 200 m/s along the normal, here 238 m/s",
}
ROW = {
    "formula": "modified_ndrc",
    "penetration_depth_m": 0.2412,
    "scabbing_thickness_m": 0.4976,
    "perforation_thickness_m": 0.4047,
    "in_range": True,
    "range_known": True,
    "out_of_range": [],
    "verified": True,
    "source": "NDRC 1946; Kennedy 1976; DOE-STD-3014-2006, appendix C",
}
SPREAD = {"lowest": 0.3664, "highest": 0.4047, "formulas": 2}
WARNING = {"code": NORMAL_COMPONENT_ONLY.code, "detail": NORMAL_COMPONENT_ONLY.detail}


class FormulaImpact(Impact):
    """Motion at first contact. Formulas use only the component of the velocity along the normal."""

    model_config = with_examples(STRIKE)

    oblique_angle_deg: Annotated[Num, Field(ge=0.0, lt=90.0)] = 0.0
    """Angle between the velocity and the inward normal of the face. The formulas are for normal impact; they
    are evaluated with the component of the velocity along the normal, which is common practice but has no other
    justification. [°]"""


class FormulasRequest(Part):
    """One strike to evaluate with all formulas."""

    model_config = with_examples(REQUEST)

    projectile: Projectile
    target: Target
    impact: FormulaImpact
    units: Units = UnitSystem.SI

    def canonical(self) -> dict[str, Any]:
        """Return all fields as JSON data, with defaults filled in."""
        return self.model_dump(mode="json")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.formulas`."""
        return {name: value for name, value in solver_arguments(self).items() if name != "units"}


class NotFitted(Part):
    """An input or a result outside the range to which a formula was fitted."""

    model_config = with_examples(NOT_FITTED)

    pointer: Annotated[str, Of(lambda outside: pointer_of_parameter(outside.field))]
    """JSON pointer to the input in the request, or to the result in the row."""
    detail: str
    """Range of the formula, and the value of this strike."""


class FormulaRow(Part):
    """Result of one formula. Quantities that it does not predict are absent."""

    model_config = with_examples(ROW)

    formula: str
    """Stable name of the formula, for programs."""
    penetration_depth_m: Num | MISSING = MISSING
    """Depth of penetration into concrete that is thick enough. [m]"""
    scabbing_thickness_m: Num | MISSING = MISSING
    """Least thickness of a wall whose rear face does not scab, without a margin. [m]"""
    perforation_thickness_m: Num | MISSING = MISSING
    """Least thickness of a wall that is not perforated, without a margin. [m]"""
    limit_speed_m_s: Num | MISSING = MISSING
    """Least speed that perforates the wall, in an answer to `/limit-speed` only. [m/s]"""
    in_range: bool
    """True if the range of the formula is known and includes the strike."""
    range_known: bool
    """True if a source states the range of the formula."""
    out_of_range: list[NotFitted]
    note: str | MISSING = MISSING
    """Doubts about the formula, or assumptions; absent if there are none."""
    verified: bool
    """True if the constants were compared with the original publication, a standard or a published shot. The constants
    of the other formulas come from secondary sources only."""
    source: str
    """Authors and year of the source."""


class FormulaSpread(Part):
    """Lowest and highest result of the formulas that are in range."""

    model_config = with_examples(SPREAD)

    lowest: Num
    """Lowest result. [m]"""
    highest: Num
    """Highest result. [m]"""
    formulas: Annotated[int, Of("count")]
    """Number of formulas in range with a result. Equal results, such as Kar's for steel and modified NDRC's, count
    once."""


def spread_of(limit: Limit) -> Of:
    """Return the source of a field that holds the spread of a limit over the formulas."""
    return Of(partial(spread, limit=limit))


class FormulasAnswer(Part):
    """Results of all formulas, and their spread."""

    model_config = with_examples(
        {
            "formulas": [ROW],
            "perforation_thickness_spread": SPREAD,
            "nose_class": "sharp",
            "scabbing_margin": SCABBING_MARGIN,
            "perforation_margin": PERFORATION_MARGIN,
            "warnings": [WARNING],
        }
        | VERSIONED
    )

    formulas: Annotated[list[FormulaRow], Of(tuple)]
    penetration_depth_spread: Annotated[FormulaSpread | MISSING, spread_of("penetration_depth")] = MISSING
    scabbing_thickness_spread: Annotated[FormulaSpread | MISSING, spread_of("scabbing_thickness")] = MISSING
    perforation_thickness_spread: Annotated[FormulaSpread | MISSING, spread_of("perforation_thickness")] = MISSING
    nose_class: Annotated[str, GIVEN, NOT_TABLED]
    """Nose class that the formulas use, from flat to sharp. It follows from the ratio of nose length to diameter."""
    scabbing_margin: Annotated[Num, Of(lambda _: SCABBING_MARGIN), NOT_TABLED]
    """Factor on the scabbing thickness that DOE-STD-3014-2006 requires in a design. [1]"""
    perforation_margin: Annotated[Num, Of(lambda _: PERFORATION_MARGIN), NOT_TABLED]
    """Factor on the perforation thickness that DOE-STD-3014-2006 requires in a design. [1]"""
    warnings: Annotated[list[ModelWarning], GIVEN]
    """Warnings: `normal_component_only` for an oblique strike, `mean_density_unusual`, `reinforcement_not_counted`."""
    key: Key
    engine_version: EngineVersion


def formulas_answer(request: FormulasRequest) -> dict[str, Any]:
    """Evaluate the formulas, and return the answer without its key and version.

    Raises
    ------
    ParameterError
        If values contradict each other, or the strike has no velocity along the normal.
    """
    arguments = request.arguments()
    projectile, oblique = arguments["projectile"], arguments["impact"].oblique_angle != 0.0
    found = [NORMAL_COMPONENT_ONLY] if oblique else []
    found += (*body_warnings(projectile), *reinforcement_warnings(arguments["target"]))
    return walk(FormulasAnswer, formulas(**arguments), nose_class=nose_class(projectile), warnings=found)
