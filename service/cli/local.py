"""Computation of single answers and small sweeps in this process. Batches and larger sweeps run in a service."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from service.cli.arguments import RefusedError
from service.cli.writers import Item

if TYPE_CHECKING:
    from service.assessment import Query

SMALL_CASES = 100
"""Largest cost that is computed in this process [ordinary cases]. The computation then takes about as long as the start
of a service, a second or two."""


def is_small(operation: str, count: int) -> bool:
    """Return True if `count` cases are few enough to be computed in this process."""
    from service.operations import OPERATIONS

    # Studies take long, and only a service computes several of them at the same time.
    return OPERATIONS[operation].study is None and count * OPERATIONS[operation].weight <= SMALL_CASES


@contextmanager
def refusals() -> Iterator[None]:
    """Convert errors of a request or its computation to the problem that a service would send."""
    from service.errors import InvalidBodyError, problem_of
    from solver import RicochetError

    try:
        yield
    except (InvalidBodyError, RicochetError) as error:
        raise RefusedError(problem_of(error)) from None


MOST_CHECKED = 2_000
"""Largest number of cases of a batch that the solver checks before the computation. The checks take
some 0.1 ms each, 0.2 s in all. Any further case whose values contradict each other gets a problem as its result."""


def wrong_cases(operation: str, cases: Iterable[Any]) -> dict[int, list[dict[str, str]]]:
    """Return the errors of the cases of a batch by case number, found by the checks that a service makes.

    Parameters
    ----------
    cases
        Cases as JSON texts or as objects.
    """
    from service.errors import InvalidBodyError, field_errors, validated_as
    from service.operations import OPERATIONS, KeyedRequest
    from service.queries import check_work
    from service.settings import Settings
    from service.workers.worker import check_requests
    from solver import ParameterError

    many, canonical = OPERATIONS[operation].many, OPERATIONS[operation].request
    assert many is not None  # noqa: S101 (a choice of the command)
    # The limit is read from the settings, so that the errors are those of a service with the same settings.
    most = Settings().max_panel_steps
    found: dict[int, list[dict[str, str]]] = {}
    for number, case in enumerate(cases):
        try:
            content = json.loads(case) if isinstance(case, bytes) else case
            request: Any = validated_as(many.models.case, content)
            check_work(request, most)
            keyed = KeyedRequest.of(operation, request)
            wrong = check_requests(canonical, [keyed.json]) if number < MOST_CHECKED else {}
            if wrong:
                raise wrong[0]
        except (InvalidBodyError, ParameterError) as error:
            found[number] = field_errors(error)
        except ValueError as error:
            found[number] = [{"pointer": "", "detail": f"not JSON: {error}" if case.strip() else "is empty"}]
    return found


def compute(name: str, body: dict[str, Any], report: Callable[[int, float | None], None] | None = None) -> bytes:
    """Compute an answer in this process, and return it as a service would send it.

    Parameters
    ----------
    report
        Function that receives the progress of a study; see `service.operations.answer_study`.

    Raises
    ------
    RefusedError
        If the request is invalid, or the computation fails.
    """
    from service.errors import validated_as
    from service.operations import OPERATIONS
    from service.schemas.requests import alternatives_in, answered_alternative, with_alternatives

    def solve_alternative(laws: dict[str, Any], request: Any) -> dict[str, Any]:
        try:
            with refusals():
                return answered_alternative(laws, _solve(name, request).answer)
        except RefusedError as error:
            return {**laws, "problem": {**error.problem, "instance": f"/{name}"}}

    with refusals():
        request: Any = validated_as(OPERATIONS[name].request, body)
        answer: bytes = _solve(name, request, report).json
    alternatives = [solve_alternative(*each) for each in alternatives_in(request)]
    return with_alternatives(answer, alternatives) if alternatives else answer


def judge(body: dict[str, Any], report: Callable[[int, float | None], None]) -> dict[str, Any]:
    """Compute the verdict on a strike in this process, and return it as a service would send it.

    Parameters
    ----------
    report
        As for `compute`.

    Raises
    ------
    RefusedError
        If the request is invalid, or the search fails.
    """
    from service.assessment import verdict_queries, weighing_queries
    from service.errors import validated_as
    from service.schemas import ReportRequest, verdict_answer

    with refusals():
        request = validated_as(ReportRequest, body)
        queries = verdict_queries(request)
    answers = dict(answers_to(queries, report))
    answers |= answers_to(weighing_queries(request, answers["cra"]))
    return verdict_answer(request, answers)


def answers_to(
    queries: Mapping[str, "Query"], report: Callable[[int, float | None], None] | None = None
) -> Iterator[tuple[str, Any]]:
    """Yield the names and answers of the queries of a verdict or a report; a failed query has a `problem`.

    Parameters
    ----------
    report
        Function that receives the progress of the uncertainty study.

    Raises
    ------
    RefusedError
        If the query `cra` fails, because there is no verdict without it.
    """
    for name, (operation, content) in queries.items():
        try:
            yield name, json.loads(compute(operation, content, report if name == "uncertainty" else None))
        except RefusedError as error:
            if name == "cra":
                raise
            yield name, {"problem": dict(error.problem)}


def usual_scatter(body: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the usual scatter of a strike, for a study without uncertain inputs of its own.

    Raises
    ------
    RefusedError
        If the strike is invalid.
    """
    from service.errors import validated_as
    from service.schemas.requests import CriticalAngleBase
    from service.schemas.verdict import usual_inputs

    with refusals():
        strike = {name: part for name, part in body.items() if name in CriticalAngleBase.model_fields}
        return usual_inputs(validated_as(CriticalAngleBase, strike))


def compute_sweep(operation: str, content: dict[str, Any]) -> Iterator[Item]:
    """Compute a sweep in this process, and yield its results in order as a service would send them.

    Parameters
    ----------
    operation
        Operation of every point.
    content
        Body of the sweep: base and axes.

    Raises
    ------
    RefusedError
        Before the first result, if the base, an axis or a point is invalid.
    """
    from service.errors import case_problem
    from service.operations import OPERATIONS
    from solver import RicochetError

    with refusals():
        points = _points(operation, content)
    # All points are validated before the first is computed, because an invalid one would otherwise be reported after
    # minutes.
    for number, (point, request) in enumerate(points):
        item: dict[str, Any] = {"index": number, "point": point}
        try:
            yield item | {"result": json.loads(_solve(operation, request).json)}
        except RicochetError as error:
            yield item | {"problem": case_problem(error) | {"instance": f"{OPERATIONS[operation].path}/sweep"}}


def _solve(name: str, request: Any, report: Callable[[int, float | None], None] | None = None) -> Any:
    """Compute a validated request, and return its record."""
    from service.cache.record import Record
    from service.cores import available_cores
    from service.operations import OPERATIONS, KeyedRequest, answer_study

    query = KeyedRequest.of(name, request)
    if report is not None:
        return Record(query.key, name, query.json, answer_study(name, request, report, available_cores()))
    return Record(query.key, name, query.json, *OPERATIONS[name].compute(query.json))


def _points(operation: str, content: dict[str, Any]) -> list[tuple[dict[str, float], Any]]:
    """Return the values of the axes and the validated request of each point."""
    from service.errors import errors_of_point, grid_of, validated_as
    from service.operations import OPERATIONS
    from service.schemas.sweeps import Outline

    many = OPERATIONS[operation].many
    assert many is not None  # noqa: S101 (a choice of the command)
    model: Any = many.models.base
    grid = grid_of(model, validated_as(Outline, content))
    found = []
    for number, values in enumerate(grid.points()):
        with errors_of_point(grid, number, values):
            request = model.model_validate(grid.request(values))
            request.canonical()
        found.append((dict(zip(grid.fields, values, strict=True)), request))
    return found
