"""The method of the source paper in plain NumPy, as a user would write it for a single strike; used as a reference.

It has 12,000 panels over nose and shank, the classical Runge-Kutta scheme with steps of 0.01 ms for 5 ms, and the
secant search of eq. 8 from 40° and 60° to 1 %. It detects no events, so every trajectory takes the full 5 ms. Units are
SI, with angles of incidence in degrees from the inward normal of the face. It needs only NumPy, and prints JSON:

    python benchmarks/numpy_script.py       # the critical angle
    python benchmarks/numpy_script.py 45    # depths of the nose tip after every step of one trajectory

Part of its time is spent in the operating system, because memory is released and requested again for every array. How
much depends on what else the process has allocated. The script is therefore measured in a process of its own, as it
would be used, and also prints the system time.
"""

import json
import math
import os
import sys
import time
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]

DIAMETER, LENGTH, CALIBER_RADIUS_HEAD, MASS = 0.08, 0.53, 3.0, 13.0
"""Dimensions and mass of the paper's projectile. [m, m, 1, kg]"""
SPEED = 238.0
"""Speed at first contact. [m/s]"""
STRENGTH, DENSITY = 39e6, 2250.0
"""Strength and density of the concrete. [Pa, kg/m³]"""
YOUNGS_MODULUS = 4.7e9 * math.sqrt(STRENGTH * 1e-6)
"""Young's modulus of the concrete, from its strength. [Pa]"""
SLICES, SECTORS = 200, 60
"""Number of panels along the axis, and around it."""
STEP, STEPS = 1e-5, 500
"""Time step, and number of steps in 5 ms. [s, 1]"""

SHANK = DIAMETER / 2.0
NOSE_LENGTH = SHANK * math.sqrt(4.0 * CALIBER_RADIUS_HEAD - 1.0)
OGIVE_RADIUS = CALIBER_RADIUS_HEAD * DIAMETER
PLASTIC_RATIO = (2.0 * YOUNGS_MODULUS / (3.0 * STRENGTH)) ** (1.0 / 3.0)  # Poisson's ratio is 1/2.


class Panels(NamedTuple):
    """Arrays over the panels. Forward is along the axis to the tip, and aside is across it in the plane of motion."""

    forward: Floats
    aside: Floats
    normal_forward: Floats
    normal_aside: Floats
    cavity: Floats
    """Distance from the axis to the panel along the panel's normal. [m]"""
    area: Floats


class Body(NamedTuple):
    """Properties of the projectile in the equations of motion."""

    panels: Panels
    tip: float
    """Position of the tip ahead of the centre of gravity. [m]"""
    inertia: float
    """Moment of inertia about a transverse axis through the centre of gravity. [kg m²]"""


def profile(behind_tip: Floats) -> tuple[Floats, Floats]:
    """Return the radius and the sine of the slope at distances behind the tip. [m, 1]"""
    sine = np.maximum(NOSE_LENGTH - behind_tip, 0.0) / OGIVE_RADIUS
    return SHANK - OGIVE_RADIUS * (1.0 - np.sqrt(1.0 - sine**2)), sine


def build_body() -> Body:
    """Return the panels and the mass properties of the homogeneous solid."""
    disc = LENGTH / 5000
    middle: Floats = disc * (np.arange(5000, dtype=np.float64) + 0.5)
    radius, _ = profile(middle)
    share = radius**2 / np.sum(radius**2)
    tip = float(np.sum(share * middle))
    inertia = MASS * float(np.sum(share * ((middle - tip) ** 2 + radius**2 / 4.0)))

    width = LENGTH / SLICES
    x, angle = np.meshgrid(
        width * (np.arange(SLICES) + 0.5), 2.0 * np.pi / SECTORS * (np.arange(SECTORS) + 0.5), indexing="ij"
    )
    x, angle = x.ravel(), angle.ravel()
    radius, sine = profile(x)
    cosine = np.sqrt(1.0 - sine**2)
    panels = Panels(
        forward=tip - x,
        aside=radius * np.cos(angle),
        normal_forward=sine,
        normal_aside=cosine * np.cos(angle),
        cavity=radius / cosine,
        area=2.0 * np.pi / SECTORS * radius * width / cosine,
    )
    return Body(panels, tip, inertia)


def decay(ratio: Floats) -> Floats:
    """Return the elastic-plastic decay at radius ratios k (eqs. 2-3). [1]"""
    deep = 1.0 + 3.0 * math.log(PLASTIC_RATIO)
    elastic = 1.0 - (PLASTIC_RATIO / ratio) ** 3 / deep
    plastic = 3.0 * np.log(ratio) / deep
    return np.where(ratio < PLASTIC_RATIO, plastic, elastic)


def derivative(state: Floats, body: Body, static_stress: float) -> Floats:
    """Return the time derivative of depth, lateral position, axis angle and their rates (eqs. 1, 4-6)."""
    p = body.panels
    depth, _, angle, sinking, sliding, turning = state
    cosine, sine = math.cos(angle), math.sin(angle)
    arm_depth = p.forward * cosine - p.aside * sine
    arm_lateral = p.forward * sine + p.aside * cosine
    normal_depth = p.normal_forward * cosine - p.normal_aside * sine
    normal_lateral = p.normal_forward * sine + p.normal_aside * cosine
    inside = depth + arm_depth
    speed = (sinking - turning * arm_lateral) * normal_depth + (sliding + turning * arm_depth) * normal_lateral

    loaded = np.flatnonzero((inside > 0.0) & (speed > 0.0))
    if loaded.size == 0:
        return np.array([sinking, sliding, turning, 0.0, 0.0, 0.0])
    facing, speed = normal_depth[loaded], speed[loaded]
    with np.errstate(divide="ignore", invalid="ignore"):  # Values that are not finite are replaced below.
        ratio = 1.0 - inside[loaded] / (facing * p.cavity[loaded])
        factor = np.where(facing < 0.0, decay(ratio), 1.0)
    push = factor * (static_stress + DENSITY * speed**2) * p.area[loaded]
    push_depth, push_lateral = push * facing, push * normal_lateral[loaded]
    moment = np.sum(arm_lateral[loaded] * push_depth - arm_depth[loaded] * push_lateral)
    return np.array(
        [
            sinking,
            sliding,
            turning,
            -np.sum(push_depth) / MASS,
            -np.sum(push_lateral) / MASS,
            moment / body.inertia,
        ]
    )


def trajectory(body: Body, oblique_angle_deg: float) -> Floats:
    """Return the states at the start and after every step, a row for each."""
    factor = 8.469 + 0.0149 * oblique_angle_deg - 0.0013 * oblique_angle_deg**2  # eq. 9
    angle = math.radians(oblique_angle_deg)
    across, along = math.sin(angle), math.cos(angle)
    path = np.empty((STEPS + 1, 6))
    path[0] = -body.tip * along, -body.tip * across, angle, SPEED * along, SPEED * across, 0.0

    def slope(state: Floats) -> Floats:
        return derivative(state, body, factor * STRENGTH)

    for step in range(STEPS):
        start = path[step]
        first = slope(start)
        second = slope(start + 0.5 * STEP * first)
        third = slope(start + 0.5 * STEP * second)
        fourth = slope(start + STEP * third)
        path[step + 1] = start + STEP / 6.0 * (first + 2.0 * (second + third) + fourth)
    return path


def tip_depth(body: Body, state: Floats) -> Any:
    """Return the depth of the nose tip in one state, or in each row of many states. [m]"""
    return state[..., 0] + body.tip * np.cos(state[..., 2])


def critical_angle(lower_deg: float = 40.0, upper_deg: float = 60.0, tolerance: float = 0.01) -> tuple[float, int]:
    """Return the angle at which the tip is at the face after 5 ms, by eq. 8, and the number of trajectories. [°, 1]"""
    body = build_body()
    angles = [lower_deg, upper_deg]
    depths = [float(tip_depth(body, trajectory(body, angle)[-1])) for angle in angles]
    while abs(angles[-1] - angles[-2]) > tolerance * angles[-2]:
        slope = (depths[-1] - depths[-2]) / (angles[-1] - angles[-2])
        angles.append(angles[-1] - depths[-1] / slope)
        depths.append(float(tip_depth(body, trajectory(body, angles[-1])[-1])))
    return angles[-1], len(angles)


def main() -> None:
    """Print the answer, and the CPU, wall and system times that it took."""
    system, cpu, wall = os.times().system, time.process_time(), time.perf_counter()
    answer: dict[str, Any]
    if sys.argv[1:]:
        body = build_body()
        answer = {"tip_depth_m": tip_depth(body, trajectory(body, float(sys.argv[1]))).tolist()}
    else:
        angle_deg, count = critical_angle()
        answer = {"angle_deg": angle_deg, "trajectories": count}
    spent = {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall}
    print(json.dumps(answer | spent | {"system_s": os.times().system - system}))


if __name__ == "__main__":
    main()
