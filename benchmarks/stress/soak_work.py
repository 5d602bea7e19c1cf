"""What the jobs of the soak ask for: batches and sweeps, partly new and partly known, the same for the same numbers."""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import orjson
from pydantic import BaseModel, ValidationError

from benchmarks.random_cases import one_by_one, study_cases
from benchmarks.stress.bodies import to_lines, to_request
from benchmarks.stress.clients import JSONL
from benchmarks.stress.faults_cases import ROUGH
from benchmarks.stress.mutations import JSON, mutants
from service.schemas import CriticalAngleRequest, TrajectoryRequest
from service.schemas.examples import PAPER_AT_45

NEW_SHARE = 0.4
"""Of the cases of a batch; the others are of batches before, as far as there are so many."""
NEW_SWEEPS = 2
"""One sweep in so many is a new one."""
ANGLES = 30
"""Of a sweep."""
FIRST_CANCELLED = 10_000_000
"""Search of jobs that are cancelled, which no other job asks for."""
MODELS: dict[str, type[BaseModel]] = {"/cra": CriticalAngleRequest, "/trajectory": TrajectoryRequest}
MOST_MUTANTS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """A job as it is asked for.

    Parameters
    ----------
    token
        Idempotency key, and the start of every `custom_id`.
    names
        Of its cases, in order: equal names ask for the same.
    """

    token: str
    path: str
    media_type: str
    body: bytes
    names: list[str]

    def custom_id(self, index: int) -> str | None:
        """Of a case; those of a sweep have none."""
        return f"{self.token}-{index}" if self.media_type == JSONL else None


class Mix:
    """Makes jobs of a size, in turn new and known.

    Parameters
    ----------
    cases
        Of each job.
    """

    def __init__(self, cases: int, seed: int = 0) -> None:
        self._cases = cases
        self._dice = random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
        self._searches = 0
        self._sweeps = 0
        self._made = 0

    def batch(self) -> Work:
        """Critical angles, new and known ones in any order."""
        known = min(self._searches, self._cases - round(NEW_SHARE * self._cases))
        new = range(self._searches, self._searches + self._cases - known)
        numbers = [*self._dice.sample(range(self._searches), known), *new]
        self._dice.shuffle(numbers)
        self._searches = new.stop
        token = self._token("batch")
        return searches(token, numbers)

    def sweep(self) -> Work:
        """Trajectories without histories: a new grid or, as often, one of before."""
        token = self._token("sweep")
        if self._sweeps and self._made // 2 % NEW_SWEEPS:
            number = self._dice.randrange(self._sweeps)
        else:
            number, self._sweeps = self._sweeps, self._sweeps + 1
        velocities = max(1, self._cases // ANGLES)
        names = [f"sweep {number} {velocities} {point}" for point in range(velocities * ANGLES)]
        body = orjson.dumps(grid(number, velocities))
        return Work(token=token, path="/trajectory/sweep", media_type=JSON, body=body, names=names)

    def cancelled(self) -> Work:
        """Critical angles that nobody else asks for, to be cancelled."""
        token = self._token("cancelled")
        first = FIRST_CANCELLED + self._made * self._cases
        return searches(token, range(first, first + self._cases))

    def _token(self, kind: str) -> str:
        self._made += 1
        return f"{kind}-{self._made}"


def searches(token: str, numbers: Sequence[int]) -> Work:
    """A batch of critical angles."""
    cases = (search(number) | {"custom_id": f"{token}-{index}"} for index, number in enumerate(numbers))
    names = [f"search {number}" for number in numbers]
    return Work(token=token, path="/cra/batch", media_type=JSONL, body=to_lines(cases), names=names)


def asked(name: str) -> dict[str, Any]:
    """The single request that a name stands for."""
    kind, *numbers = name.split()
    if kind == "search":
        return search(int(numbers[0]))
    number, velocities, point = map(int, numbers)
    row, column = divmod(point, ANGLES)
    impact = {"velocity_m_s": speeds(velocities)[row], "oblique_angle_deg": angles()[column]}
    return at_strength(number) | {"impact": impact, "output": {"history": False}}


def search(number: int) -> dict[str, Any]:
    """A strike of a study, sought to 1° but for every fourth, which is sought to the usual 0.01°."""
    [case] = one_by_one(study_cases(1, number))
    return to_request(case) | ({"search": ROUGH} if number % 4 else {})


def grid(number: int, velocities: int) -> dict[str, Any]:
    """A sweep over velocities and angles; no two numbers have a strength in common."""
    axes = [
        {"field": "impact.velocity_m_s", "values": speeds(velocities)},
        {"field": "impact.oblique_angle_deg", "values": angles()},
    ]
    return {"base": at_strength(number), "axes": axes}


def at_strength(number: int) -> dict[str, Any]:
    """The paper's strike at 45° on a concrete of its own."""
    return PAPER_AT_45 | {"target": PAPER_AT_45["target"] | {"compressive_strength_pa": 35e6 + 1e3 * number}}


def speeds(count: int) -> list[float]:
    """Velocities of a sweep. [m/s]"""
    return [200.0 + 150.0 * row / count for row in range(count)]


def angles() -> list[float]:
    """Angles of a sweep, at most of which the projectile is turned away: others take many times as long. [°]"""
    return [55.0 + 25.0 * column / ANGLES for column in range(ANGLES)]


def invalid_bodies(seed: int) -> Iterator[tuple[str, bytes]]:
    """Path and body of queries that do not fit the contract."""
    for mutant in mutants(MOST_MUTANTS, seed):
        model = MODELS.get(mutant.path)
        if model is not None and mutant.media_type == JSON:
            try:
                model.model_validate_json(mutant.body)
            except ValidationError:
                yield mutant.path, mutant.body
