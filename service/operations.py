"""What the service computes, each operation once: request, computation, answer, columns and key of its result."""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, TypeAlias

import orjson
from pydantic import ValidationError

import solver
from service.columns import SUMMARY, Column
from service.schemas import (
    CriticalAngleBase,
    CriticalAngleRequest,
    CriticalAngleUncertaintyRequest,
    DepthCalibrationRequest,
    FormulasRequest,
    LimitSpeedRequest,
    MotionCalibrationRequest,
    ObliquityCalibrationRequest,
    ThicknessRequest,
    TrajectoryRequest,
    TrajectoryUncertaintyRequest,
    critical_angle_answer,
    critical_angle_uncertainty_answer,
    depth_answer,
    formulas_answer,
    limit_speed_answer,
    motion_answer,
    obliquity_answer,
    thickness_answer,
    trajectory_answer,
    trajectory_uncertainty_answer,
)
from service.schemas.quantities import Part
from service.schemas.requests import Case, TrajectoryFields, alternative_requests
from service.schemas.uncertain_inputs import with_values
from service.schemas.uncertainty import UncertainCase, crossings_in, ending_in
from solver import ENGINE_VERSION
from solver.arrays import FloatArray
from solver.calibration import fit_decay_laws, fit_depth, fit_obliquity, penetration_depths, predict_motion
from solver.search.trials import LAST_POINTS, LAST_STATIONS, LAST_TOLERANCE
from solver.strike import SEARCH_STATIONS
from solver.uncertainty import Crossings, Ending

SCHEMA_VERSION = "1"
"""Raised whenever the meaning of a request or an answer changes: results kept under another version are not used."""


class Request(Protocol):
    """A validated request."""

    def canonical(self) -> dict[str, Any]:
        """Return every field as JSON data, defaults filled in."""
        ...


@dataclass(frozen=True, slots=True)
class KeyedRequest:
    """A canonical request as JSON, and the key of its result."""

    key: str
    json: bytes
    work: int = 1
    """What it counts as, in ordinary cases."""

    @classmethod
    def of(cls, operation: str, request: Request) -> "KeyedRequest":
        """Return the canonical form of a validated request with its key."""
        canonical = request.canonical()
        work = work_of(operation, request) if isinstance(request, Case) else 1
        return cls(result_key(operation, canonical), orjson.dumps(canonical), work)


def result_key(operation: str, request: dict[str, Any]) -> str:
    """Key of the result of a request.

    Parameters
    ----------
    operation
        Name of the operation, such as ``"cra"``.
    request
        Canonical request: validated, every default filled in.

    Returns
    -------
    str
        SHA-256, hexadecimal. The order of the fields does not matter, nor 1 or 1.0, nor the sign of a zero; anything
        else does, to the last bit of a number.
    """
    content = {
        "operation": operation,
        "request": _plain(request),
        "engine_version": ENGINE_VERSION,
        "schema_version": SCHEMA_VERSION,
    }
    return hashlib.sha256(orjson.dumps(content, option=orjson.OPT_SORT_KEYS)).hexdigest()


def _plain(value: Any) -> Any:
    """Replace numbers by floats, each of which has one text, and -0.0 by 0.0."""
    kind = type(value)
    if kind is float or kind is int:
        return float(value) + 0.0
    if kind is dict:
        return {name: _plain(item) for name, item in value.items()}
    if kind is list:
        return [_plain(item) for item in value]
    return value


Answer: TypeAlias = tuple[dict[str, Any], dict[str, FloatArray] | None]
"""The JSON answer without its key, its version and the columns of its history; and those columns."""


@dataclass(frozen=True, slots=True)
class Operation:
    """One kind of request.

    Parameters
    ----------
    compute
        Takes the canonical request as JSON, as a worker receives it. A function of a module, so that its name is all
        that goes to the worker.
    request
        Model of the request. Its `arguments` raises ParameterError if values do not go together.
    columns
        The answer in one row.
    cases
        Returns what a request counts as against a quota.
    weight
        What an ordinary case of a batch or a sweep counts as, against a quota and the size of what is answered at once.
    runs
        Runs of which it consists, about.
    """

    compute: Callable[[bytes], Answer]
    request: type[Part]
    columns: tuple[Column, ...] = ()
    cases: Callable[[Any], int] = lambda _: 1
    weight: int = 1
    runs: int = 1


def compute_trajectory(request: bytes) -> Answer:
    """Run one strike."""
    return trajectory_answer(solver.simulate(**TrajectoryRequest.model_validate_json(request).arguments()))


DECIDING_SETTINGS: tuple[dict[str, Any], ...] = (
    {"stations": SEARCH_STATIONS},
    {"relative_tolerance": LAST_TOLERANCE, "stations": LAST_STATIONS, "points": LAST_POINTS},
)
"""Settings of the two levels of a search that decide on its angle."""


def compute_critical_angle(request: bytes) -> Answer:
    """Find a critical angle and, if it has a history and there is such an angle, run the strike at it."""
    arguments, sample_interval = CriticalAngleRequest.model_validate_json(request).arguments()
    found = solver.critical_angle(**arguments)
    if sample_interval is None or found.angle is None:
        return critical_angle_answer(found, None)
    del arguments["search"]
    strike = {name: arguments.pop(name) for name in ("velocity", "angle_of_attack", "angular_velocity")}
    impact = solver.Impact(oblique_angle=found.angle, **strike)
    numerics, trajectory = arguments.pop("numerics"), None
    for settings in DECIDING_SETTINGS:  # just as much energy is left as must be: other settings may find a little less
        trajectory = solver.simulate(
            **arguments, impact=impact, numerics=replace(numerics, **settings), sample_interval=sample_interval
        )
        if trajectory.outcome is solver.Outcome.RICOCHET or numerics.method == "panels":
            break
    return critical_angle_answer(found, trajectory)


def compute_depth_calibration(request: bytes) -> Answer:
    """Fit a strength factor to depths; predict them with each strength factor to compare."""
    arguments, strength_factors, velocities = DepthCalibrationRequest.model_validate_json(request).arguments()
    model = {name: arguments[name] for name in ("projectile", "target", "resistance")}
    curves = [
        (factor, velocities, penetration_depths(**model, velocities=velocities, strength_factor=factor))
        for factor in strength_factors
    ]
    return depth_answer(fit_depth(**arguments), curves), None


def compute_motion_calibration(request: bytes) -> Answer:
    """Fit a strength factor to motions with every decay law; predict them with each strength factor to compare."""
    calibration = MotionCalibrationRequest.model_validate_json(request)
    arguments, strength_factors, times = calibration.arguments()
    try:
        fits = fit_decay_laws(**arguments)
    except solver.ParameterError as error:
        raise calibration.located(error) from None
    model = {name: arguments[name] for name in ("projectile", "target", "resistance")}
    compared = [
        [
            (factor, predict_motion(**model, impact=run.impact, times=rows, strength_factor=factor))
            for factor in strength_factors
        ]
        for run, rows in zip(arguments["runs"], times, strict=True)
    ]
    return motion_answer(fits, compared, several=calibration.several), None


def compute_obliquity_calibration(request: bytes) -> Answer:
    """Fit a polynomial in the oblique angle to strength factors."""
    return obliquity_answer(fit_obliquity(**ObliquityCalibrationRequest.model_validate_json(request).arguments())), None


def compute_formulas(request: bytes) -> Answer:
    """Evaluate the empirical formulas."""
    return formulas_answer(FormulasRequest.model_validate_json(request)), None


def compute_thickness(request: bytes) -> Answer:
    """Find the least thickness that is not perforated."""
    return thickness_answer(ThicknessRequest.model_validate_json(request)), None


def compute_limit_speed(request: bytes) -> Answer:
    """Find the least speed that perforates a wall."""
    return limit_speed_answer(LimitSpeedRequest.model_validate_json(request)), None


StudyReport: TypeAlias = Callable[[int, float | None], None]
"""Takes the number of samples done and the half width reached, if there is one."""


@dataclass(frozen=True, slots=True)
class StudyOperation:
    """How a study of uncertainty computes its samples: each is a request of another operation.

    Parameters
    ----------
    sample
        That operation.
    model
        Its request among many.
    finding
        Returns what the study keeps of an answer.
    failed, outside
        What it keeps of a sample that could not be computed, or is outside the accepted range.
    answer
        Returns the answer of the study as JSON data.
    """

    sample: str
    model: type[Case]
    finding: Callable[[Mapping[str, Any]], Any]
    failed: Any
    outside: Any
    answer: Callable[[Any], dict[str, Any]]

    def base(self, request: Any) -> Case:
        """Return the request that the samples differ from."""
        return self.model.model_validate(request.base)

    def requests(self, request: Any, points: Sequence[Sequence[Any]]) -> list[KeyedRequest | None]:
        """Return the request of every sample; None for one outside the accepted range."""
        base, fields = request.base, [each.field for each in request.uncertain]
        found: list[KeyedRequest | None] = []
        for point in points:
            try:
                case: Any = self.model.model_validate(with_values(base, fields, point))
                found.append(KeyedRequest.of(self.sample, case))
            except (ValidationError, solver.ParameterError):
                found.append(None)
        return found


UNCERTAIN: Mapping[str, StudyOperation] = {
    "cra_uncertainty": StudyOperation(
        "cra",
        CriticalAngleBase,
        crossings_in,
        Crossings(problem="failed"),
        Crossings(problem="outside"),
        critical_angle_uncertainty_answer,
    ),
    "trajectory_uncertainty": StudyOperation(
        "trajectory",
        TrajectoryFields,
        ending_in,
        Ending(problem="failed"),
        Ending(problem="outside"),
        trajectory_uncertainty_answer,
    ),
}
"""Studies of uncertainty, by operation."""


def compute_critical_angle_uncertainty(request: bytes) -> Answer:
    """Sample critical angles, one after the other."""
    return answer_study("cra_uncertainty", CriticalAngleUncertaintyRequest.model_validate_json(request)), None


def compute_trajectory_uncertainty(request: bytes) -> Answer:
    """Sample runs, one after the other."""
    return answer_study("trajectory_uncertainty", TrajectoryUncertaintyRequest.model_validate_json(request)), None


def answer_study(operation: str, request: Any, report: StudyReport = lambda *_: None) -> dict[str, Any]:
    """Return the answer of a study without key and version, its samples computed one after the other.

    Parameters
    ----------
    request
        The validated request of the operation.
    report
        Called before every sample with the number of those done and the half width reached, None before there is one.
    """
    study: Any = UNCERTAIN[operation]
    compute = OPERATIONS[study.sample].compute

    def evaluate(sample: KeyedRequest | None) -> Any:
        if sample is None:
            return study.outside
        try:
            return study.finding(compute(sample.json)[0])
        except solver.RicochetError as error:
            return study.outside if isinstance(error, solver.ParameterError) else study.failed

    steps: Any = request.study().steps()
    batch, done = next(steps), 0
    while True:
        half_width = None if batch.so_far is None else batch.so_far.convergence[-1].half_width
        found = []
        for sample in study.requests(request, batch.points):
            report(done, half_width)
            found.append(evaluate(sample))
            done += 1
        try:
            batch = steps.send(found)
        except StopIteration as end:
            answer: dict[str, Any] = study.answer(end.value)
            return answer


WALL_CASES = 20
"""What a search for perforation counts as: it takes 20 to 30 runs."""


SEARCH_RUNS = 10
"""Runs of a search for a critical angle, about."""
PANEL_STEPS = 1e6
"""Panels times time steps of a run that takes as long as an ordinary case, 10 to 20 ms."""


def work_of(operation: str, request: Case) -> int:
    """Return what one case counts as: by panels, as all the time steps that its runs may take."""
    found = OPERATIONS[operation]
    return max(found.weight, math.ceil(found.runs * request.panel_steps() / PANEL_STEPS))


def cases_of_a_fit(_: Part) -> int:
    """Return what a calibration counts as: it takes as long as so many cases."""
    return 20


def cases_of_motions(request: MotionCalibrationRequest) -> int:
    """Return what a calibration by motion counts as: a fit of each run with each of three decay laws."""
    return 3 * request.run_count * cases_of_a_fit(request)


def cases_of_a_study(request: UncertainCase) -> int:
    """Return what a study counts as at most."""
    return request.sampling.max_samples


def cases_of_a_query(operation: str, request: Any) -> int:
    """Return what a query counts as: with alternatives, each of them is a case too."""
    return work_of(operation, request) * (1 + len(alternative_requests(request)) if request.alternatives else 1)


OPERATIONS: Mapping[str, Operation] = {
    "trajectory": Operation(
        compute_trajectory, TrajectoryRequest, SUMMARY["trajectory"], partial(cases_of_a_query, "trajectory")
    ),
    "cra": Operation(
        compute_critical_angle,
        CriticalAngleRequest,
        SUMMARY["cra"],
        partial(cases_of_a_query, "cra"),
        runs=SEARCH_RUNS,
    ),
    "calibration_depth": Operation(
        compute_depth_calibration,
        DepthCalibrationRequest,
        SUMMARY["calibration_depth"],
        cases_of_a_fit,
    ),
    "calibration_motion": Operation(
        compute_motion_calibration,
        MotionCalibrationRequest,
        SUMMARY["calibration_motion"],
        cases_of_motions,
    ),
    "calibration_obliquity": Operation(
        compute_obliquity_calibration, ObliquityCalibrationRequest, cases=cases_of_a_fit
    ),
    "formulas": Operation(compute_formulas, FormulasRequest),
    "thickness": Operation(
        compute_thickness,
        ThicknessRequest,
        SUMMARY["thickness"],
        partial(work_of, "thickness"),
        weight=WALL_CASES,
        runs=WALL_CASES,
    ),
    "limit-speed": Operation(
        compute_limit_speed,
        LimitSpeedRequest,
        SUMMARY["limit-speed"],
        partial(work_of, "limit-speed"),
        weight=WALL_CASES,
        runs=WALL_CASES,
    ),
    "cra_uncertainty": Operation(
        compute_critical_angle_uncertainty,
        CriticalAngleUncertaintyRequest,
        SUMMARY["cra_uncertainty"],
        cases_of_a_study,
    ),
    "trajectory_uncertainty": Operation(
        compute_trajectory_uncertainty,
        TrajectoryUncertaintyRequest,
        SUMMARY["trajectory_uncertainty"],
        cases_of_a_study,
    ),
}


def outcome_of(answer: Mapping[str, Any]) -> str:
    """Return how a run, a search or a study ended; a fit that has an answer was found, and so were formulas."""
    if "formulas" in answer and "status" not in answer:
        return "evaluated"
    if "converged" in answer:
        return "converged" if answer["converged"] else "not_converged"
    outcome: str = answer.get("outcome") or answer.get("status") or "fitted"
    return outcome
