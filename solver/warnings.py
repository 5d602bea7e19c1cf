"""Warnings that are part of a result: limits of its validity that a user should know before relying on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import assert_never

from solver.formulas import NAMES, formulas, spread
from solver.motion import MOST_TURN
from solver.projectile import Projectile, solid_properties
from solver.resistance import (
    EQUATION_9_COEFFICIENTS,
    FAR_OFF,
    FINITE_ELEMENTS_TO,
    HELD_FROM,
    ConstantStrengthFactor,
    ObliquityPolynomial,
    ObliquityShape,
    OwnTests,
    PublishedTests,
    Resistance,
    StrengthPosterior,
    StrengthPowerLaw,
    body_of,
    plug_height,
)
from solver.strike import PAPER_PROJECTILE, Impact
from solver.target import MOST_PLUG, Target
from solver.units import fixed, interval, quantity, rounded, with_symbol

# Steel noses eroded above about this speed in tests (Forrestal et al. 1996).
RIGID_VELOCITY = 800.0
"""Speed above which a body is not rigid. [m/s]"""
TESTED_STRENGTH = (13e6, 97e6)
"""Range of compressive strengths in the tests behind eq. 1 (Forrestal et al. 1994, Frew et al. 1998). [Pa]"""
EQUATION_9_STRENGTH, EQUATION_9_DIAMETER = 39e6, 0.08
"""Strength of the concrete and diameter of the projectile to which eq. 9 was fitted. [Pa, m]"""
# By the law of published tests, S changes by 2 % over the first and by 5 to 7 % over the second, less than it scatters.
SAME_STRENGTH, SAME_DIAMETER = 0.1, 0.25
"""Relative differences of strength and diameter from those of eq. 9 up to which it is used without a warning. [1]"""
# Tungsten and uranium have about 19,000 kg/m³; the lower bound is arbitrary.
MEAN_DENSITY = (1e3, 2e4)
"""Usual mean densities of bodies, from hollow ones to tungsten or uranium. [kg/m³]"""
# This is the lowest yield strength of 4340 steel hardened to Rc 45.
USUAL_YIELD_STRENGTH = 1.2e9
"""Default yield strength of the body. [Pa]"""
# Bodies bend and break at larger angles of attack; the value is arbitrary.
SMALL_ATTACK = math.radians(5.0)
"""Largest angle of attack without a warning. [rad]"""
# Nobody would read a longer list; the value is arbitrary.
MOST_NAMED = 5
"""Largest number of shots that a warning names."""
# The theory of deep cavities does not apply within the front crater, where spalling governs (Forrestal et al. 1994).
CRATER_CALIBERS = 2.0
"""Depth of the front crater, relative to the diameter. [1]"""


@dataclass(frozen=True, slots=True)
class ModelWarning:
    """Warning about a result: a limit of its validity, or an assumption behind it.

    Parameters
    ----------
    code
        Stable name, for programs.
    detail
        Explanation for people, with quantities in the units that `solver.units` has in use.
    standing
        True for a standing note: a warning that most answers have, or that hardly changes this answer. Standing notes
        are shown together.
    angle_shift
        Change of the critical angle by the effect that the warning names, if it was computed. [rad]
    """

    code: str
    detail: str
    standing: bool = False
    angle_shift: float | None = None


def range_warnings(*, target: Target, velocity: float) -> tuple[ModelWarning, ...]:
    """Warn about a speed or a strength outside the range of the tests behind the resistance law."""
    found = []
    if velocity > RIGID_VELOCITY:
        found.append(
            ModelWarning(
                "velocity_beyond_rigid",
                f"{quantity(velocity, 'm/s', 6)} is above {quantity(RIGID_VELOCITY, 'm/s')}, where noses of steel "
                "erode; the body is taken as rigid",
            )
        )
    lowest, highest = TESTED_STRENGTH
    if not lowest <= target.compressive_strength <= highest:
        found.append(
            ModelWarning(
                "strength_beyond_tests",
                f"compressive strength {quantity(target.compressive_strength, 'MPa', 6)} is outside "
                f"{interval(lowest, highest, 'MPa')}, the range of the tests behind the resistance law",
            )
        )
    return tuple(found)


def body_warnings(projectile: Projectile) -> tuple[ModelWarning, ...]:
    """Warn about a body that is too light or too heavy for its size: its mass or its size may be in a wrong unit."""
    lowest, highest = MEAN_DENSITY
    density = projectile.mass / solid_properties(projectile).volume
    if lowest <= density <= highest:
        return ()
    return (
        ModelWarning(
            "mean_density_unusual",
            "the mean density of the projectile, its mass over the volume of its outline, is "
            f"{quantity(density, 'kg/m³')}, outside {interval(lowest, highest, 'kg/m³')}: compare its "
            "mass, diameter and length with those meant",
        ),
    )


def reinforcement_warnings(target: Target) -> tuple[ModelWarning, ...]:
    """Warn that a reinforcement ratio above 0 has no effect."""
    ratio = target.reinforcement_ratio_percent
    if not ratio:
        return ()
    return (
        ModelWarning(
            "reinforcement_not_counted",
            f"reinforcement of {ratio:g} % each way and each face has no effect: neither the model nor any of "
            "the formulas includes it, so the answers are those of plain concrete",
        ),
    )


def in_degrees(angle: float, form: str) -> str:
    """Return an angle in degrees for a sentence, with a minus sign rather than a hyphen."""
    return f"{math.degrees(angle):{form}}°".replace("-", "\N{MINUS SIGN}")


def input_warnings(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    angle_of_attack: float,
    angle_shift: float | None = None,
) -> tuple[ModelWarning, ...]:
    """Return the warnings about the inputs, which do not depend on the oblique angle.

    Parameters
    ----------
    angle_shift
        Change of the critical angle for a moment of inertia 10 % larger, stated in a warning if given. [rad]
    """
    found = list(range_warnings(target=target, velocity=velocity))
    if abs(angle_of_attack) > SMALL_ATTACK:
        found.append(
            ModelWarning(
                "large_angle_of_attack",
                f"angle of attack {in_degrees(angle_of_attack, 'g')} is beyond {math.degrees(SMALL_ATTACK):g}°, "
                "where bodies bend and break; the body is taken as rigid",
            )
        )
    found += body_warnings(projectile)
    found += reinforcement_warnings(target)
    found += _mass_properties_assumed(projectile, angle_shift)
    return tuple(found)


def _mass_properties_assumed(projectile: Projectile, angle_shift: float | None) -> tuple[ModelWarning, ...]:
    given = {
        "centre of gravity": projectile.center_of_gravity,
        "moment of inertia": projectile.moment_of_inertia,
    }
    missing = [name for name, value in given.items() if value is None]
    if not missing:
        return ()
    bore = "" if projectile.inner_diameter is None else " with the bore along its shank"
    detail = f"{' and '.join(missing)} not given: those of a homogeneous solid of the outer shape{bore} are used"
    if angle_shift is not None:
        detail += f"; a moment of inertia 10 % larger moves the angle by about {in_degrees(angle_shift, '+.1g')}"
    return (ModelWarning("mass_properties_assumed", detail, standing=True, angle_shift=angle_shift),)


def law_warnings(
    *, projectile: Projectile, target: Target, resistance: Resistance, impact: Impact
) -> tuple[ModelWarning, ...]:
    """Return the warnings about laws used outside the range of their data, and about effects that they leave out."""
    found = _strength_law_warnings(projectile=projectile, target=target, resistance=resistance, impact=impact)
    if resistance.crater is not None and impact.oblique_angle != 0.0:
        found.append(CRATER_AT_OBLIQUITY)
    if target.thickness is not None:
        found.append(_rear_face(projectile=projectile, target=target, resistance=resistance, impact=impact))
        found += _plug_through_wall(projectile, target, resistance)
    return tuple(found)


def _strength_law_warnings(
    *, projectile: Projectile, target: Target, resistance: Resistance, impact: Impact
) -> list[ModelWarning]:
    model, angle, held = resistance.strength_factor, abs(impact.oblique_angle), resistance.held_from
    found: list[ModelWarning] = []
    match model:
        case ConstantStrengthFactor():
            pass
        case ObliquityPolynomial():
            # Any polynomial is assumed to be a fit over the angles of eq. 9.
            found += _beyond_fit_over_angle("equation_9", angle, held)
            if any(model.coefficients[1:]) and angle > HELD_FROM < held:
                found.append(_strength_factor_not_held(angle, held))
            if model.coefficients == EQUATION_9_COEFFICIENTS:
                found += _other_concrete(projectile, target)
        case StrengthPowerLaw():
            found += _beyond_fit_over_angle(model.obliquity_shape, angle, held)
        case PublishedTests():
            found += _beyond_fit_over_angle(model.obliquity_shape, angle, held)
            found += _beyond_published_tests(projectile, target, impact.velocity)
        case OwnTests():
            found += _beyond_fit_over_angle(model.obliquity_shape, angle, held)
            posterior = model.posterior(
                target=target, projectile=projectile, inertia_factor=resistance.inertia_factor, crater=resistance.crater
            )
            found += own_tests_apart(posterior)
            found += shallow_shots(
                depths=[shot.depth for shot in model.shots],
                diameters=[projectile.diameter if shot.diameter is None else shot.diameter for shot in model.shots],
            )
            found += _own_tests_deeper_than_wall(model, target)
        case _:
            assert_never(model)
    return found


def _beyond_fit_over_angle(shape: ObliquityShape, angle: float, held: float) -> tuple[ModelWarning, ...]:
    """Warn about an oblique angle beyond those to which S(θ) was fitted.

    Parameters
    ----------
    angle, held
        Absolute value of the oblique angle, and the angle from which S is held constant. [rad]
    """
    fitted_to = FINITE_ELEMENTS_TO if shape == "finite_elements" else ObliquityPolynomial.fitted_to
    # An angle converted from degrees may exceed the limit by rounding.
    if shape == "constant" or angle <= fitted_to * (1.0 + 1e-12):
        return ()
    return (
        ModelWarning(
            "strength_fit_extrapolated",
            f"the strength factor was fitted to finite element runs from 0° to {math.degrees(fitted_to):g}° "
            f"from the normal; {math.degrees(angle):.4g}° is beyond"
            + (f", where it is held from {math.degrees(held):.4g}° on" if angle > held else ""),
        ),
    )


def _strength_factor_not_held(angle: float, held: float) -> ModelWarning:
    """Warn about a polynomial that is not held constant beyond the angle from which eq. 9 is."""
    return ModelWarning(
        "strength_factor_not_held",
        f"beyond {math.degrees(HELD_FROM):g}° the strength factor follows its polynomial, which nothing bounds "
        f"there, up to {math.degrees(min(angle, held)):.4g}°; eq. 9 is held from "
        f"{math.degrees(HELD_FROM):g}° on, see `held_from_deg`",
    )


def _rear_face(*, projectile: Projectile, target: Target, resistance: Resistance, impact: Impact) -> ModelWarning:
    """Warn about effects that the model of the rear face leaves out; state the thicknesses that formulas require."""
    if resistance.rear_plug is not None:
        code, detail = "rear_plug_quasi_static", REAR_PLUG_QUASI_STATIC
    else:
        front = "" if resistance.crater is not None else " and the impact face no crater"
        code = "rear_face_unconservative"
        detail = f"the rear face has no plug that shears out{front}: real walls resist less than the model computes"
    oblique_angle = math.degrees(abs(impact.oblique_angle))
    strike = f"{quantity(impact.velocity, 'm/s')} at {oblique_angle:.4g}° from the normal"
    answers = formulas(projectile=projectile, target=target, impact=impact)
    if required := spread(answers, "perforation_thickness"):
        # The thicknesses are rounded up, as in the design values, to be on the safe side.
        thicknesses = [rounded(each, "mm", math.ceil) for each in sorted({required.lowest, required.highest})]
        by = "formula within its range requires" if required.count == 1 else "formulas within their range require"
        needed = with_symbol(" to ".join(dict.fromkeys(thicknesses)), "mm")
        detail += f"; against {strike} {required.count} {by} {needed}"
    else:
        detail += f"; no formula is within its range for {strike}"
    return ModelWarning(code, detail)


def _plug_through_wall(projectile: Projectile, target: Target, resistance: Resistance) -> tuple[ModelWarning, ...]:
    """Warn about a plug that would be higher than `MOST_PLUG` of the wall."""
    height = plug_height(resistance=resistance, target=replace(target, thickness=None), projectile=projectile)
    if target.thickness is None or height <= MOST_PLUG * target.thickness:
        return ()
    return (
        ModelWarning(
            "plug_through_wall",
            f"the plug would be {quantity(height, 'mm', 3)} high in thicker concrete, and the wall is "
            f"{quantity(target.thickness, 'mm')} thick: the plug is taken as {100.0 * MOST_PLUG:g} % of the wall, and "
            "how such a wall holds is a guess",
        ),
    )


def _other_concrete(projectile: Projectile, target: Target) -> tuple[ModelWarning, ...]:
    """Warn about eq. 9 for a concrete or a projectile other than the ones to which it was fitted."""
    if _like_equation_9(projectile, target):
        return ()
    strength, diameter = target.compressive_strength, projectile.diameter
    other = PublishedTests().polynomial(target=target, projectile=projectile)[0]
    return (
        ModelWarning(
            "strength_factor_of_other_concrete",
            f"the strength factor of eq. 9 was fitted to concrete of {quantity(EQUATION_9_STRENGTH, 'MPa')} and a "
            f"projectile of {quantity(EQUATION_9_DIAMETER, 'mm')}; here are {quantity(strength, 'MPa')} and "
            f"{quantity(diameter, 'mm')}. In normal impact eq. 9 gives {EQUATION_9_COEFFICIENTS[0]:.3g}, the law "
            f"{PublishedTests.name} {other:.3g}",
        ),
    )


def _like_equation_9(projectile: Projectile, target: Target) -> bool:
    """Return whether strength and diameter are close to the values for which eq. 9 was fitted."""
    strength = abs(target.compressive_strength / EQUATION_9_STRENGTH - 1.0)
    diameter = abs(projectile.diameter / EQUATION_9_DIAMETER - 1.0)
    # The margin allows for rounding where a difference equals its limit.
    return strength <= SAME_STRENGTH * (1.0 + 1e-12) and diameter <= SAME_DIAMETER * (1.0 + 1e-12)


def scatter_of_table_1(projectile: Projectile, target: Target) -> ModelWarning:
    """Return the warning that S is assumed to scatter as little as in the paper's four tests."""
    same = projectile.nose == PAPER_PROJECTILE.nose and _like_equation_9(projectile, target)
    detail = (
        "the scatter of the strength factor is the one that the four tests of the paper's Table 1 leave, into its "
        f"concrete of {quantity(EQUATION_9_STRENGTH, 'MPa')}"
    )
    if not same:
        detail += ": nothing shows that it is known so well for this nose, diameter and strength"
    return ModelWarning("scatter_of_table_1", f"{detail}; without `strength_scatter` it is that of the law", same)


def own_tests_apart(posterior: StrengthPosterior) -> tuple[ModelWarning, ...]:
    """Warn about shots of `OwnTests` that are far from the prediction by the published tests and the other shots."""
    apart = [
        f"shot {number} (S {factor:.3g}, {abs(deviation):.2g} dispersions {'above' if deviation > 0.0 else 'below'})"
        for number, (factor, deviation) in enumerate(zip(posterior.factors, posterior.deviations, strict=True), start=1)
        if abs(deviation) > FAR_OFF
    ]
    if not apart:
        return ()
    more = f" and {len(apart) - MOST_NAMED} more" if len(apart) > MOST_NAMED else ""
    return (
        ModelWarning(
            "own_tests_apart",
            f"far from what the published tests and the other shots predict: {', '.join(apart[:MOST_NAMED])}{more}; "
            "compare speed, depth, mass and diameter with those measured",
        ),
    )


def _own_tests_deeper_than_wall(tests: OwnTests, target: Target) -> tuple[ModelWarning, ...]:
    if target.thickness is None:
        return ()
    deeper = [number for number, shot in enumerate(tests.shots, start=1) if shot.depth >= target.thickness]
    if not deeper:
        return ()
    more = f" and {len(deeper) - MOST_NAMED} more" if len(deeper) > MOST_NAMED else ""
    named = ", ".join(map(str, deeper[:MOST_NAMED])) + more
    return (
        ModelWarning(
            DEEPER_THAN_WALL,
            f"shots deeper than the wall of {quantity(target.thickness, 'mm')}: {named}; own tests must be into a "
            "target that stops them well before its rear, as one that is perforated says little of S",
        ),
    )


# Any excess counts, because the margins on the design values are for the scatter of the formulas. A third of the 251
# published shots to which S is fitted are deeper than every formula within its range, up to 1.6 times.
def own_tests_deeper_than_formulas(
    *, projectile: Projectile, target: Target, resistance: Resistance
) -> tuple[ModelWarning, ...]:
    """Warn about shots of `OwnTests` that went deeper than every formula within its range gives for them."""
    tests = resistance.strength_factor
    if not isinstance(tests, OwnTests):
        return ()
    deeper: list[tuple[float, int, float, str]] = []
    for number, shot in enumerate(tests.shots, start=1):
        impact = Impact(velocity=shot.velocity, oblique_angle=0.0)
        rows = formulas(projectile=body_of(shot, projectile), target=target, impact=impact)
        depths = [(row.penetration_depth, row.formula) for row in rows if row.in_range and row.penetration_depth]
        if depths and shot.depth > max(depths)[0]:
            depth, formula = max(depths)
            deeper.append((shot.depth / depth, number, depth, formula))
    if not deeper:
        return ()
    more = f" and {len(deeper) - MOST_NAMED} more" if len(deeper) > MOST_NAMED else ""
    named = ", ".join(str(number) for _, number, _, _ in deeper[:MOST_NAMED]) + more
    ratio, number, depth, formula = max(deeper)
    return (
        ModelWarning(
            DEEPER_THAN_FORMULAS,
            f"shots deeper than every formula within its range gives for them: {named}; shot {number} went to "
            f"{quantity(tests.shots[number - 1].depth, 'mm')}, {ratio:.2f} times the largest depth by a formula, "
            f"{quantity(depth, 'mm')} ({NAMES[formula]}): the design values, which come from formulas, may be too thin "
            "for this concrete",
        ),
    )


def _beyond_published_tests(projectile: Projectile, target: Target, velocity: float) -> tuple[ModelWarning, ...]:
    limits = (
        ("compressive strength", target.compressive_strength, PublishedTests.compressive_strengths, "MPa"),
        ("diameter", projectile.diameter, PublishedTests.diameters, "mm"),
        ("speed", velocity, PublishedTests.velocities, "m/s"),
    )
    # Rounding in a unit conversion may put a value at the end of a range just outside it.
    outside = [
        f"{name} {quantity(value, unit)} outside {interval(lowest, highest, unit)}"
        for name, value, (lowest, highest), unit in limits
        if not lowest * (1.0 - 1e-12) <= value <= highest * (1.0 + 1e-12)
    ]
    if not outside:
        return ()
    return (
        ModelWarning(
            "published_tests_extrapolated",
            f"the strength factor is extrapolated from published tests: {', '.join(outside)}",
        ),
    )


UNDECIDED = "undecided"
"""Code of the warnings about runs that ended at the termination time."""
DEEPER_THAN_WALL = "own_tests_deeper_than_wall"
"""Code of the warning about shots of `OwnTests` that went deeper than the wall is thick."""
DEEPER_THAN_FORMULAS = "own_tests_deeper_than_formulas"
"""Code of the warning about shots of `OwnTests` that went deeper than by every formula."""
RETENTION_DECIDES = "retention_decides"
"""Code of the warning about critical angles that depend on the retention energy."""


def undecided(*, termination_time: float) -> ModelWarning:
    """Return the warning about a run that was still in motion at its termination time."""
    return ModelWarning(
        UNDECIDED,
        f"still loaded or moving in at the termination time, {termination_time:g} s: neither embedded, turned away nor "
        "through",
    )


def decided_by_time(*, termination_time: float) -> ModelWarning:
    """Return the warning about a change of outcome next to a run that was still in motion at its termination time."""
    return ModelWarning(
        UNDECIDED,
        "next to a change of outcome, a trial was still loaded or moving in at the termination time, "
        f"{termination_time:g} s: that change separates what leaves by then, moves with that time, and is less certain "
        "than its bracket is wide",
    )


# The retention energy is a convention. A factor of ten either way is about a factor of three in speed.
RETENTION_RANGE = (0.1, 10.0)
"""Range of retention energies, relative to the one in use, within which an angle should hardly move. [1]"""


def retention_decides(*, retention: float, below: float, above: float) -> ModelWarning:
    """Return the warning about a critical angle that depends on the retention energy.

    Parameters
    ----------
    below, above
        Fractions of the energy left half a degree below and above the angle. [1]
    """
    low, high = (factor * retention for factor in RETENTION_RANGE)
    return ModelWarning(
        RETENTION_DECIDES,
        f"{_share(below, low)} of the energy is left half a degree below the angle, {_share(above, low)} half a degree "
        f"above it: between thresholds of {100.0 * low:g} % and {100.0 * high:g} % the angle moves by more than 0.5°; "
        "friction and rubble, which the model leaves out, decide what becomes of so slow a body",
    )


def retention_decides_perforation(*, angle: float, retention: float, outside: float, inside: float) -> ModelWarning:
    """Return the warning about a change to or from perforation that depends on the retention energy.

    Parameters
    ----------
    angle
        Angle of the change. [rad]
    outside, inside
        Fractions of the energy left half a degree outside and inside the perforated range. [1]
    """
    low, high = (factor * retention for factor in RETENTION_RANGE)
    return ModelWarning(
        "retention_decides_perforation",
        f"at {math.degrees(angle):.4g}° the outcome changes to or from perforation: half a degree outside the "
        f"perforated angles {_share(outside, low)} of the energy is left behind the wall, half a degree inside "
        f"{_share(inside, low)}: between thresholds of {100.0 * low:g} % and {100.0 * high:g} % that change moves by "
        "more than 0.5°",
    )


def _share(energy: float, least: float) -> str:
    """Format a fraction of the energy in per cent; 0 means that it is less than `least`."""
    return f"{100.0 * energy:.2g} %" if energy > 0.0 else f"less than {100.0 * least:g} %"


IMPLAUSIBLE = "implausible"
"""Code of warnings about physically impossible results."""


def implausible(what: str) -> ModelWarning:
    """Return the warning about a physically impossible answer, which is a sign of a bug."""
    return ModelWarning(
        IMPLAUSIBLE, f"{what}: no such strike exists; this is a fault of the program, please report it with the inputs"
    )


TUMBLING = "tumbling"
"""Code of the warning about projectiles that turn end over end."""


def tumbling(*, turned: float, oblique_angle: float) -> tuple[ModelWarning, ...]:
    """Warn about a projectile that turns end over end in the target."""
    if turned <= math.pi:
        return ()
    ends = "; the run ends there, in motion" if turned > MOST_TURN else ""
    return (
        ModelWarning(
            TUMBLING,
            f"at {in_degrees(oblique_angle, '.4g')} the projectile turns by {math.degrees(turned):.0f}° in the "
            "target: the model takes concrete that is broken already for intact, the outcomes of such strikes change "
            "within fractions of a degree, and a search may miss them" + ends,
        ),
    )


def range_clipped(*, upper: float, given: float) -> ModelWarning:
    """Return the warning about a search that ends below its range, where the strength factor falls to zero."""
    return ModelWarning(
        "range_clipped",
        f"the strength factor is above 0 up to {math.degrees(upper):.4g}° only: the search ends there, not at "
        f"{math.degrees(given):.4g}°",
    )


def shallow(*, depth: float, diameter: float) -> tuple[ModelWarning, ...]:
    """Warn about a body that came to rest within the front crater."""
    if depth >= CRATER_CALIBERS * diameter:
        return ()
    return (
        ModelWarning(
            "shallow_penetration",
            f"at rest {depth / diameter:.2g} diameters deep, within the front crater of about {CRATER_CALIBERS:g}: "
            "spalling, which the model leaves out, governs there",
        ),
    )


def bends(*, stress: float, time: float, distance: float, yield_strength: float | None) -> tuple[ModelWarning, ...]:
    """Warn about a projectile whose surface yields in bending, so it does not stay rigid."""
    limit = USUAL_YIELD_STRENGTH if yield_strength is None else yield_strength
    if stress <= limit:
        return ()
    given = "its yield strength" if yield_strength is not None else "that of hardened steel, as none is given"
    return (
        ModelWarning(
            BENDS,
            f"its surface yields in bending: {quantity(stress, 'MPa')}, {with_symbol(fixed(distance, 'mm'), 'mm')} "
            f"behind the tip, {1e3 * time:.2f} ms after first contact, are above {quantity(limit, 'MPa')}, {given}; "
            "from there on the motion of a rigid body says less",
        ),
    )


BENDS = "bends"
"""Code of the warning about bodies that yield in bending."""

BENDING_UNKNOWN = ModelWarning(
    "bending_unknown",
    "the centre of gravity or the moment of inertia given are not those of the homogeneous solid of the shape: how the "
    "mass lies along the axis is not known, so the bending stress is not computed",
    standing=True,
)

CRATER_AT_OBLIQUITY = ModelWarning(
    "crater_at_obliquity",
    "the crater is that of normal impact: at an angle it reduces the resistance to all parts of the body near the "
    "face, and moves the critical angle of the paper's strike from 48.6° to 64.4° at two diameters",
)

REAR_PLUG_QUASI_STATIC = (
    "nothing resists within the plug that shears out of the rear, of a height for quasi-static loads: its mass, its "
    "energy and reinforcement do not count"
)

NORMAL_COMPONENT_ONLY = ModelWarning(
    "normal_component_only",
    "the formulas have no angle: the component of the velocity along the normal takes its place, which is common "
    "practice and no more than that",
)

BASE_FIRST = ModelWarning(
    "base_strikes_first",
    "the rear edge touches first: the projectile strikes with its tail ahead",
)

ENERGY_GAIN = ModelWarning(
    "fixed_step_energy_gain",
    "the fixed time step is too long for parts of this motion: kinetic energy rose within a step; compare with the "
    "adaptive method or a shorter step",
)

NO_MEASURED_ANGLE = ModelWarning(
    "no_measured_angle",
    "no test of the critical ricochet angle of a rigid body on concrete is known in the open literature: the angle is "
    "the model's, checked against finite elements only",
    standing=True,
)

RICOCHET_AT_LOWER_BOUND = ModelWarning(
    "ricochet_at_lower_bound",
    "the projectile is turned away at the lower end of the search already: a smaller critical angle lies below it",
)

STANDARD_ERROR_UNKNOWN = ModelWarning(
    "standard_error_unknown",
    "with the strength factor one standard error lower or higher the search finds no critical angle in the range: the "
    "angle's own standard error is not known",
)


def shallow_shots(*, depths: Sequence[float], diameters: Sequence[float]) -> tuple[ModelWarning, ...]:
    """Warn about shots that ended within the front crater."""
    shallow_ones = [
        index
        for index, (depth, diameter) in enumerate(zip(depths, diameters, strict=True))
        if depth < CRATER_CALIBERS * diameter
    ]
    if not shallow_ones:
        return ()
    return (
        ModelWarning(
            "shallow_tests",
            f"{len(shallow_ones)} of {len(depths)} tests, the first of them number {shallow_ones[0] + 1}, ended less "
            f"than {CRATER_CALIBERS:g} diameters deep, within the front crater: spalling, which the model leaves out, "
            "governs there",
        ),
    )


def group_of_one(name: str) -> ModelWarning:
    """Return the warning about a group with a single test, to which no factor is fitted."""
    return ModelWarning(
        "group_of_one", f"group {name} has one test, which leaves no scatter to judge by: it is not fitted by itself"
    )
