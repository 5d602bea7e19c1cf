"""Find quantities in texts, to compare a text in US customary units with the same text in SI units."""

import re

import pytest

from solver.units import FOOT, INCH, POUND, PSI

SI_SIZES = {
    "mm": 1e-3,
    "m": 1.0,
    "m/s": 1.0,
    "kg": 1.0,
    "Pa": 1.0,
    "MPa": 1e6,
    "GPa": 1e9,
    "kg/m³": 1.0,
    "kg m²": 1.0,
}
US_SIZES = {
    "in": INCH,
    "ft": FOOT,
    "ft/s": FOOT,
    "lb": POUND,
    "psi": PSI,
    "ksi": 1e3 * PSI,
    "lb/ft³": POUND / FOOT**3,
    "lb ft²": POUND * FOOT**2,
}
"""Size of each US customary unit, in SI units."""
STEP = {"in": 0.13 * INCH, "mm": 1.01e-3}
"""Largest rounding error of a length given in each unit. [m]"""
NUMBER = r"\d[\d,]*(?:\.\d+)?"


def pattern(units: dict[str, float]) -> re.Pattern[str]:
    names = "|".join(map(re.escape, sorted(units, key=len, reverse=True)))
    return re.compile(rf"(?:({NUMBER}) to )?({NUMBER})[ \N{{NO-BREAK SPACE}}]({names})(?![\w²³/])")


SI, US = pattern(SI_SIZES), pattern(US_SIZES)
"""Patterns of a quantity, or of a range whose limits share a unit."""
HEAD_IN_SI = re.compile(r"\[(?:mm|m|m/s|kg|[MG]?Pa)\]")


def check_converted(in_si: str, in_us: str) -> None:
    """Check that two texts differ only in their units, and that no quantity in the second is in SI units."""
    assert SI.findall(in_us) == []
    assert SI.sub("#", in_si) == US.sub("#", in_us)
    for si, us in zip(SI.finditer(in_si), US.finditer(in_us), strict=True):
        for before, after in zip(si.groups()[:2], us.groups()[:2], strict=True):
            if before is not None or after is not None:
                exact = float(before.replace(",", "")) * SI_SIZES[si[3]]
                found = float(after.replace(",", "")) * US_SIZES[us[3]]
                assert found == pytest.approx(exact, rel=6e-3, abs=STEP["in"] + STEP["mm"] if us[3] == "in" else 0.0), (
                    in_si,
                    in_us,
                )
