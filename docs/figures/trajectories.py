"""Draw docs/figures/trajectories.svg, a side view of the paper's projectile at 45° and at 55° from the normal."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.reports.style import draw_concrete, draw_path, tip_path
from solver import simulate
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

OBLIQUE_ANGLES_DEG = (45.0, 55.0)
SNAPSHOTS = 5
PICTURE = Path(__file__).with_suffix(".svg")


def draw(axes: Axes, oblique_angle_deg: float) -> None:
    """Draw the path of the nose tip, and the body at equal intervals of time; depth is downwards."""
    trajectory = simulate(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=paper_impact(oblique_angle_degrees=oblique_angle_deg),
    )
    motion = trajectory.history
    assert motion is not None  # noqa: S101
    path = tip_path(
        PAPER_PROJECTILE,
        time=motion.time,
        depth_displacement=motion.center_of_gravity_depth - motion.center_of_gravity_depth[0],
        lateral_displacement=motion.center_of_gravity_lateral,
        axis_angle=motion.axis_angle,
    )
    draw_path(axes, PAPER_PROJECTILE, path, np.linspace(0.0, motion.time[-1], SNAPSHOTS))
    draw_concrete(axes, lateral=(-0.5, 0.7), depth=(-0.42, 0.24))
    axes.set_xlabel("along the face [m]")
    axes.set_title(f"{oblique_angle_deg:g}° from the normal: {trajectory.outcome.value}", fontsize=11)
    axes.legend(loc="lower left", fontsize=8, frameon=False, ncols=2, columnspacing=1.0)


def main() -> None:
    """Write the figure. The bytes depend only on the results, so an unchanged figure gives no difference in git."""
    settings: dict[Any, Any] = {
        "svg.hashsalt": "ricochet",
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    with mpl.rc_context(settings):
        figure = Figure(figsize=(10.0, 3.5))
        panels = figure.subplots(1, len(OBLIQUE_ANGLES_DEG), sharex=True, sharey=True)
        for axes, angle in zip(panels, OBLIQUE_ANGLES_DEG, strict=True):
            draw(axes, angle)
        panels[0].set_ylabel("depth [m]")
        strength = PAPER_TARGET.compressive_strength / 1e6
        figure.suptitle(f"80 × 530 mm, 13 kg, {PAPER_VELOCITY:g} m/s on concrete of {strength:g} MPa", fontsize=11)
        figure.tight_layout()
        figure.savefig(PICTURE, metadata={"Date": None})
    print(f"wrote {PICTURE.name}")


if __name__ == "__main__":
    main()
