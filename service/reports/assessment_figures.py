"""Figures of the report of one strike: a sketch, side views of runs, and curves against speed and angle."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
from matplotlib.ticker import AutoLocator

from service.reports import style
from service.reports.style import TIP_PATH, TipPath, draw_concrete, draw_path, silhouette, tip_path
from solver.projectile import Projectile
from solver.units import quantity, shown_unit, symbol

SNAPSHOTS = 4
"""Number of outlines of the projectile in the view of a run. An arbitrary choice: more would overlap."""
LEAST_WIDTH = 0.8
"""Smallest width of a view relative to the widest one [1], which leaves room for its title."""
Frame: TypeAlias = tuple[float, float, float, float]
"""Left, right, top and bottom limit of a view. [m]"""
SETTINGS: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "svg.fonttype": "path",
}
ONE_LINE: dict[str, Any] = {
    "ncols": 4,
    "handlelength": 1.2,
    "columnspacing": 0.9,
    "handletextpad": 0.4,
    "borderpad": 0.2,
}
"""Options of a legend below a figure, with which its entries fit on one line."""
PAGE = 7.2
"""Width of the page between its margins. [in]"""


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG, without the date so that the same strike gives the same bytes."""
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None}, bbox_inches="tight", pad_inches=0.03)
    return file.getvalue()


def sketch(projectile: Projectile, *, oblique_deg: float, attack_deg: float, thickness: float | None) -> Figure:
    """Draw the projectile at first contact with the face, its angles, and the back of a wall.

    Parameters
    ----------
    oblique_deg, attack_deg
        Angle from the inward normal to the velocity, and from the velocity to the axis. [°]
    thickness
        Thickness of a wall; None for a half-space. [m]
    """
    figure = Figure(figsize=(2.6, 2.2), layout="constrained")
    axes = figure.subplots()
    velocity, axis = math.radians(oblique_deg), math.radians(oblique_deg + attack_deg)
    body, length = silhouette(projectile), projectile.length
    lateral = -body[:, 0] * math.sin(axis) + body[:, 1] * math.cos(axis)
    depth = -body[:, 0] * math.cos(axis) - body[:, 1] * math.sin(axis)
    # At first contact the deepest point touches the face. At a large angle it is on an edge rather than at the tip.
    depth -= max(depth.max(), 0.0)
    below = 0.6 * length if thickness is None else min(max(1.2 * thickness, 0.45 * length), 1.2 * length)
    side = 0.12 * length
    left, right = min(lateral.min(), -0.3 * length) - side, max(lateral.max(), 0.75 * length) + side
    axes.fill(lateral, depth, facecolor="#c9d3df", edgecolor="black", linewidth=1.0, zorder=3)
    draw_concrete(axes, lateral=(left, right), depth=(depth.min() - side, below), thickness=thickness)
    axes.plot((0.0, 0.0), (-0.75 * length, min(below, 0.55 * length)), color=style.HINT, linewidth=0.8, linestyle="--")
    tip = (0.5 * length * math.sin(velocity), 0.5 * length * math.cos(velocity))
    axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": TIP_PATH, "linewidth": 1.4})
    _arc(axes, 0.34 * length, 0.0, oblique_deg)
    axes.text(-0.04 * length, 0.34 * length, f"θ = {oblique_deg:.4g}°", ha="right", va="center")
    if attack_deg:
        _arc(axes, 0.44 * length, oblique_deg, oblique_deg + attack_deg)
        ahead = (0.5 * length * math.sin(axis), 0.5 * length * math.cos(axis))
        axes.plot((0.0, ahead[0]), (0.0, ahead[1]), color="black", linewidth=0.7, linestyle=":")
        axes.text(max(tip[0], ahead[0]) + 0.04 * length, min(tip[1], ahead[1]), f"δ = {attack_deg:.3g}°", va="center")
    axes.text(left + 0.3 * side, 0.0, "face ", ha="left", va="bottom", fontsize=7)
    if thickness is not None and thickness < below:
        text = f"back, {quantity(thickness, 'mm')}"
        axes.text(left + 0.3 * side, thickness, text, ha="left", va="top", fontsize=7)
    axes.set_axis_off()
    return figure


def _arc(axes: Axes, radius: float, start_deg: float, stop_deg: float) -> None:
    """Draw the arc between two angles from the inward normal, in axes whose depth grows downwards."""
    ends = sorted((90.0 - start_deg, 90.0 - stop_deg))
    axes.add_patch(Arc((0.0, 0.0), 2.0 * radius, 2.0 * radius, theta1=ends[0], theta2=ends[1], linewidth=0.9))


def side_views(
    projectile: Projectile, runs: Sequence[tuple[str, Mapping[str, Any]]], *, thickness: float | None
) -> Figure:
    """Draw runs beside one another, to the same scale.

    Parameters
    ----------
    runs
        Title and answer, with its history, of each run.
    thickness
        Thickness of a wall; None for a half-space. [m]
    """
    paths = [_path_of(projectile, answer["history"]) for _, answer in runs]
    body = silhouette(projectile)
    length, breadth = body.max(axis=0)
    frames = [_frame(path, length, breadth, thickness) for path in paths]
    top, bottom = min(frame[2] for frame in frames), max(frame[3] for frame in frames)
    widest = max(right - left for left, right, _, _ in frames)
    frames = [_widened(frame, LEAST_WIDTH * widest) for frame in frames]
    widths = [right - left for left, right, _, _ in frames]
    height = min(max((PAGE - 0.9) * (bottom - top) / sum(widths) + 0.55, 1.5), 1.75)
    figure = Figure(figsize=(PAGE, height), layout="constrained")
    grid = figure.subplots(1, len(runs), sharey=True, squeeze=False, gridspec_kw={"width_ratios": widths}).ravel()
    for axes, (title, _), path, (left, right, _, _) in zip(grid, runs, paths, frames, strict=True):
        draw_path(axes, projectile, path, np.linspace(0.0, path.time[-1], SNAPSHOTS))
        draw_concrete(axes, lateral=(left, right), depth=(top, bottom), thickness=thickness)
        axes.set(title=title, xlabel=f"along the face [{symbol('m')}]")
        if (factor := shown_unit("m").factor) != 1.0:
            _tick_in(axes, factor)
    grid[0].set(ylabel=f"depth [{symbol('m')}]")
    return figure


class _ScaledTicks(AutoLocator):
    """Ticks at round numbers in a unit other than the unit of the data.

    Parameters
    ----------
    factor
        Factor from the unit of the data to the unit shown.
    """

    def __init__(self, factor: float) -> None:
        super().__init__()
        self._factor = factor

    def tick_values(self, vmin: float, vmax: float) -> Any:
        return np.asarray(super().tick_values(vmin * self._factor, vmax * self._factor)) / self._factor


def _tick_in(axes: Axes, factor: float) -> None:
    """Label axes in a unit other than the metres of their data; `factor` converts metres to that unit."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(_ScaledTicks(factor))
        axis.set_major_formatter(lambda value, _: f"{value * factor:.6g}".replace("-", "\N{MINUS SIGN}"))


def _widened(frame: Frame, width: float) -> Frame:
    """Return a view widened to at least `width` [m], which leaves room for its title."""
    left, right, top, bottom = frame
    more = max(0.5 * (width - (right - left)), 0.0)
    return left - more, right + more, top, bottom


def _path_of(projectile: Projectile, history: Mapping[str, Sequence[float]]) -> TipPath:
    depth = np.array(history["center_of_gravity_depth_m"])
    return tip_path(
        projectile,
        time=np.array(history["time_s"]),
        depth_displacement=depth - depth[0],
        lateral_displacement=np.array(history["center_of_gravity_lateral_m"]),
        axis_angle=np.radians(history["axis_angle_deg"]),
    )


def _frame(path: TipPath, length: float, breadth: float, thickness: float | None) -> Frame:
    """Return the view that contains the whole run and, unless it is far away, the back of the wall."""
    tails = path.lateral - length * np.sin(path.axis_angle), path.depth - length * np.cos(path.axis_angle)
    lateral, depth = np.concatenate((path.lateral, tails[0])), np.concatenate((path.depth, tails[1], [0.0]))
    margin = 0.05 * length + breadth
    bottom = depth.max() + margin
    if thickness is not None and thickness < 2.0 * bottom:
        bottom = max(bottom, 1.15 * thickness)
    return lateral.min() - margin, lateral.max() + margin, depth.min() - margin, bottom


def curves(
    speeds: Sequence[tuple[float, Mapping[str, Any]]],
    uncertainty: Mapping[str, Any] | None,
    *,
    speed: float,
    angle: float | None,
    judged: float | None,
) -> Figure:
    """Draw the critical angle against the speed, and the probability of ricochet against the angle.

    Parameters
    ----------
    speeds
        Speed [m/s] and answer of each search.
    uncertainty
        Answer of the uncertainty study; None if there is none.
    speed, angle, judged
        Speed of the case [m/s], its critical angle if there is one, and its oblique angle if it has one [°].
    """
    figure = Figure(figsize=(PAGE, 1.6), layout="constrained")
    grid = figure.add_gridspec(1, 2)
    halves = [figure.add_subfigure(grid[column]) for column in range(2)]
    left = halves[0].subplots()
    factor = shown_unit("m/s").factor
    speed *= factor
    _draw_speeds(left, [(each * factor, answer) for each, answer in speeds])
    left.axvline(speed, color=style.HINT, linewidth=0.8, linestyle="--")
    if angle is not None:
        left.plot([speed], [angle], "o", color="black", markersize=5, zorder=5, label="this case")
    if judged is not None:
        left.plot([speed], [judged], "x", color=TIP_PATH, markersize=6, zorder=5, label="angle to judge")
    left.set(title="Critical angle over the speed", xlabel=f"speed [{symbol('m/s')}]", ylabel="angle θ [°]")
    left.set(ylim=(0.0, 90.0), yticks=(0, 30, 60, 90))
    if left.get_legend_handles_labels()[1]:
        halves[0].legend(loc="outside lower center", **ONE_LINE)  # No place within the axes is free for every case.
    if uncertainty is None:
        return figure
    right = halves[1].subplots()
    curve = uncertainty["probability"]
    angles = curve["oblique_angle_deg"]
    right.fill_between(
        angles, curve["lower"], curve["upper"], color=style.MODEL, alpha=0.25, linewidth=0.0, label="95 % band"
    )
    right.plot(angles, curve["ricochet_probability"], color=style.MODEL)
    if angle is not None:
        right.axvline(angle, color="black", linewidth=0.8, linestyle="--", label="critical angle")
    if judged is not None:
        right.axvline(judged, color=TIP_PATH, linewidth=0.8, linestyle=":", label="angle to judge")
    right.set(title="Probability of ricochet", xlabel="oblique angle θ from the normal [°]", ylabel="probability")
    right.set(xlim=(angles[0], angles[-1]), ylim=(0.0, 1.02))
    halves[1].legend(loc="outside lower center", **ONE_LINE)
    return figure


def _draw_speeds(axes: Axes, speeds: Sequence[tuple[float, Mapping[str, Any]]]) -> None:
    """Draw the critical angle against the speed, and for walls the angle up to which they are perforated."""
    perforated = [(speed, _perforated_to(answer)) for speed, answer in speeds]
    critical = [(speed, answer.get("critical_angle_deg", math.nan)) for speed, answer in speeds]
    if all(math.isnan(angle) for _, angle in critical):
        axes.text(0.5, 0.5, "none at these speeds", transform=axes.transAxes, ha="center", va="center")
    else:
        x, y = zip(*critical, strict=True)
        axes.plot(x, y, "-", marker=".", color=style.MODEL, label="critical angle")
    if critical:
        axes.set_xlim(critical[0][0], critical[-1][0])
    if any(not math.isnan(angle) for _, angle in perforated):
        x, y = zip(*perforated, strict=True)
        axes.plot(x, y, "-", marker=".", color=style.FINITE_ELEMENT, label="perforated up to")


def _perforated_to(answer: Mapping[str, Any]) -> float:
    found = [each["upper_deg"] for each in answer.get("outcomes", ()) if each["outcome"] == "perforated"]
    return max(found, default=math.nan)
