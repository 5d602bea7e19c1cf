# %% [markdown]
# # One strike, from its motion to how sure its critical angle is
#
# A rigid projectile of 80 × 530 mm and 13 kg strikes concrete of 39 MPa. The cells (`# %%`) run one by one in any
# editor that knows them, or all at once: `.venv/bin/python examples/notebook.py`. It needs what `make demo` installs.
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
# `columns()` gives arrays; with pandas, `to_dataframe()` a table. For polars: `polars.DataFrame(strike.columns())`.

# %%
strike = solver.simulate(
    projectile=projectile, target=target, impact=Impact(velocity=238.0, oblique_angle=math.radians(55.0))
)
history = strike.columns()
deepest = strike.maximum_depth or 0.0  # there is one, as nothing perforates thick concrete
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
# ## The critical angle over speed, and its standard error
#
# The strength factors are those of the paper's finite element runs at four angles. The polynomial through them has a
# covariance, which says how far the critical angle may be off. What the warnings say comes on top of that: no standard
# error knows what the model leaves out.

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
print("mind:", ", ".join(sorted(set(" ".join(table["warnings"]).split()))))

# %% [markdown]
# ## As a picture

# %%
figure = Figure(figsize=(6.0, 4.0), layout="constrained")
axes = figure.subplots()
axes.errorbar(velocities, angles, standard_errors, fmt="o-", capsize=3.0)
axes.set(xlabel="velocity [m/s]", ylabel="critical angle from the normal [°]")
picture = Path("critical_angle.svg")
figure.savefig(picture)
print(f"wrote {picture}")
