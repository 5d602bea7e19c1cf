"""Why the closed form goes deeper than the trajectory model: how each lets the nose in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.reports import style
from service.reports.contents import Figure, Section, Table
from service.reports.validation.assessment import Assessment, percent
from service.reports.validation.predictions import CLOSED_FORM, POWER_LAW, TRAJECTORY, Strike
from service.reports.validation.ratios import MARKS, SERIES, agreement_1994
from solver import Projectile, solid_properties
from solver.arrays import FloatArray

FASTEST = 1300.0
"""End of the axis. [m/s]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CraterDifference:
    """Depth of the closed form less that of the trajectory model, over the counted tests of one nose and calibre."""

    diameter: float
    """[m]"""
    caliber_radius_head: float
    static: float
    """Without inertia, at every speed and strength. [m]"""
    strikes: Sequence[Strike]
    differences: FloatArray
    """Differences of each test. [m]"""

    @property
    def extent(self) -> str:
        """Least and most, for a text."""
        return f"{self.differences.min() * 1e3:.1f} to {self.differences.max() * 1e3:.1f} mm"


def static_difference(projectile: Projectile) -> float:
    """Depth of the closed form less that of the trajectory model if nothing but S f'c resisted. [m]

    Notes
    -----
    Full resistance on the area A from the face on would stop the projectile at m V² / (2 S f'c A). A crater two
    diameters deep that resists as a linear spring saves half of it, one diameter. The trajectory model loads what
    section of the nose is in the face, which saves the length of the nose less its volume over A.
    """
    nose = replace(projectile, length=projectile.nose_length, center_of_gravity=None)
    area = math.pi * projectile.radius**2
    return projectile.diameter - (projectile.nose_length - solid_properties(nose).volume / area)


def crater_differences(assessment: Assessment) -> Sequence[CraterDifference]:
    """Differences by calibre and nose, with the power law 82.6."""
    closed, ours = (assessment.predictions[method, POWER_LAW].depths for method in (CLOSED_FORM, TRAJECTORY))
    kinds: dict[tuple[float, float], list[int]] = {}
    for place in assessment.chosen():
        test = assessment.strikes[place].test
        kinds.setdefault((test.diameter, test.caliber_radius_head), []).append(place)
    return [
        CraterDifference(
            diameter=diameter,
            caliber_radius_head=caliber_radius_head,
            static=static_difference(assessment.strikes[places[0]].projectile),
            strikes=[assessment.strikes[place] for place in places],
            differences=(closed - ours)[places],
        )
        for (diameter, caliber_radius_head), places in sorted(kinds.items())
    ]


def crater_section(assessment: Assessment) -> Section:
    """Quantify the difference between the two ways to a depth."""
    differences = crater_differences(assessment)
    return Section(
        title="The closed form and the trajectory model",
        text=_text(assessment, differences),
        tables=(_table(differences),),
        figures=(_figure(differences),),
    )


def _text(assessment: Assessment, differences: Sequence[CraterDifference]) -> tuple[str, ...]:
    ours, closed = (agreement_1994(assessment, method) for method in (TRAJECTORY, CLOSED_FORM))
    (tested,) = (each for each in differences if each.strikes[0].test.series == SERIES)
    sharpest = max(differences, key=lambda each: each.caliber_radius_head)
    added = np.concatenate([each.differences / each.static - 1.0 for each in differences if each.static > 0.0])
    return (
        (
            f"On {SERIES} with S = {POWER_LAW} the trajectory model has a mean ratio of {ours.mean_ratio:.3f} and "
            f"a coefficient of variation of {ours.coefficient_of_variation:.3f}, the closed form "
            f"{closed.mean_ratio:.3f} and {closed.coefficient_of_variation:.3f}. Once the nose is in, both resist "
            "alike. They differ in how it gets in: the crater of the closed form, two diameters deep, resists as "
            "a linear spring, with half of the full force on average; the trajectory model resists in full from "
            "the tip on, on as much of the nose as is inside."
        ),
        (
            "Were there no inertia, the difference would be one diameter, which the crater saves, less what the "
            "gradual entry of the nose saves, its length less its volume over the area of the shank: a constant "
            "of the projectile, whatever the speed and the concrete. Inertia adds to it, since the crater leaves "
            f"a higher speed than the entry does: {percent(added.min())} at the slowest of the tests, "
            f"{percent(added.max())} at the fastest."
        ),
        (
            f"So the depths differ by nearly a constant, {tested.extent} in {SERIES}, where "
            f"{tested.static * 1e3:.1f} mm follow without inertia. Over these depths it is "
            f"{100.0 * (closed.mean_ratio - ours.mean_ratio):.1f} % on average, and more where the depth is small. "
            f"A nose of ψ {sharpest.caliber_radius_head:g} enters more gradually than two diameters of crater do; "
            f"there the closed form is the shallower, by {-sharpest.differences.max() * 1e3:.1f} to "
            f"{-sharpest.differences.min() * 1e3:.1f} mm."
        ),
        (
            "A strength factor belongs to the model that it was fitted with. Those fitted with the closed form "
            "make the trajectory model somewhat too shallow for most noses; its own, in the table above, are "
            "lower."
        ),
    )


def _table(differences: Sequence[CraterDifference]) -> Table:
    rows = [
        (
            each.diameter * 1e3,
            each.caliber_radius_head,
            len(each.strikes),
            each.static * 1e3,
            float(each.differences.mean()) * 1e3,
            float(each.differences.min()) * 1e3,
            float(each.differences.max()) * 1e3,
            float(each.differences.mean()) / each.diameter,
        )
        for each in differences
    ]
    columns = (
        "d [mm]",
        "ψ",
        "tests",
        "without inertia [mm]",
        "mean [mm]",
        "least [mm]",
        "most [mm]",
        "mean [diameters]",
    )
    caption = f"Depth of the closed form less that of the trajectory model, S = {POWER_LAW}."
    return Table(name="crater", caption=caption, columns=columns, rows=rows)


def _figure(differences: Sequence[CraterDifference]) -> Figure:
    figure, (axes,) = style.panels(1, height=4.0)
    data: dict[str, list[object]] = {
        name: [] for name in ("diameter_m", "caliber_radius_head", "row", "velocity_m_s", "difference_m", "static_m")
    }
    for each, color, mark in zip(differences, style.shades(len(differences)), MARKS, strict=False):
        velocities = [strike.test.velocity for strike in each.strikes]
        label = f"{each.diameter * 1e3:g} mm, ψ {each.caliber_radius_head:g}"
        axes.plot([0.0, FASTEST], [each.static / each.diameter] * 2, color=color, linewidth=1.0)
        axes.plot(velocities, each.differences / each.diameter, mark, color=color, markerfacecolor="none", label=label)
        for row in zip(velocities, each.differences.tolist(), each.strikes, strict=True):
            values = (each.diameter, each.caliber_radius_head, row[2].test.row, *row[:2], each.static)
            for name, value in zip(data, values, strict=True):
                data[name].append(value)
    axes.set(xlabel="striking velocity [m/s]", ylabel="closed form less trajectory [diameters]", xlim=(0.0, FASTEST))
    axes.legend(ncols=3, loc="center right")
    caption = (
        f"Depth of the closed form less that of the trajectory model over velocity, S = {POWER_LAW}. Lines: "
        "without inertia, where the nose alone sets it."
    )
    return Figure(name="crater", caption=caption, figure=figure, data=data)
