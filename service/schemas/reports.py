"""The report of one strike: its request, and the scatter of inputs that it assumes."""

from typing import Annotated, Any

from pydantic import MISSING, Field

from service.schemas.examples import PAPER, PAPER_AT_45
from service.schemas.numerics import Method
from service.schemas.quantities import with_examples
from service.schemas.requests import CriticalAngleRequest
from service.schemas.resistance import FreeSurfaceModel
from service.schemas.strike import STRIKE, ObliqueAngle, Strike
from solver import ParameterError

SPREADS: dict[str, dict[str, float]] = {
    "impact.velocity_m_s": {"coefficient_of_variation": 0.02},
    "target.density_kg_m3": {"coefficient_of_variation": 0.02},
    "projectile.mass_kg": {"coefficient_of_variation": 0.005},
    "impact.angle_of_attack_deg": {"standard_deviation": 1.0},
}
"""Usual scatter of inputs that are normally distributed around the value of the case."""
STRENGTH_DISPERSION = 0.12
"""Usual standard deviation of the logarithm of the compressive strength. [1]"""
DECAY_WEIGHTS = {FreeSurfaceModel.ELASTIC_PLASTIC: 0.8, FreeSurfaceModel.MOHR_COULOMB: 0.2}
"""Weights of the two theories of the decay. [1]"""


class ReportedStrike(Strike):
    """The motion at first contact, with the oblique angle if one is to be judged."""

    model_config = with_examples(STRIKE, STRIKE | {"oblique_angle_deg": 45.0})

    oblique_angle_deg: (
        Annotated[ObliqueAngle, Field(description="Angle to judge: its run and outcome are in the report. [°]")]
        | MISSING
    ) = MISSING


class ReportRequest(CriticalAngleRequest):
    """One strike as in a search for its critical angle; `output` and `alternatives` are without effect."""

    model_config = with_examples(PAPER, PAPER_AT_45)

    impact: ReportedStrike

    def check(self) -> None:
        """Refuse routes that take seconds a case: a report is made of some hundreds.

        Raises
        ------
        ParameterError
            If the search or the numerics are the paper's.
        """
        if self.search.by_paper:
            raise ParameterError("search.method", "must be `outcome` in a report, which takes hundreds of searches")
        if self.numerics.method is Method.PANELS:
            raise ParameterError("numerics.method", "must be `adaptive` in a report, which takes hundreds of searches")

    def usual_scatter(self) -> list[dict[str, Any]]:
        """Return the usual scatter around the values of the case, as `/cra/uncertainty` takes it.

        The decay law scatters between the two theories, unless the case has none.
        """
        case = self.model_dump(mode="json")
        found = []
        for field, spread in SPREADS.items():
            part, name = field.split(".")
            found.append({"field": field, "distribution": {"type": "normal", "mean": case[part][name], **spread}})
        strength = {"type": "lognormal", "median": self.target.compressive_strength_pa}
        found.insert(
            1,
            {
                "field": "target.compressive_strength_pa",
                "distribution": strength | {"dispersion": STRENGTH_DISPERSION},
            },
        )
        if self.resistance.free_surface.model in DECAY_WEIGHTS:
            laws = {"values": [law.value for law in DECAY_WEIGHTS], "weights": list(DECAY_WEIGHTS.values())}
            found.append({"field": "resistance.free_surface.model", "distribution": {"type": "discrete", **laws}})
        return found
