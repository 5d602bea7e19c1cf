# %% [markdown]
# # One strike, from its motion to how sure its critical angle is
#
# A rigid projectile of 80 × 530 mm and 13 kg strikes concrete of 39 MPa. The cells (`# %%`) run one by one in any
# editor that knows them, or all at once: `.venv/bin/python examples/notebook.py`. It needs pandas and matplotlib.
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
# `columns()` gives arrays, `to_dataframe()` a table of pandas. Of polars: `polars.DataFrame(strike.columns())`.

# %%
strike = solver.simulate(
    projectile=projectile, target=target, impact=Impact(velocity=238.0, oblique_angle=math.radians(55.0))
)
history = strike.to_dataframe()
history["axis_angle_deg"] = np.degrees(history["axis_angle"])
print(f"{strike.outcome} after {1e3 * strike.final.time:.2f} ms, {1e3 * strike.maximum_depth:.0f} mm deep at most")
print(history[["nose_tip_depth", "axis_angle_deg", "depth_velocity", "depth_force"]].iloc[::50].round(3))
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
angles = solver.to_dataframe(answers)
angles["angle_deg"] = np.degrees(angles["angle"])
angles["standard_error_deg"] = np.degrees(angles["standard_error"])
print(angles[["velocity", "status", "angle_deg", "standard_error_deg"]].round(2))
print("mind:", ", ".join(sorted(set(" ".join(angles["warnings"]).split()))))

# %% [markdown]
# ## As a picture

# %%
figure = Figure(figsize=(6.0, 4.0), layout="constrained")
axes = figure.subplots()
axes.errorbar(angles["velocity"], angles["angle_deg"], angles["standard_error_deg"], fmt="o-", capsize=3.0)
axes.set(xlabel="velocity [m/s]", ylabel="critical angle from the normal [°]")
picture = Path("critical_angle.svg")
figure.savefig(picture)
print(f"wrote {picture}")
