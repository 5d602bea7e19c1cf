"""Draw docs/figures/trajectories.svg: the paper's projectile from the side, at 45° and at 55° from the normal."""

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from solver import mass_properties, simulate
from solver.arrays import FloatArray
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.projectile import Line, Projectile

OBLIQUE_ANGLES_DEG = (45.0, 55.0)
SNAPSHOTS = 5
PICTURE = Path(__file__).with_suffix(".svg")

CONCRETE, FACE, TIP_PATH = "#e4e1dc", "#8a8378", "#c8102e"


def silhouette(projectile: Projectile) -> FloatArray:
    """(n, 2) distance behind the tip and signed distance from the axis, once around. [m]"""
    edge: list[tuple[float, float]] = []
    for piece in projectile.outline():
        if isinstance(piece, Line):
            edge += [(piece.x_start, piece.r_start), (piece.x_end, piece.r_end)]
        else:
            angles = np.linspace(piece.angle_start, piece.angle_end, 60)
            x, r = piece.x_center - piece.radius * np.sin(angles), piece.r_center + piece.radius * np.cos(angles)
            edge += zip(x.tolist(), r.tolist(), strict=True)
    upper = np.array(edge)
    return np.concatenate([upper, upper[::-1] * (1.0, -1.0)])


def draw(axes: Axes, oblique_angle_deg: float) -> None:
    """Path of the nose tip and the body at even times, depth downwards."""
    trajectory = simulate(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=paper_impact(oblique_angle_degrees=oblique_angle_deg),
    )
    motion = trajectory.history
    assert motion is not None  # noqa: S101
    ahead = mass_properties(PAPER_PROJECTILE).center_of_gravity  # nose tip, from the centre of gravity
    tip_lateral = motion.center_of_gravity_lateral + ahead * np.sin(motion.axis_angle)
    origin = tip_lateral[0]
    body = silhouette(PAPER_PROJECTILE)

    colors = mpl.colormaps["viridis"](np.linspace(0.75, 0.0, SNAPSHOTS))
    rows = np.searchsorted(motion.time, np.linspace(0.0, motion.time[-1], SNAPSHOTS))
    for row, color in zip(rows, colors, strict=True):
        cosine, sine = math.cos(motion.axis_angle[row]), math.sin(motion.axis_angle[row])
        lateral = tip_lateral[row] - origin - body[:, 0] * sine + body[:, 1] * cosine
        depth = motion.nose_tip_depth[row] - body[:, 0] * cosine - body[:, 1] * sine
        label = f"{motion.time[row] * 1e3:.1f} ms"
        axes.fill(lateral, depth, facecolor=(*color[:3], 0.25), edgecolor=color, linewidth=1.1, label=label)
    axes.plot(tip_lateral - origin, motion.nose_tip_depth, color=TIP_PATH, linewidth=1.8, label="nose tip")
    axes.set_title(f"{oblique_angle_deg:g}° from the normal: {trajectory.outcome.value}", fontsize=11)
    axes.legend(loc="lower left", fontsize=8, frameon=False, ncols=2, columnspacing=1.0)


def main() -> None:
    """Write the picture, the same bytes each time."""
    mpl.use("Agg")
    plt.rcParams |= {"svg.hashsalt": "ricochet", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    figure, panels = plt.subplots(1, len(OBLIQUE_ANGLES_DEG), figsize=(10.0, 3.5), sharex=True, sharey=True)
    for axes, angle in zip(panels, OBLIQUE_ANGLES_DEG, strict=True):
        draw(axes, angle)
    for axes in panels:
        axes.set(xlabel="along the face [m]", xlim=(-0.5, 0.7), ylim=(0.24, -0.42), aspect="equal")
        axes.axhspan(0.0, 0.24, color=CONCRETE, zorder=0)
        axes.axhline(0.0, color=FACE, linewidth=1.0, zorder=1)
    panels[0].set_ylabel("depth [m]")
    strength = PAPER_TARGET.compressive_strength / 1e6
    figure.suptitle(f"80 × 530 mm, 13 kg, {PAPER_VELOCITY:g} m/s on concrete of {strength:g} MPa", fontsize=11)
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)
    print(f"wrote {PICTURE.name}")


if __name__ == "__main__":
    main()
