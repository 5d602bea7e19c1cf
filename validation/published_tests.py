"""The report of `make validate`: its tests one by one, its limits, the walls, and the order of its sections."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

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
from solver.warnings import NO_MEASURED_ANGLE
from validation.depth_ratios import crater_section, ratios_section
from validation.depth_tests import (
    CLOSED_FORM,
    CONSTANT,
    FACTOR_MODELS,
    LEFT_OUT,
    LIKELY_VELOCITY,
    METHODS,
    OUTLIER_ROW,
    POWER_LAW,
    SQUARE_ROOT,
    STEEL_DENSITY,
    TRAJECTORY,
    Assessment,
    assess,
    crater_depth,
    model_factors,
    of_diameter,
    of_group,
    of_series,
    percent,
)
from validation.report import Progress, ReportTable, Section, paragraphs
from validation.strength_law import strength_law_section

ALIKE = 0.05
"""Speeds that differ by less are compared directly. [1]"""


def tests_section(assessment: Assessment) -> Section:
    """All tests and the depths that one correlation gives them."""
    strikes = assessment.strikes
    counted = [strike for strike in strikes if strike.counted]
    flagged = sum(bool(strike.flags) for strike in counted)
    assumed = sorted(strike.projectile.length for strike in strikes if strike.test.length is None)
    text = (
        (
            f"{len(strikes)} tests in {len(assessment.series)} series, {len(counted)} of them counted. They come "
            "from a third party's transcription of the articles; `SOURCES.md` beside the data names both."
        ),
        _outlier_text(assessment),
        (
            f"The length of {len(assumed)} projectiles is not known. Depth in normal impact does not depend on it: "
            "nothing but the nose is loaded, and the mass is given. They are taken as solid steel of "
            f"{STEEL_DENSITY:g} kg/m³, which makes them {assumed[0] * 1e3:.0f} to {assumed[-1] * 1e3:.0f} mm long."
        ),
        (
            f"Flags are the model's own warnings, on {flagged} of the counted tests: `velocity_beyond_rigid`, "
            "where noses of steel erode, and `strength_beyond_tests`, outside the concretes behind the resistance "
            "law. Flagged tests are counted."
        ),
    )
    return Section(title="The tests", text=text, tables=(_tests_table(assessment),))


def _outlier_text(assessment: Assessment) -> str:
    strikes = assessment.strikes
    (outlier,) = (strike for strike in strikes if not strike.counted)
    ratios = assessment.ratios(CLOSED_FORM, POWER_LAW)
    place = strikes.index(outlier)
    factor = float(assessment.predictions[CLOSED_FORM, POWER_LAW].factors[place])
    peers = [
        strike.test
        for strike in strikes
        if strike.counted
        and strike.group == outlier.group
        and abs(strike.test.velocity / outlier.test.velocity - 1.0) < ALIKE
    ]
    went = " and ".join(f"{peer.depth:g} m at {peer.velocity:g} m/s" for peer in peers)
    mean = assessment.agreement(CLOSED_FORM, POWER_LAW, of_group(outlier.group)).mean_ratio
    likely = (
        crater_depth(replace(outlier, test=replace(outlier.test, velocity=LIKELY_VELOCITY)), factor)
        / outlier.test.depth
    )
    lowest = min(assessment.chosen(of_group(outlier.group)), key=lambda each: float(ratios[each]))
    return (
        f"**Row {OUTLIER_ROW} of {outlier.test.series} is left out of every fit and statistic**: "
        f"{outlier.test.depth:g} m at {outlier.test.velocity:g} m/s, where the same projectile in the same grade "
        f"of concrete went {went}. The closed form with S = {POWER_LAW} gives {ratios[place]:.2f} of its depth, "
        f"against {mean:.2f} on average for the others; at {LIKELY_VELOCITY:g} m/s, of which it may be a slip, it "
        f"would give {likely:.2f}. The next in line, row {strikes[lowest].test.row} with {ratios[lowest]:.2f}, is "
        "counted."
    )


def _tests_table(assessment: Assessment) -> ReportTable:
    columns: tuple[str, ...] = ("series", "row", "d [mm]", "ψ", "f'c [MPa]", "v [m/s]", "depth [m]")
    columns += ("trajectory [m]", "ratio", "closed form [m]", "its ratio", "flags")
    rows = []
    for place, strike in enumerate(assessment.strikes):
        test = strike.test
        flags = [warning.code for warning in strike.flags] + ([] if strike.counted else ["left_out"])
        predicted = [
            (float(assessment.predictions[method, POWER_LAW].depths[place]), float(ratios[place]))
            for method in METHODS
            for ratios in [assessment.ratios(method, POWER_LAW)]
        ]
        rows.append(
            (
                *(test.series, test.row, test.diameter * 1e3, test.caliber_radius_head),
                *(test.compressive_strength / 1e6, test.velocity, test.depth),
                *(round(value, 3) for pair in predicted for value in pair),
                ", ".join(f"`{flag}`" for flag in flags),
            )
        )
    caption = f"Measured depth of every test, the depths by S = {POWER_LAW}, and the ratios of these to it."
    return ReportTable(name="tests", caption=caption, columns=columns, rows=rows)


LARGE_DIAMETER = 0.0762
"""Diameter of the largest projectiles. [m]"""


def limits_section(assessment: Assessment) -> Section:
    """Where the model misses, and by how much."""
    known = assessment.agreement(TRAJECTORY, LEFT_OUT)
    constant = assessment.agreement(TRAJECTORY, CONSTANT, of_diameter(LARGE_DIAMETER))
    spread = [assessment.agreement(TRAJECTORY, CONSTANT, of_group(group)).mean_ratio for group in assessment.groups]
    text = (
        _large_projectiles(assessment),
        (
            f"With S known from other tests of the same series and grade, the mean ratio of all {known.number} "
            f"tests is {known.mean_ratio:.2f} and the coefficient of variation "
            f"{known.coefficient_of_variation:.2f}. One constant, fitted to the concrete and the size in question, "
            "carries the depth: fit it (`ricochet calibrate depth`) before relying on one."
        ),
        (
            f"The constant of the paper is made for one concrete. It gives the {LARGE_DIAMETER * 1e3:.1f} mm "
            f"projectiles {constant.mean_ratio:.2f} of their depth on average, and by group of the table below "
            f"{min(spread):.2f} to {max(spread):.2f}: it is no law over strength."
        ),
        (
            "**Depth is all that these tests show.** "
            f"{NO_MEASURED_ANGLE.detail[0].upper()}{NO_MEASURED_ANGLE.detail[1:]}. Whether a projectile is turned "
            "away is decided by the decay near the face and by the load on the shank, and normal impact shows "
            "nothing of either."
        ),
    )
    return Section(
        title="What the model misses, and what no test shows", text=text, tables=(_limits_table(assessment),)
    )


def _large_projectiles(assessment: Assessment) -> str:
    large = [strike for strike in assessment.strikes if strike.test.diameter == LARGE_DIAMETER]
    missed = [
        f"in {series} by {percent(short[0])} ({percent(short[1])})"
        for series in assessment.series
        if any(strike.test.series == series for strike in large)
        for short in [
            [1.0 - assessment.agreement(method, POWER_LAW, of_series(series)).mean_ratio for method in METHODS]
        ]
    ]
    small = [
        f"{series} {assessment.agreement(TRAJECTORY, POWER_LAW, of_series(series)).mean_ratio:.2f}"
        for series in assessment.series
        if all(strike.test.series != series for strike in large)
    ]
    closed = assessment.agreement(CLOSED_FORM, POWER_LAW, of_diameter(LARGE_DIAMETER))
    return (
        f"**The strength correlations miss the {LARGE_DIAMETER * 1e3:.1f} mm projectiles by a third and more.** "
        f"With S = {POWER_LAW} the trajectory model (the closed form) is too shallow {' and '.join(missed)}; over "
        f"all {closed.number} of these tests the closed form by {percent(1.0 - closed.mean_ratio)}. S = "
        f"{SQUARE_ROOT} does no better. The mean ratios of the smaller projectiles, from which the correlations "
        f"come, are {' and '.join(small)}. The table has the strength factors that fit each group: the large "
        "projectiles meet far less resistance than the strength alone says, most of all in the weak concrete. A "
        "correlation that does not know the size of the projectile does not carry over to another size."
    )


def _limits_table(assessment: Assessment) -> ReportTable:
    laws = {name: model_factors(assessment.strikes, FACTOR_MODELS[name]) for name in (POWER_LAW, SQUARE_ROOT)}
    rows = []
    for group in assessment.groups:
        places = assessment.chosen(of_group(group))
        diameters = sorted({assessment.strikes[place].test.diameter * 1e3 for place in places})
        left_out = assessment.predictions[TRAJECTORY, LEFT_OUT].factors[places]
        rows.append(
            (
                group,
                len(places),
                " and ".join(f"{diameter:g}" for diameter in diameters),
                *(assessment.group_factors[method, group] for method in METHODS),
                f"{left_out.min():.2f} to {left_out.max():.2f}",
                *(float(np.mean(law[places])) for law in laws.values()),
            )
        )
    columns = ["series and concrete", "tests", "d [mm]", "trajectory model", "closed form"]
    columns += ["leaving one out", *(f"{name}, mean" for name in laws)]
    caption = (
        "Strength factors fitted by least squares in depth to all counted tests of a group, beside the correlations."
    )
    return ReportTable(name="strength-factors", caption=caption, columns=columns, rows=rows)


MODELS: Final[Mapping[str, Resistance]] = {
    "decay at the rear face (default)": Resistance(),
    "and a plug": Resistance(rear_plug=ShearPlug()),
    "and a plug and a crater": Resistance(rear_plug=ShearPlug(), crater=Crater()),
}
ANGLES_DEG = (0.0, 30.0)
SLAB, SLAB_SHOT = 0.178, Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.0254, length=0.144, mass=0.5)
SLAB_STRENGTHS = (48e6, 140e6)
SLAB_SLOWEST = 300.0
"""Least impact speed with a measured residual speed, by the abstract. [m/s]"""


def walls_section(_: Assessment) -> Section:
    """Compare thicknesses and limit speeds of both models of the rear face with the formulas and with tests."""
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
        title="Walls: both models of the rear face, and the formulas",
        text=paragraphs(text),
        tables=(thicknesses, speeds),
    )


def _thickness_table() -> ReportTable:
    """Least thicknesses of the paper's strike."""
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


def _speed_table() -> ReportTable:
    """Limit speeds of the slabs of Hanchak et al."""
    walls = [Target(compressive_strength=strength, density=2400.0, thickness=SLAB) for strength in SLAB_STRENGTHS]
    rows: list[tuple[object, ...]] = []
    for name, resistance in MODELS.items():
        law = replace(resistance, strength_factor=PublishedTests())
        found = [
            limit_velocity(projectile=SLAB_SHOT, target=wall, oblique_angle=0.0, resistance=law).value for wall in walls
        ]
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


TITLE = "Validation: depths of published tests"
INTRODUCTION = (
    "Normal impact of ogive-nosed steel projectiles on concrete, as measured by others, beside this model.",
    (
        "A ratio is **predicted over measured** depth: above 1 the prediction is too deep. The coefficient of "
        "variation is the sample standard deviation of the ratios, with n - 1, over their mean."
    ),
)
PARTS: Final[Mapping[str, Callable[[Assessment], Section]]] = {
    "tests": tests_section,
    "predicted over measured depth": ratios_section,
    "what the model misses": limits_section,
    "strength factor over the literature": lambda _: strength_law_section(),
    "closed form and trajectory model": crater_section,
    "walls": walls_section,
}
"""In the order of the page."""
COUNT: Final = len(PARTS)


def sections(progress: Progress) -> Iterator[Section]:
    """Compute and write the sections one by one.

    Parameters
    ----------
    progress
        Called with what comes next.

    Yields
    ------
    Section
        Sections in their order in the report.
    """
    yield from parts(assess(progress), progress)


def parts(assessment: Assessment, progress: Progress) -> Iterator[Section]:
    """Sections from the computed depths."""
    for what, section in PARTS.items():
        progress(what)
        yield section(assessment)
