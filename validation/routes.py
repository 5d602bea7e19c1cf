"""Comparison of the two numerical methods ("routes"), Gauss points and panels, over random strikes of every kind.

Each strike has one combination of the discrete choices of the model, and random sizes, speeds and angles. A new choice
must be added to `Combination`; the table of combinations then includes it.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from solver import (
    BoatTail,
    Conical,
    ConstantStrengthFactor,
    Crater,
    ElasticPlastic,
    Flat,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    Ogive,
    Outcome,
    Profile,
    Projectile,
    Resistance,
    ShearPlug,
    Sphere,
    Spherical,
    Target,
    solid_properties,
)
from solver.free_surface import FreeSurface
from solver.motion import Run, Termination
from solver.prepared import OUTCOMES, PreparedCase, Protrusion, exit_of, integrate, prepare, protrusion_of
from solver.projectile import NoseShape
from solver.strike import RETENTION_ENERGY_FRACTION, USUAL, usual_termination_time
from solver.surface import deepest_offset

BODIES = (
    "ogive", "cone", "cap", "flat", "pointed profile", "truncated profile",
    "sphere", "boat-tail", "tapering profile",
)  # fmt: skip
"""Shapes of bodies. The first six are named after the nose, and the last two after the part behind the widest point; a
sphere has only one part."""
DECAYS: dict[str, FreeSurface] = {
    "elastic-plastic": ElasticPlastic(),
    "elastic-plastic, inertia": ElasticPlastic(inertia=True),
    "Mohr-Coulomb": MohrCoulomb(),
    "Mohr-Coulomb, inertia": MohrCoulomb(inertia=True),
    "none": NoFreeSurface(),
}
MOST_STEPS = 190_000
"""Largest number of steps of a run with panels, a little below the limit of the solver."""
PANELS, RAMP, GRAZING = "finer panels", "shorter ramp", "contact between panels"
"""Explanations of a difference between routes. `GRAZING` is a contact so shallow that no panel has its centre in the
concrete."""
SHORT_RAMPS = (0.01, 0.001)
"""Factors on the usual ramp of the static stress in the method of Gauss points; the panel method has no ramp. Because
of the ramp, a shank that rests against the wall of its hole creeps. Over a long path this turns the body by tenths of a
degree, and moves its last contact with the hole. [1]"""
GRAZING_DEPTH = 1e-3
"""Ratio of the depth of a contact to the length of the body below which the contact may lie between two rows of
panels. It is about the spacing of the rows with the `FINEST` resolution. [1]"""
NEAR_THRESHOLD = 3.0
"""Outcomes of the routes may differ if the energy left is within this factor of the retention energy. [1]"""
SPEED_TOLERANCE, DEPTH_TOLERANCE = 0.01, 0.02
"""Tolerance of the exit speed relative to the striking speed, and of depth and protrusion relative to the larger of
depth and diameter. [1]"""


class Resolution(NamedTuple):
    """Resolution of the panel method."""

    panels: int
    steps: float
    """Number of steps in the time to travel one diameter."""


COARSE = Resolution(4_000, 40.0)
FINER = (Resolution(16_000, 160.0), Resolution(64_000, 640.0))
"""Finer resolutions. A difference that vanishes with one of them was an error of the coarse panels."""
FINEST = Resolution(256_000, 640.0)
"""Resolution for strikes whose difference neither finer panels nor a shorter ramp removes; such a run takes minutes."""


class Combination(NamedTuple):
    """Choices of a strike: shape, decay law, and whether it has a wall, crater, plug, angle of attack and spin."""

    body: str
    wall: bool
    decay: str
    crater: bool
    plug: bool
    attack: bool
    spin: bool


CELLS = tuple(itertools.product(BODIES, (False, True), DECAYS))
"""Combinations of body, wall and decay; successive strikes go through them in turn."""
EXTRAS = {
    wall: tuple(itertools.product((False, True), (False, True) if wall else (False,), (False, True), (False, True)))
    for wall in (False, True)
}
"""Combinations of crater, plug, angle of attack and spin, without and with a wall."""
STRIDE = 5
"""Step in `EXTRAS` from one round through `CELLS` to the next. It is coprime to the lengths of `EXTRAS`, so every
combination occurs."""
COMBINATIONS = tuple(Combination(*cell, *extras) for cell in CELLS for extras in EXTRAS[cell[1]])
FULL_TABLE = len(CELLS) * len(EXTRAS[True])
"""Number of strikes after which every combination has occurred."""


class End(NamedTuple):
    """The part of the result of a run that is compared between the routes."""

    outcome: Outcome
    energy: float
    """Final kinetic energy, without rotation for a sphere, relative to the translational energy at first contact.
    [1]"""
    speed: float | None
    """Exit speed; None if the projectile does not leave. [m/s]"""
    depth: float
    """Greatest depth of the deepest point. [m]"""
    protrusion: Protrusion | None
    """Protrusion from the rear face of a wall, if any."""
    at_rest: bool
    """True if the run ended because the body was at rest. The panel method does not always detect rest."""
    time: float
    """Time at which the run ended. [s]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Strike:
    """A strike, as arguments of `simulate`."""

    combination: Combination
    projectile: Projectile
    target: Target
    impact: Impact
    resistance: Resistance

    def end(self, numerics: Numerics = USUAL, ramp_share: float = 1.0) -> End:
        """Return the result of the strike; `ramp_share` multiplies the ramp velocity of the static stress."""
        prepared, run = self.run(numerics, ramp_share)
        body = prepared.model.body
        outcome = OUTCOMES[run.end]
        left = exit_of(outcome, run.state.tolist(), body)
        _, _, _, *speeds, spin = run.state.tolist()
        energy = sum(speed**2 for speed in speeds)
        if not prepared.is_centred:
            energy += body.moment_of_inertia / body.mass * spin**2
        speed, out = left.speed if left else None, protrusion_of(outcome, run, body, self.target.thickness)
        at_rest = run.end == Termination.REST
        return End(outcome, energy / self.impact.velocity**2, speed, run.maximum_depth, out, at_rest, run.time)

    def run(self, numerics: Numerics, ramp_share: float = 1.0) -> tuple[PreparedCase, Run]:
        """Integrate the strike to the termination time of the numerics or, without one, as long as `simulate` does."""
        longest = usual_termination_time(length=self.projectile.length, velocity=self.impact.velocity)
        prepared = prepare(
            projectile=self.projectile,
            target=self.target,
            resistance=self.resistance,
            numerics=numerics.resolved(termination_time=longest),
        )
        law = prepared.law_at(self.impact)
        model = prepared.model._replace(law=law._replace(ramp_velocity=ramp_share * law.ramp_velocity))
        run, _ = integrate(prepared, model, self.impact, keep_steps=False)
        return prepared, run


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A strike, its results by both routes, and their difference."""

    number: int
    strike: Strike
    adaptive: End
    panels: End
    explained: str
    """Explanation of a difference: `PANELS`, `RAMP` or `GRAZING`; empty without a difference or an explanation."""
    difference: str
    """Difference without an explanation; empty if there is none."""


def combination(number: int) -> Combination:
    """Return the choices of the strike with this number."""
    turn, place = divmod(number, len(CELLS))
    cell = CELLS[place]
    extras = EXTRAS[cell[1]]
    return Combination(*cell, *extras[(STRIDE * turn + place) % len(extras)])


def random_strikes(count: int, seed: int) -> Iterator[Strike]:
    """Yield random strikes, with the combinations in `CELLS` in turn.

    Diameter 5 to 250 mm, shank of 1 to 8 diameters, velocity 30 to 900 m/s and walls of 0.2 to 6 diameters, evenly in
    their logarithms; mean density 3000 to 12,000 kg/m³; concrete of 10 to 150 MPa and 1900 to 2600 kg/m³; oblique angle
    0° to 85°, but 0° for one strike in eight; angle of attack up to 5° and spin up to a tenth of speed over length,
    with either sign; strength factor 3 to 15, inertia factor 0 to 1.5, crater of 0.5 to 3 diameters, plug of 40° to
    75°.
    """
    random = np.random.default_rng(seed)
    for number in range(count):
        yield _random_strike(combination(number), random)


def _random_strike(chosen: Combination, random: np.random.Generator) -> Strike:
    projectile = random_projectile(chosen.body, random)
    diameter, velocity = projectile.diameter, _log_uniform(random, 30.0, 900.0)
    target = Target(compressive_strength=random.uniform(10e6, 150e6), density=random.uniform(1900.0, 2600.0))
    thickness, oblique = _log_uniform(random, 0.2, 6.0) * diameter, math.radians(random.uniform(0.0, 85.0))
    head_on = random.integers(8) == 0
    attack = math.radians(random.uniform(-5.0, 5.0))
    spin = random.uniform(-0.1, 0.1) * velocity / projectile.length
    crater, plug = random.uniform(0.5, 3.0), math.radians(random.uniform(40.0, 75.0))
    return Strike(
        combination=chosen,
        projectile=projectile,
        target=replace(target, thickness=thickness) if chosen.wall else target,
        impact=Impact(
            velocity=velocity,
            oblique_angle=0.0 if head_on else oblique,
            angle_of_attack=attack if chosen.attack else 0.0,
            angular_velocity=spin if chosen.spin else 0.0,
        ),
        resistance=Resistance(
            strength_factor=ConstantStrengthFactor(value=random.uniform(3.0, 15.0)),
            inertia_factor=random.uniform(0.0, 1.5),
            free_surface=DECAYS[chosen.decay],
            crater=Crater(depth_diameters=crater) if chosen.crater else None,
            rear_plug=ShearPlug(cone_angle=plug) if chosen.plug else None,
        ),
    )


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def random_projectile(shape: str, random: np.random.Generator) -> Projectile:
    """Return a random body of this shape."""
    diameter = _log_uniform(random, 0.005, 0.25)
    nose = _random_nose(shape, diameter / 2.0, random)
    shank, tail = diameter * _log_uniform(random, 1.0, 8.0), None
    length = nose.length(diameter / 2.0) + shank
    if isinstance(nose, Sphere):
        length = diameter
    if isinstance(nose, Profile) and nose.falls:
        length = nose.points[-1][0]
    if shape == "boat-tail":
        tail = BoatTail(length=random.uniform(0.05, 1.0) * shank, base_diameter=random.uniform(0.0, 1.0) * diameter)
    body = Projectile(nose=nose, diameter=diameter, length=length, mass=1.0, boat_tail=tail)
    return replace(body, mass=random.uniform(3000.0, 12_000.0) * solid_properties(body).volume)


def _random_nose(shape: str, radius: float, random: np.random.Generator) -> NoseShape:
    slope, front, middle = _log_uniform(random, 0.02, 4.0), random.uniform(0.1, 0.9), random.uniform(0.2, 0.8)
    roundness = _log_uniform(random, 0.5, 10.0)
    if shape in ("ogive", "boat-tail"):
        return Ogive(caliber_radius_head=roundness)
    if shape == "cone":
        return Conical(length_to_diameter=slope)
    if shape == "cap":
        return Spherical(caliber_radius_head=roundness)
    if shape in ("flat", "sphere"):
        return Flat() if shape == "flat" else Sphere()
    height, begin = 2.0 * slope * radius, 0.0 if shape == "pointed profile" else front * radius
    # The middle point lies above the straight line, so the outline is convex.
    bend = begin + (radius - begin) * (middle + 0.5 * (1.0 - middle))
    if shape == "tapering profile":
        behind = ((height + front * radius, radius), (height + (front + roundness) * radius, (1.0 - middle) * radius))
        return Profile(points=((0.0, begin), (height, radius), *behind))
    return Profile(points=((0.0, begin), (middle * height, bend), (height, radius)))


def compare(number: int, strike: Strike) -> Comparison:
    """Compare both routes; as long as they differ, refine the panels, shorten the ramp, and use the finest panels."""
    adaptive, explained = strike.end(), ""
    sharp = adaptive
    panels = strike.end(_panel_numerics(strike, adaptive, COARSE))
    difference = _difference(strike, adaptive, panels)
    for resolution in FINER:
        if not difference:
            break
        panels, explained = strike.end(_panel_numerics(strike, adaptive, resolution)), PANELS
        difference = _difference(strike, adaptive, panels)
    for share in SHORT_RAMPS:
        if not difference:
            break
        sharp, explained = strike.end(ramp_share=share), RAMP
        difference = _difference(strike, sharp, panels)
    if difference:
        panels = strike.end(_panel_numerics(strike, adaptive, FINEST))
        explained = PANELS if not _difference(strike, adaptive, panels) else RAMP
        difference = _difference(strike, adaptive if explained == PANELS else sharp, panels)
    if difference and _grazes(strike, adaptive, panels):
        explained, difference = GRAZING, ""
    return Comparison(
        number=number,
        strike=strike,
        adaptive=adaptive,
        panels=panels,
        explained="" if difference else explained,
        difference=difference,
    )


def _grazes(strike: Strike, adaptive: End, panels: End) -> bool:
    """Return whether the routes agree until the panels lose contact, with the body barely in the concrete at that time.

    With the panels of `FINEST` the rows are about a thousandth of the length apart. An edge that is less deep contains
    no panel centre, but it contains Gauss points, which are placed on the part of the surface below the face.
    """
    if adaptive.speed is None or panels.speed is None or panels.time >= adaptive.time:
        return False
    prepared, run = strike.run(replace(USUAL, termination_time=panels.time))
    depth, _, axis_angle, *velocity, _ = run.state.tolist()
    shallow = depth + deepest_offset(prepared.model.body, axis_angle) < GRAZING_DEPTH * strike.projectile.length
    equal = abs(math.hypot(*velocity) - panels.speed) < SPEED_TOLERANCE * strike.impact.velocity
    return shallow and equal


def _panel_numerics(strike: Strike, adaptive: End, resolution: Resolution) -> Numerics:
    """Return numerics with this resolution, and a termination time of at most `MOST_STEPS` steps.

    Fixed steps do not always detect rest. A body that the adaptive method embeds before it reaches the rear face is
    therefore followed for at most 1.5 times as long as that run took.
    """
    velocity = strike.impact.velocity
    step = strike.projectile.diameter / velocity / resolution.steps
    end = min(usual_termination_time(length=strike.projectile.length, velocity=velocity), MOST_STEPS * step)
    rear = math.inf if strike.target.thickness is None else strike.target.thickness
    if adaptive.outcome is Outcome.EMBEDDED and adaptive.depth < rear:
        end = min(end, 1.5 * adaptive.time)
    return Numerics(method="panels", panels=resolution.panels, time_step=step, termination_time=end)


def _difference(strike: Strike, one: End, other: End) -> str:
    """Return the first difference beyond its tolerance as text; empty if there is none."""
    if one.outcome is not other.outcome:
        near = any(
            1.0 / NEAR_THRESHOLD < end.energy / RETENTION_ENERGY_FRACTION < NEAR_THRESHOLD for end in (one, other)
        )
        return "" if near else f"outcome: {one.outcome.value} and {other.outcome.value}"
    if one.speed is not None and other.speed is not None:
        error = abs(one.speed - other.speed) / strike.impact.velocity
        if error > SPEED_TOLERANCE:
            return f"exit speed: by {100.0 * error:.2g} % of the striking speed"
    on_wall = strike.target.thickness is not None
    drifts = on_wall and one.outcome is Outcome.EMBEDDED and not one.at_rest
    if one.outcome is Outcome.PERFORATED or drifts:
        # The distance that a body flies behind a wall is not compared, and neither is the last contact of a body that
        # drifts through the hole of its plug with too little energy to count as perforating.
        return ""
    size = max(one.depth, strike.projectile.diameter)
    error = abs(one.depth - other.depth) / size
    if error > DEPTH_TOLERANCE:
        return f"depth: by {100.0 * error:.2g} %"
    ways = [(0.0 if end.protrusion is None else end.protrusion.greatest) for end in (one, other)]
    error = abs(ways[0] - ways[1]) / size
    if one.at_rest:
        # The final protrusion is compared only at rest, because a body may also creep back through its hole.
        ends = [(0.0 if end.protrusion is None else end.protrusion.final or 0.0) for end in (one, other)]
        error = max(error, abs(ends[0] - ends[1]) / size)
    return f"protrusion: by {100.0 * error:.2g} %" if error > DEPTH_TOLERANCE else ""


def table_of_combinations(strikes: Iterator[Strike] | list[Strike]) -> Counter[Combination]:
    """Count the strikes of each combination, including combinations without any."""
    counts: Counter[Combination] = Counter(dict.fromkeys(COMBINATIONS, 0))
    counts.update(strike.combination for strike in strikes)
    return counts
