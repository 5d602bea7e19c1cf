# %% [markdown]
# # One strike: its motion, its critical angle and the uncertainty of that angle
#
# A rigid projectile of 80 × 530 mm and 13 kg strikes concrete of 39 MPa. Run the cells (`# %%`) one by one in an
# editor that supports them, or all at once with `.venv/bin/python examples/notebook.py`, after `make demo`.
#
# Everything is in SI units and radians; angles are from the inward normal of the face.

# %%
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import solver
from solver import Impact, Ogive, Projectile, Resistance, Target
from solver.calibration import ObliquityPoint, fit_obliquity

projectile = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
target = Target(compressive_strength=39e6, density=2250.0)

# %% [markdown]
# ## The motion at 55°
#
# `columns()` returns arrays, and `to_dataframe()` a pandas data frame. For polars, use
# `polars.DataFrame(strike.columns())`.

# %%
strike = solver.simulate(
    projectile=projectile, target=target, impact=Impact(velocity=238.0, oblique_angle=math.radians(55.0))
)
history = strike.columns()
deepest = strike.maximum_depth or 0.0  # It is None only if the target is perforated.
print(f"{strike.outcome} after {1e3 * strike.final.time:.2f} ms, {1e3 * deepest:.0f} mm deep at most")
print(f"{'time [ms]':>10} {'nose tip [m]':>13} {'axis [deg]':>11} {'depth force [kN]':>17}")
for row in range(0, len(history["time"]), 50):
    axis_angle = math.degrees(history["axis_angle"][row])
    print(
        f"{1e3 * history['time'][row]:10.2f} {history['nose_tip_depth'][row]:13.3f} {axis_angle:11.2f} "
        f"{1e-3 * history['depth_force'][row]:17.1f}"
    )
side_view = Path("side_view.svg")
strike.plot(projectile).savefig(side_view)
print(f"wrote {side_view}")

# %% [markdown]
# ## The critical angle at several speeds, and its standard error
#
# The strength factors are those of the paper's Table 2, at four angles. The covariance of the polynomial fitted to them
# gives the critical angle a standard error. It does not include the effects that the warnings describe.

# %%
points = [
    ObliquityPoint(oblique_angle=math.radians(angle), strength_factor=factor)
    for angle, factor in ((0.0, 8.52), (15.0, 8.25), (30.0, 7.91), (45.0, 6.48))
]
calibrated = fit_obliquity(points=points).model
velocities = np.linspace(180.0, 340.0, 9)
answers = solver.critical_angle_many(
    projectile=projectile,
    target=target,
    velocity=velocities,
    resistance=Resistance(strength_factor=calibrated),
    threads=2,
)
table = solver.columns(answers)
angles, standard_errors = np.degrees(table["angle"]), np.degrees(table["standard_error"])
for velocity, status, angle, error in zip(velocities, table["status"], angles, standard_errors, strict=True):
    print(f"{velocity:.0f} m/s  {status}  {angle:.2f}° ± {error:.2f}°")
print("warnings:", ", ".join(sorted(set(" ".join(table["warnings"]).split()))))

# %% [markdown]
# ## The same as a plot

# %%
figure = Figure(figsize=(6.0, 4.0), layout="constrained")
axes = figure.subplots()
axes.errorbar(velocities, angles, standard_errors, fmt="o-", capsize=3.0)
axes.set(xlabel="velocity [m/s]", ylabel="critical angle from the normal [°]")
picture = Path("critical_angle.svg")
figure.savefig(picture)
print(f"wrote {picture}")
