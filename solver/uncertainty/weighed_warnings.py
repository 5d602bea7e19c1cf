"""Warnings about a critical angle, with their effect on it: those with little effect become standing notes."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from solver.checks import ParameterError
from solver.projectile import Projectile
from solver.resistance import HELD_FROM, ConstantStrengthFactor, ObliquityPolynomial, Resistance, strength_factor
from solver.strike import RETENTION_BOUNDS, Numerics
from solver.target import Target
from solver.warnings import RETENTION_DECIDES, RETENTION_RANGE, ModelWarning, in_degrees

EXTRAPOLATED = "strength_fit_extrapolated"
"""Code of the warning about an extrapolated fit of S."""
HELD = "strength_held"
"""Key of the search with S held constant from `HELD_EARLIER` on, in place of the code of a warning."""
# There is no finite element run at a larger angle, so S may be held from 55° on as well as from 60°. The range of a
# verdict includes the results of both.
HELD_EARLIER = math.radians(55.0)
"""Smaller angle from which the S of eq. 9 may be held constant. [rad]"""
# An effect that is small compared with the scatter should not distract from other warnings. A quarter is arbitrary.
LITTLE_SHIFT = 0.25
"""Largest shift of the angle with which a warning is a standing note, relative to the width of the 90 % range. [1]"""
MOVES = {
    RETENTION_DECIDES: "with those thresholds it moves by",
    EXTRAPOLATED: f"with S from {math.degrees(ObliquityPolynomial.fitted_to):g}° on as it is there, the angle moves by",
}


def probes(
    codes: Collection[str],
    *,
    angle: float | None,
    projectile: Projectile,
    target: Target,
    resistance: Resistance,
    numerics: Numerics,
) -> dict[str, tuple[float, ...]]:
    """Return values for further searches that show the effects of warnings, by code or `HELD`. [1]

    The values are retention energies, and strength factors at the last angle that the fit of S covers and at
    `HELD_EARLIER`. If the critical angle lies beyond such an angle, a search with that constant factor finds the
    critical angle of a fit that is held from that angle on.
    """

    def held_at(oblique_angle: float) -> tuple[float, ...]:
        try:
            return (
                strength_factor(
                    resistance=resistance, oblique_angle=oblique_angle, target=target, projectile=projectile
                ),
            )
        except ParameterError:  # S is not above zero at this angle
            return ()

    found: dict[str, tuple[float, ...]] = {}
    if RETENTION_DECIDES in codes:
        lowest, highest = RETENTION_BOUNDS
        retention = numerics.retention_energy_fraction
        found[RETENTION_DECIDES] = tuple(min(max(factor * retention, lowest), highest) for factor in RETENTION_RANGE)
    if EXTRAPOLATED in codes:
        found[EXTRAPOLATED] = held_at(ObliquityPolynomial.fitted_to)
    if resistance.held_from == HELD_FROM and angle is not None and angle > HELD_EARLIER:
        found[HELD] = held_at(HELD_EARLIER)
    return {code: values for code, values in found.items() if values}


def range_held_earlier(
    spread: tuple[float, float] | None, angle: float | None, held: float | None
) -> tuple[float, float] | None:
    """Extend a range of the critical angle by the angles with S held from `HELD_EARLIER` on.

    Critical angles beyond `HELD_EARLIER` decrease by about as much as the angle with the inputs as given, but not below
    `HELD_EARLIER`; smaller angles do not change.

    Parameters
    ----------
    spread
        Range with S as given. [rad]
    angle, held
        Critical angle with the inputs as given, and with S held earlier; None if there is none. [rad]
    """
    if spread is None or angle is None or held is None:
        return spread
    lower = spread[0]
    if lower > HELD_EARLIER:
        lower = max(lower + min(held - angle, 0.0), HELD_EARLIER)
    return min(lower, held), max(spread[1], held)


def with_probe(code: str, value: float, *, resistance: Resistance, numerics: Numerics) -> dict[str, Any]:
    """Return the arguments of a search with a value from `probes`."""
    if code == RETENTION_DECIDES:
        return {"resistance": resistance, "numerics": replace(numerics, retention_energy_fraction=value)}
    held = ConstantStrengthFactor(value=value)
    return {"resistance": replace(resistance, strength_factor=held), "numerics": numerics}


def weighed(
    warnings: Sequence[ModelWarning],
    *,
    angle: float | None,
    spread: tuple[float, float] | None,
    moved: Mapping[str, Sequence[float | None]],
) -> tuple[ModelWarning, ...]:
    """Add to warnings their effect on the angle, and mark those with little effect as standing notes.

    A warning remains unchanged if there is no angle or no range, or if its effect is unknown.

    Parameters
    ----------
    angle, spread
        Critical angle and its 90 % range. [rad]
    moved
        Critical angles of the further searches, by code; None if a search finds none. [rad]
    """
    if angle is None or spread is None:
        return tuple(warnings)
    return tuple(_weighed(each, angle, spread, moved.get(each.code, ())) for each in warnings)


def _weighed(
    warning: ModelWarning,
    angle: float,
    spread: tuple[float, float],
    moved: Sequence[float | None],
) -> ModelWarning:
    shifts = [each - angle for each in moved if each is not None]
    shift, detail = warning.angle_shift, warning.detail
    if shifts and len(shifts) == len(moved):
        shift = max(shifts, key=abs)
        by = " and ".join(in_degrees(each, "+.1f") for each in shifts)
        detail += f"; {MOVES[warning.code]} {by}"
    if shift is None:
        return warning
    little = abs(shift) <= LITTLE_SHIFT * (spread[1] - spread[0])
    if shifts and little:
        detail += ", less than a quarter of the 90 % range"
    return replace(warning, detail=detail, standing=little, angle_shift=shift)
