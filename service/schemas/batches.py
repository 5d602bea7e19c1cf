"""Models of batches and of their results."""

from typing import Annotated, Any, Generic, TypeVar

from pydantic import MISSING, Field, StringConstraints

from service.schemas.problems import Problem
from service.schemas.quantities import Count, Flag, Num, Part, with_examples
from service.schemas.requests import Case, TrajectoryFields, TrajectoryOutput
from service.schemas.strike import PAPER_AT_45

MOST_CASES = 1_000
"""Largest number of cases in a JSON batch. It bounds the time for which parsing blocks other requests: a thousand cases
take some milliseconds."""
MOST_LINES = 100_000
"""Largest number of cases in a JSONL batch, and of points in a sweep. An arbitrary choice: this many critical angles
are some ten minutes of work on one core and 40 MB of JSON lines; larger numbers have not been measured."""

CustomId = Annotated[
    str,
    StringConstraints(strict=True, min_length=1, max_length=128),
    Field(description="Name of the case, returned with its result. It should be unique, but need not be."),
]
Index = Annotated[Count, Field(ge=0, description="Number of the case in the request, from 0.")]


BatchCase = TypeVar("BatchCase", bound="NamedCase")
Answer = TypeVar("Answer", bound=Part)
ItemOf = TypeVar("ItemOf", bound="Item")


class NamedCase(Case):
    """A case of a batch, with an optional name."""

    custom_id: CustomId | MISSING = MISSING


class Batch(Part, Generic[BatchCase]):
    """Body of a batch: cases of one operation."""

    cases: Annotated[list[BatchCase], Field(min_length=1, max_length=MOST_CASES)]


class Cases(Part):
    """Body of a batch whose cases have not been validated yet, since they are validated in blocks."""

    cases: Annotated[list[Any], Field(min_length=1, max_length=MOST_CASES)]


class Item(Part):
    """A case of a batch or a point of a sweep with its result, or with the reason why there is none."""

    index: Index
    custom_id: CustomId | MISSING = MISSING
    point: dict[str, Num] | MISSING = MISSING
    """Values of the axes of a sweep, keyed by field."""
    problem: Problem | MISSING = MISSING
    """Reason why there is no result."""


class ResultItem(Item, Generic[Answer]):
    """A case or point of one operation with its result, or with the reason why there is none."""

    result: Answer | MISSING = MISSING


class Results(Part, Generic[ItemOf]):
    """Results of many cases, in the order of the request."""

    results: list[ItemOf]


class BatchOutput(TrajectoryOutput):
    """Contents of the answer to one case of a batch or one point of a sweep."""

    model_config = with_examples({"history": True, "sample_interval_s": 1e-4})

    history: Flag = False
    """Include the motion over time. It is left out by default, since the answers to a batch would be very long."""


class TrajectoryBase(TrajectoryFields):
    """One strike in a batch or a sweep. By default, the answer has no history, unlike the answer to a single strike."""

    model_config = with_examples(PAPER_AT_45)

    output: Annotated[BatchOutput, Field(default_factory=BatchOutput)]
