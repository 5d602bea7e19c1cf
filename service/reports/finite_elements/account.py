"""What the finite element comparison shows, in words."""

import math
from collections.abc import Mapping

from service.reports.finite_elements.calibration import (
    BRACKETING,
    CALIBRATED,
    NORMAL,
    Calibration,
    Calibrations,
)
from service.reports.finite_elements.prediction import CHOSEN, NEAR, PAPER, Prediction
from service.reports.reference import equation_9, finite_element_runs
from solver.arrays import FloatArray
from solver.calibration import ObliquityFit

FINER_BRACKET = (48.0, 50.0)
"""Marginal, and turned away, with cubes of 7.5 mm instead of 10 mm. [°]"""


def paragraphs(
    found: Calibrations,
    fits: Mapping[str, ObliquityFit],
    predicted: Mapping[str, Prediction],
    bracket: tuple[float, float],
) -> tuple[str, ...]:
    """Text of the section, from its numbers; the bracket in radians."""
    low, high = (math.degrees(angle) for angle in bracket)
    return (
        _worth(),
        _calibration(found),
        _rotation(found),
        _depths(found),
        _polynomial(found, fits),
        _angle(found, predicted, low, high),
        _meaning(predicted, low),
        _cost(found, predicted),
    )


def _worth() -> str:
    return (
        "An OpenRadioss model of the paper's strike, made for this project (Johnson-Holmquist concrete, cubes of "
        "10 mm where it is struck, no friction), stands where the paper had LS-DYNA. It knows nothing of this "
        "method: its one calibrated number, the strain at which elements go, was set on the depths of the four "
        "normal shots. It is worth 2 to 3 % at 15°, at 30° until arrest, and at every angle for the first 1 to "
        "1.5 ms. **It is no converged answer late at steep angles**: after 2 ms at 45° and above allow ±4° in "
        "rotation and ±30 mm in position."
    )


def _calibration(found: Calibrations) -> str:
    values = [
        f"{estimate.strength_factor:.2f} ± {estimate.standard_error:.2f} at {math.degrees(angle):.0f}°"
        for angle, estimate in found.points.items()
    ]
    return (
        "As in the paper's section 3, S is fitted to greatest depths at 0° and to the motion at 15°, 30° and 45°, to "
        "depth, lateral displacement and rotation together, each scaled by its span. The fit ends when the nose tip "
        "is deepest: without friction an embedded projectile is squeezed back after that, and at 45° the tail sinks "
        f"on to the end of the run. **S is {', '.join(values)}** (standard errors; intervals in the table). It falls "
        "with the angle as in Table 2."
    )


def _rotation(found: Calibrations) -> str:
    oblique = found.of(CALIBRATED)
    turned = [
        f"{_last(each.run.rotation, each):.1f}° against {_last(each.fit.predicted.rotation, each):.1f}° at "
        f"{_degrees(each):.0f}°"
        for each in oblique
    ]
    poor = min(each.fit.r_squared["rotation"] for each in oblique)
    alone = [f"{each.alone['rotation'].strength_factor:.1f}" for each in oblique]
    return (
        "**One number does not serve all three quantities.** Depth and lateral displacement alone ask for S close "
        "to each other, with which the model follows them to millimetres, at 45° to a centimetre. Rotation asks for "
        "more, and the fit lies between: when the tip is deepest, the finite elements have turned by more than it, "
        f"{', '.join(turned)}. The model explains as little as {100.0 * poor:.0f} % of the variance of the "
        f"rotation, and rotation alone would ask for S of {', '.join(alone)}, or tells none. The model stops "
        "turning when its shank bears on the concrete, which resists with S f'c in full at any speed; the finite "
        "elements, with eroded room around the shank, turn on. The intervals count neighbours in a history as "
        "alike, but an error of this kind is not in them."
    )


def _depths(found: Calibrations) -> str:
    fit = found.by_depth
    return (
        f"From the four greatest depths in normal impact alone S is {fit.estimate.strength_factor:.2f} ± "
        f"{fit.estimate.standard_error:.2f}, with residuals from {_signed(fit.residuals.max() * 1e3, 0)} mm at the "
        f"slowest to {_signed(fit.residuals.min() * 1e3, 0)} mm at the fastest: the depth of the finite elements "
        "grows less with speed than eq. 1 says. At 238 m/s, the speed of all oblique runs, the motion of the normal "
        f"run gives {found.of([NORMAL])[0].estimate.strength_factor:.2f}. The polynomial takes the value from all "
        "four, as the paper's does; the table of angles has the other."
    )


def _polynomial(found: Calibrations, fits: Mapping[str, ObliquityFit]) -> str:
    c, freedom = fits[CHOSEN].coefficients, fits[CHOSEN].degrees_of_freedom
    paper = equation_9()
    weights = [1.0 / estimate.standard_error**2 for estimate in found.points.values()]
    return (
        f"The polynomial of eq. 9 through the four points is S(θ) = {c[0]:.3f} {_signed(c[1], 4)} θ "
        f"{_signed(c[2], 5)} θ², **all points weighing alike**; the paper's is {paper[0]:g} {_signed(paper[1], 4)} θ "
        f"{_signed(paper[2], 4)} θ². By their standard errors the point at 0° would have "
        f"{100.0 * weights[0] / sum(weights):.0f} % of the weight, but they do not hold the error of the model. The "
        "covariance therefore follows from the scatter about the polynomial, of which the degrees of freedom are "
        f"{freedom}: the standard error of the angle is hardly known itself. The table has the other readings."
    )


def _angle(found: Calibrations, predicted: Mapping[str, Prediction], low: float, high: float) -> str:
    near = [each.estimate.strength_factor for each in found.of(BRACKETING)]
    chosen = predicted[CHOSEN]
    taken = "" if chosen.factor is None else f" It takes S = {chosen.factor:.2f} from beyond the last calibrated angle."
    return (
        f"**Critical angle: predicted {_answer(chosen)}; finite elements between {low:g}° (sliding) and {high:g}° "
        "(ricochet)**; with the paper's eq. 9, calibrated on the paper's finite elements, "
        f"{_answer(predicted[PAPER])}. The prediction is "
        f"{placed(chosen.degrees, chosen.error_degrees, low, high)}.{taken} The runs at 48° to 55° ask for "
        f"{min(near):.2f} to {max(near):.2f} until their tips are deepest; a constant S of that mean gives "
        f"{_answer(predicted[NEAR])}."
    )


def _answer(prediction: Prediction) -> str:
    if prediction.degrees is None:
        return f"none (`{prediction.answer.status.value}`)"
    error = prediction.error_degrees
    return f"{prediction.degrees:.1f}°" + ("" if error is None else f" ± {error:.1f}°")


def placed(angle: float | None, error: float | None, low: float, high: float) -> str:
    """Where a predicted angle lies, whatever it is. [°]"""
    if angle is None:
        return "missing, so nothing can be compared"
    if low <= angle <= high:
        return "between these"
    where = f"{angle - high:.1f}° above both" if angle > high else f"{low - angle:.1f}° below both"
    if error is None:
        return f"{where}, with a standard error that is not known"
    nearest = min(abs(angle - low), abs(angle - high))
    return f"{where}, {'less' if nearest < error else 'more'} than its standard error"


def _meaning(predicted: Mapping[str, Prediction], low: float) -> str:
    angles = [each.degrees for what, each in predicted.items() if what != PAPER and each.degrees is not None]
    marginal, turned = FINER_BRACKET
    return (
        f"**What this is worth.** With 7.5 mm cubes the finite elements hold 45°, are marginal at {marginal:g}° "
        f"and turn {turned:g}° away: their own angle falls by about {low - marginal:g}° with refinement, towards "
        f"the paper's, and is not settled. The readings of one calibration spread from {min(angles):.1f}° to "
        f"{max(angles):.1f}°. The histories near the critical angle agree for the first 2 ms; after that the "
        "finite elements slide on, where the model comes to rest or is thrown out sooner. Agreement within a few "
        "degrees can be claimed, none to the degree, and it is agreement between two computations: no test of "
        "this angle is known."
    )


def _cost(found: Calibrations, predicted: Mapping[str, Prediction]) -> str:
    normal = [run for run in finite_element_runs() if run.oblique_angle == 0.0]
    runs = sum(run.cpu_seconds for run in normal) + sum(each.run.cpu_seconds for each in found.of(CALIBRATED))
    near = sum(each.run.cpu_seconds for each in found.of(BRACKETING))
    fits = sum(each.cpu_seconds for each in found.of(CALIBRATED))
    search = predicted[PAPER].cpu_seconds
    times = float(f"{near / search:.1g}")
    return (
        f"**Cost.** The bracket took {near:,.0f} CPU s of finite elements; a critical angle at known S takes "
        f"{search * 1e3:.0f} ms here, some {times:,.0f} times less. The calibration is not free of them: its "
        f"{len(normal) + len(CALIBRATED)} runs took {runs:,.0f} CPU s, and the fits {fits:.1f}. What is saved "
        "is every further angle, speed and size for which the same S is taken to hold."
    )


def _degrees(each: Calibration) -> float:
    return math.degrees(each.run.oblique_angle)


def _last(rotation: FloatArray | None, each: Calibration) -> float:
    """Rotation at the end of the fit; nan if there is none. [°]"""
    return math.nan if rotation is None else math.degrees(float(rotation[len(each.fit.predicted.time) - 1]))


def _signed(value: float, decimals: int) -> str:
    """A number with its sign, as it is printed."""
    return f"{value:+.{decimals}f}".replace("-", "\N{MINUS SIGN}")
