"""Checks shared by the input types: each names the field and the bound it missed."""

import math
from typing import get_args

from solver.errors import ParameterError


def require(condition: bool, field: str, requirement: str) -> None:
    """Raise `ParameterError` for `field` unless `condition` holds."""
    if not condition:
        raise ParameterError(field, requirement)


def require_number(field: str, value: object) -> float:
    """Return a number, which may be one of NumPy's; refuse arrays, texts and other objects.

    Raises
    ------
    ParameterError
        If it is not.
    """
    if isinstance(value, float | int) and not isinstance(value, bool):
        return float(value)
    if hasattr(value, "__float__") and getattr(value, "ndim", None) == 0:
        return float(value)
    if hasattr(value, "__len__") and not isinstance(value, str):
        found = f"{type(value).__name__} of {len(value)}"
        raise ParameterError(
            field, f"must be one number, got {found}: simulate_many and critical_angle_many take many cases"
        )
    raise ParameterError(field, f"must be a number, got {value!r}")


def require_kind(field: str, value: object, union: object) -> None:
    """Refuse anything but an instance of one of the classes of a union.

    Raises
    ------
    ParameterError
        If it is not; it names the classes, and the one that a text or a bare class stands for.
    """
    kinds = get_args(union)
    if isinstance(value, kinds):
        return
    *names, last = (f"{kind.__name__}(...)" for kind in kinds)
    found = (
        value.__name__ if isinstance(value, type) else repr(value) if isinstance(value, str) else type(value).__name__
    )
    meant = [f"; give {kind.__name__}(...)" for kind in kinds if value is kind or value == kind.name]
    raise ParameterError(field, f"must be {', '.join(names)} or {last}, got {found}{''.join(meant)}")


def require_finite(field: str, value: float) -> None:
    """Refuse NaN and infinities, and anything that is no number."""
    require_number(field, value)
    require(math.isfinite(value), field, f"must be a finite number, got {value}")


def require_positive(field: str, value: float) -> None:
    """Refuse anything but a finite number above zero."""
    require_number(field, value)
    require(math.isfinite(value) and value > 0.0, field, f"must be greater than 0, got {value:g}")


def require_between(field: str, value: float, lower: float, upper: float) -> None:
    """Refuse anything outside the closed range from `lower` to `upper`."""
    require_number(field, value)
    require(
        math.isfinite(value) and lower <= value <= upper,
        field,
        f"must be between {lower:g} and {upper:g}, got {value:g}",
    )
