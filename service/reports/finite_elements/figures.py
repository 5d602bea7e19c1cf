"""Drawings of the finite element comparison."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from service.reports import style
from service.reports.contents import Column, Figure, stack
from service.reports.finite_elements.calibration import BRACKETING, Calibration, Calibrations
from service.reports.paper.strike import history_of, impact_of, motion_of, path_of
from service.reports.reference import FiniteElementRun, equation_9, table_2
from solver.arrays import FloatArray
from solver.calibration import Estimate, MotionHistory
from solver.resistance import ObliquityPolynomial

QUANTITIES = {
    "depth_displacement": "depth displacement [m]",
    "lateral_displacement": "lateral displacement [m]",
    "rotation": "rotation [°]",
}
ANGLES = np.linspace(0.0, 60.0, 121)
"""[°]"""
FINITE_ELEMENTS = "finite elements"


def degrees_of(run: FiniteElementRun) -> float:
    """Oblique angle of a run, as its name has it. [°]"""
    return round(math.degrees(run.oblique_angle), 6)


def fitted_figure(calibrations: Sequence[Calibration]) -> Figure:
    """Histories at the S fitted to each."""
    motions = {each.run.name: (each.run, each.estimate.strength_factor) for each in calibrations}
    ends = {each.run.name: float(each.fit.predicted.time[-1]) for each in calibrations}
    figure, data = _histories(list(motions.values()), ends)
    caption = (
        "Finite element runs and the model at the S fitted to each. The fit ends at the dotted line, where the "
        "nose tip of the finite element run is deepest; what follows is not fitted."
    )
    return Figure(name="finite-elements-fitted", caption=caption, figure=figure, data=data)


def predicted_figure(runs: Sequence[FiniteElementRun], model: ObliquityPolynomial) -> Figure:
    """Histories near the critical angle, at the S of the polynomial."""
    polynomial = np.polynomial.Polynomial(model.coefficients)
    figure, data = _histories([(run, float(polynomial(degrees_of(run)))) for run in runs], {})
    caption = (
        "Runs near the critical angle and the model at the S that the fitted polynomial, extrapolated, has there. "
        "None of it was fitted to these runs."
    )
    return Figure(name="finite-elements-predicted", caption=caption, figure=figure, data=data)


def tip_figure(calibrations: Sequence[Calibration], model: ObliquityPolynomial) -> Figure:
    """Depth of the nose tip near the critical angle, which decides the outcome."""
    figure, panels = style.panels(len(calibrations), height=3.0, sharey=True)
    polynomial = np.polynomial.Polynomial(model.coefficients)
    series: dict[str, dict[str, Column]] = {}
    for axes, each in zip(panels, calibrations, strict=True):
        run, degrees = each.run, degrees_of(each.run)
        extrapolated, own = float(polynomial(degrees)), each.estimate.strength_factor
        curves = {
            FINITE_ELEMENTS: history_of(run),
            "polynomial's S": motion_of(impact_of(run), strength_factor=extrapolated, times=run.time),
            "own S": motion_of(impact_of(run), strength_factor=own, times=run.time),
        }
        looks = ((style.FINITE_ELEMENT, "-"), (style.MODEL, "--"), (style.MODEL, ":"))
        for (name, history), (color, line) in zip(curves.items(), looks, strict=True):
            depth = path_of(history, impact_of(run)).depth
            axes.plot(history.time * 1e3, depth * 1e3, color=color, linestyle=line, label=name)
            series[f"{degrees:g} deg, {name}"] = {"time_s": history.time, "nose_tip_depth_m": depth}
        axes.axhline(0.0, color=style.FACE, linewidth=1.0)
        axes.set(xlabel="time [ms]", title=f"{degrees:g}°: S {extrapolated:.2f}, {own:.2f}", xlim=(0.0, 7.0))
    panels[0].set_ylabel("depth of the nose tip [mm]")
    panels[0].set_ylim(-150.0, 230.0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    caption = (
        "Depth of the nose tip near the critical angle, inside positive. In the titles S of the extrapolated "
        "polynomial and the S fitted to the run itself until its tip is deepest."
    )
    return Figure(name="finite-elements-tip", caption=caption, figure=figure, data=stack("series", series))


def _histories(
    motions: Sequence[tuple[FiniteElementRun, float]], ends: dict[str, float]
) -> tuple[Drawing, dict[str, list[object]]]:
    """A row of panels for each run, a column for each quantity."""
    figure, panels = style.panels(3 * len(motions), rows=len(motions), height=0.5 + 2.1 * len(motions))
    series: dict[str, dict[str, Column]] = {}
    for place, (run, factor) in enumerate(motions):
        model = motion_of(impact_of(run), strength_factor=factor, times=run.time)
        for axes, (quantity, label) in zip(panels[3 * place :], QUANTITIES.items(), strict=False):
            for name, history, color, line in (
                (FINITE_ELEMENTS, history_of(run), style.FINITE_ELEMENT, "-"),
                ("model", model, style.MODEL, "--"),
            ):
                axes.plot(history.time * 1e3, _shown(history, quantity), line, color=color, label=name)
            if run.name in ends:
                axes.axvline(ends[run.name] * 1e3, color="#5c6670", linestyle=":", linewidth=1.0)
            axes.set_xlim(0.0, run.time[-1] * 1e3)
            axes.set(title=label if place == 0 else "", xlabel="time [ms]" if run is motions[-1][0] else "")
        panels[3 * place].set_ylabel(f"{degrees_of(run):g}°, S = {factor:.2f}", fontweight="bold")
        series |= {f"{run.name}, {FINITE_ELEMENTS}": _columns(history_of(run)), f"{run.name}, model": _columns(model)}
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure, stack("series", series)


def _shown(history: MotionHistory, quantity: str) -> FloatArray:
    values = history.columns[quantity]
    return np.degrees(values) if quantity == "rotation" else values


def _columns(history: MotionHistory) -> dict[str, Column]:
    return {
        "time_s": history.time,
        "depth_displacement_m": _shown(history, "depth_displacement"),
        "lateral_displacement_m": _shown(history, "lateral_displacement"),
        "rotation_deg": _shown(history, "rotation"),
    }


def factor_figure(
    found: Calibrations, model: ObliquityPolynomial, predicted: float | None, bracket: tuple[float, float]
) -> Figure:
    """S over the angle: fitted points and their polynomial, beside Table 2 and eq. 9; angles in radians."""
    figure, (axes,) = style.panels(1, height=4.8)
    low, high = (math.degrees(angle) for angle in bracket)
    axes.axvspan(low, high, color=style.CONCRETE, label=f"finite elements change: {low:g}° to {high:g}°")
    curve, paper = (np.polynomial.polynomial.polyval(ANGLES, each) for each in (model.coefficients, equation_9()))
    errors = np.array([model.standard_error(math.radians(angle)) for angle in ANGLES.tolist()])
    axes.fill_between(ANGLES, curve - errors, curve + errors, color=style.MODEL, alpha=0.12, linewidth=0)
    axes.plot(ANGLES, curve, color=style.MODEL, label="through the filled points, ± standard error")
    axes.plot(ANGLES, paper, color=style.PAPER, label="the paper's eq. 9")
    axes.plot(*np.array(table_2()).T, "s", color=style.PAPER, label="Table 2 (LS-DYNA)")
    series: dict[str, dict[str, Column]] = {
        "polynomial": {"oblique_angle_deg": ANGLES, "strength_factor": curve.tolist(), "standard_error": errors},
        "equation 9": {"oblique_angle_deg": ANGLES, "strength_factor": paper.tolist()},
        "calibrated": _points(axes, found.points, style.FINITE_ELEMENT, "finite elements, 95 %"),
        "not in the polynomial": _points(
            axes,
            {each.run.oblique_angle: each.estimate for each in found.of(BRACKETING)},
            "none",
            "the same, not in the polynomial",
        ),
    }
    if predicted is not None:
        axes.axvline(math.degrees(predicted), color=style.MODEL, linestyle=":", label="predicted angle")
    axes.set(
        xlabel="oblique angle from the normal [°]", ylabel="strength factor S", xlim=(-2.0, 60.0), ylim=(0.0, 14.0)
    )
    figure.legend(loc="outside lower center", ncols=3)
    caption = (
        "Strength factor over the oblique angle: fitted to finite element depths at 0° and motion elsewhere, and the "
        "paper's. Bars are 95 % intervals; they do not hold an error that all of a fit has in common."
    )
    return Figure(name="finite-elements-factor", caption=caption, figure=figure, data=stack("series", series))


def _points(axes: Axes, points: Mapping[float, Estimate], fill: str, label: str) -> dict[str, Column]:
    """Draw fitted strength factors with their intervals, and return them; angles in radians."""
    estimates, angles = list(points.values()), np.degrees(list(points))
    values = np.array([each.strength_factor for each in estimates])
    ends = np.array([each.confidence_interval for each in estimates]).T
    color = style.FINITE_ELEMENT
    axes.errorbar(
        angles, values, yerr=np.abs(ends - values), fmt="o", color=color, markerfacecolor=fill, capsize=2.5, label=label
    )
    return {
        "oblique_angle_deg": angles,
        "strength_factor": values,
        "standard_error": np.array([each.standard_error for each in estimates]),
        "lower": ends[0],
        "upper": ends[1],
    }
