"""Figures of the finite element comparison."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D

from service.reports import style
from solver import ObliquityPolynomial
from solver.arrays import FloatArray
from solver.calibration import Estimate, MotionHistory
from validation.finite_elements_fits import (
    LAW_NAMES,
    LAWS,
    NEAR_ANGLES,
    PAPER_ANGLES,
    Calibration,
    Prediction,
    Predictions,
)
from validation.reference import (
    MESHES,
    FiniteElementRun,
    Mesh,
    equation_9,
    history_of,
    impact_of,
    motion_of,
    path_of,
    table_2,
)
from validation.report import Column, Figure, stack

QUANTITIES = {
    "depth_displacement": "depth displacement [m]",
    "lateral_displacement": "lateral displacement [m]",
    "rotation": "rotation [°]",
}
LAW_COLORS = {"elastic_plastic": style.MODEL, "mohr_coulomb": "#8a4fae", "none": style.HINT}
LAW_LINES = {"elastic_plastic": "--", "mohr_coulomb": "-."}
MESH_LINES: Mapping[Mesh, str] = {"coarse": "-", "fine": ":"}
MESH_MARKS: Mapping[Mesh, str] = {"coarse": "o", "fine": "s"}
ANGLES = (44.0, 54.0)
"""Limits of the axis of critical angles. [°]"""
BESIDE: Mapping[Mesh, float] = {"coarse": -0.3, "fine": 0.3}
"""Shifts of the points along the angle axis, so that those of the two meshes do not overlap. [°]"""
MESH_COLORS: Mapping[Mesh, str] = {"coarse": style.FINITE_ELEMENT, "fine": style.TEST}


def rms_figure(found: Mapping[Mesh, Calibration]) -> Figure:
    """Draw the normalised RMS misfit of each run against its angle, by decay law."""
    figure, panels = style.panels(2, height=3.6, sharey=True)
    series: dict[str, dict[str, Column]] = {}
    for axes, later in zip(panels, (False, True), strict=True):
        until = "centre of gravity" if later else "nose tip"
        for mesh, calibration in found.items():
            for law, name in LAW_NAMES.items():
                fits = calibration.own(law, later=later)
                angles, values = list(fits), [fit.normalized_root_mean_square for fit in fits.values()]
                axes.plot(
                    *(angles, values, MESH_MARKS[mesh]),
                    linestyle=MESH_LINES[mesh],
                    color=LAW_COLORS[law],
                    markerfacecolor=LAW_COLORS[law] if mesh == "coarse" else "white",
                    label=f"{name}, {mesh} mesh",
                )
                series[f"{name}, {mesh} mesh, {until}"] = {
                    "oblique_angle_deg": angles,
                    "normalized_root_mean_square": values,
                }
        axes.set(xlabel="oblique angle from the normal [°]", title=f"until the {until} is deepest", xlim=(12.0, 58.0))
    panels[0].set(ylabel="normalised root mean square", ylim=(0.0, 0.4))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    caption = (
        "Normalised root mean square of what each fit leaves, by decay law: every run at its own S, fitted until its "
        "nose tip is deepest (left) or until its centre of gravity is (right)."
    )
    return Figure(name="finite-elements-rms", caption=caption, figure=figure, data=stack("series", series))


def fitted_figure(found: Mapping[Mesh, Calibration]) -> Figure:
    """Draw histories at 15°, 30° and 45°: finite elements, and the model with each law and the S of the coarse run."""
    figure, panels = style.panels(3 * len(PAPER_ANGLES), rows=len(PAPER_ANGLES), height=0.5 + 2.1 * len(PAPER_ANGLES))
    coarse = found["coarse"]
    series: dict[str, dict[str, Column]] = {}
    for row, angle in enumerate(PAPER_ANGLES):
        (run,) = (run for run in coarse.runs if run.degrees == angle)
        histories = _computed(found, angle) | _modelled(coarse, run)
        for axes, (quantity, label) in zip(panels[3 * row :], QUANTITIES.items(), strict=False):
            for name, history in histories.items():
                axes.plot(history.time * 1e3, _in_display_units(history)[quantity], **_line_style(name), label=name)
            axes.axvline(_end(coarse, run) * 1e3, color=style.HINT, linestyle=":", linewidth=1.0)
            axes.set(xlim=(0.0, run.time[-1] * 1e3), title=label if row == 0 else "")
            axes.set_xlabel("time [ms]" if angle == PAPER_ANGLES[-1] else "")
        factors = [coarse.own(law)[angle].estimate.strength_factor for law in LAWS]
        panels[3 * row].set_ylabel(f"{angle:g}°: S {factors[0]:.2f}, {factors[1]:.2f}", fontweight="bold")
        series |= {f"{angle:g} deg, {name}": _columns(history) for name, history in histories.items()}
    _legend(figure, panels[3])
    caption = (
        "Finite element runs and the model at the S fitted to the coarse run with each decay law (elastic-plastic, "
        "Mohr-Coulomb). The fit ends at the dotted vertical line, where the nose tip of the coarse run is deepest; "
        "what follows is not fitted. There is no fine run at 15°."
    )
    return Figure(name="finite-elements-fitted", caption=caption, figure=figure, data=stack("series", series))


def tip_figure(found: Mapping[Mesh, Calibration]) -> Figure:
    """Draw the depth of the nose tip at angles near the change of outcome, with a row of panels for each mesh."""
    angles = NEAR_ANGLES
    figure, panels = style.panels(2 * len(angles), rows=2, height=5.4, sharex=True, sharey=True)
    series: dict[str, dict[str, Column]] = {}
    for row, mesh in enumerate(MESHES):
        calibration = found[mesh]
        for axes, angle in zip(panels[len(angles) * row :], angles, strict=False):
            (run,) = (run for run in calibration.runs if run.degrees == angle)
            histories = {f"finite elements, {mesh} mesh": history_of(run)} | _modelled(calibration, run)
            for name, history in histories.items():
                depth = path_of(history, impact_of(run)).depth
                axes.plot(history.time * 1e3, depth * 1e3, **_line_style(name), label=name)
                series[f"{angle:g} deg, {mesh}: {name}"] = {"time_s": history.time, "nose_tip_depth_m": depth}
            factors = [calibration.own(law)[angle].estimate.strength_factor for law in LAWS]
            axes.axhline(0.0, color=style.FACE, linewidth=1.0)
            axes.axvline(_end(calibration, run) * 1e3, color=style.HINT, linestyle=":", linewidth=1.0)
            axes.set(title=f"{mesh}, {angle:g}°: S {factors[0]:.2f}, {factors[1]:.2f}", xlim=(0.0, 7.0))
    for axes in panels[:: len(angles)]:
        axes.set(ylabel="depth of the nose tip [mm]", ylim=(-100.0, 200.0))
    for axes in panels[-len(angles) :]:
        axes.set_xlabel("time [ms]")
    lines = {str(line.get_label()): line for axes in (panels[-1], panels[0]) for line in axes.get_lines()}
    shown = {label: line for label, line in lines.items() if not label.startswith("_")}
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=len(shown))
    caption = (
        "Depth of the nose tip around the change of outcome, inside positive, for both meshes. In the titles S fitted "
        "to the run itself until its tip is deepest (dotted line), elastic-plastic and Mohr-Coulomb."
    )
    return Figure(name="finite-elements-tip", caption=caption, figure=figure, data=stack("series", series))


def factor_figure(
    found: Mapping[Mesh, Calibration], predicted: Predictions, brackets: Mapping[Mesh, tuple[float, float]]
) -> Figure:
    """Draw the fitted S and their polynomials against the angle, with a panel for each decay law.

    `brackets` has, for each mesh, the angles between which the outcome changes. [rad]
    """
    figure, panels = style.panels(len(LAWS), height=4.4, sharey=True)
    series: dict[str, dict[str, Column]] = {}
    for axes, law in zip(panels, LAWS, strict=True):
        _shade(axes, brackets)
        for mesh, calibration in found.items():
            points = _points(axes, calibration.factors(law), mesh)
            series[f"{LAW_NAMES[law]}, {mesh} mesh"] = points
            series[f"{LAW_NAMES[law]}, {mesh} mesh, polynomial"] = _polynomial(axes, predicted.chosen(law, mesh))
        axes.set(xlabel="oblique angle from the normal [°]", title=LAW_NAMES[law], xlim=(-2.0, 60.0), ylim=(0.0, 14.0))
    angles: FloatArray = np.linspace(0.0, PAPER_ANGLES[-1], 91)
    paper = np.polynomial.polynomial.polyval(angles, equation_9())
    panels[0].plot(angles, paper, color=style.PAPER, label="the paper's eq. 9")
    panels[0].plot(*np.array(table_2()).T, "^", color=style.PAPER, label="Table 2 (LS-DYNA)")
    series["equation 9"] = {"oblique_angle_deg": angles, "strength_factor": np.asarray(paper)}
    panels[0].set_ylabel("strength factor S")
    _legend(figure, panels[0])
    caption = (
        "Strength factor over the oblique angle, fitted to finite element depths at 0° and motion elsewhere, by decay "
        "law and mesh, and the paper's. Polynomials end at the last fitted angle. Bars are 95 % intervals; they do not "
        "hold an error that all of a fit has in common. Shaded: where the finite elements change their outcome."
    )
    return Figure(name="finite-elements-factor", caption=caption, figure=figure, data=stack("series", series))


def angle_figure(predicted: Predictions, brackets: Mapping[Mesh, tuple[float, float]]) -> Figure:
    """Draw the critical angle of each fit, and the angles between which the outcome of the finite elements changes."""
    shown = [each for each in predicted.each if each.degrees is not None]
    figure, (axes,) = style.panels(1, height=1.4 + 0.2 * len(shown))
    _shade(axes, brackets)
    for place, each in enumerate(shown):
        degrees, color = each.degrees or math.nan, _color(each)
        if degrees > ANGLES[1]:
            axes.annotate(f"{degrees:.1f}° →", (ANGLES[1], place), color=color, ha="right", va="center", fontsize=7.5)
            continue
        axes.errorbar(
            *(degrees, place),
            xerr=each.error_degrees,
            fmt="^" if each.mesh is None else MESH_MARKS[each.mesh],
            color=color,
            markerfacecolor="white" if each.extrapolated else color,
            capsize=2.5,
        )
    names = [f"{each.reading}, {each.mesh} mesh" if each.mesh else each.reading for each in shown]
    axes.set_yticks(range(len(shown)), names, fontsize=7.5)
    axes.invert_yaxis()
    axes.set(xlabel="critical angle from the normal [°]", xlim=ANGLES)
    handles, labels = axes.get_legend_handles_labels()
    marks = {LAW_NAMES[law]: (LAW_COLORS[law], LAW_COLORS[law]) for law in LAWS}
    marks |= {"S within the fitted angles": (style.HINT, style.HINT), "S extrapolated": (style.HINT, "white")}
    for label, (color, face) in marks.items():
        handles.append(Line2D([], [], marker="o", linestyle="", color=color, markerfacecolor=face))
        labels.append(label)
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    data: dict[str, Column] = {
        "decay_law": [each.law for each in shown],
        "mesh": [each.mesh or "" for each in shown],
        "strength_factor": [each.reading for each in shown],
        "fitted_to_deg": [each.fitted_to for each in shown],
        "critical_angle_deg": [each.degrees for each in shown],
        "standard_error_deg": [each.error_degrees for each in shown],
        "extrapolated": ["yes" if each.extrapolated else "no" for each in shown],
    }
    caption = (
        "Critical angle by decay law, mesh and reading of the calibration, with its standard error where there is one. "
        "Shaded: where the finite elements change their outcome, by mesh."
    )
    return Figure(name="finite-elements-angles", caption=caption, figure=figure, data=data)


def _color(each: Prediction) -> str:
    return style.PAPER if each.mesh is None else LAW_COLORS[each.law]


def _computed(found: Mapping[Mesh, Calibration], angle: float) -> dict[str, MotionHistory]:
    return {
        f"finite elements, {mesh} mesh": history_of(run)
        for mesh, calibration in found.items()
        for run in calibration.runs
        if run.degrees == angle
    }


def _modelled(calibration: Calibration, run: FiniteElementRun) -> dict[str, MotionHistory]:
    """Return the motion of the model with the S fitted to a run, by decay law."""
    return {
        LAW_NAMES[name]: motion_of(
            impact_of(run),
            strength_factor=calibration.own(name)[run.degrees].estimate.strength_factor,
            times=run.time,
            free_surface=law,
        )
        for name, law in LAWS.items()
    }


def _line_style(name: str) -> dict[str, Any]:
    for mesh in MESHES:
        if name == f"finite elements, {mesh} mesh":
            return {"color": MESH_COLORS[mesh], "linestyle": "-"}
    (law,) = (law for law in LAWS if LAW_NAMES[law] == name)
    return {"color": LAW_COLORS[law], "linestyle": LAW_LINES[law]}


def _end(calibration: Calibration, run: FiniteElementRun) -> float:
    """Return the time at which the fit of a run ends. [s]"""
    return float(calibration.own("elastic_plastic")[run.degrees].predicted.time[-1])


def _in_display_units(history: MotionHistory) -> dict[str, FloatArray]:
    return {name: np.degrees(values) if name == "rotation" else values for name, values in history.columns.items()}


def _columns(history: MotionHistory) -> dict[str, Column]:
    units = {"depth_displacement": "m", "lateral_displacement": "m", "rotation": "deg"}
    columns: dict[str, Column] = {"time_s": history.time}
    return columns | {f"{name}_{units[name]}": values for name, values in _in_display_units(history).items()}


def _shade(axes: Axes, brackets: Mapping[Mesh, tuple[float, float]]) -> None:
    """Shade the angles between which the outcome of the finite element runs changes."""
    for mesh, ends in brackets.items():
        low, high = (math.degrees(angle) for angle in ends)
        label = f"finite elements change, {mesh} mesh: {low:g}° to {high:g}°"
        axes.axvspan(low, high, color=MESH_COLORS[mesh], alpha=0.14, linewidth=0, label=label)


def _polynomial(axes: Axes, prediction: Prediction) -> dict[str, Column]:
    """Draw the polynomial of a mesh and its standard error up to the last fitted angle, and return the values."""
    assert isinstance(prediction.model, ObliquityPolynomial)  # noqa: S101 (every fit over the angle is one)
    assert prediction.mesh is not None  # noqa: S101 (a prediction over the angle has one)
    angles: FloatArray = np.linspace(0.0, prediction.fitted_to, 111)
    curve = np.polynomial.polynomial.polyval(angles, prediction.model.coefficients)
    errors = np.array([prediction.model.standard_error(math.radians(angle)) for angle in angles.tolist()])
    color = MESH_COLORS[prediction.mesh]
    axes.fill_between(angles, curve - errors, curve + errors, color=color, alpha=0.12, linewidth=0)
    axes.plot(angles, curve, color=color, label=f"second order, {prediction.mesh} mesh, ± standard error")
    return {"oblique_angle_deg": angles, "strength_factor": np.asarray(curve), "standard_error": errors}


def _points(axes: Axes, points: Mapping[float, Estimate], mesh: Mesh) -> dict[str, Column]:
    """Draw fitted strength factors with their intervals, by angle in degrees, and return the points."""
    estimates, angles = list(points.values()), list(points)
    values = np.array([each.strength_factor for each in estimates])
    ends = np.array([each.confidence_interval for each in estimates]).T
    axes.errorbar(
        np.array(angles) + BESIDE[mesh],
        values,
        yerr=np.abs(ends - values),
        fmt=MESH_MARKS[mesh],
        color=MESH_COLORS[mesh],
        capsize=2.5,
        elinewidth=0.9,
        label=f"finite elements, {mesh} mesh, 95 %",
    )
    return {
        "oblique_angle_deg": angles,
        "strength_factor": values,
        "standard_error": np.array([each.standard_error for each in estimates]),
        "lower": ends[0],
        "upper": ends[1],
    }


def _legend(figure: Drawing, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
