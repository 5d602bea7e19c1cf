"""Many cases at once, and their results, as the contract has them."""

from typing import Annotated, Any, Generic, TypeVar

from pydantic import MISSING, Field, StringConstraints

from service.schemas.problems import Problem
from service.schemas.quantities import Count, Flag, Num, Part, with_examples
from service.schemas.requests import Case, TrajectoryFields, TrajectoryOutput
from service.schemas.strike import PAPER_AT_45

MOST_CASES = 1_000
"""Cases of a JSON batch, which is parsed in one piece."""
MOST_LINES = 100_000
"""Cases of a JSONL batch, and points of a sweep."""

CustomId = Annotated[
    str,
    StringConstraints(strict=True, min_length=1, max_length=128),
    Field(description="Given back with the result. It need not be unique, though it serves better if it is."),
]
Index = Annotated[Count, Field(ge=0, description="Place of the case in the request, from 0.")]


BatchCase = TypeVar("BatchCase", bound="NamedCase")
Answer = TypeVar("Answer", bound=Part)
ItemOf = TypeVar("ItemOf", bound="Item")


class NamedCase(Case):
    """A case of a batch, which may have a name."""

    custom_id: CustomId | MISSING = MISSING


class Batch(Part, Generic[BatchCase]):
    """Cases of one operation."""

    cases: Annotated[list[BatchCase], Field(min_length=1, max_length=MOST_CASES)]


class Cases(Part):
    """A batch before its cases are looked at."""

    cases: Annotated[list[Any], Field(min_length=1, max_length=MOST_CASES)]


class Item(Part):
    """What became of one case: its result, or the problem that kept it from having one."""

    index: Index
    custom_id: CustomId | MISSING = MISSING
    point: dict[str, Num] | MISSING = MISSING
    """Values of the axes of a sweep, by their fields."""
    problem: Problem | MISSING = MISSING
    """Why there is no result."""


class ResultItem(Item, Generic[Answer]):
    """What became of one case of one operation."""

    result: Answer | MISSING = MISSING


class Results(Part, Generic[ItemOf]):
    """What became of many cases, in the order of the request."""

    results: list[ItemOf]


class BatchOutput(TrajectoryOutput):
    """What the answer to a trajectory among many holds."""

    model_config = with_examples({"history": True, "sample_interval_s": 1e-4})

    history: Flag = False
    """Whether to give the motion over time; not among many, unless requested."""


class TrajectoryBase(TrajectoryFields):
    """One strike among many: as a single one, but without a history unless requested."""

    model_config = with_examples(PAPER_AT_45)

    output: Annotated[BatchOutput, Field(default_factory=BatchOutput)]
