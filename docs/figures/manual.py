"""Draw the figures of the manual into docs/_figures, which is not committed. The build of the manual calls `draw_all`.

The page "The effect of each input on the angle" takes its numbers from `terms` too, so its figure and table agree.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle

from service.reports import style
from service.reports.style import silhouette
from solver import (
    ConstantStrengthFactor,
    Crater,
    ElasticPlastic,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    ObliquityPolynomial,
    Ogive,
    Projectile,
    PublishedTests,
    Resistance,
    Spherical,
    Target,
    critical_angle,
    critical_angle_many,
    decay_factor,
    flight_after,
    mass_properties,
    simulate,
)
from solver.resistance import EQUATION_9_COEFFICIENTS, HELD_FROM
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.uncertainty import RESIDUAL, Lognormal, Normal, Sampling, Uncertain, critical_angle_uncertainty

FOLDER = Path(__file__).parents[1] / "_figures"
VELOCITIES, STRENGTHS = np.linspace(200.0, 300.0, 7), np.linspace(30e6, 48e6, 6)
"""Values on the axes of the map of the critical angle. [m/s, Pa]"""
OBLIQUE_ANGLE, ATTACK = math.radians(44.0), math.radians(15.0)
"""Oblique angle and angle of attack in the drawing of the angles. A real angle of attack is much smaller. [rad]"""


@cache
def terms() -> dict[str, dict[str, float]]:
    """Return critical angles of the paper's strike with one input or law changed at a time, in groups. [°]"""
    properties = mass_properties(PAPER_PROJECTILE)
    inertia, center = properties.moment_of_inertia, properties.center_of_gravity

    def scaled(factor: float) -> Resistance:
        coefficients = tuple(factor * each for each in EQUATION_9_COEFFICIENTS)
        return Resistance(strength_factor=ObliquityPolynomial(coefficients=coefficients, held_from=HELD_FROM))

    projectile, target = PAPER_PROJECTILE, PAPER_TARGET
    groups: dict[str, dict[str, float]] = {
        "Decay near the face": {
            "elastic-plastic (default)": angle(),
            "with inertia of the concrete": angle(resistance=Resistance(free_surface=ElasticPlastic(inertia=True))),
            "Poisson's ratio 0.2, not 0.5": angle(target=replace(target, poissons_ratio=0.2)),
            "Mohr-Coulomb": angle(resistance=Resistance(free_surface=MohrCoulomb())),
            "none": angle(resistance=Resistance(free_surface=NoFreeSurface())),
        },
        "Resistance": {
            "S 10 % less": angle(resistance=scaled(0.9)),
            "S 10 % more": angle(resistance=scaled(1.1)),
            "S 8.52 at every angle": angle(resistance=Resistance(strength_factor=ConstantStrengthFactor(value=8.52))),
            "S of the published tests": angle(resistance=Resistance(strength_factor=PublishedTests())),
            "no inertia term, B = 0": angle(resistance=Resistance(inertia_factor=0.0)),
            "a crater of two diameters": angle(resistance=Resistance(crater=Crater())),
        },
        "Target": {
            "strength 10 % less, same S": angle(target=replace(target, compressive_strength=35.1e6)),
            "strength 10 % more, same S": angle(target=replace(target, compressive_strength=42.9e6)),
            "density 10 % more": angle(target=replace(target, density=2475.0)),
            "a wall of 0.2 m": angle(target=replace(target, thickness=0.2)),
        },
        "Projectile": {
            "mass 10 % more": angle(projectile=replace(projectile, mass=14.3)),
            "moment of inertia 10 % more": angle(projectile=replace(projectile, moment_of_inertia=1.1 * inertia)),
            "moment of inertia 10 % less": angle(projectile=replace(projectile, moment_of_inertia=0.9 * inertia)),
            "centre of gravity 10 mm further back": angle(
                projectile=replace(projectile, center_of_gravity=center + 0.01, moment_of_inertia=inertia)
            ),
            "blunter nose, ψ = 2": angle(projectile=replace(projectile, nose=Ogive(caliber_radius_head=2.0))),
            "more pointed nose, ψ = 4": angle(projectile=replace(projectile, nose=Ogive(caliber_radius_head=4.0))),
        },
        "Impact": {
            "10 % slower": angle(velocity=0.9 * PAPER_VELOCITY),
            "10 % faster": angle(velocity=1.1 * PAPER_VELOCITY),
            "angle of attack -1°": angle(angle_of_attack=math.radians(-1.0)),
            "angle of attack +1°": angle(angle_of_attack=math.radians(1.0)),
        },
        "What counts as turned away": {
            "0.1 % of the energy": angle(numerics=Numerics(retention_energy_fraction=0.001)),
            "10 % of the energy": angle(numerics=Numerics(retention_energy_fraction=0.1)),
        },
    }
    return groups


def angle(**changed: object) -> float:
    """Return the critical angle of the paper's strike with some arguments changed. [°]"""
    usual = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "velocity": PAPER_VELOCITY}
    found = critical_angle(**(usual | changed)).angle  # type: ignore[arg-type]
    return math.nan if found is None else math.degrees(found)


def angles(axes: Axes) -> None:
    """Draw the face, the normal, the velocity, the axis and the angles between them."""
    axis_angle = OBLIQUE_ANGLE + ATTACK
    body = silhouette(PAPER_PROJECTILE)
    lateral = -body[:, 0] * math.sin(axis_angle) + body[:, 1] * math.cos(axis_angle)
    depth = -body[:, 0] * math.cos(axis_angle) - body[:, 1] * math.sin(axis_angle)
    axes.axhspan(0.0, 0.3, color=style.CONCRETE, zorder=0)
    axes.axhline(0.0, color=style.FACE, linewidth=1.2)
    lift = float(depth.max())  # The deepest point touches the face.
    axes.fill(lateral, depth - lift, facecolor="#dbe4ef", edgecolor=style.MODEL, linewidth=1.3)
    center = mass_properties(PAPER_PROJECTILE).center_of_gravity
    x, y = -center * math.sin(axis_angle), -center * math.cos(axis_angle) - lift
    axes.plot([x], [y], "o", color=style.MODEL, markersize=5)
    rays = (
        (0.0, "inward normal", "#3c444c", 0.30, (-0.012, 0.0)),
        (OBLIQUE_ANGLE, "velocity of the centre of gravity", style.TEST, 0.34, (0.0, 0.022)),
        (axis_angle, "axis, tail to nose", style.MODEL, 0.44, (0.012, 0.0)),
    )
    for direction, label, color, length, shift in rays:
        end = (x + length * math.sin(direction), y + length * math.cos(direction))
        axes.annotate("", end, (x, y), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.3})
        side = "right" if direction == 0.0 else "left"
        axes.text(end[0] + shift[0], end[1] + shift[1], label, color=color, ha=side, va="center", fontsize=9)
    for label, begin, end_angle, radius in (
        ("θ", 0.0, OBLIQUE_ANGLE, 0.13),
        ("δ", OBLIQUE_ANGLE, axis_angle, 0.24),
        ("φ = θ + δ", 0.0, axis_angle, 0.19),
    ):
        # Depth is drawn downwards, so an angle from the normal is 90° minus it in the plane of the picture.
        low, high = 90.0 - math.degrees(end_angle), 90.0 - math.degrees(begin)
        axes.add_patch(Arc((x, y), 2 * radius, 2 * radius, theta1=low, theta2=high, color="#3c444c", linewidth=0.9))
        middle = 0.5 * (begin + end_angle)
        at = (x + (radius + 0.022) * math.sin(middle), y + (radius + 0.022) * math.cos(middle))
        if label.startswith("φ"):  # The labels of the other two arrows are near the middle.
            at = (x - 0.075, y + radius - 0.012)
        axes.text(*at, label, ha="center", va="center", fontsize=11)
    for end, label, at in (((0.41, 0.0), "y, lateral", (0.33, -0.016)), ((0.31, 0.1), "x, depth", (0.325, 0.085))):
        axes.annotate("", end, (0.31, 0.0), arrowprops={"arrowstyle": "-|>", "color": "#3c444c"})
        axes.text(*at, label, fontsize=9, va="bottom")
    axes.text(-0.6, 0.02, "impact face", fontsize=9, va="top", color=style.FACE)
    axes.text(-0.6, 0.16, "target", fontsize=9, va="top", color=style.FACE)
    axes.set(xlim=(-0.62, 0.48), ylim=(0.2, -0.42), aspect="equal")
    axes.axis("off")


def decay(axes: Axes) -> None:
    """Draw the decay functions against the radius ratio k, which grows with the distance from the face."""
    ratios = np.geomspace(1.0, 50.0, 200)
    for law, label in (
        (ElasticPlastic(), "elastic-plastic (default)"),
        (MohrCoulomb(), "Mohr-Coulomb"),
        (NoFreeSurface(), "none"),
    ):
        axes.plot(ratios, decay_factor(model=law, target=PAPER_TARGET, radius_ratio=ratios), label=label)
    axes.set(xscale="log", xlabel="$k = r_d / r_a$ [1]", ylabel="f [1]", xlim=(1.0, 50.0), ylim=(0.0, 1.05))
    axes.set_xticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    axes.legend(loc="lower right")


def terms_bars(axes: Axes) -> None:
    """Draw the change of the critical angle for each change of an input or law."""
    labels, values = [], []
    for group in terms().values():
        for label, value in group.items():
            labels.append(label)
            values.append(value)
    usual = values[0]
    places = np.arange(len(values))
    changes = np.array(values) - usual
    axes.barh(places, changes, color=np.where(changes < 0.0, style.TEST, style.MODEL), height=0.7)
    axes.axvline(0.0, color="#3c444c", linewidth=0.8)
    axes.set_yticks(places, labels)
    axes.invert_yaxis()
    axes.set_xlabel(f"change of the critical angle of {usual:.1f}° [°]")


def energy_left(axes: Axes) -> None:
    """Draw, over the oblique angle, the energy with which the paper's projectile leaves."""
    degrees = np.arange(47.0, 60.01, 0.25)
    shares = []
    for oblique in degrees:
        run = simulate(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=paper_impact(oblique_angle_degrees=float(oblique)),
            numerics=Numerics(retention_energy_fraction=1e-4),
            sample_interval=None,
        )
        energy = 0.5 * PAPER_PROJECTILE.mass * PAPER_VELOCITY**2
        shares.append(run.exit.kinetic_energy / energy if run.exit else math.nan)
    axes.plot(degrees, 100.0 * np.array(shares), color=style.MODEL)
    axes.axhline(1.0, color=style.TEST, linewidth=1.0, linestyle="--", label="retention threshold, 1 %")
    axes.set(yscale="log", xlabel="oblique angle from the normal [°]", ylabel="kinetic energy left [%]")
    axes.legend(loc="lower right")


def angle_map(axes: Axes) -> None:
    """Draw a map of the critical angle over speed and strength."""
    grid = [(velocity, strength) for strength in STRENGTHS for velocity in VELOCITIES]
    answers = critical_angle_many(
        projectile=PAPER_PROJECTILE,
        target=[replace(PAPER_TARGET, compressive_strength=float(strength)) for _, strength in grid],
        velocity=np.array([velocity for velocity, _ in grid]),
        threads=2,
    )
    found = [math.degrees(getattr(answer, "angle", None) or math.nan) for answer in answers]
    shown = np.array(found).reshape(len(STRENGTHS), len(VELOCITIES))
    mesh = axes.pcolormesh(VELOCITIES, STRENGTHS / 1e6, shown, shading="gouraud", cmap="viridis")
    lines = axes.contour(VELOCITIES, STRENGTHS / 1e6, shown, colors="white", linewidths=0.8)
    axes.clabel(lines, fmt="%g°")
    axes.grid(visible=False)
    axes.set(xlabel="impact speed [m/s]", ylabel="compressive strength [MPa]")
    axes.figure.colorbar(mesh, ax=axes, label="critical angle from the normal [°]")


def probability(axes: Axes) -> None:
    """Draw the probability of ricochet of the paper's strike, with the distributions of docs/how-to/uncertainty.md."""
    answer = critical_angle_uncertainty(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=PAPER_VELOCITY,
        uncertain=[
            Uncertain("impact.velocity", Normal(mean=PAPER_VELOCITY, coefficient_of_variation=0.01)),
            Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=0.1)),
            Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.1)),
            Uncertain("impact.angle_of_attack", Normal(mean=0.0, standard_deviation=math.radians(1.0))),
        ],
        sampling=Sampling(half_width=0.1, max_samples=256),
        sensitivity=False,
        threads=2,
    )
    degrees = np.degrees(answer.oblique_angles)
    axes.fill_between(degrees, 100.0 * answer.lower, 100.0 * answer.upper, color=style.MODEL, alpha=0.2, linewidth=0)
    axes.plot(degrees, 100.0 * answer.probability, color=style.MODEL)
    axes.set(xlabel="oblique angle from the normal [°]", ylabel="probability of ricochet [%]", xlim=(40.0, 60.0))


def histories(axes: Axes) -> None:
    """Draw the axis angle against time, for two oblique angles below the critical angle and two above it."""
    for degrees in (45.0, 48.0, 49.0, 55.0):
        impact: Impact = paper_impact(oblique_angle_degrees=degrees)
        motion = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact).history
        assert motion is not None  # noqa: S101
        axes.plot(1e3 * motion.time, np.degrees(motion.axis_angle), label=f"θ = {degrees:g}°")
    axes.axhline(90.0, color="#5c6670", linewidth=0.8, linestyle="--")
    axes.set(xlabel="time since first contact [ms]", ylabel="axis angle φ [°]", xlim=(0.0, 6.0))
    axes.legend(loc="lower right")


def danger_zone(axes: Axes) -> None:
    """Draw a plan of the tutorial fragment's flight, with circles at its farthest range and its range without drag."""
    fragment = Projectile(nose=Spherical(caliber_radius_head=0.5), diameter=0.04, length=0.08, mass=0.65)
    slab = Target(compressive_strength=38e6, density=2400.0)
    impact = Impact(velocity=250.0, oblique_angle=math.radians(70.0))
    resistance = Resistance(strength_factor=PublishedTests())
    left = simulate(projectile=fragment, target=slab, impact=impact, resistance=resistance, sample_interval=None).exit
    assert left is not None, "the fragment of the tutorial has to be turned away"  # noqa: S101
    landed = flight_after(left, projectile=fragment)
    for distance, line, words in (
        (landed.farthest_range, "-", "farthest at any elevation"),
        (landed.range_without_drag, "--", "without drag"),
    ):
        axes.add_patch(Circle((0.0, 0.0), distance, fill=False, linestyle=line))
        text = f"{words}: {distance:,.0f} m"
        axes.annotate(text, (0.0, distance), xytext=(0.0, 3.0), textcoords="offset points", ha="center")
    axes.annotate("", (landed.range, 0.0), (0.0, 0.0), arrowprops={"arrowstyle": "->"})
    axes.annotate(f"as computed: {landed.range:,.0f} m", (0.0, 0.0), xytext=(0.0, -12.0), textcoords="offset points")
    reach = 1.1 * landed.range_without_drag
    axes.set(
        xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="along the face [m]", ylabel="across [m]"
    )


FIGURES: dict[str, tuple[Callable[[Axes], None], tuple[float, float]]] = {
    "angles": (angles, (7.0, 4.2)),
    "decay": (decay, (6.0, 3.4)),
    "terms": (terms_bars, (7.0, 6.4)),
    "energy-left": (energy_left, (6.0, 3.2)),
    "map": (angle_map, (6.0, 3.8)),
    "probability": (probability, (6.0, 3.2)),
    "histories": (histories, (6.0, 3.4)),
    "danger-zone": (danger_zone, (5.0, 5.0)),
}


def draw_all() -> None:
    """Draw the figures that are missing, or older than a file of the solver or this file."""
    FOLDER.mkdir(exist_ok=True)
    sources = [Path(__file__), *(Path(__file__).parents[2] / "solver").rglob("*.py")]
    newest = max(source.stat().st_mtime for source in sources)
    for name, (draw, size) in FIGURES.items():
        path = FOLDER / f"{name}.svg"
        if path.exists() and path.stat().st_mtime > newest:
            continue
        with style.styled():
            figure = Figure(figsize=size, layout="constrained")
            draw(figure.subplots())
            figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    draw_all()
