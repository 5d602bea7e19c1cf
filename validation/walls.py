"""Walls: least thickness and limit speed by each model of the faces and by formulas, compared with tests."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from solver import (
    Crater,
    Impact,
    Ogive,
    Projectile,
    PublishedTests,
    Resistance,
    ShearPlug,
    Target,
    cea_edf_limit_speed,
    formulas,
    least_thickness,
    limit_velocity,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from validation.report import ReportTable, Section, paragraphs

MODELS: Final[Mapping[str, Resistance]] = {
    "decay at the rear face (default)": Resistance(),
    "and a plug": Resistance(rear_plug=ShearPlug()),
    "and a plug and a crater": Resistance(rear_plug=ShearPlug(), crater=Crater()),
}
ANGLES_DEG = (0.0, 30.0)
SLAB, SLAB_SHOT = 0.178, Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.0254, length=0.144, mass=0.5)
SLAB_STRENGTHS = (48e6, 140e6)
SLAB_SLOWEST = 300.0
"""Lowest impact speed with a measured residual speed, according to the abstract. [m/s]"""


def walls_section() -> Section:
    """Return the section that compares the models of the faces with formulas and with tests."""
    thicknesses, speeds = _thickness_table(), _speed_table()
    model, plugged, both = (row[1] for row in thicknesses.rows[: len(MODELS)])
    required = sorted(
        float(str(row[1])) for row in thicknesses.rows[len(MODELS) :] if row[1] != "" and row[-1] == "in range"
    )
    slow, plug_slow, both_slow = (row[1] for row in speeds.rows[: len(MODELS)])
    text = f"""
        Least thickness of the paper's strike at normal impact: {model} mm by the default, {plugged} mm with a plug that
        shears out of the rear, {both} mm with a front crater as well. The formulas within their range require
        {required[0]:g} to {required[-1]:g} mm.

        Hanchak, Forrestal, Young and Ehrgott (1992) shot projectiles of {SLAB_SHOT.diameter * 1e3:g} mm and
        {SLAB_SHOT.mass:g} kg through reinforced slabs {SLAB * 1e3:g} mm thick. Their abstract, which is all of it that
        is open, has residual speeds for impacts from {SLAB_SLOWEST:g} m/s on: in either concrete the limit speed is no
        higher than about that. With S of the published tests the default says {slow} m/s for the weaker concrete,
        {plug_slow} m/s with a plug, {both_slow} m/s with a crater as well.
    """
    return Section(
        title="Walls: the models of the rear face, and the formulas",
        text=paragraphs(text),
        tables=(thicknesses, speeds),
    )


def _thickness_table() -> ReportTable:
    impacts = [Impact(velocity=PAPER_VELOCITY, oblique_angle=math.radians(angle)) for angle in ANGLES_DEG]
    case: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
    rows: list[tuple[object, ...]] = []
    for name, resistance in MODELS.items():
        found = [least_thickness(**case, impact=impact, resistance=resistance).value for impact in impacts]
        rows.append((name, *(_millimetres(each) for each in found), "model", ""))
    for results in zip(*(formulas(**case, impact=impact) for impact in impacts), strict=True):
        first = results[0]
        limits = [_millimetres(each.perforation_thickness) for each in results]
        outside = ", ".join(sorted({each.field for result in results for each in result.out_of_range}))
        source = f"{first.source}{'' if first.verified else ' (not compared with the original)'}"
        source += f"; {first.note}" if first.note else ""
        known = "in range" if first.range_known else "range not known"
        rows.append((first.formula, *limits, source, f"out of range: {outside}" if outside else known))
    angles = [f"at {angle:g}° [mm]" for angle in ANGLES_DEG]
    caption = (
        "Least thickness that is not perforated by the paper's strike; formulas have no angle and take, as is common "
        "practice, the normal part of the speed."
    )
    return ReportTable(name="walls", caption=caption, columns=("by", *angles, "source", "range"), rows=rows)


def slab(strength: float) -> Target:
    """Return the slab of Hanchak et al. for one of the tested concrete strengths. [Pa]"""
    return Target(compressive_strength=strength, density=2400.0, thickness=SLAB)


def slab_limit_speed(resistance: Resistance, strength: float) -> float | None:
    """Return the limit speed of the slab of Hanchak et al. in normal impact, with S of the published tests. [m/s]"""
    law = replace(resistance, strength_factor=PublishedTests())
    return limit_velocity(projectile=SLAB_SHOT, target=slab(strength), oblique_angle=0.0, resistance=law).value


def _speed_table() -> ReportTable:
    walls = [slab(strength) for strength in SLAB_STRENGTHS]
    rows: list[tuple[object, ...]] = []
    for name, resistance in MODELS.items():
        found = [slab_limit_speed(resistance, strength) for strength in SLAB_STRENGTHS]
        rows.append((name, *("" if each is None else round(each) for each in found)))
    by_formula = [cea_edf_limit_speed(projectile=SLAB_SHOT, target=wall, thickness=SLAB) for wall in walls]
    name = "cea_edf" if all(each.in_range for each in by_formula) else "cea_edf, out of range"
    rows.append((name, *("" if each.limit_speed is None else round(each.limit_speed) for each in by_formula)))
    rows.append(("tests, slowest with a residual speed", *(f"≤ {SLAB_SLOWEST:g}" for _ in walls)))
    strengths = [f"{strength / 1e6:g} MPa [m/s]" for strength in SLAB_STRENGTHS]
    caption = f"Limit speeds of slabs {SLAB * 1e3:g} mm thick at normal impact, S of `published_tests`."
    return ReportTable(name="slabs", caption=caption, columns=("by", *strengths), rows=rows)


def _millimetres(value: float | None) -> object:
    return "" if value is None else round(1e3 * value, 1)
