"""The tests: what was measured, what is left out, and what the model warns of."""

from dataclasses import replace

from service.reports.contents import Section, Table
from service.reports.validation.assessment import Assessment, of_group
from service.reports.validation.predictions import CLOSED_FORM, METHODS, POWER_LAW, crater_depth
from service.reports.validation.strikes import LIKELY_VELOCITY, OUTLIER_ROW, STEEL_DENSITY

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
    return Section(title="The tests", text=text, tables=(_table(assessment),))


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


def _table(assessment: Assessment) -> Table:
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
    return Table(name="tests", caption=caption, columns=columns, rows=rows)
