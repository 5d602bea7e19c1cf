"""Empirical formulas for a hard projectile on a concrete wall, each with its source and its range.

The formulas give the depth in thick concrete, and the thicknesses below which the rear of a wall scabs and below which
it is perforated. They were fitted to different tests and differ by 50 % and more, so their spread says more than any
single result. No formula includes an angle; as is common practice, the normal component of the velocity represents an
oblique strike. Some formulas were fitted to flat noses and have no factor for others. Their sources do not state the
error for other noses, so these count as out of range.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

from solver.checks import BOUNDS, ParameterError, require_positive
from solver.projectile import Projectile
from solver.resistance import StrengthPowerLaw, nose_factor
from solver.strike import Impact
from solver.target import Target
from solver.units import number, quantity, with_symbol

NoseClass: TypeAlias = Literal["flat", "blunt", "hemispherical", "sharp"]
"""Classes of noses, from least to most penetrating."""
NDRC_NOSE: Mapping[NoseClass, float] = {"flat": 0.72, "blunt": 1.0, "hemispherical": 1.0, "sharp": 1.14}
"""Nose factor N of the NDRC formula, see `modified_ndrc`. [1]"""
NDRC_NOSE_NOTE = "nose factor 1.0, on the safe side; some sources give 0.84"
"""Note on results for noses whose factor differs between the sources."""
HUGHES_NOSE: Mapping[NoseClass, float] = {"flat": 1.0, "blunt": 1.12, "hemispherical": 1.26, "sharp": 1.39}
"""Nose factor N of Hughes' formula. [1]"""
# Exact conversion of the formula in US units gives the constant 3.8034e-5, which is 0.1 % larger.
NDRC_CONSTANT = 3.8e-5
"""Constant of the NDRC formula in SI units."""
SCABBING_MARGIN, PERFORATION_MARGIN = 1.1, 1.2
"""Safety factors that DOE-STD-3014-2006 requires on the limit thicknesses. [1]"""
NAMES: Mapping[str, str] = {
    "modified_ndrc": "Modified NDRC",
    "degen": "Degen",
    "cea_edf": "CEA-EDF",
    "ukaea": "UKAEA (Barr)",
    "chang": "Chang",
    "hughes": "Hughes",
    "kar": "Kar",
    "ace": "ACE",
    "brl": "BRL",
    "li_chen": "Li and Chen",
    "whiffen": "Whiffen",
}
"""Display names of the formulas."""
# A limit speed outside the bounds of the impact velocity would be of no use.
LIMIT_SPEEDS = (BOUNDS["impact.velocity"].lower, BOUNDS["impact.velocity"].upper)
"""Range of the normal speed in the search for a limit speed. [m/s]"""
# Half or twice this aggregate size changes the depth in Whiffen's formula by 7 %.
AGGREGATE_SIZE = 0.02
"""Default largest aggregate size. [m]"""
# The constants of the formulas have two to four digits, so seven digits of the pressure unit are enough.
POUND, INCH, FOOT, PSI = 0.45359237, 0.0254, 0.3048, 6894.757
"""US units in SI units. [kg, m, m, Pa]"""


@dataclass(frozen=True, slots=True)
class OutOfRange:
    """Input or result of a formula that is outside its range."""

    field: str
    """Name of the input or result."""
    detail: str
    """Text with the range of the formula and the value found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormulaResult:
    """Result of one formula; quantities that it does not give are None."""

    formula: str
    """Name of the formula."""
    penetration_depth: float | None = None
    """Depth of penetration into thick concrete. [m]"""
    scabbing_thickness: float | None = None
    """Least thickness of a wall whose rear face does not scab. [m]"""
    perforation_thickness: float | None = None
    """Least thickness of a wall that is not perforated. [m]"""
    limit_speed: float | None = None
    """Least speed that perforates the wall. [m/s]"""
    out_of_range: tuple[OutOfRange, ...] = ()
    """Inputs and results outside the range to which the formula was fitted; empty within it."""
    range_known: bool = True
    """True if a source states the range of the formula."""
    note: str = ""
    """Caveats and assumptions of the formula; empty if there are none."""
    source: str
    """Authors and year of the source."""
    verified: bool
    """True if the constants were compared with the original, a standard or a published shot. False if they come from
    secondary sources only."""

    @property
    def in_range(self) -> bool:
        """True if the range of the formula is known and contains every input and result."""
        return self.range_known and not self.out_of_range


Limit: TypeAlias = Literal["penetration_depth", "scabbing_thickness", "perforation_thickness"]
"""Depth or thickness that a formula gives."""
LIMITS: tuple[Limit, ...] = get_args(Limit)
"""All depths and thicknesses that formulas give."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Lowest and highest result for a quantity among the formulas within their range."""

    lowest: float
    """Lowest value. [m]"""
    highest: float
    """Highest value. [m]"""
    count: int
    """Number of different results."""


def spread(results: Iterable[FormulaResult], limit: Limit) -> Spread | None:
    """Return the spread of a quantity over the formulas in range; None if none of them gives it."""
    # Equal values count once, since some formulas share them: the results of Kar's formula for steel, and the depth by
    # Degen's, are those of the modified NDRC formula.
    values = {value for each in results if each.in_range and (value := getattr(each, limit)) is not None}
    return Spread(min(values), max(values), len(values)) if values else None


def nose_class(projectile: Projectile) -> NoseClass:
    """Return the class of the nose for the formulas, from the ratio of its length to the diameter.

    Notes
    -----
    The sources name nose classes without giving dimensions. Here a nose of length zero is flat, one shorter than a
    hemisphere is blunt, one of up to one diameter is hemispherical, such as that of a bullet with a spherical end, and
    a longer one is sharp.
    """
    ratio = _nose_ratio(projectile)
    if ratio == 0.0:
        return "flat"
    if ratio < 0.5 - 1e-9:  # rounding may make a hemisphere slightly shorter
        return "blunt"
    return "hemispherical" if ratio <= 1.0 else "sharp"


def modified_ndrc(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute penetration, scabbing and perforation by the modified NDRC formula.

    Notes
    -----
    NDRC (1946) with the limits of Kennedy (1976), as in DOE-STD-3014-2006, appendix C: ``G = 3.8e-5 N M / (d sqrt(f'c))
    (V/d)^1.8`` in SI units, ``x/d = 2 sqrt(G)`` up to G = 1 and ``G + 1`` beyond. The converted form in US units is 0.1
    % larger. With X = x/d, ``e/d = 3.19 X - 0.718 X²`` up to X = 1.35 and ``1.32 + 1.24 X`` beyond, ``h/d = 7.91 X -
    5.06 X²`` up to X = 0.65 and ``2.12 + 1.36 X`` beyond, each up to 18 diameters. The often quoted bound of 3
    diameters is where the straight lines begin; the standard uses the parabolas below it.

    N is 0.72 for flat and 1.14 for sharp noses. Between them sources disagree: the standard has 0.84 for hemispherical
    and 1.0 for blunt noses, others 0.84 for blunt and 1.0 for spherical ones. Both get 1.0 here, which is conservative:
    spheres on a slab of 140 mm (Erkander and Pettersson 1985) began to scab it between 859 and 925 m/s, where 1.0 gives
    844 and 0.84 gives 930 m/s.
    """
    return _by_ndrc_limits(
        "modified_ndrc",
        projectile,
        _ndrc_depth(_ndrc_impact(projectile, target, impact)),
        source="NDRC 1946; Kennedy 1976; DOE-STD-3014-2006, appendix C",
        verified=True,
    )


def kar(*, projectile: Projectile, target: Target, impact: Impact, stiffness_ratio: float = 1.0) -> FormulaResult:
    """Compute penetration, scabbing and perforation by Kar's formula, which extends NDRC's to bodies softer than steel.

    Parameters
    ----------
    stiffness_ratio
        Young's modulus of the projectile divided by that of steel; 1 gives the modified NDRC formula. [1]

    Notes
    -----
    Kar (1978): NDRC's G times ``(E/E_steel)^1.25``. The aggregate size, which Kar adds to the limit thicknesses, is
    left out. The constants were not compared with the original.
    """
    require_positive("stiffness_ratio", stiffness_ratio)
    depth = _ndrc_depth(_ndrc_impact(projectile, target, impact) * stiffness_ratio**1.25)
    return _by_ndrc_limits("kar", projectile, depth, source="Kar 1978", verified=False)


def degen(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute perforation by Degen's formula, with the depth of the modified NDRC formula.

    Notes
    -----
    Degen (1980), as in DOE-STD-3014-2006, appendix C: ``e/d = 2.2 X - 0.3 X²`` up to X = x/d = 1.52, and
    ``0.69 + 1.29 X`` beyond, where e/d is 2.65 to 18.
    """
    d, ratio = projectile.diameter, _ndrc_depth(_ndrc_impact(projectile, target, impact))
    thickness = 2.2 * ratio - 0.3 * ratio**2 if ratio < 1.52 else 0.69 + 1.29 * ratio
    return FormulaResult(
        formula="degen",
        penetration_depth=ratio * d,
        perforation_thickness=thickness * d,
        out_of_range=_outside("perforation_thickness", thickness, 0.0, 18.0, "diameters"),
        note=_ndrc_note(projectile),
        source="Degen 1980; DOE-STD-3014-2006, appendix C",
        verified=True,
    )


def ace(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute penetration and perforation by the formula of the U.S. Army Corps of Engineers.

    Notes
    -----
    ACE (1946): ``x/d = 3.5e-4 / sqrt(f'c) (M/d³) d^0.215 V^1.5 + 0.5`` and ``e/d = 1.32 + 1.24 x/d`` for x/d from 1.35
    to 13.5. Two secondary sources agree; neither has a form for shallower penetration.
    """
    d, v = projectile.diameter, _normal_velocity(impact)
    ratio = 3.5e-4 / math.sqrt(target.compressive_strength) * (projectile.mass / d**3) * d**0.215 * v**1.5 + 0.5
    return FormulaResult(
        formula="ace",
        penetration_depth=ratio * d,
        perforation_thickness=(1.32 + 1.24 * ratio) * d,
        out_of_range=_outside("penetration_depth", ratio, 1.35, 13.5, "diameters"),
        source="U.S. Army Corps of Engineers 1946, after Chelapati, Kennedy and Wall 1972",
        verified=False,
    )


def brl(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute penetration and perforation by the formula of the Ballistic Research Laboratory.

    Notes
    -----
    BRL (1941): ``x/d = 1.33e-3 / sqrt(f'c) (M/d³) d^0.2 V^1.33`` and ``e = 1.3 x``. Two secondary sources agree;
    neither gives a range. It is uncertain whether 1.33e-3 belongs to the penetration or to the perforation.
    """
    d, v = projectile.diameter, _normal_velocity(impact)
    depth = d * 1.33e-3 / math.sqrt(target.compressive_strength) * (projectile.mass / d**3) * d**0.2 * v**1.33
    return FormulaResult(
        formula="brl",
        penetration_depth=depth,
        perforation_thickness=1.3 * depth,
        range_known=False,
        note="in doubt: the constant may be that of the perforation, and the factor 1.3 then counts twice",
        source="Ballistic Research Laboratory 1941, after Chelapati, Kennedy and Wall 1972",
        verified=False,
    )


def chang(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute scabbing and perforation by Chang's formulas.

    Notes
    -----
    Chang (1981), for flat noses: ``e/d = (61/V)^0.25 (M V² / (d³ f'c))^0.5`` and
    ``h/d = 1.84 (61/V)^0.13 (M V² / (d³ f'c))^0.4``, from tests at 16 to 312 m/s with masses of 0.11 to 343 kg and
    diameters of 5 to 30 cm on concrete of 23 to 46 MPa. The constants were not compared with the original.
    """
    d, v, strength = projectile.diameter, _normal_velocity(impact), target.compressive_strength
    energy = projectile.mass * v**2 / (d**3 * strength)
    return FormulaResult(
        formula="chang",
        scabbing_thickness=1.84 * (61.0 / v) ** 0.13 * energy**0.4 * d,
        perforation_thickness=(61.0 / v) ** 0.25 * math.sqrt(energy) * d,
        out_of_range=_outside("impact.velocity", v, 16.0, 312.0, "m/s", of="along the normal")
        + _outside("projectile.mass", projectile.mass, 0.11, 343.0, "kg")
        + _outside("projectile.diameter", d, 0.05, 0.3, "mm")
        + _outside("target.compressive_strength", strength, 23e6, 46e6, "MPa")
        + _not_flat(projectile),
        source="Chang 1981",
        verified=False,
    )


def cea_edf(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute perforation by the formula of CEA and EDF, for flat noses.

    Notes
    -----
    Berriaud et al. (1978): ``e = 0.82 M^0.5 V^0.75 / (ρ^0.125 f'c^0.375 d^0.5)``, from tests at 20 to 200 m/s.
    `cea_edf_limit_speed` is its inverse to within 0.2 %. The constants were not compared with the original.
    """
    v = _normal_velocity(impact)
    thickness = (
        0.82
        * math.sqrt(projectile.mass / projectile.diameter)
        * v**0.75
        / (target.density**0.125 * target.compressive_strength**0.375)
    )
    return FormulaResult(
        formula="cea_edf",
        perforation_thickness=thickness,
        out_of_range=_outside("impact.velocity", v, 20.0, 200.0, "m/s", of="along the normal") + _not_flat(projectile),
        source="Berriaud et al. 1978",
        verified=False,
    )


def cea_edf_limit_speed(
    *, projectile: Projectile, target: Target, thickness: float, oblique_angle: float = 0.0
) -> FormulaResult:
    """Compute the least speed that perforates a wall, by the formula of CEA and EDF for flat noses.

    Parameters
    ----------
    thickness
        Thickness of the wall. [m]
    oblique_angle
        Angle from the inward normal of the face to the velocity; the formula gives the component along the normal.
        [rad]

    Notes
    -----
    ``V = 1.3 ρ^(1/6) f'c^0.5 (d H² / M)^(2/3)``, fitted from 20 to 200 m/s; see `cea_edf`.
    """
    require_positive("thickness", thickness)
    cosine = _normal_velocity(Impact(velocity=1.0, oblique_angle=oblique_angle))
    slenderness = projectile.diameter * thickness**2 / projectile.mass
    strength = math.sqrt(target.compressive_strength)
    normal = 1.3 * math.pow(target.density, 1.0 / 6.0) * strength * math.pow(slenderness, 2.0 / 3.0)
    return FormulaResult(
        formula="cea_edf",
        limit_speed=normal / cosine,
        out_of_range=_outside("limit_speed", normal, 20.0, 200.0, "m/s", of="along the normal") + _not_flat(projectile),
        source="Berriaud et al. 1978",
        verified=False,
    )


def ukaea(*, projectile: Projectile, target: Target, impact: Impact) -> FormulaResult:
    """Compute penetration and scabbing by Barr's formula for the UKAEA, for the low speeds relevant to plant safety.

    Notes
    -----
    Barr's formula for perforation, which includes the reinforcement ratio, is left out: no open source was found that
    states it with its range and a value to compare with.

    Barr (1990), with NDRC's G: ``x/d = 0.275 - sqrt(0.0756 - G)`` up to G = 0.0726, ``sqrt(4 G - 0.242)`` up to 1.0605
    and ``G + 0.9395`` beyond; ``h/d = 5.3 G^0.33``. It holds for 25 to 300 m/s, 22 to 44 MPa and M/d³ from 5,000 to
    200,000 kg/m³. The constants were not compared with the original.
    """
    d, g = projectile.diameter, _ndrc_impact(projectile, target, impact)
    if g <= 0.0726:
        ratio = 0.275 - math.sqrt(0.0756 - g)
    elif g < 1.0605:
        ratio = math.sqrt(4.0 * g - 0.242)
    else:
        ratio = g + 0.9395
    return FormulaResult(
        formula="ukaea",
        penetration_depth=ratio * d,
        scabbing_thickness=5.3 * g**0.33 * d,
        out_of_range=_outside("impact.velocity", _normal_velocity(impact), 25.0, 300.0, "m/s", of="along the normal")
        + _outside("target.compressive_strength", target.compressive_strength, 22e6, 44e6, "MPa")
        + _outside("projectile.mass", projectile.mass / d**3, 5e3, 2e5, "kg/m³", of="(M/d³)"),
        note=_ndrc_note(projectile),
        source="Barr 1990 (UKAEA)",
        verified=False,
    )


def hughes(
    *, projectile: Projectile, target: Target, impact: Impact, tensile_strength: float | None = None
) -> FormulaResult:
    """Compute penetration, scabbing and perforation by Hughes' formula.

    Parameters
    ----------
    tensile_strength
        Modulus of rupture f_t of the concrete; 0.63 MPa (f'c/MPa)^0.5 when not given. [Pa]

    Notes
    -----
    Hughes (1984): ``x/d = 0.19 N I / (1 + 12.3 ln(1 + 0.03 I))`` with ``I = M V² / (d³ f_t)`` from 40 to 3,500;
    ``e/d = 3.6 X`` below X = x/d = 0.7 and ``1.58 X + 1.4`` beyond, ``h/d = 5 X`` and ``1.74 X + 2.3``. N is 1, 1.12,
    1.26 and 1.39 for flat, blunt, spherical and very sharp noses. Two secondary sources agree; the constants were not
    compared with the original.
    """
    if tensile_strength is None:
        tensile_strength = 0.63e6 * math.sqrt(target.compressive_strength / 1e6)
    require_positive("tensile_strength", tensile_strength)
    d = projectile.diameter
    energy = projectile.mass * _normal_velocity(impact) ** 2 / (d**3 * tensile_strength)
    ratio = 0.19 * HUGHES_NOSE[nose_class(projectile)] * energy / (1.0 + 12.3 * math.log1p(0.03 * energy))
    return FormulaResult(
        formula="hughes",
        penetration_depth=ratio * d,
        scabbing_thickness=(5.0 * ratio if ratio < 0.7 else 1.74 * ratio + 2.3) * d,
        perforation_thickness=(3.6 * ratio if ratio < 0.7 else 1.58 * ratio + 1.4) * d,
        out_of_range=_outside("impact.velocity", energy, 40.0, 3500.0, of="(I = M V²/(d³ f_t))"),
        source="Hughes 1984",
        verified=False,
    )


def li_chen(
    *, projectile: Projectile, target: Target, impact: Impact, strength_factor: float | None = None
) -> FormulaResult:
    """Compute penetration by Li and Chen's formula, with its branch for shallow penetration.

    Parameters
    ----------
    strength_factor
        Strength factor S; 82.6 (f'c/MPa)^-0.544 when not given. [1]

    Notes
    -----
    Li and Chen (2003): ``I = M V² / (S d³ f'c)``, ``N = M / (N* ρ d³)`` and a crater of ``k = 0.707 + h/d`` diameters,
    h the length of the nose. ``x/d = sqrt(4 k I / π (1 + k π / (4 N)) / (1 + I / N))`` up to I = π k / 4, and
    ``2 N / π ln((1 + I / N) / (1 + k π / (4 N))) + k`` beyond. With k = 2 the latter is `closed_form_depth`. The
    formula was compared with that and with one published shot, not with the original. Below X = x/d = 0.5 it is out of
    its range. The published correction ``1.628 X^2.789`` is left out there, since it is not continuous with the
    formula: it gives 0.24 at X = 0.5.
    """
    if strength_factor is None:
        (strength_factor,) = StrengthPowerLaw().polynomial(target=target, projectile=projectile)
    require_positive("strength_factor", strength_factor)
    d, mass = projectile.diameter, projectile.mass
    energy = mass * _normal_velocity(impact) ** 2 / (strength_factor * d**3 * target.compressive_strength)
    slenderness = mass / (nose_factor(projectile) * target.density * d**3)
    crater = 0.707 + _nose_ratio(projectile)
    entry = 1.0 + crater * math.pi / (4.0 * slenderness)
    if energy <= math.pi * crater / 4.0:
        ratio = math.sqrt(4.0 * crater * energy / math.pi * entry / (1.0 + energy / slenderness))
    else:
        ratio = 2.0 / math.pi * slenderness * math.log((1.0 + energy / slenderness) / entry) + crater
    return FormulaResult(
        formula="li_chen",
        penetration_depth=ratio * d,
        out_of_range=_outside("penetration_depth", ratio, 0.5, math.inf, "diameters"),
        source="Li and Chen 2003",
        verified=True,
    )


def whiffen(
    *, projectile: Projectile, target: Target, impact: Impact, aggregate_size: float | None = None
) -> FormulaResult:
    """Compute penetration by Whiffen's formula, which fits its tests within 15 %.

    Parameters
    ----------
    aggregate_size
        Largest aggregate size of the concrete; 20 mm when not given. [m]

    Notes
    -----
    Whiffen (1943): ``x = 870 / sqrt(f'c) (M/d²) (d/c)^0.1 (V/1750)^n`` with ``n = 10.7 / f'c^0.25`` in inches, pounds,
    psi and ft/s, where c is the largest aggregate size; from tests with masses of 0.3 to 22,000 lb and diameters of 0.5
    to 38 in, at up to 3,700 ft/s. The constants were not compared with the original.
    """
    note = "within 15 % of its tests"
    if aggregate_size is None:
        aggregate_size = AGGREGATE_SIZE
        note += (
            f"; largest aggregate taken as {quantity(aggregate_size, 'mm')}: half or twice that moves the depth by 7 %"
        )
    require_positive("aggregate_size", aggregate_size)
    d, v, strength = projectile.diameter, _normal_velocity(impact), target.compressive_strength / PSI
    weight_over_square = projectile.mass / POUND / (d / INCH) ** 2
    speed_factor = math.pow(v / FOOT / 1750.0, 10.7 / strength**0.25)
    depth = 870.0 / math.sqrt(strength) * weight_over_square * math.pow(d / aggregate_size, 0.1) * speed_factor
    return FormulaResult(
        formula="whiffen",
        penetration_depth=depth * INCH,
        out_of_range=_outside("impact.velocity", v, 0.0, 1127.8, "m/s", of="along the normal")
        + _outside("projectile.mass", projectile.mass, 0.136, 9979.0, "kg")
        + _outside("projectile.diameter", d, 0.0127, 0.9652, "mm"),
        note=note,
        source="Whiffen 1943, after Leppänen 2002",
        verified=False,
    )


Formula: TypeAlias = Callable[..., FormulaResult]
"""Function that evaluates one formula for a projectile, a target and an impact."""
FORMULAS: tuple[Formula, ...] = (modified_ndrc, degen, cea_edf, ukaea, chang, hughes, kar, ace, brl, li_chen, whiffen)


def formulas(*, projectile: Projectile, target: Target, impact: Impact) -> tuple[FormulaResult, ...]:
    """Return the results of all formulas for one strike.

    Parameters
    ----------
    projectile, target, impact
        Projectile, concrete, and motion at first contact, of which only the normal component of the velocity counts.

    Returns
    -------
    tuple of FormulaResult
        Results of all formulas, including those out of range.

    Raises
    ------
    ParameterError
        If the strike has no velocity along the normal.

    Examples
    --------
    >>> from solver import Impact, Ogive, Projectile, Target, formulas
    >>> projectile = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
    >>> target = Target(compressive_strength=39e6, density=2250.0)
    >>> for answer in formulas(projectile=projectile, target=target, impact=Impact(velocity=238.0, oblique_angle=0.0)):
    ...     if answer.perforation_thickness is not None and answer.verified:
    ...         print(answer.formula, round(answer.perforation_thickness, 3), answer.in_range)
    modified_ndrc 0.405 True
    degen 0.366 True
    """
    return tuple(formula(projectile=projectile, target=target, impact=impact) for formula in FORMULAS)


def limit_speeds(
    *, projectile: Projectile, target: Target, thickness: float, oblique_angle: float = 0.0
) -> tuple[FormulaResult, ...]:
    """Return the least speed that perforates a wall, by each formula that gives a perforation thickness.

    Parameters
    ----------
    thickness
        Thickness of the wall. [m]
    oblique_angle
        Angle from the inward normal of the face to the velocity; the formulas give the component along the normal.
        [rad]

    Returns
    -------
    tuple of FormulaResult
        Result by CEA-EDF, and by each other formula whose limit speed along the normal lies within `LIMIT_SPEEDS`.

    Raises
    ------
    ParameterError
        If the thickness is not above zero, or the strike has no velocity along the normal.

    Notes
    -----
    CEA-EDF has a formula for the speed, see `cea_edf_limit_speed`; the others are solved for it numerically. If
    the thickness given by a formula falls slightly where two of its branches meet, there are two solutions, 0.2 %
    apart; one of them is returned.
    """
    require_positive("thickness", thickness)
    cosine = _normal_velocity(Impact(velocity=1.0, oblique_angle=oblique_angle))
    found = []
    for formula in FORMULAS:
        if formula is cea_edf:
            found.append(
                cea_edf_limit_speed(
                    projectile=projectile, target=target, thickness=thickness, oblique_angle=oblique_angle
                )
            )
        elif (solved := _solved_for_speed(formula, projectile, target, thickness, cosine)) is not None:
            found.append(solved)
    return tuple(found)


def _solved_for_speed(
    formula: Formula, projectile: Projectile, target: Target, thickness: float, cosine: float
) -> FormulaResult | None:
    """Solve a formula for the least speed that perforates a wall.

    The result is None if that speed is outside `LIMIT_SPEEDS`, or the formula gives no perforation thickness.
    """

    def at(velocity: float) -> FormulaResult:
        return formula(projectile=projectile, target=target, impact=Impact(velocity=velocity, oblique_angle=0.0))

    def perforates(velocity: float) -> bool:
        needed = at(velocity).perforation_thickness
        return needed is not None and needed > thickness

    lower, upper = LIMIT_SPEEDS
    if perforates(lower) or not perforates(upper):
        return None
    # Bisection converges even if the thickness falls where two branches of a formula meet. On a logarithmic scale it
    # takes about 45 trials; a smaller tolerance would be below the rounding error of the formula.
    while upper - lower > 1e-12 * upper:
        middle = math.sqrt(lower * upper)
        if not lower < middle < upper:
            break
        lower, upper = (lower, middle) if perforates(middle) else (middle, upper)
    there = at(upper)
    fields = {"impact.velocity": "limit_speed", "perforation_thickness": "target.thickness"}
    outside = tuple(
        replace(each, field=fields.get(each.field, each.field))
        for each in there.out_of_range
        if each.field != "scabbing_thickness"
    )
    return replace(
        there,
        penetration_depth=None,
        scabbing_thickness=None,
        perforation_thickness=None,
        limit_speed=upper / cosine,
        out_of_range=outside,
    )


def _normal_velocity(impact: Impact) -> float:
    normal = impact.velocity * math.cos(impact.oblique_angle)
    if normal <= 0.0:
        raise ParameterError("impact.oblique_angle", "must leave a velocity along the normal for the formulas")
    return normal


def _nose_ratio(projectile: Projectile) -> float:
    """Return the length of the nose divided by the diameter. [1]"""
    return projectile.nose.length(projectile.radius) / projectile.diameter


def _ndrc_impact(projectile: Projectile, target: Target, impact: Impact) -> float:
    """Return the impact factor G of the NDRC formula. [1]"""
    d, nose = projectile.diameter, NDRC_NOSE[nose_class(projectile)]
    rate = math.pow(_normal_velocity(impact) / d, 1.8)
    return NDRC_CONSTANT * nose * projectile.mass / (d * math.sqrt(target.compressive_strength)) * rate


def _ndrc_note(projectile: Projectile) -> str:
    return NDRC_NOSE_NOTE if nose_class(projectile) in ("blunt", "hemispherical") else ""


def _ndrc_depth(g: float) -> float:
    """Return the penetration in diameters by the NDRC formula, given the impact factor G. [1]"""
    return 2.0 * math.sqrt(g) if g <= 1.0 else g + 1.0


def _by_ndrc_limits(
    formula: str, projectile: Projectile, ratio: float, *, source: str, verified: bool
) -> FormulaResult:
    """Return a result with Kennedy's limit thicknesses (1976); `ratio` is the penetration in diameters. [1]"""
    d = projectile.diameter
    scabbing = 7.91 * ratio - 5.06 * ratio**2 if ratio <= 0.65 else 2.12 + 1.36 * ratio
    perforation = 3.19 * ratio - 0.718 * ratio**2 if ratio <= 1.35 else 1.32 + 1.24 * ratio
    return FormulaResult(
        formula=formula,
        penetration_depth=ratio * d,
        scabbing_thickness=scabbing * d,
        perforation_thickness=perforation * d,
        out_of_range=_outside("perforation_thickness", perforation, 0.0, 18.0, "diameters")
        + _outside("scabbing_thickness", scabbing, 0.0, 18.0, "diameters"),
        note=_ndrc_note(projectile),
        source=source,
        verified=verified,
    )


def _not_flat(projectile: Projectile) -> tuple[OutOfRange, ...]:
    nose = nose_class(projectile)
    return () if nose == "flat" else (OutOfRange("projectile.nose", f"fitted to flat noses, here {nose}"),)


# Whiffen's largest speed, 1,127.8 m/s, has the most digits.
BOUND_DIGITS = 5
"""Largest number of significant digits of the bounds of a formula's range. [1]"""
# A bound may have only two digits, such as 18 diameters. With two digits, 19.58 would be shown as 20.
FEWEST_DIGITS = 3
"""Least number of significant digits of a value outside the range of a formula. [1]"""


def _outside(
    field: str, value: float, lowest: float, highest: float, unit: str = "", *, of: str = ""
) -> tuple[OutOfRange, ...]:
    """Return a tuple with an `OutOfRange` if a value is outside the range of a formula; else an empty tuple.

    Parameters
    ----------
    unit
        SI unit in which the message gives the value, such as ``mm``.
    of
        Words that follow the range in the message.
    """
    if lowest <= value <= highest:
        return ()
    least, most = (quantity(each, unit, BOUND_DIGITS) for each in (lowest, highest))
    bounds = f"from {least} to {most}" if lowest > 0.0 else f"up to {most}"
    if math.isinf(highest):
        bounds = f"at least {least}"
    here = _beyond(value, lowest if value < lowest else highest, unit)
    return (OutOfRange(field, f"fitted {bounds} {of}".rstrip() + f", here {here}"),)


def _beyond(value: float, bound: float, unit: str) -> str:
    """Format a value beyond a bound with as many digits as the bound, or up to two more if both would look the same."""
    end = number(bound, unit, BOUND_DIGITS)
    digits = sum(each.isdecimal() for each in end.lstrip("0."))
    for more in range(max(digits, FEWEST_DIGITS), digits + 3):
        text = number(value, unit, more, converted_digits=more)
        if text != end:
            return with_symbol(text, unit)
    return f"just {'below' if value < bound else 'above'} {with_symbol(end, unit)}"
