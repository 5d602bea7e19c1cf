"""Style of the figures of all reports, and a side view of the projectile at instants of its motion."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from solver import mass_properties
from solver.arrays import FloatArray
from solver.projectile import Line, Projectile

SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "ricochet",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5c6670",
    "axes.linewidth": 0.8,
    "grid.color": "#e3e6e9",
    "grid.linewidth": 0.7,
    "xtick.color": "#3c444c",
    "ytick.color": "#3c444c",
    "lines.linewidth": 1.5,
    "lines.markersize": 5.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "savefig.dpi": 150,
}
WIDTH = 8.0
"""Width of a figure that fills the text column of a page [in]."""

TEST, FINITE_ELEMENT, MODEL, PAPER = "#c8102e", "#d95f00", "#123f73", "#1d7a46"
"""Colours of measured values, of finite elements, of this model, and of values printed in the paper."""
CONCRETE, FACE, HINT = "#e4e1dc", "#8a8378", "#5c6670"
TIP_PATH = "#c8102e"


@contextmanager
def styled(further: Mapping[Any, Any] | None = None) -> Iterator[None]:
    """Draw and save in this style, with further settings if given.

    The defaults of Matplotlib are restored first, so that a user's matplotlibrc does not change a report.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({**SETTINGS, **(further or {})})
        yield


def panels(count: int, *, height: float = 3.2, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return an empty figure as wide as the page, with its panels laid out in rows.

    Parameters
    ----------
    count
        Number of panels.
    height
        Height of the figure. [in]
    rows
        Number of rows; the last one may have fewer panels.
    **options
        Options of `Figure.subplots`, such as `sharex` and `sharey`.
    """
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    grid = figure.subplots(rows, -(-count // rows), squeeze=False, **options).ravel().tolist()
    for spare in grid[count:]:
        spare.remove()
    return figure, grid[:count]


def shades(count: int) -> list[tuple[float, float, float]]:
    """Return the colours of a family of curves, from light to dark."""
    shaded = mpl.colormaps["viridis"](np.linspace(0.88, 0.0, count))
    return [(float(red), float(green), float(blue)) for red, green, blue, _ in shaded]


@dataclass(frozen=True, slots=True, kw_only=True)
class TipPath:
    """Motion of the nose tip, which starts at the origin."""

    time: FloatArray
    """Time since first contact. [s]"""
    lateral: FloatArray
    """Position along the face. [m]"""
    depth: FloatArray
    """Distance behind the face. [m]"""
    axis_angle: FloatArray
    """Angle from the inward normal to the axis of the projectile. [rad]"""


def tip_path(
    projectile: Projectile,
    *,
    time: FloatArray,
    depth_displacement: FloatArray,
    lateral_displacement: FloatArray,
    axis_angle: FloatArray,
) -> TipPath:
    """Return the path of the nose tip, which follows from the motion of the centre of gravity.

    Parameters
    ----------
    projectile
        The projectile, which gives the distance from the tip to the centre of gravity.
    time
        Time since first contact, from 0. [s]
    depth_displacement, lateral_displacement
        Displacement of the centre of gravity since first contact. [m]
    axis_angle
        Angle from the inward normal to the axis. [rad]
    """
    ahead = mass_properties(projectile).center_of_gravity
    lateral, depth = ahead * np.sin(axis_angle), ahead * np.cos(axis_angle)
    return TipPath(
        time=time,
        lateral=lateral_displacement + lateral - lateral[0],
        depth=depth_displacement + depth - depth[0],
        axis_angle=axis_angle,
    )


def silhouette(projectile: Projectile) -> FloatArray:
    """Return the outline on both sides of the axis: (n, 2) distances behind the tip and from the axis. [m]"""
    edge: list[tuple[float, float]] = []
    for piece in projectile.outline():
        if isinstance(piece, Line):
            edge += [(piece.x_start, piece.r_start), (piece.x_end, piece.r_end)]
        else:
            x, r, _, _ = piece.at(np.linspace(0.0, 1.0, 60))
            edge += zip(x.tolist(), r.tolist(), strict=True)
    upper = np.array(edge)
    return np.concatenate([upper, upper[::-1] * (1.0, -1.0)])


def draw_path(axes: Axes, projectile: Projectile, path: TipPath, instants: Sequence[float] | FloatArray) -> None:
    """Draw the body at the given instants, and the path of its tip, with labels for a legend."""
    body = silhouette(projectile)
    colors = mpl.colormaps["viridis"](np.linspace(0.75, 0.0, len(instants)))
    for row, color in zip(np.searchsorted(path.time, instants), colors, strict=True):
        cosine, sine = np.cos(path.axis_angle[row]), np.sin(path.axis_angle[row])
        lateral = path.lateral[row] - body[:, 0] * sine + body[:, 1] * cosine
        depth = path.depth[row] - body[:, 0] * cosine - body[:, 1] * sine
        label = f"{path.time[row] * 1e3:.1f} ms"
        axes.fill(lateral, depth, facecolor=(*color[:3], 0.25), edgecolor=color, linewidth=1.1, label=label)
    axes.plot(path.lateral, path.depth, color=TIP_PATH, linewidth=1.8, label="nose tip")


def draw_concrete(
    axes: Axes, *, lateral: tuple[float, float], depth: tuple[float, float], thickness: float | None = None
) -> None:
    """Set the limits [m] of a view, and draw the target: a wall if a thickness is given, otherwise a half-space."""
    axes.set(xlim=lateral, ylim=(depth[1], depth[0]), aspect="equal")
    back = depth[1] if thickness is None else min(thickness, depth[1])
    axes.axhspan(0.0, back, color=CONCRETE, zorder=0)
    for place in (0.0,) if thickness is None or thickness > depth[1] else (0.0, thickness):
        axes.axhline(place, color=FACE, linewidth=1.0, zorder=1)


def embedded(picture: bytes) -> str:
    """Return an SVG as a data URI, for the `src` of an `<img>`.

    Inline SVGs would share the identifiers of the page, and clip paths of one could act on another.
    """
    return "data:image/svg+xml;base64," + base64.b64encode(picture).decode("ascii")
