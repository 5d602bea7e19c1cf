"""What `ricochet calibrate` answers, as tables for people."""

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from service.schemas import obliquity_answer
from service.schemas.quantities import degrees
from solver import Impact, ModelWarning
from solver.calibration import (
    DepthFit,
    DepthTest,
    Estimate,
    MotionFit,
    ObliquityFit,
    ObliquityPoint,
)


def print_depth(tests: Sequence[DepthTest], fit: DepthFit) -> None:
    """Print the answer of a fit to depths."""
    table = _table("velocity m/s", "depth m", "predicted m", "residual mm")
    for test, predicted, residual in zip(tests, fit.predicted, fit.residuals, strict=True):
        numbers = (f"{test.velocity:g}", f"{test.depth:g}", f"{predicted:.4f}", f"{1e3 * residual:+.1f}")
        table.add_row(*numbers)
    console = Console(highlight=False)
    console.print(table)
    if fit.groups:
        groups = _table("strength factor", "standard error", "interval", first="group")
        for name, group in fit.groups.items():
            groups.add_row(escape(name), *_in_words(group.estimate))
        console.print(groups)
    console.print(
        _sentence(fit.estimate),
        f"root mean square {1e3 * fit.root_mean_square:.1f} mm",
        sep="\n",
        markup=False,
        soft_wrap=True,
    )
    _print_warnings(fit.warnings)


def print_motion(impact: Impact, fit: MotionFit) -> None:
    """Print the answer of a fit to a motion."""
    table = _table("root mean square", "explained", first="quantity")
    for name, value in fit.root_mean_square.items():
        scatter = f"{degrees(value):.2f}°" if name == "rotation" else f"{1e3 * value:.1f} mm"
        table.add_row(name.replace("_", " "), scatter, f"{fit.r_squared[name]:.2%}" if name in fit.r_squared else "")
    console = Console(highlight=False)
    console.print(table)
    end = f"{len(fit.predicted.time)} instants up to {1e3 * fit.predicted.time[-1]:.3g} ms"
    angle = f"{degrees(impact.oblique_angle):g}° from the normal, {end}"
    console.print(_sentence(fit.estimate), angle, sep="\n", markup=False, soft_wrap=True)
    _print_warnings(fit.warnings)


def print_obliquity(points: Sequence[ObliquityPoint], fit: ObliquityFit) -> None:
    """Print the answer of a fit over the oblique angle."""
    coefficients = _table("coefficient", "standard error", first="power of °")
    for power, coefficient in enumerate(fit.coefficients):
        error = "" if fit.covariance is None else f"{fit.covariance[power][power] ** 0.5:.4g}"
        coefficients.add_row(str(power), f"{coefficient:.6g}", error)
    rows = _table("oblique angle °", "strength factor", "residual")
    for point, residual in zip(points, fit.residuals, strict=True):
        rows.add_row(f"{degrees(point.oblique_angle):g}", f"{point.strength_factor:g}", f"{residual:+.4f}")
    console = Console(highlight=False)
    console.print(coefficients, rows)
    console.print("strength_factor of a request:", markup=False)
    console.print_json(data=obliquity_answer(fit)["strength_factor_model"], indent=None)
    _print_warnings(fit.warnings)


def _table(*columns: str, first: str = "") -> Table:
    table = Table()
    if first:
        table.add_column(first)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _in_words(estimate: Estimate) -> tuple[str, str, str]:
    low, high = estimate.confidence_interval
    return f"{estimate.strength_factor:.3f}", f"{estimate.standard_error:.3f}", f"{low:.3f} to {high:.3f}"


def _sentence(estimate: Estimate) -> str:
    value, error, interval = _in_words(estimate)
    return (
        f"strength factor {value}, standard error {error}, {estimate.confidence_level:.0%} interval {interval} "
        f"({estimate.degrees_of_freedom:.3g} degrees of freedom)"
    )


def _print_warnings(warnings: Sequence[ModelWarning]) -> None:
    for warning in warnings:
        print(f"warning: {warning.detail}", file=sys.stderr)
