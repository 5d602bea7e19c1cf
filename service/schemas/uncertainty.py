"""Models of the requests for uncertainty studies, and the results that a study needs from its samples."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import MISSING, Field, model_validator
from pydantic_core import PydanticCustomError

from service.schemas.fields import in_solver_units
from service.schemas.flight import FlightInput
from service.schemas.numerics import Search
from service.schemas.quantities import WHOLE, Count, Flag, Num, Part, SolverPart, Units, with_examples
from service.schemas.requests import Case, CriticalAngleBase, TrajectoryFields
from service.schemas.strike import PAPER, PAPER_AT_45, Impact, Strike
from service.schemas.uncertain_inputs import (
    CENTRED,
    SCATTER,
    UncertainInput,
    accepts,
    check_fields,
    inputs_of,
    open_centre,
    with_centres,
    without_shots,
)
from solver import Exit
from solver.arrays import FloatArray
from solver.uncertainty import (
    AngleStudy,
    Crossings,
    Ending,
    Sampling,
    TrajectoryStudy,
)
from solver.uncertainty.next_shot import next_shots
from solver.uncertainty.results import FLIGHT_QUANTITIES
from solver.uncertainty.sampling import FEWEST_SAMPLES
from solver.units import UnitSystem, written_in
from solver.warnings import body_warnings

SAMPLING = Sampling()
MOST_SAMPLES_OF_A_REQUEST = 131_072
"""Largest number of samples of one study, which take a few minutes on two cores."""

FEW_SAMPLES = {"uncertain": CENTRED, "sampling": {"max_samples": 512, "half_width": 0.05}}
"""Uncertain inputs and sampling for the examples of sweeps and batches, about a second of work per study."""


class AngleRange(Part):
    """Evenly spaced angles, both ends included."""

    model_config = with_examples({"start": 30.0, "stop": 70.0, "count": 81})

    start: Annotated[Num, Field(ge=0.0, lt=90.0)] = 5.0
    """First angle. [°]"""
    stop: Annotated[Num, Field(ge=0.0, lt=90.0)] = 85.0
    """Last angle. [°]"""
    # The upper bound is `MOST_ANGLES` of the solver. The default is every half degree.
    count: Annotated[Count, Field(ge=2, le=2001), WHOLE] = 161

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.stop <= self.start:
            raise PydanticCustomError("angle_range", "`stop` must be above `start`")
        return self

    def radians(self) -> FloatArray:
        """Return the angles. [rad]"""
        return np.radians(np.linspace(self.start, self.stop, self.count))


class SamplingMethod(StrEnum):
    """Method that estimates probabilities from samples."""

    AUTO = "auto"
    DIRECT = "direct"


class SamplingSettings(SolverPart[Sampling]):
    """Accuracy, number and method of the samples."""

    model_config = with_examples({"half_width": 0.02, "confidence": 0.95, "max_samples": 16384, "seed": 7})

    half_width: Annotated[Num, Field(ge=1e-4, le=0.5)] = SAMPLING.half_width
    """Sampling ends when the confidence interval of every probability, cut off at 0 and 1, has at most this half width.
    [1]"""
    confidence: Annotated[Num, Field(ge=0.5, le=0.9999)] = SAMPLING.confidence
    """Confidence level of every interval. [1]"""
    max_samples: Annotated[Count, Field(ge=FEWEST_SAMPLES, le=MOST_SAMPLES_OF_A_REQUEST), WHOLE] = SAMPLING.max_samples
    """Largest number of searches or runs. With `sensitivity` it must be at least 256, plus the number of searches that
    change a single input: two for each continuous input, one for each discrete value."""
    seed: Annotated[Count, Field(ge=0, le=2**53), WHOLE] = SAMPLING.seed
    """Seed of the samples; the same seed always gives the same samples."""
    method: SamplingMethod = SamplingMethod.AUTO
    """Method of estimation. `auto` uses a surrogate if it passes its check and gives narrower intervals; `direct` uses
    none."""


# The upper bound is `MOST_INPUTS` of the solver.
Inputs = Annotated[list[UncertainInput], Field(min_length=1, max_length=24)]


class UncertainCase(Case):
    """Base class of the requests for uncertainty studies."""

    sample_model: ClassVar[type[Case]]
    """Model of the request of each sample."""

    uncertain: Inputs
    sampling: Annotated[SamplingSettings, Field(default_factory=SamplingSettings)]
    units: Units = UnitSystem.SI

    def resolved(self) -> Self:
        """Return the request with omitted centres filled in. The requests of the samples fill in all other defaults.

        Raises
        ------
        ParameterError
            If the case has no value for an omitted centre.
        """
        if not any(map(open_centre, self.uncertain)):
            return self
        return self.model_copy(update={"uncertain": with_centres(self.uncertain, self.central)})

    @property
    @abstractmethod
    def base(self) -> dict[str, Any]:
        """Request of a sample before its values are set."""

    def check_fields(self) -> None:
        """Check that the fields of the uncertain inputs exist, and that no two inputs have the same field.

        Raises
        ------
        ParameterError
            If a field does not exist, or two inputs have the same field.
        """
        check_fields(self.uncertain, self.sample_model, self.base)

    @abstractmethod
    def study(self) -> Any:
        """Convert the request to a study of the solver.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """

    @property
    def central(self) -> Case:
        """Case around which the samples vary."""
        shared = self.sample_model.model_fields.keys() & type(self).model_fields.keys()
        # The parts have already been validated as parts of this request.
        return self.sample_model.model_construct(**{name: getattr(self, name) for name in shared})

    @property
    def searches(self) -> int:
        """Largest number of samples."""
        return self.sampling.max_samples

    def panel_steps(self) -> float:
        """Return the panels times the time steps of the longest run; 0 with the adaptive method. [1]"""
        return self.central.panel_steps()


class CriticalAngleUncertaintyRequest(UncertainCase):
    """Study of the critical angle of strikes with uncertain inputs."""

    model_config = with_examples({**PAPER, "uncertain": SCATTER})

    sample_model: ClassVar = CriticalAngleBase

    impact: Strike
    search: Annotated[Search, Field(default_factory=Search)]
    oblique_angles_deg: Annotated[AngleRange, Field(default_factory=AngleRange)]
    """Angles at which the probability of ricochet is given."""
    sensitivity: Flag = True
    """Include the sensitivity to each input."""

    @property
    def base(self) -> dict[str, Any]:
        """Request of a sample before its values are set."""
        names = {"projectile", "target", "resistance", "numerics", "impact", "search"}
        return without_shots(self, self.model_dump(mode="json", include=names))

    def study(self) -> AngleStudy:
        """Convert the request to a study of the solver.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        lower, upper = self.search.to_solver().bounds
        base, arguments = self.base, self.shared_arguments()
        inputs = inputs_of(self.resolved().uncertain, CriticalAngleBase, base)
        with written_in(self.units):
            warnings = body_warnings(self.projectile.to_solver())
        return AngleStudy(
            inputs,
            self.oblique_angles_deg.radians(),
            self.sampling.to_solver(),
            sensitivity=self.sensitivity,
            bounds=(lower, upper),
            accepts=partial(accepts, CriticalAngleBase, base, inputs),
            warnings=warnings,
            shots=next_shots(inputs, **{name: arguments[name] for name in ("projectile", "target", "resistance")}),
        )


class TrajectoryUncertaintyRequest(UncertainCase):
    """Study of the outcome of one strike with uncertain inputs."""

    model_config = with_examples({**PAPER_AT_45, "uncertain": SCATTER})

    sample_model: ClassVar = TrajectoryFields

    impact: Impact
    flight: FlightInput | MISSING = MISSING
    """Conditions of the flight. If they are given, the answer has quantiles of the distance of flight."""

    @property
    def base(self) -> dict[str, Any]:
        """Request of a sample before its values are set, without a history."""
        names = {"projectile", "target", "resistance", "numerics", "impact", "flight"}
        return without_shots(self, self.model_dump(mode="json", include=names) | {"output": {"history": False}})

    def study(self) -> TrajectoryStudy:
        """Convert the request to a study of the solver.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        inputs = inputs_of(self.resolved().uncertain, TrajectoryFields, self.base)
        with written_in(self.units):
            warnings = body_warnings(self.projectile.to_solver())
        return TrajectoryStudy(inputs, self.sampling.to_solver(), warnings=warnings)


def crossings_in(answer: Mapping[str, Any]) -> Crossings:
    """Return the critical angles of a sample, as a study needs them, from the answer to its search."""
    others = [math.radians(angle) for angle in answer["other_crossings_deg"]]
    if answer["status"] == "not_converged":
        return Crossings(problem="failed")
    if "critical_angle_deg" not in answer:
        return Crossings(tuple(sorted(others)), answer["status"] == "always_ricochet")
    return Crossings(tuple(sorted((math.radians(answer["critical_angle_deg"]), *others))))


def ending_in(answer: Mapping[str, Any]) -> Ending:
    """Return the outcome, depth and exit of a sample, as a study needs them, from the answer to its run."""
    left = dict(answer.get("exit", {}))
    flight = left.pop("flight", {})
    distances = {name: flight[f"{name}_m"] for name in FLIGHT_QUANTITIES if flight}
    depth = answer.get("maximum_depth_m", math.nan)
    return Ending(answer["outcome"], depth, Exit(**in_solver_units(left)) if left else None, **distances)
