"""Answers and tables are built from results of the solver, as the fields of the models declare."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
from pydantic import MISSING, Field

from service.columns import Column
from service.schemas.fields import GIVEN, NOT_TABLED, columns_of, in_solver_units, walk
from service.schemas.quantities import Count, Num, Of, Part
from solver.arrays import FloatArray


class Ending(StrEnum):
    """How an attempt ends."""

    DONE = "done"


@dataclass
class Try:
    """An attempt of a search, as a result of the solver."""

    value: float
    """Speed that was tried. [m/s] Two at least."""
    ending: Ending = Ending.DONE
    """Ending of a try."""
    slope: float | None = None
    """Slope. [rad]"""


@dataclass
class Found:
    """A result of the solver with fields of every kind."""

    angle: float | None = math.radians(30.0)
    length: float = 2.0
    ending: Ending = Ending.DONE
    bracket: tuple[float, float] = (0.0, math.radians(45.0))
    angles: FloatArray | None = None
    tries: tuple[Try, ...] = (Try(1.0), Try(3.0))
    note: str = ""
    steps: int = 4


class EndingPart(Part):
    """Base of models that share the field `ending`."""

    answered_last: ClassVar = ("ending",)

    ending: Ending


class TryAnswer(EndingPart):
    """An attempt of a search, as part of an answer."""

    solved = Try

    speed_m_s: Annotated[Num, Of("value")]
    slope_deg: Annotated[Num | MISSING, NOT_TABLED] = MISSING
    burden_kg: Annotated[Num | MISSING, GIVEN, NOT_TABLED] = MISSING


class FoundAnswer(Part):
    """The answer to be built from `Found`."""

    tabled = ("angle_deg", "bracket_deg", "ending", "fastest_m_s", "steps", "first_m", "seconds_s")

    angle_deg: Num | MISSING = MISSING
    """Smallest angle of all. Others are left out. [°]"""
    bracket_deg: Annotated[
        list[Num], Field(min_length=2), Column("low_deg", "lower angle"), Column("high_deg", "upper angle")
    ]
    first_m: Annotated[Num, Of("length")]
    """Length at first. [m]"""
    ending: Ending
    angles_deg: list[Num] | MISSING = MISSING
    tries: list[TryAnswer] | MISSING = MISSING
    fastest_m_s: Annotated[Num | MISSING, Of(lambda found: max((each.value for each in found.tries), default=None))] = (
        MISSING
    )
    note: str | MISSING = MISSING
    steps: Count
    seconds_s: Annotated[Num | MISSING, GIVEN] = MISSING


EVERYTHING: dict[str, Any] = {
    "angle_deg": 30.0,
    "bracket_deg": [0.0, 45.0],
    "first_m": 2.0,
    "ending": "done",
    "tries": [{"speed_m_s": 1.0, "ending": "done"}, {"speed_m_s": 3.0, "ending": "done"}],
    "fastest_m_s": 3.0,
    "steps": 4,
}


@pytest.mark.parametrize(
    ("found", "given", "expected"),
    [
        (Found(), {}, EVERYTHING),
        (Found(angle=None), {}, {name: value for name, value in EVERYTHING.items() if name != "angle_deg"}),
        (Found(angle=0.0), {}, EVERYTHING | {"angle_deg": 0.0}),
        (
            Found(tries=()),
            {},
            {name: value for name, value in EVERYTHING.items() if name not in {"tries", "fastest_m_s"}},
        ),
        (Found(angles=np.radians([0.0, 90.0])), {}, EVERYTHING | {"angles_deg": [0.0, 90.0]}),
        (Found(note="rough"), {}, EVERYTHING | {"note": "rough"}),
        (
            Found(),
            {"seconds_s": 0.5, "tries": [{"ready": 1}]},
            EVERYTHING | {"seconds_s": 0.5, "tries": [{"ready": 1}]},
        ),
    ],
    ids=["all", "no value", "zero", "no items", "array", "text", "given"],
)
def test_answer_has_the_fields_of_its_model(found: Found, given: dict[str, Any], expected: dict[str, Any]) -> None:
    answer = walk(FoundAnswer, found, **given)
    assert answer == expected
    assert list(answer) == [name for name in FoundAnswer.model_fields if name in expected]
    assert type(answer["ending"]) is str


def test_fields_declared_last_are_last_in_nested_parts() -> None:
    assert [list(each) for each in walk(FoundAnswer, Found())["tries"]] == [["speed_m_s", "ending"]] * 2


def test_missing_attribute_is_an_error() -> None:
    with pytest.raises(AttributeError, match="angle"):
        walk(FoundAnswer, Try(1.0))


def test_columns_are_the_numbers_and_strings_of_an_answer() -> None:
    assert columns_of(FoundAnswer) == (
        Column("angle_deg", "smallest angle of all"),
        Column("low_deg", "lower angle"),
        Column("high_deg", "upper angle"),
        Column("ending", "", "S32"),
        Column("fastest_m_s", ""),
        Column("steps", ""),
        Column("first_m", "length at first"),
        Column("seconds_s", ""),
    )
    assert columns_of(TryAnswer, "try_", "; rough") == (
        Column("try_speed_m_s", "speed that was tried; rough"),
        Column("try_ending", "ending of a try; rough", "S32"),
    )


def test_description_of_a_field_has_the_unit_in_its_name() -> None:
    properties = TryAnswer.model_json_schema()["properties"]
    assert properties["speed_m_s"]["description"] == "Speed that was tried. Two at least. [m/s]"
    assert properties["slope_deg"]["description"] == "Slope. [°]"


def test_answer_is_converted_back_to_solver_units() -> None:
    assert in_solver_units({"angle_deg": 180.0, "speed_m_s": 2.0}) == {"angle": math.pi, "speed": 2.0}
