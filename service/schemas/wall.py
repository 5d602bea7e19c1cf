"""Models of the verdict on a wall: request and answer."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import MISSING

import solver
from service.schemas.answers import VERSIONED, WARNING, EngineVersion, Key, ModelWarning, Protrusion
from service.schemas.fields import NOT_TABLED, walk
from service.schemas.numerics import Method
from service.schemas.quantities import Flag, Num, Part, Units, with_examples
from service.schemas.requests import Case
from service.schemas.strike import PAPER, PAPER_AT_45, Impact
from solver import Outcome
from solver.uncertainty import DesignValue, RearFaceVariants, WallVerdict
from solver.units import UnitSystem

PERFORATION = {"enough": True, "limit_m": 0.3663, "design_m": 0.4396, "formula": "hughes"}
SCABBING = {"enough": False, "limit_m": 0.4641, "design_m": 0.5105, "formula": "hughes"}
NORMAL = {"perforation_design_m": 0.5988, "scabbing_design_m": 0.6712}
WALL = {"enough": False, "perforation": PERFORATION, "scabbing": SCABBING, "normal_impact": NORMAL}
VARIANTS = {"plain": 0.1864, "rear_plug": 0.2180, "rear_plug_and_crater": 0.3006}
QUESTIONS = ("perforation", "scabbing")


class WallRequest(Case):
    """A strike on a wall. Without `target.thickness_m` the answer has design values and limits, but no outcome.

    The method is always `adaptive`.
    """

    model_config = with_examples(PAPER_AT_45, PAPER_AT_45 | {"target": PAPER["target"] | {"thickness_m": 0.45}})

    impact: Impact
    units: Units = UnitSystem.SI

    @property
    def by_panels(self) -> bool:
        """False: a verdict takes about a hundred runs, and those with panels take seconds."""
        return False

    def resolved(self) -> Self:
        """Return the request with the adaptive method and with defaults, except for the tolerances of the searches."""
        numerics = self.numerics.model_copy(update={"method": Method.ADAPTIVE})
        adaptive = self.model_copy(update={"numerics": numerics})
        return adaptive.adaptive(termination_time_s=self.usual_termination_time(self.impact.velocity_m_s))

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.uncertainty.judge_wall`.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        case = self.resolved()
        return case.shared_arguments() | {"impact": case.impact.to_solver()}


class WallQuestion(Part):
    """Design of a wall against perforation or scabbing; an empty object if no formula is within its range."""

    model_config = with_examples(PERFORATION)

    enough: Flag | MISSING = MISSING
    """True if the wall has at least the design thickness and, for perforation, nothing comes out of the rear face in
    the model."""
    limit_m: Num | MISSING = MISSING
    """Largest limit thickness of the formulas within their range, without a margin. [m]"""
    design_m: Num | MISSING = MISSING
    """Design thickness: the limit times 1.2 for perforation and times 1.1 for scabbing (DOE-STD-3014-2006). For
    perforation it is at least the thickness at which the projectile does not protrude from the rear face in the model,
    both with the resistance of the request and with a plug and a crater. [m]"""
    formula: str | MISSING = MISSING
    """Formula that determines the design thickness; `this_model` if the model requires a thicker wall than the formulas
    with their margins."""


class NormalImpactDesign(Part):
    """Design values for normal impact at the same speed, as used in design practice."""

    model_config = with_examples(NORMAL)

    perforation_design_m: Num | MISSING = MISSING
    """Design thickness against perforation. [m]"""
    scabbing_design_m: Num | MISSING = MISSING
    """Design thickness against scabbing. [m]"""


class WallDesign(Part):
    """Design of a wall against perforation and scabbing.

    For an oblique strike, the formulas use the component of the velocity along the normal.
    """

    model_config = with_examples(WALL)

    enough: Flag | MISSING = MISSING
    """True if the wall is thick enough against both. Absent if the target has no thickness, or if no formula is within
    its range for one of them and the wall is not too thin against the other."""
    perforation: WallQuestion
    """Design against perforation, in which the body passes through the wall."""
    scabbing: WallQuestion
    """Design against scabbing, in which concrete breaks off the rear face."""
    normal_impact: NormalImpactDesign


class Variants(Part):
    """Limits in the model: without a plug and a crater, with a plug that shears out of the rear, and with both."""

    model_config = with_examples(VARIANTS)

    plain: Num | MISSING = MISSING
    """Limit without a plug and a crater, in the unit of the answer."""
    rear_plug: Num | MISSING = MISSING
    """Limit with the plug of the request, or the default plug."""
    rear_plug_and_crater: Num | MISSING = MISSING
    """Limit with this plug and the crater of the request, or the default crater."""


class WallAnswer(WallDesign):
    """Verdict on a wall in words and in numbers."""

    model_config = with_examples(
        {
            "sentence": "Wall of 450 mm at 45° from the normal: not enough against scabbing; enough against "
            "perforation at this angle only. Design value against scabbing 511 mm (Hughes × 1.1), against perforation "
            "440 mm (Hughes × 1.2), with the mean strength of 39 MPa, as no characteristic strength is given.",
            **WALL,
            "variants": VARIANTS,
            "outcome": "embedded",
            "warnings": [WARNING],
        }
        | VERSIONED
    )

    sentence: Annotated[str, NOT_TABLED]
    """Verdict in words, which the page, the report and the command line show."""
    variants: Variants
    """Least thickness that is not perforated in the model, which is not a design value. [m]"""
    outcome: Outcome | MISSING = MISSING
    """Outcome of the strike in the model, if the wall has a thickness."""
    protrusion: Protrusion | MISSING = MISSING
    """Protrusion from the rear face, if the wall is not perforated and any part comes out."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def wall_answer(found: WallVerdict) -> dict[str, Any]:
    """Return the answer without its key and version."""
    answer: dict[str, Any] = {"sentence": found.sentence, **_present(enough=found.enough)}
    for name in QUESTIONS:
        value: DesignValue = getattr(found, name)
        answer[name] = _present(enough=value.enough, limit_m=value.limit, design_m=value.design, formula=value.formula)
    names = [f"{name}_design_m" for name in QUESTIONS]
    answer["normal_impact"] = _present(**dict(zip(names, found.normal_impact, strict=True)))
    answer["variants"] = walk(Variants, found.variants)
    answer |= _present(outcome=found.outcome and found.outcome.value)
    if found.protrusion is not None:
        answer["protrusion"] = walk(Protrusion, found.protrusion)
    return answer | {"warnings": [walk(ModelWarning, each) for each in found.warnings]}


def design_in(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an answer that the verdict on a strike repeats."""
    return {name: answer[name] for name in WallDesign.model_fields if name in answer}


def wall_in(request: Case, answer: Mapping[str, Any], oblique_angle: float) -> WallVerdict:
    """Convert an answer back to the solver's `WallVerdict`.

    Parameters
    ----------
    request
        Request of the strike.
    oblique_angle
        Oblique angle of the strike. [rad]
    """
    variants = answer["variants"]
    questions = {
        name: DesignValue(**{key.removesuffix("_m"): value for key, value in answer[name].items()})
        for name in QUESTIONS
    }
    normal, target = answer["normal_impact"], request.target.to_solver()
    return WallVerdict(
        thickness=target.thickness,
        oblique_angle=oblique_angle,
        compressive_strength=target.compressive_strength,
        characteristic_strength=target.characteristic_strength,
        perforation=questions["perforation"],
        scabbing=questions["scabbing"],
        normal_impact=(normal.get("perforation_design_m"), normal.get("scabbing_design_m")),
        variants=RearFaceVariants(**{name: variants.get(name) for name in Variants.model_fields}),
        outcome=Outcome(answer["outcome"]) if "outcome" in answer else None,
        protrusion=protrusion_in(answer),
        warnings=tuple(map(warning_in, answer["warnings"])),
        sentence=answer["sentence"],
    )


def warning_in(found: Mapping[str, Any]) -> solver.ModelWarning:
    """Convert a warning in an answer to a warning of the solver."""
    shift = found.get("angle_shift_deg")
    return solver.ModelWarning(
        found["code"],
        found["detail"],
        standing=found.get("standing", False),
        angle_shift=None if shift is None else math.radians(shift),
    )


def protrusion_in(answer: Mapping[str, Any]) -> solver.Protrusion | None:
    """Convert the protrusion in the answer to a run back to the solver's `Protrusion`; None if there is none."""
    found = answer.get("protrusion")
    return None if found is None else solver.Protrusion(final=found.get("final_m"), greatest=found["greatest_m"])


def _present(**values: Any) -> dict[str, Any]:
    """Return the values that are not None."""
    return {name: value for name, value in values.items() if value is not None}
