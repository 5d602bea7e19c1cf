"""The report of `make validate`: the order of its sections, the table of tests, and the limits of the model."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

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
from validation.evidence import evidence_section
from validation.never_fitted import never_fitted_section
from validation.report import Progress, ReportTable, Section
from validation.strength_law import strength_law_section
from validation.walls import walls_section

ALIKE = 0.05
"""Relative difference from the speed of the test left out, within which other tests are compared with it. [1]"""


def tests_section(assessment: Assessment) -> Section:
    """Return the section with all tests and their depths for S = 82.6 f'c^−0.544."""
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
    """Return the section on what the model predicts badly, and on what the tests do not show."""
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


TITLE = "Validation: depths of published tests"
INTRODUCTION = (
    "Normal impact of ogive-nosed steel projectiles on concrete, as measured by others, beside this model.",
    (
        "A ratio is **predicted over measured** depth: above 1 the prediction is too deep. The coefficient of "
        "variation is the sample standard deviation of the ratios, with n - 1, over their mean."
    ),
)
PARTS: Final[Mapping[str, Callable[[Assessment], Section]]] = {
    "evidence for what": lambda _: evidence_section(),
    "tests": tests_section,
    "predicted over measured depth": ratios_section,
    "what the model misses": limits_section,
    "strength factor over the literature": lambda _: strength_law_section(),
    "articles that no fit has seen": lambda _: never_fitted_section(),
    "closed form and trajectory model": crater_section,
    "walls": lambda _: walls_section(),
}
"""Functions that return the sections, by the name shown as progress, in the order of the page."""
COUNT: Final = len(PARTS)


def sections(progress: Progress) -> Iterator[Section]:
    """Compute all depths, then yield the sections one by one.

    Parameters
    ----------
    progress
        Called with the name of the next step.

    Yields
    ------
    Section
        Sections in their order in the report.
    """
    yield from parts(assess(progress), progress)


def parts(assessment: Assessment, progress: Progress) -> Iterator[Section]:
    """Yield the sections from the computed depths."""
    for what, section in PARTS.items():
        progress(what)
        yield section(assessment)
