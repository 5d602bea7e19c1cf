"""Fields of a strike by their dotted names, such as ``target.density``."""

from collections.abc import Sequence
from dataclasses import is_dataclass, replace
from typing import Any

from solver.impact import Impact
from solver.numerics import USUAL, Numerics
from solver.projectile import Projectile
from solver.resistance import EQUATION_9, Resistance
from solver.target import Target


def is_part(value: Any) -> bool:
    """Whether it is an object with fields."""
    return is_dataclass(value) and not isinstance(value, type)


def strike_parts(
    impact: Impact,
    projectile: Projectile,
    target: Target,
    resistance: Resistance | None,
    numerics: Numerics | None,
) -> dict[str, Any]:
    """Return the parts of a strike, those not given filled in."""
    return {
        "projectile": projectile,
        "target": target,
        "impact": impact,
        "resistance": resistance or EQUATION_9,
        "numerics": numerics or USUAL,
    }


def put(part: Any, path: Sequence[str], value: Any) -> Any:
    """Return a copy of a part with this value there."""
    name, *rest = path
    return replace(part, **{name: put(getattr(part, name), rest, value) if rest else value})
