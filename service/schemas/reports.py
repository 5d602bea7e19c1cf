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

USUAL_SCATTER: dict[str, dict[str, Any]] = {
    "impact.velocity_m_s": {"type": "normal", "coefficient_of_variation": 0.02},
    "target.compressive_strength_pa": {"type": "lognormal", "dispersion": 0.12},
    "target.density_kg_m3": {"type": "normal", "coefficient_of_variation": 0.02},
    "projectile.mass_kg": {"type": "normal", "coefficient_of_variation": 0.005},
    "impact.angle_of_attack_deg": {"type": "normal", "standard_deviation": 1.0},
    "resistance.free_surface.model": {
        "type": "discrete",
        "values": [FreeSurfaceModel.ELASTIC_PLASTIC.value, FreeSurfaceModel.MOHR_COULOMB.value],
        "weights": [0.8, 0.2],
    },
}
"""Distributions of the inputs that usually scatter, around the value of the case; the page takes them from here."""
CENTRES = {"normal": "mean", "lognormal": "median"}
"""Parameter of a distribution that is the value of the case."""


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
        if self.by_paper:
            raise ParameterError("search.method", "must be `outcome` in a report, which takes hundreds of searches")
        if self.numerics.method is Method.PANELS:
            raise ParameterError("numerics.method", "must be `adaptive` in a report, which takes hundreds of searches")

    def usual_scatter(self) -> list[dict[str, Any]]:
        """Return the usual scatter around the values of the case, as `/cra/uncertainty` takes it.

        The decay law scatters between the two theories, unless the case has none.
        """
        case = self.model_dump(mode="json")
        found = []
        for field, usual in USUAL_SCATTER.items():
            value: Any = case
            for name in field.split("."):
                value = value[name]
            if usual["type"] in CENTRES:
                found.append({"field": field, "distribution": usual | {CENTRES[usual["type"]]: value}})
            elif value in usual["values"]:
                found.append({"field": field, "distribution": usual})
        return found
