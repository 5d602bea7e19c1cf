"""Checks shared by the input types: each names the field and the bound it missed."""

import math

from solver.errors import ParameterError


def require(condition: bool, field: str, requirement: str) -> None:
    """Raise `ParameterError` for `field` unless `condition` holds."""
    if not condition:
        raise ParameterError(field, requirement)


def require_finite(field: str, value: float) -> None:
    """Refuse NaN and infinities."""
    require(math.isfinite(value), field, f"must be a finite number, got {value}")


def require_positive(field: str, value: float) -> None:
    """Refuse anything but a finite number above zero."""
    require(math.isfinite(value) and value > 0.0, field, f"must be greater than 0, got {value:g}")


def require_between(field: str, value: float, lower: float, upper: float) -> None:
    """Refuse anything outside the closed range from `lower` to `upper`."""
    require(
        math.isfinite(value) and lower <= value <= upper,
        field,
        f"must be between {lower:g} and {upper:g}, got {value:g}",
    )
