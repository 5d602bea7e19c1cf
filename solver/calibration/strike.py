"""One strike at any strength factor, as displacement and rotation at given times."""

from dataclasses import replace

import numpy as np

from solver.arrays import FloatArray
from solver.calibration.history import QUANTITIES, MotionHistory
from solver.prepared import initial_state, integrate, positions_at, prepare
from solver.projectile import Projectile
from solver.resistance import ConstantStrengthFactor, Resistance
from solver.strike import Impact, Numerics, ResolvedNumerics
from solver.target import Target
from solver.validation import require_positive


class Strike:
    """One strike, prepared, at any strength factor."""

    def __init__(
        self,
        projectile: Projectile,
        target: Target,
        impact: Impact,
        resistance: Resistance | None,
        numerics: ResolvedNumerics,
        times: FloatArray,
    ) -> None:
        self.impact, self.times = impact, times
        self.prepared = prepare(
            projectile=projectile,
            target=target,
            resistance=resistance or Resistance(),
            numerics=replace(numerics, termination_time=float(times[-1])),
        )

    def columns(self, strength_factor: float) -> dict[str, FloatArray]:
        """The three quantities at these times."""
        law = replace(self.prepared.resistance, strength_factor=ConstantStrengthFactor(value=strength_factor))
        prepared = replace(self.prepared, resistance=law)
        run, steps = integrate(
            prepared, prepared.model._replace(law=prepared.law_at(self.impact)), self.impact, keep_steps=True
        )
        moved = positions_at(run, steps, self.times) - initial_state(self.impact, prepared.model.body)[:3]
        return dict(zip(QUANTITIES, moved.T, strict=True))


def predict_motion(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    strength_factor: float,
    times: FloatArray,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
) -> MotionHistory:
    """Motion of the centre of gravity at given times.

    Parameters
    ----------
    projectile, target, impact
        What strikes, what is struck, and how.
    strength_factor
        S. [1]
    times
        (n,) rising, from 0 or later, two or more. [s]
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Route and resolution; adaptive unless given. The run goes on to the last of the times.

    Returns
    -------
    MotionHistory
        After the end of the run the body stays where it came to rest, or flies freely once it was released.

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts.
    """
    require_positive("strength_factor", strength_factor)
    sampled = MotionHistory(time=times, rotation=np.zeros(len(times))).time
    strike = Strike(projectile, target, impact, resistance, (numerics or Numerics()).resolved(), sampled)
    return MotionHistory(time=sampled, **strike.columns(strength_factor))
