"""Operations of the service, each defined once: request, computation, answer, columns and key of the result."""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeAlias

import orjson
from pydantic import ValidationError

import solver
from service.columns import Column
from service.schemas import (
    CaseModels,
    CriticalAngleAnswer,
    CriticalAngleBase,
    CriticalAngleRequest,
    CriticalAngleUncertaintyAnswer,
    CriticalAngleUncertaintyRequest,
    DepthCalibrationAnswer,
    DepthCalibrationRequest,
    FlightAnswer,
    FlightRequest,
    FormulasAnswer,
    FormulasRequest,
    LimitSpeedAnswer,
    LimitSpeedBase,
    LimitSpeedRequest,
    MotionCalibrationAnswer,
    MotionCalibrationRequest,
    ObliquityCalibrationAnswer,
    ObliquityCalibrationRequest,
    ThicknessAnswer,
    ThicknessBase,
    ThicknessRequest,
    TrajectoryAnswer,
    TrajectoryBase,
    TrajectoryRequest,
    TrajectoryUncertaintyAnswer,
    TrajectoryUncertaintyRequest,
    WallAnswer,
    WallRequest,
    critical_angle_answer,
    depth_answer,
    formulas_answer,
    limit_speed_answer,
    motion_answer,
    obliquity_answer,
    thickness_answer,
    trajectory_answer,
    wall_answer,
)
from service.schemas.answers import FOUND, RUN, VERSIONED
from service.schemas.calibration_motion import Calibration
from service.schemas.fields import columns_of, walk
from service.schemas.flight import flight_of
from service.schemas.perforation import SPEED, THICKNESS, WALL
from service.schemas.quantities import Part
from service.schemas.requests import Case, alternatives_in
from service.schemas.resistance import FreeSurfaceModel
from service.schemas.strike import PAPER, PAPER_AT_45
from service.schemas.sweeps import ANGLES, EVEN, LISTED
from service.schemas.uncertain_inputs import with_values
from service.schemas.uncertainty import FEW_SAMPLES, MOST_SAMPLES_OF_A_REQUEST, crossings_in, ending_in
from service.schemas.uncertainty_answers import ANGLE_STUDY, STRIKE_STUDY
from solver import ENGINE_VERSION
from solver.arrays import FloatArray
from solver.calibration import fit_decay_laws, fit_depth, fit_obliquity, penetration_depths, predict_motion
from solver.search.trials import LAST_POINTS, LAST_STATIONS, LAST_TOLERANCE
from solver.strike import SEARCH_STATIONS
from solver.uncertainty import Crossings, Ending, compute_study, judge_wall
from solver.units import whole_number, written_in

SCHEMA_VERSION = "1"
"""Version of the requests. It is part of every key, and is raised when the meaning of a request changes, so that older
results are no longer found; `ENGINE_VERSION` does the same for answers."""


class Request(Protocol):
    """Protocol of validated request models."""

    def canonical(self) -> dict[str, Any]:
        """Return all fields as JSON data, with defaults filled in."""
        ...


@dataclass(frozen=True, slots=True)
class KeyedRequest:
    """A canonical request as JSON, with the key of its result and its cost."""

    key: str
    json: bytes
    work: int = 1
    """Cost of the computation. [ordinary cases]"""

    @classmethod
    def of(cls, operation: str, request: Request) -> "KeyedRequest":
        """Return a validated request in canonical form with its key and cost."""
        canonical = request.canonical()
        work = OPERATIONS[operation].work(request) if isinstance(request, Case) else 1
        return cls(result_key(operation, canonical), orjson.dumps(canonical), work)


def result_key(operation: str, request: dict[str, Any]) -> str:
    """Return the key of the result of a request.

    Parameters
    ----------
    operation
        Name of the operation, such as ``"cra"``.
    request
        Canonical request: validated, with all defaults filled in.

    Returns
    -------
    str
        Hexadecimal SHA-256 digest. It does not depend on the order of fields, the notation of a number (1 or 1.0) or
        the sign of a zero, but it depends on everything else, to the last bit of each number.
    """
    content = {
        "operation": operation,
        "request": _with_floats(request),
        "engine_version": ENGINE_VERSION,
        "schema_version": SCHEMA_VERSION,
    }
    return hashlib.sha256(orjson.dumps(content, option=orjson.OPT_SORT_KEYS)).hexdigest()


def _with_floats(value: Any) -> Any:
    """Convert all numbers to floats, so that equal numbers have the same JSON text."""
    kind = type(value)
    if kind is float or kind is int:
        return float(value) + 0.0  # Adding 0.0 turns -0.0 into 0.0.
    if kind is dict:
        return {name: _with_floats(item) for name, item in value.items()}
    if kind is list:
        return [_with_floats(item) for item in value]
    return value


Answer: TypeAlias = tuple[dict[str, Any], dict[str, FloatArray] | None]
"""The answer as JSON data without key, versions and history, and the columns of the history if there is one."""


@dataclass(frozen=True, slots=True)
class Many:
    """Routes for batches and sweeps of an operation.

    Parameters
    ----------
    models
        Models of the bodies and of the answer.
    batch, sweep
        Operation id of the route, and the first words of its description.
    note
        Additional sentence for the description of the batch route.
    """

    models: CaseModels
    batch: tuple[str, str]
    sweep: tuple[str, str]
    note: str = ""


class ToolText(NamedTuple):
    """A tool of the Model Context Protocol.

    Operations whose tools have the same `name` share one tool. `field` names the argument that holds the request of the
    operation; if it is empty, the arguments themselves are the request.
    """

    name: str
    title: str
    description: str
    field: str = ""


@dataclass(frozen=True, slots=True)
class Operation:
    """One kind of request, with everything that routes, jobs, tools and commands need to know about it.

    Parameters
    ----------
    name
        Name in keys, results and metrics, and the path of the route with `_` for `/`.
    compute
        Function from the canonical request, as JSON, to the answer. It must be at the top level of a module, because
        pickle sends functions to workers by name.
    request, answer
        Models of the request and the answer. Calling `arguments` of a request raises ParameterError if values
        contradict each other.
    route, description, tag
        Operation id, description and tag of the route in the contract.
    cases
        Function that returns the cost of a request against a quota, if `weight` and `work` do not determine it.
        [ordinary cases]
    weight
        Cost of a case with the adaptive method, which counts against quotas and against the size of a batch that is
        answered in the response. [ordinary cases]
    runs
        Approximate number of runs of one computation.
    long
        True if the body may be as long as the body of a batch. It is then validated in a thread.
    many
        Routes for batches and sweeps, if there are any.
    study
        Sampling of a study of uncertainty, if the operation is one.
    tool
        Tool of the Model Context Protocol, if there is one.
    """

    name: str
    compute: Callable[[bytes], Answer]
    request: type[Part]
    answer: type[Part] = Part
    route: str = ""
    description: str = ""
    tag: str = ""
    cases: Callable[[Any], int] | None = None
    weight: int = 1
    runs: int = 1
    long: bool = False
    many: Many | None = None
    study: "StudyOperation | None" = None
    tool: ToolText | None = None

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of a table with one row per answer."""
        return columns_of(self.answer)

    @property
    def path(self) -> str:
        """Path of the route."""
        return f"/{self.name.replace('_', '/')}"

    def work(self, request: Case) -> int:
        """Return the cost of one case. [ordinary cases]

        With panels, all time steps up to the termination time count, since the end of a run is not known beforehand.
        """
        once = max(self.weight, math.ceil(self.runs * request.panel_steps() / PANEL_STEPS))
        return once * request.searches

    def samples(self, request: bytes) -> int:
        """Return the largest number of samples of a study, from its canonical request; 1 for other operations.

        In queues and estimates, a study in a job counts as this many cases.
        """
        if self.study is None:
            return 1
        samples: int = orjson.loads(request)["sampling"]["max_samples"]
        return samples

    def cost(self, request: KeyedRequest) -> int:
        """Return the cost of a case in a queue, as if it were computed with the adaptive method. [ordinary cases]"""
        return self.weight * self.samples(request.json)

    def charge(self, request: Any) -> int:
        """Return the cost of a request against a quota; each alternative costs as much as the case. [ordinary cases]"""
        if self.cases is not None:
            return self.cases(request)
        if not isinstance(request, Case):
            return self.weight
        return self.work(request) * (1 + len(alternatives_in(request)))


def compute_trajectory(request: bytes) -> Answer:
    """Compute the motion of one strike and, if requested, the flight of a body that leaves the target."""
    strike = TrajectoryRequest.model_validate_json(request)
    arguments = strike.arguments()
    with written_in(strike.units):
        found = solver.simulate(**arguments)
    return trajectory_answer(found, flight_of(strike.flight, arguments["projectile"], found))


DECIDING_SETTINGS: tuple[dict[str, Any], ...] = (
    {"stations": SEARCH_STATIONS},
    {"relative_tolerance": LAST_TOLERANCE, "stations": LAST_STATIONS, "points": LAST_POINTS},
)
"""Numerical settings of the last two levels of refinement of a search, which determine its angle."""


def compute_critical_angle(request: bytes) -> Answer:
    """Find a critical angle and, if its history is requested, compute the run at that angle."""
    search = CriticalAngleRequest.model_validate_json(request)
    with written_in(search.units):
        return _critical_angle(search)


def _critical_angle(search: CriticalAngleRequest) -> Answer:
    arguments, sample_interval = search.arguments()
    found = solver.critical_angle(**arguments)
    if sample_interval is None or found.angle is None:
        return critical_angle_answer(found, None)
    del arguments["search"]
    strike = {name: arguments.pop(name) for name in ("velocity", "angle_of_attack", "angular_velocity")}
    impact = solver.Impact(oblique_angle=found.angle, **strike)
    numerics, trajectory = arguments.pop("numerics"), None
    # At the critical angle the retained energy only just reaches its threshold, so the run could end embedded with
    # settings other than those of the search. The settings of the deciding level reproduce the ricochet.
    for settings in DECIDING_SETTINGS:
        trajectory = solver.simulate(
            **arguments, impact=impact, numerics=replace(numerics, **settings), sample_interval=sample_interval
        )
        if trajectory.outcome is solver.Outcome.RICOCHET or numerics.method == "panels":
            break
    return critical_angle_answer(found, trajectory)


MODEL_ARGUMENTS = ("projectile", "target", "resistance", "numerics")
"""Arguments that a fit and its predictions share."""


def compute_depth_calibration(request: bytes) -> Answer:
    """Fit a strength factor to depths, and predict the depths with each strength factor to compare."""
    arguments, strength_factors, velocities = DepthCalibrationRequest.model_validate_json(request).arguments()
    model = {name: arguments[name] for name in MODEL_ARGUMENTS}
    curves = [
        (factor, velocities, penetration_depths(**model, velocities=velocities, strength_factor=factor))
        for factor in strength_factors
    ]
    return depth_answer(fit_depth(**arguments), curves), None


def compute_motion_calibration(request: bytes) -> Answer:
    """Fit a strength factor to motions with each decay law, and predict them with each strength factor to compare."""
    calibration = MotionCalibrationRequest.model_validate_json(request)
    arguments, strength_factors, times = calibration.arguments()
    try:
        fits = fit_decay_laws(**arguments)
    except solver.ParameterError as error:
        raise calibration.located(error) from None
    model = {name: arguments[name] for name in MODEL_ARGUMENTS}
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


def compute_flight(request: bytes) -> Answer:
    """Compute the flight of a body from the face of the target to the ground."""
    return walk(FlightAnswer, solver.flight(**FlightRequest.model_validate_json(request).arguments())), None


def compute_formulas(request: bytes) -> Answer:
    """Evaluate the empirical formulas for one strike."""
    strike = FormulasRequest.model_validate_json(request)
    with written_in(strike.units):
        return formulas_answer(strike), None


def compute_thickness(request: bytes) -> Answer:
    """Find the least thickness of a wall that a strike does not perforate."""
    strike = ThicknessRequest.model_validate_json(request)
    with written_in(strike.units):
        return thickness_answer(strike), None


def compute_limit_speed(request: bytes) -> Answer:
    """Find the least speed that perforates a wall."""
    wall = LimitSpeedRequest.model_validate_json(request)
    with written_in(wall.units):
        return limit_speed_answer(wall), None


def compute_wall(request: bytes) -> Answer:
    """Judge whether a wall is thick enough against perforation and scabbing."""
    strike = WallRequest.model_validate_json(request)
    with written_in(strike.units):
        return wall_answer(judge_wall(**strike.arguments())), None


StudyReport: TypeAlias = Callable[[int, float | None], None]
"""Function that receives the number of samples taken and the half width reached (None before there is one)."""


@dataclass(frozen=True, slots=True)
class StudyOperation:
    """Sampling of a study of uncertainty, whose samples are requests of another operation.

    Parameters
    ----------
    sample
        Operation of the samples.
    finding
        Function that takes the result that the study needs from the answer to a sample.
    failed, outside
        Results that stand for a failed sample and for a sample outside the accepted range.
    answer
        Function that converts the result of the study to JSON data.
    """

    sample: str
    finding: Callable[[Mapping[str, Any]], Any]
    failed: Any
    outside: Any
    answer: Callable[[Any], dict[str, Any]]

    def sampler(self, request: Any) -> Callable[[Sequence[Any]], KeyedRequest | None]:
        """Return a function that converts the values of a sample to a request, or to None if they are not accepted."""
        model, base, fields = request.sample_model, request.base, [each.field for each in request.uncertain]

        def sample(point: Sequence[Any]) -> KeyedRequest | None:
            try:
                case: Any = model.model_validate(with_values(base, fields, point))
                return KeyedRequest.of(self.sample, case)
            except (ValidationError, solver.ParameterError):
                return None

        return sample


def compute_critical_angle_uncertainty(request: bytes) -> Answer:
    """Compute a study of a critical angle, one sample after the other."""
    return answer_study("cra_uncertainty", CriticalAngleUncertaintyRequest.model_validate_json(request)), None


def compute_trajectory_uncertainty(request: bytes) -> Answer:
    """Compute a study of the outcome of a strike, one sample after the other."""
    return answer_study("trajectory_uncertainty", TrajectoryUncertaintyRequest.model_validate_json(request)), None


def answer_study(
    operation: str, request: Any, report: StudyReport = lambda *_: None, threads: int = 1
) -> dict[str, Any]:
    """Compute a study, and return its answer without key and versions.

    Parameters
    ----------
    request
        Validated request of the operation.
    report
        Function called after each sample, with the number of samples and the half width reached.
    threads
        Number of samples that are computed at the same time.
    """
    study = study_of(operation)
    compute, sample = OPERATIONS[study.sample].compute, study.sampler(request)

    def evaluate(point: Sequence[Any]) -> Any:
        query = sample(point)
        if query is None:
            return study.outside
        try:
            return study.finding(compute(query.json)[0])
        except solver.RicochetError as error:
            return study.outside if isinstance(error, solver.ParameterError) else study.failed

    return study.answer(compute_study(request.study().steps(), evaluate, threads, report))


WALL_CASES = 20
"""Cost of a search for perforation, which takes 20 to 30 runs. [ordinary cases]"""

WALL_SEARCHES = 5
"""Largest number of searches in a verdict on a wall: with the resistance of the request, without a plug and a crater,
with a plug, with both, and with both in normal impact."""


SEARCH_RUNS = 10
"""Approximate number of runs of a search for a critical angle. The secant search of the paper takes 9 to 12 runs; see
benchmarks/results.md."""
PANEL_STEPS = 1e6
"""Product of panels and time steps of a run that takes as long as an ordinary case, 10 to 20 ms. [1]"""


FIT_CASES = 20
"""Cost of fitting one strength factor, chosen in proportion to the time that a fit takes. [ordinary cases]"""


def cases_of_a_fit(request: Calibration) -> int:
    """Return the cost of fitting one strength factor; with panels it grows with the time steps. [ordinary cases]"""
    return math.ceil(FIT_CASES * max(1.0, request.panel_steps() / PANEL_STEPS))


def cases_of_motions(request: MotionCalibrationRequest) -> int:
    """Return the cost of a calibration by motion, counted as one fit for each run and decay law. [ordinary cases]"""
    return len(FreeSurfaceModel) * request.run_count * cases_of_a_fit(request)


SEARCH_NOTE = (
    f"A case counts as {WALL_CASES} against a quota, as many as the runs of its search, or as "
    f"{6 * WALL_CASES} with the 90 % range."
)
UNCERTAINTY_TOOL = (
    "uncertainty",
    "Uncertainty of an angle or an outcome",
    (
        "Sample uncertain inputs: the distribution of the critical angle and the probability of ricochet over the "
        "oblique angle, or the probability of each outcome of one impact. Takes seconds to minutes."
    ),
)

CRITICAL_ANGLE = Operation(
    "cra",
    compute_critical_angle,
    CriticalAngleRequest,
    CriticalAngleAnswer,
    route="find_critical_angle",
    description="Find the smallest oblique angle, from the normal, at which a projectile is turned away.\n\n"
    "If the range has no such angle, the `status` of the answer says so; this is not an error.",
    tag="critical ricochet angle",
    runs=SEARCH_RUNS,
    many=Many(
        CaseModels.of(
            "CriticalAngle",
            CriticalAngleBase,
            CriticalAngleAnswer,
            one="critical angle",
            many="critical angles",
            verb="find",
            example=PAPER,
            custom_id="paper",
            axes=[EVEN, LISTED],
            result=FOUND | VERSIONED,
        ),
        batch=("find_critical_angles", "Find many critical angles"),
        sweep=("sweep_critical_angles", "Find the critical angle"),
    ),
    tool=ToolText(
        "critical_angle",
        "Critical ricochet angle",
        "Find the smallest oblique angle, from the normal, at which a projectile is turned away by concrete.",
    ),
)
TRAJECTORY = Operation(
    "trajectory",
    compute_trajectory,
    TrajectoryRequest,
    TrajectoryAnswer,
    route="compute_trajectory",
    description="Compute the motion of a projectile until it is turned away, perforates the target, comes to rest or "
    "reaches the termination time.",
    tag="trajectory",
    many=Many(
        CaseModels.of(
            "Trajectory",
            TrajectoryBase,
            TrajectoryAnswer,
            one="trajectory",
            many="trajectories",
            verb="compute",
            example=PAPER_AT_45,
            custom_id="shot-1",
            axes=[EVEN, LISTED],
            result=RUN | VERSIONED,
            items=[{"index": 0, "custom_id": "shot-1", "result": RUN | VERSIONED}],
        ),
        batch=("compute_trajectories", "Compute the motion of many projectiles"),
        sweep=("sweep_trajectories", "Compute a trajectory"),
        note="Histories are given only if a case requests its own.",
    ),
    tool=ToolText(
        "trajectory",
        "Trajectory of one impact",
        "Compute how one impact ends: outcome, greatest depth, state at the end and as the projectile leaves. For the "
        "columns over time, `GET /results/{key}` of the service.",
    ),
)
CRITICAL_ANGLE_UNCERTAINTY = Operation(
    "cra_uncertainty",
    compute_critical_angle_uncertainty,
    CriticalAngleUncertaintyRequest,
    CriticalAngleUncertaintyAnswer,
    route="estimate_critical_angle",
    description="Estimate the probability of ricochet over the oblique angle, and the sensitivity of the critical "
    f"angle to its inputs.\n\nUp to {whole_number(MOST_SAMPLES_OF_A_REQUEST)} searches, each a case that is kept and "
    "counted like any other; a request that is sent again is\nanswered from the cache. "
    "`max_samples` above 16,384 (unless the service is configured otherwise) or `Prefer:\n"
    "respond-async` creates a job, which counts as `max_samples` cases until it ends, then as the samples it has "
    "taken. A\nsample outside the accepted range counts as unknown and widens the intervals.",
    tag="critical ricochet angle",
    runs=SEARCH_RUNS,
    many=Many(
        CaseModels.of(
            "CriticalAngleUncertainty",
            CriticalAngleUncertaintyRequest,
            CriticalAngleUncertaintyAnswer,
            one="study of a critical angle",
            many="studies of critical angles",
            verb="compute",
            example=PAPER | FEW_SAMPLES,
            custom_id="paper",
            axes=[LISTED],
            result=ANGLE_STUDY,
        ),
        batch=(
            "estimate_critical_angles",
            "Estimate the probability of ricochet of many strikes over the oblique angle",
        ),
        sweep=("sweep_critical_angle_uncertainty", "Estimate the probability of ricochet over the oblique angle"),
    ),
    study=StudyOperation(
        "cra",
        crossings_in,
        Crossings(problem="failed"),
        Crossings(problem="outside"),
        partial(walk, CriticalAngleUncertaintyAnswer),
    ),
    tool=ToolText(*UNCERTAINTY_TOOL, field="critical_angle"),
)
TRAJECTORY_UNCERTAINTY = Operation(
    "trajectory_uncertainty",
    compute_trajectory_uncertainty,
    TrajectoryUncertaintyRequest,
    TrajectoryUncertaintyAnswer,
    route="estimate_trajectory",
    description="Estimate the probability of each outcome of one strike, with quantiles of depth, exit speed and exit "
    "angle.\n\nWhether the answer comes at once or as a job is decided as for critical angles.",
    tag="trajectory",
    many=Many(
        CaseModels.of(
            "TrajectoryUncertainty",
            TrajectoryUncertaintyRequest,
            TrajectoryUncertaintyAnswer,
            one="study of the outcome of a strike",
            many="studies of the outcomes of strikes",
            verb="compute",
            example=PAPER_AT_45 | FEW_SAMPLES,
            custom_id="shot-1",
            axes=[EVEN],
            result=STRIKE_STUDY,
        ),
        batch=("estimate_trajectories", "Estimate the probability of each outcome of many strikes"),
        sweep=("sweep_trajectory_uncertainty", "Estimate the probability of each outcome"),
    ),
    study=StudyOperation(
        "trajectory",
        ending_in,
        Ending(problem="failed"),
        Ending(problem="outside"),
        partial(walk, TrajectoryUncertaintyAnswer),
    ),
    tool=ToolText(*UNCERTAINTY_TOOL, field="trajectory"),
)
DEPTH_CALIBRATION = Operation(
    "calibration_depth",
    compute_depth_calibration,
    DepthCalibrationRequest,
    DepthCalibrationAnswer,
    route="calibrate_by_depth",
    description="Find the strength factor that fits penetration depths best, by weighted least squares.\n\n"
    "The shots are along the normal, with one kind of projectile into one target.",
    tag="calibration",
    cases=cases_of_a_fit,
    long=True,
)
MOTION_CALIBRATION = Operation(
    "calibration_motion",
    compute_motion_calibration,
    MotionCalibrationRequest,
    MotionCalibrationAnswer,
    route="calibrate_by_motion",
    description="Find the strength factor that fits the motion in oblique strikes best, from measurements or finite "
    "element runs.\n\nThe request has the motion of one strike, or of several `runs` at any angles and speeds, to "
    "which one strength factor is\nfitted. The fit is made with every decay law.",
    tag="calibration",
    cases=cases_of_motions,
    long=True,
)
OBLIQUITY_CALIBRATION = Operation(
    "calibration_obliquity",
    compute_obliquity_calibration,
    ObliquityCalibrationRequest,
    ObliquityCalibrationAnswer,
    route="calibrate_over_obliquity",
    description="Fit a polynomial in the oblique angle to strength factors.\n\nThe answer contains the "
    "polynomial in the form that a `resistance` accepts, so that `/cra` gives its angle a standard error.",
    tag="calibration",
    weight=FIT_CASES,
    long=True,
)
FORMULAS = Operation(
    "formulas",
    compute_formulas,
    FormulasRequest,
    FormulasAnswer,
    route="evaluate_formulas",
    description="Evaluate the empirical formulas of the field: penetration depth, scabbing and perforation thickness."
    "\n\nEach result states whether the strike is in the range to which the formula was fitted. An oblique strike is "
    "evaluated with\nthe component of its velocity along the normal.",
    tag="formulas",
)
FLIGHT = Operation(
    "flight",
    compute_flight,
    FlightRequest,
    FlightAnswer,
    route="compute_flight",
    description="Compute where a body lands on level ground: a point mass with quadratic drag.\n\nThe direction in "
    "which a tumbling body leaves the target is the most uncertain quantity, so the answer\nalso has the farthest "
    "distance over all elevations.",
    tag="flight",
)
LEAST_THICKNESS = Operation(
    "thickness",
    compute_thickness,
    ThicknessRequest,
    ThicknessAnswer,
    route="find_least_thickness",
    description="Find the least thickness of a wall that a strike does not perforate, with the results of the "
    "empirical formulas.",
    tag="walls",
    weight=WALL_CASES,
    runs=WALL_CASES,
    many=Many(
        CaseModels.of(
            "Thickness",
            ThicknessBase,
            ThicknessAnswer,
            one="least thickness",
            many="least thicknesses",
            verb="find",
            example=PAPER_AT_45,
            custom_id="shot-1",
            axes=[ANGLES],
            result=THICKNESS | VERSIONED,
        ),
        batch=("find_least_thicknesses", "Find the least thickness of a wall for many strikes"),
        sweep=("sweep_least_thicknesses", "Find the least thickness of a wall"),
        note=SEARCH_NOTE,
    ),
    tool=ToolText(
        "thickness",
        "Least thickness of a wall",
        "Find the least thickness of a wall that a strike does not perforate, beside the empirical formulas.",
    ),
)
LIMIT_SPEED = Operation(
    "limit-speed",
    compute_limit_speed,
    LimitSpeedRequest,
    LimitSpeedAnswer,
    route="find_limit_speed",
    description="Find the least speed at which a projectile perforates a wall, with the results of the empirical "
    "formulas.",
    tag="walls",
    weight=WALL_CASES,
    runs=WALL_CASES,
    many=Many(
        CaseModels.of(
            "LimitSpeed",
            LimitSpeedBase,
            LimitSpeedAnswer,
            one="limit speed",
            many="limit speeds",
            verb="find",
            example=WALL,
            custom_id="wall-1",
            axes=[ANGLES],
            result=SPEED | VERSIONED,
        ),
        batch=("find_limit_speeds", "Find many limit speeds"),
        sweep=("sweep_limit_speeds", "Find the limit speed"),
        note=SEARCH_NOTE,
    ),
)
WALL_VERDICT = Operation(
    "wall",
    compute_wall,
    WallRequest,
    WallAnswer,
    route="judge_wall",
    description="Judge a wall: whether it is thick enough against perforation and against scabbing.\n\n"
    "The largest of the formulas within their range decides, with the margins of DOE-STD-3014-2006, and against\n"
    "perforation the model with a plug and a crater where it requires a thicker wall. `/verdict` on a target with a\n"
    "thickness gives the same verdict.",
    tag="walls",
    weight=WALL_SEARCHES * WALL_CASES,
    runs=WALL_SEARCHES * WALL_CASES,
    tool=ToolText(
        "judge_wall",
        "Whether a wall is thick enough",
        "Judge a wall: perforation and scabbing, each with its limit, its design value, the formula that decides and "
        "yes or no, and a sentence to repeat.",
    ),
)

OPERATIONS: dict[str, Operation] = {
    each.name: each
    for each in (
        CRITICAL_ANGLE,
        TRAJECTORY,
        CRITICAL_ANGLE_UNCERTAINTY,
        TRAJECTORY_UNCERTAINTY,
        DEPTH_CALIBRATION,
        MOTION_CALIBRATION,
        OBLIQUITY_CALIBRATION,
        FORMULAS,
        FLIGHT,
        LEAST_THICKNESS,
        LIMIT_SPEED,
        WALL_VERDICT,
    )
}
"""All operations by name. A new operation gets its routes, jobs, tables and commands from its entry here."""


def is_study(operation: str) -> bool:
    """Return True if an operation is a study of uncertainty; False for an unknown name from a later version."""
    return operation in OPERATIONS and OPERATIONS[operation].study is not None


def study_of(operation: str) -> StudyOperation:
    """Return the sampling of a study of uncertainty."""
    study = OPERATIONS[operation].study
    assert study is not None  # noqa: S101 (called only for studies)
    return study


def outcome_of(answer: Mapping[str, Any]) -> str:
    """Return the outcome of an answer for metrics and results, such as `ricochet`, `converged` or `fitted`."""
    if "formulas" in answer and "status" not in answer:
        return "evaluated"
    if "scabbing" in answer:
        return "judged"
    if "converged" in answer:
        return "converged" if answer["converged"] else "not_converged"
    outcome: str = answer.get("outcome") or answer.get("status") or "fitted"
    return outcome
