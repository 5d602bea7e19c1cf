"""Tests with spheres by Erkander and Pettersson, compared with the model and the formulas."""

import pytest

from validation.spheres import (
    CRATERED,
    DEPTHS,
    LAW,
    SCABBED,
    SCABBED_SLAB,
    VELOCITIES,
    WEAK,
    formula_speeds,
    model_depth,
    needed_speeds,
    wall_speeds,
)


@pytest.mark.parametrize("strength", DEPTHS)
def test_speeds_for_the_printed_depths_are_within_the_series_to_three_percent(strength: float) -> None:
    """In the strong concrete the model needs speeds at the upper end of the series, and lower ones with a crater."""
    slow, fast = VELOCITIES
    assert model_depth(strength, slow, LAW) < min(DEPTHS[strength])
    for needed, cratered in zip(needed_speeds(strength, LAW), needed_speeds(strength, CRATERED), strict=True):
        assert slow < cratered < 0.8 * needed
        assert needed < 1.03 * fast


def test_scabbing_by_ndrc_begins_just_below_the_tests() -> None:
    speeds = formula_speeds(WEAK, SCABBED_SLAB, "scabbing_thickness")
    assert speeds["modified_ndrc"] == pytest.approx(844.0, abs=0.5)
    assert all(speed < SCABBED[0] for speed in speeds.values())


def test_model_overestimates_thin_slabs_compared_with_the_formulas() -> None:
    alone, plug, both = (speed or 0.0 for speed in wall_speeds(WEAK).values())
    assert alone > plug > both
    assert plug > max(formula_speeds(WEAK, 0.07, "perforation_thickness").values())
