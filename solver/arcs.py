"""The loaded arc of one ring of the surface, and the part of it that is resisted in full, in closed form, compiled.

On a ring depth and normal velocity are linear in c = cos β. They are given by their values at c = 0 and their slopes.
"""

import math

from solver.compilation import vectorised
from solver.decay import TINY


@vectorised
def clamp(value: float, low: float, high: float) -> float:
    """The value, or the end of the range that it is beyond."""
    bounded = max(low, value)
    return min(high, bounded)


@vectorised
def loaded_range(depth: float, depth_slope: float, speed: float, speed_slope: float) -> tuple[float, float]:
    """Lowest and highest c that is below the face and moves into the target; the same if none does."""
    face = depth / (TINY - depth_slope)
    separation = -speed / speed_slope
    high = min(1.0, face)
    high = separation if speed_slope < 0.0 and separation < high else high
    low = separation if speed_slope > 0.0 and separation > -1.0 else -1.0
    low = min(1.0, low)
    return low, high if speed + abs(speed_slope) > 0.0 and high > low else low


@vectorised
def ramped(fastest: float, static_stress: float, ramp_velocity: float, smooth: bool) -> float:
    """Static stress on a ring with this largest normal velocity. [Pa]"""
    ramp = fastest / ramp_velocity
    ramp *= ramp if smooth else 1.0
    return static_stress * ramp / math.sqrt(1.0 + ramp * ramp)


@vectorised
def integrate_full(
    low: float, high: float, turn: float, static: float, density: float, speed: float, speed_slope: float
) -> tuple[float, float]:
    """Integrals over β of the full stress, and of it times c, from low to high c, which lie `turn` apart in β."""
    sine_low, sine_high = math.sqrt(1.0 - low * low), math.sqrt(1.0 - high * high)
    c1 = sine_low - sine_high
    c2 = 0.5 * (turn + sine_low * low - sine_high * high)
    c3 = c1 - (sine_low * sine_low * sine_low - sine_high * sine_high * sine_high) / 3.0
    constant = static + density * speed * speed
    linear, square = 2.0 * density * speed * speed_slope, density * speed_slope * speed_slope
    return constant * turn + linear * c1 + square * c2, constant * c1 + linear * c2 + square * c3
