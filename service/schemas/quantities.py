"""Building blocks of the contract: numbers as JSON knows them, and the base of every model."""

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, FiniteFloat, Strict

from solver.validation import BOUNDS

Num = Annotated[FiniteFloat, Strict()]
"""A JSON number, 13 as good as 13.0. No text, no truth value, nothing infinite."""

Flag = Annotated[bool, Strict()]
"""true or false, not 1 or "yes"."""


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, Strict()]
WHOLE = BeforeValidator(_whole)
"""With a `Count`, after its bounds: a JSON integer, 12000.0 as good as 12000."""


class Part(BaseModel):
    """Base of all models: unknown fields are refused, a field that is not given is absent, never null."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def with_examples(*examples: Any) -> ConfigDict:
    """Model configuration that shows these in the schema."""
    return ConfigDict(json_schema_extra={"examples": list(examples)})


def within(field: str) -> dict[str, Any]:
    """Return the bounds of a field of the solver, as arguments of `Field`."""
    bound = BOUNDS[field]
    return {"gt" if bound.above else "ge": bound.lower, "lt" if bound.below else "le": bound.upper}


def degrees(angle: float) -> float:
    """Degrees of an angle in radians; those it was made from, where they had 15 digits or fewer."""
    exact = math.degrees(angle)
    short = float(f"{exact:.15g}")
    return short if math.radians(short) == angle else exact
