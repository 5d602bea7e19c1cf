"""What the strength correlations miss, and what no test shows."""

import numpy as np

from service.reports.contents import Section, Table
from service.reports.validation.assessment import Assessment, of_diameter, of_group, of_series, percent
from service.reports.validation.predictions import (
    CLOSED_FORM,
    CONSTANT,
    FACTOR_MODELS,
    LEFT_OUT,
    METHODS,
    POWER_LAW,
    SQUARE_ROOT,
    TRAJECTORY,
    model_factors,
)
from solver.warnings import NO_MEASURED_ANGLE

LARGE_DIAMETER = 0.0762
"""Of the largest projectiles. [m]"""


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
    return Section(title="What the model misses, and what no test shows", text=text, tables=(_table(assessment),))


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
        f"come, are {' and '.join(small)}. The table has the strength factors that each group asks for: the large "
        "projectiles meet far less resistance than the strength alone says, most of all in the weak concrete. A "
        "correlation that does not know the size of the projectile does not carry over to another size."
    )


def _table(assessment: Assessment) -> Table:
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
    return Table(name="strength-factors", caption=caption, columns=columns, rows=rows)
