"""An external check of the law of S, with articles that were not used in any fit."""

import math
from collections.abc import Collection
from functools import cache
from typing import Final

import numpy as np

from solver import PublishedTests
from solver.resistance import NORMAL_QUANTILE
from validation.depth_tests import percent
from validation.reference import DepthShot, depth_shots, never_fitted_shots
from validation.report import ReportTable, Section, paragraphs
from validation.strength_law import (
    CHOSEN,
    Coverage,
    SeriesScatter,
    UnseenSeries,
    chosen_law,
    coverage,
    design,
    in_series,
    logarithms,
    reason_left_out,
)

PROGRAMME: Final = frozenset({29, 30, 64})
"""Articles about one test programme. Some of their rows are repeated, and its 12.7 mm bodies weigh a third of solid
steel bodies of the stated size, so one of these numbers is probably wrong."""
LAW: Final = SeriesScatter(between=PublishedTests.between_series, within=PublishedTests.within_series)


def counted_rows(without: Collection[int] = ()) -> tuple[DepthShot, ...]:
    """Return the rows to which a law for rigid bodies applies, without those of the articles in `without`.

    Three rows of article 43 are left out because they repeat shots of article 40, to which the law was fitted.
    """
    fitted = {_numbers(shot) for shot in depth_shots()}
    return tuple(
        shot
        for shot in never_fitted_shots()
        if reason_left_out(shot) is None and _numbers(shot) not in fitted and shot.article not in without
    )


def _numbers(shot: DepthShot) -> tuple[float, ...]:
    """Return the numbers that are equal if two articles list the same shot."""
    return shot.mass, shot.velocity, shot.depth, shot.compressive_strength


def check(without: Collection[int] = ()) -> tuple[Coverage, ...]:
    """Return the coverage of the solver's law after no, one and two shots of a series, without some articles."""
    found = [UnseenSeries(misses=misses, scatter=LAW) for misses in series_misses(without)]
    return tuple(coverage(found, count) for count in range(3))


def series_misses(without: Collection[int] = ()) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the residuals of ln S, measured minus the law of the solver, for the shots of each series. [1]"""
    shots, law = counted_rows(without), PublishedTests.law
    exponents = (math.log(law.coefficient), law.exponent, law.diameter_exponent)
    misses = logarithms(shots) - design(shots, CHOSEN) @ np.array(exponents)
    return in_series(misses, [shot.series for shot in shots])


@cache
def normal_half_width() -> float:
    """Return the half width of the 90 % interval of a series without shots, by the normal mixed model. [ln]"""
    law = chosen_law()
    return NORMAL_QUANTILE * math.hypot(law.between, law.within)


def never_fitted_section() -> Section:
    """Return the section on how often the intervals contain shots of articles that were not used in any fit."""
    rows, lines = [], ["Shots of articles that no fit has seen, in their 90 % interval of S, mean of series:"]
    for name, without in (("all", ()), ("without articles 29, 30 and 64", PROGRAMME)):
        for each in check(without):
            shares = (each.covered, each.covered_shots, each.half_width)
            rows.append((name, each.shots_given, each.series, *(round(value, 3) for value in shares)))
            lines.append(
                f"  {name}, after {each.shots_given} own shots: {each.covered:.2f} of {each.series} series, "
                f"half width {each.half_width:.2f} in ln S"
            )
    shots, (none, one, _) = counted_rows(), check()
    growth = none.half_width / normal_half_width() - 1.0
    lines.append(f"  without own shots {percent(growth)} wider than a normal distribution with the same data")
    text = f"""
        {len(shots)} rows of {len({shot.article for shot in shots})} further articles of the compilation may be used
        by the same rule, {none.series} series. No fit has seen them. {percent(none.covered)} of the shots of a series
        lie in the 90 % interval of `published_tests` without shots into the concrete, and {percent(one.covered)} of
        the others after one. Articles 29, 30 and 64 are one programme with partly repeated rows, in which some number
        is probably wrong.

        The interval without shots has a half width of {none.half_width:.2f} in ln S, {percent(growth)} more than that
        of a normal distribution with the same data, {normal_half_width():.2f}.
    """
    columns = ("articles", "own shots", "series", "covered, mean of series", "covered, of all shots", "half width")
    caption = "Shots of articles that no fit has seen in their 90 % interval of S."
    return Section(
        title="Strength factor: articles that no fit has seen",
        text=paragraphs(text),
        tables=(ReportTable(name="never-fitted-coverage", caption=caption, columns=columns, rows=rows),),
        summary="\n".join(lines),
    )
