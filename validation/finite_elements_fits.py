"""Strength factors fitted to the finite element runs, and the resulting outcomes and critical angles."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver import (
    ConstantStrengthFactor,
    CriticalAngle,
    ElasticPlastic,
    MohrCoulomb,
    Numerics,
    ObliquityPolynomial,
    Outcome,
    Resistance,
    Search,
    critical_angle,
    mass_properties,
    simulate,
)
from solver.calibration import (
    DecayLawFits,
    DepthFit,
    Estimate,
    MotionFit,
    MotionRun,
    ObliquityFit,
    ObliquityPoint,
    UndeterminedError,
    Weights,
    fit_decay_laws,
    fit_motion,
    fit_obliquity,
)
from solver.free_surface import FreeSurface
from solver.resistance import StrengthFactor, strength_factor
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from validation.reference import (
    MESHES,
    FiniteElementRun,
    Mesh,
    equation_9,
    finite_element_depths,
    finite_element_runs,
    history_of,
    impact_of,
    path_of_run,
    time_of_deepest_tip,
)
from validation.report import Progress, ReportTable

ELASTIC_PLASTIC, MOHR_COULOMB = ElasticPlastic(), MohrCoulomb()
LAWS: Mapping[str, FreeSurface] = {law.name: law for law in (ELASTIC_PLASTIC, MOHR_COULOMB)}
"""Decay laws for which a critical angle is predicted."""
LAW_NAMES = {"elastic_plastic": "elastic-plastic", "mohr_coulomb": "Mohr-Coulomb", "none": "no decay"}
PAPER_ANGLES = (15.0, 30.0, 45.0)
"""Oblique angles at which the paper calibrates. [°]"""
ROUGHER = Numerics(relative_tolerance=1e-5)
"""Coarser numerics for fits to a single quantity, which determine S to no more than two decimals."""
ALONE = {
    "depth_displacement": Weights(lateral=0.0, rotation=0.0),
    "lateral_displacement": Weights(depth=0.0, rotation=0.0),
    "rotation": Weights(depth=0.0, lateral=0.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The oblique runs with one mesh, and all fits for that mesh."""

    mesh: Mesh
    runs: Sequence[FiniteElementRun]
    """Oblique runs, in the order of their angles."""
    fits: DecayLawFits
    """Fits to each run until its nose tip is deepest."""
    later_fits: DecayLawFits
    """Fits to each run until its centre of gravity is deepest, which is later at large angles."""
    by_depth: DepthFit
    """Fit to the greatest depths in normal impact, where the decay law has no effect."""
    alone: Mapping[str, Mapping[float, Mapping[str, Estimate | None]]]
    """S fitted to each quantity separately, by law, oblique angle [°] and quantity; None if undetermined."""
    cpu_seconds: float
    """Processor time of `fits`. [s]"""

    def own(self, law: str, *, later: bool = False) -> dict[float, MotionFit]:
        """Return the fits with a decay law, by oblique angle [°]; a run that does not determine S is left out."""
        found = (self.later_fits if later else self.fits).laws[law]
        alone = found.alone if found else ()
        return {run.degrees: fit for run, fit in zip(self.runs, alone, strict=False) if fit is not None}

    def factors(self, law: str, *, later: bool = False) -> dict[float, Estimate]:
        """Return S by oblique angle: from the greatest depths at 0°, and from the motion at other angles. [°]"""
        return {0.0: self.by_depth.estimate} | {
            angle: fit.estimate for angle, fit in self.own(law, later=later).items()
        }

    def normalized_root_mean_square(self, law: str, *, later: bool = False) -> float:
        """Return the normalised RMS misfit of all oblique runs, each fitted with its own S. [1]"""
        return overall(self.own(law, later=later).values())


def overall(fits: Iterable[MotionFit]) -> float:
    """Return the normalised RMS misfit of several fits, which have equal weights. [1]"""
    return math.sqrt(float(np.mean([fit.normalized_root_mean_square**2 for fit in fits])))


def calibrations(progress: Progress) -> dict[Mesh, Calibration]:
    """Fit every run with every law, for each mesh."""
    return {mesh: _calibrate(mesh, progress) for mesh in MESHES}


def _calibrate(mesh: Mesh, progress: Progress) -> Calibration:
    runs = [run for run in finite_element_runs(mesh) if run.oblique_angle > 0.0]
    progress(f"finite elements, {mesh} mesh: fits to the motion")
    fit_laws([runs[0]], [time_of_deepest_tip(runs[0])])  # Compile before times are measured.
    ends = [time_of_deepest_tip(run) for run in runs]
    start = time.process_time()
    fits = fit_laws(runs, ends)
    spent = time.process_time() - start
    later = fit_laws(runs, [history_of(run).time_of_greatest_depth for run in runs])
    progress(f"finite elements, {mesh} mesh: fits to one quantity")
    alone = {
        name: {run.degrees: _fit_quantities(run, end, law) for run, end in zip(runs, ends, strict=True)}
        for name, law in LAWS.items()
    }
    return Calibration(
        mesh=mesh,
        runs=runs,
        fits=fits,
        later_fits=later,
        by_depth=finite_element_depths(mesh),
        alone=alone,
        cpu_seconds=spent,
    )


def fit_laws(runs: Sequence[FiniteElementRun], ends: Sequence[float]) -> DecayLawFits:
    """Fit S to runs with every decay law, using the motion of each run up to its time in `ends`. [s]"""
    return fit_decay_laws(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        runs=[
            MotionRun(impact=impact_of(run), history=history_of(run).until(end))
            for run, end in zip(runs, ends, strict=True)
        ],
    )


def _fit_quantities(run: FiniteElementRun, end: float, law: FreeSurface) -> dict[str, Estimate | None]:
    return {name: _fit_quantity(run, end, law, weights) for name, weights in ALONE.items()}


def _fit_quantity(run: FiniteElementRun, end: float, law: FreeSurface, weights: Weights) -> Estimate | None:
    try:
        fit = fit_motion(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            impact=impact_of(run),
            history=history_of(run).until(end),
            weights=weights,
            resistance=Resistance(free_surface=law),
            numerics=ROUGHER,
        )
    except UndeterminedError:
        return None
    return fit.estimate


RETAINED = 0.01
"""Least fraction of the initial kinetic energy with which a leaving projectile counts as turned away. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """State of the projectile in the last row of an oblique run."""

    run: FiniteElementRun
    tip_depth: float
    """Depth of the nose tip. [m]"""
    tip_velocity: float
    """Velocity of the nose tip along the inward normal. [m/s]"""
    center_velocity: float
    """Velocity of the centre of gravity along the inward normal. [m/s]"""
    energy_share: float
    """Kinetic energy as a fraction of the initial one. [1]"""

    @property
    def turned_away(self) -> bool:
        """Whether nose tip and centre of gravity move out of the target, with at least 1 % of the energy."""
        return max(self.tip_velocity, self.center_velocity) < 0.0 and self.energy_share >= RETAINED

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run: ricochet, embedded if the energy is spent, otherwise in motion."""
        if self.turned_away:
            return Outcome.RICOCHET
        return Outcome.EMBEDDED if self.energy_share < RETAINED else Outcome.IN_MOTION


def ending(run: FiniteElementRun) -> Ending:
    """Return the state in the last row of a run."""
    properties = mass_properties(PAPER_PROJECTILE)
    axis, rate = run.oblique_angle + run.rotation[-1], float(run.angular_velocity[-1])
    return Ending(
        run=run,
        tip_depth=float(path_of_run(run).depth[-1]),
        tip_velocity=float(run.depth_velocity[-1] - properties.center_of_gravity * math.sin(axis) * rate),
        center_velocity=float(run.depth_velocity[-1]),
        energy_share=_energy(run, -1) / _energy(run, 0),
    )


def _energy(run: FiniteElementRun, row: int) -> float:
    """Return the kinetic energy per mass in a row of a run. [J/kg]"""
    properties = mass_properties(PAPER_PROJECTILE)
    gyration = properties.moment_of_inertia / properties.mass
    speeds = run.depth_velocity[row] ** 2 + run.lateral_velocity[row] ** 2
    return 0.5 * float(speeds + gyration * run.angular_velocity[row] ** 2)


def modelled_outcome(run: FiniteElementRun, *, strength_factor: float, free_surface: FreeSurface) -> Outcome:
    """Return the outcome that the model predicts for the strike of a run."""
    law = ConstantStrengthFactor(value=strength_factor)
    return simulate(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact_of(run),
        resistance=Resistance(strength_factor=law, free_surface=free_surface),
        sample_interval=None,
    ).outcome


def bracket(runs: Sequence[FiniteElementRun]) -> tuple[float, float]:
    """Return the largest angle at which a run is not turned away, and the smallest at which one is. [rad]"""
    turned = {run.oblique_angle: ending(run).turned_away for run in runs if run.oblique_angle > 0.0}
    return max(angle for angle, away in turned.items() if not away), min(a for a, away in turned.items() if away)


def endings_table(runs: Sequence[FiniteElementRun]) -> ReportTable:
    """Return the table with the last row of each oblique run."""
    endings = [ending(run) for run in runs if run.oblique_angle > 0.0]
    words = {
        Outcome.RICOCHET: "turned away",
        Outcome.EMBEDDED: "embedded",
        Outcome.IN_MOTION: "retained so far, still in motion",
    }
    rows = [
        (
            each.run.degrees,
            each.run.mesh,
            float(each.run.time[-1]) * 1e3,
            round(each.tip_depth * 1e3, 1),
            round(each.tip_velocity, 1),
            round(each.center_velocity, 1),
            round(100.0 * each.energy_share, 2),
            words[each.outcome],
        )
        for each in sorted(endings, key=lambda each: each.run.oblique_angle)
    ]
    columns: tuple[str, ...] = ("oblique angle [°]", "mesh", "end [ms]", "tip depth [mm]", "tip velocity [m/s]")
    columns += ("velocity of the centre of gravity [m/s]", "energy left [%]", "outcome")
    caption = (
        "Last row of each oblique finite element run; velocities along the inward normal, negative outwards. Turned "
        f"away: nose tip and centre of gravity move out with at least {100.0 * RETAINED:g} % of the energy."
    )
    return ReportTable(name="finite-elements-endings", caption=caption, columns=columns, rows=rows)


CHOSEN = "second order, all runs"
LINEAR = "first order, all runs"
BY_ERRORS = "second order, all runs, weighted by standard errors"
LATER = "second order, all runs, to the deepest centre of gravity"
COMMON = "second order, angles of the finer mesh"
NEAR = "constant, mean of 45° to 50°"
TO_45 = "second order, up to 45°"
PAPER = "the paper's eq. 9"
SCAN = math.radians(0.3)
"""Scan interval of the search. Where S falls to zero at larger angles, projectiles may be turned away only in a narrow
range of angles, which a wider interval could miss. [rad]"""
NEAR_ANGLES = (45.0, 48.0, 50.0)
"""Angles near the change of outcome. [°]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A strength factor fitted to finite elements, and the critical angle of the paper's strike with it."""

    law: str
    mesh: Mesh | None
    """Mesh of the runs; None for eq. 9, which the paper fitted to finite elements of its own."""
    reading: str
    model: StrengthFactor
    fit: ObliquityFit | None
    fitted_to: float
    """Largest oblique angle for which S was fitted. [°]"""
    answer: CriticalAngle
    cpu_seconds: float

    @property
    def degrees(self) -> float | None:
        """The critical angle; None if there is none. [°]"""
        return None if self.answer.angle is None else math.degrees(self.answer.angle)

    @property
    def error_degrees(self) -> float | None:
        """Standard error of the critical angle; None if it is not known. [°]"""
        return None if self.answer.standard_error is None else math.degrees(self.answer.standard_error)

    @property
    def extrapolated(self) -> bool:
        """Whether the critical angle uses S beyond the fitted angles."""
        return self.degrees is not None and self.degrees > self.fitted_to

    @property
    def factor(self) -> float | None:
        """Strength factor at the critical angle; None if there is none. [1]"""
        if self.answer.angle is None:
            return None
        resistance = Resistance(strength_factor=self.model)
        return strength_factor(
            resistance=resistance, oblique_angle=self.answer.angle, target=PAPER_TARGET, projectile=PAPER_PROJECTILE
        )


@dataclass(frozen=True, slots=True)
class Predictions:
    """All predictions, with access by law, mesh and fit."""

    each: Sequence[Prediction]

    def of(self, law: str, mesh: Mesh | None, reading: str) -> Prediction:
        """Return the prediction with a decay law, mesh and fit of S."""
        (found,) = (p for p in self.each if (p.law, p.mesh, p.reading) == (law, mesh, reading))
        return found

    def chosen(self, law: str, mesh: Mesh) -> Prediction:
        """Return the prediction with the second-order fit of S to all runs with a mesh."""
        return self.of(law, mesh, CHOSEN)

    @property
    def paper(self) -> Prediction:
        """The prediction with the paper's eq. 9."""
        return self.of("elastic_plastic", None, PAPER)


def predictions(found: Mapping[Mesh, Calibration]) -> Predictions:
    """Compute the critical angle with each decay law, mesh and fit of S, and with the paper's eq. 9."""
    shared = [run.degrees for run in found["fine"].runs]
    equation = ObliquityPolynomial(coefficients=equation_9())
    _predict("elastic_plastic", None, PAPER, equation, None, PAPER_ANGLES[-1])  # Compile before times are measured.
    each = [_predict("elastic_plastic", None, PAPER, equation, None, PAPER_ANGLES[-1])]
    for law in LAWS:
        for mesh, calibration in found.items():
            each += _predictions_with_mesh(law, mesh, calibration, shared)
    return Predictions(each)


def _predictions_with_mesh(
    law: str, mesh: Mesh, calibration: Calibration, shared: Sequence[float]
) -> Iterator[Prediction]:
    factors = calibration.factors(law)
    readings = {
        CHOSEN: (factors, 2, False),
        LINEAR: (factors, 1, False),
        BY_ERRORS: (factors, 2, True),
        LATER: (calibration.factors(law, later=True), 2, False),
        TO_45: (_at_angles(factors, (0.0, *PAPER_ANGLES)), 2, False),
    }
    if mesh == "coarse":
        readings[COMMON] = (_at_angles(factors, (0.0, *shared)), 2, False)
    for reading, (points, order, weighted) in readings.items():
        fit = fit_obliquity(points=_points(points, weighted=weighted), order=order)
        yield _predict(law, mesh, reading, fit.model, fit, max(points))
    near = np.mean([estimate.strength_factor for estimate in _at_angles(factors, NEAR_ANGLES).values()])
    yield _predict(law, mesh, NEAR, ConstantStrengthFactor(value=float(near)), None, NEAR_ANGLES[-1])


def _at_angles(factors: Mapping[float, Estimate], angles: Sequence[float]) -> dict[float, Estimate]:
    return {angle: factor for angle, factor in factors.items() if angle in angles}


def _points(estimates: Mapping[float, Estimate], *, weighted: bool) -> list[ObliquityPoint]:
    return [
        ObliquityPoint(
            oblique_angle=math.radians(angle),
            strength_factor=estimate.strength_factor,
            standard_error=estimate.standard_error if weighted else None,
        )
        for angle, estimate in estimates.items()
    ]


def _predict(
    law: str, mesh: Mesh | None, reading: str, model: StrengthFactor, fit: ObliquityFit | None, fitted_to: float
) -> Prediction:
    start = time.process_time()
    answer = critical_angle(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=PAPER_VELOCITY,
        resistance=Resistance(strength_factor=model, free_surface=LAWS[law]),
        search=Search(scan_interval=SCAN),
    )
    return Prediction(
        law=law,
        mesh=mesh,
        reading=reading,
        model=model,
        fit=fit,
        fitted_to=fitted_to,
        answer=answer,
        cpu_seconds=time.process_time() - start,
    )
