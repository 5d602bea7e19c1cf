"""Load or compile every compiled function, so that no query has to wait for it."""

from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.numerics import Numerics
from solver.search.critical_angle import critical_angle
from solver.trajectory import simulate


def warm_up() -> None:
    """Run both routes once; takes one to three minutes on a new machine, a fraction of a second after."""
    for method in ("adaptive", "panels"):
        simulate(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=paper_impact(oblique_angle_degrees=45.0),
            numerics=Numerics(method=method, panels=100, termination_time=1e-4),
            sample_interval=1e-4,
        )
    critical_angle(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY)
