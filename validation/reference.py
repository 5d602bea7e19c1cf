"""Published numbers, tests and finite element runs that the reports compare with the model, and fits to the runs.

Their sources are in `data/SOURCES.md`.
"""

import csv
import math
import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np

from service.reports.style import TipPath, tip_path
from solver import Impact, Resistance
from solver.arrays import FloatArray
from solver.calibration import (
    DepthFit,
    DepthTest,
    MotionFit,
    MotionHistory,
    fit_depth,
    fit_motion,
    predict_motion,
)
from solver.free_surface import FreeSurface
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

DATA = Path(__file__).with_name("data")
Mesh: TypeAlias = Literal["coarse", "fine"]
MESHES: Final[tuple[Mesh, ...]] = ("coarse", "fine")
"""Meshes of the finite element runs: cubes of 10 mm and 7.5 mm near the point of impact."""
THREADS = 2
"""Number of threads for long computations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperNumber:
    """A number printed in the paper."""

    table: str
    quantity: str
    key: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedShot:
    """A test of the paper's Table 1."""

    name: str
    mass: float
    """Mass of the projectile. [kg]"""
    velocity: float
    """Impact velocity. [m/s]"""
    depth: float
    """Depth of penetration. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PenetrationTest:
    """A published test of a steel projectile with an ogive nose in normal impact on concrete."""

    series: str
    row: int
    """Row in the data set from which it was taken."""
    mass: float
    """Mass of the projectile. [kg]"""
    diameter: float
    """Diameter of the projectile. [m]"""
    length: float | None
    """Length of the projectile; None if not known. [m]"""
    caliber_radius_head: float
    compressive_strength: float
    """Compressive strength of the concrete. [Pa]"""
    density: float
    """Density of the concrete. [kg/m³]"""
    target_diameter: float
    """Diameter of the target. [m]"""
    velocity: float
    """Impact velocity. [m/s]"""
    depth: float
    """Depth of penetration. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthShot:
    """A row of the compilation of depth tests: normal impact on concrete, mortar, grout or rock."""

    row: int
    article: int
    concrete: str
    """Name of the concrete in the compilation, often the label of a specimen."""
    compressive_strength: float
    """Compressive strength of the concrete. [Pa]"""
    density: float
    """Density of the concrete. [kg/m³]"""
    thickness: float | None
    """Thickness of the target; None if not known. [m]"""
    area: float | None
    """Area of the face of the target; None if not known. [m²]"""
    mass: float
    """Mass of the projectile; nan if not known. [kg]"""
    diameter: float
    """Diameter of the projectile. [m]"""
    length: float
    """Length of the projectile. [m]"""
    caliber_radius_head: float | None
    """Calibre-radius-head; None if not known, or if the nose has none. [1]"""
    projectile_density: float
    """Density of the projectile's material. [kg/m³]"""
    velocity: float
    """Impact velocity; nan if not known. [m/s]"""
    depth: float
    """Depth of penetration; nan if not known. [m]"""

    @property
    def series(self) -> tuple[int, float]:
        """Article and compressive strength. Shots with the same pair count as shots into one concrete."""
        return self.article, self.compressive_strength


@dataclass(frozen=True, slots=True, kw_only=True)
class FiniteElementRun:
    """A run of the project's finite element model of the paper's strike, with displacements since first contact."""

    name: str
    mesh: Mesh
    oblique_angle: float
    """Oblique angle of the strike. [rad]"""
    velocity: float
    """Impact velocity. [m/s]"""
    greatest_tip_depth: float
    """Greatest depth of the nose tip. [m]"""
    outcome: str
    """Name of the outcome in the solver; `in_motion` if the run ends before the outcome is decided."""
    cpu_seconds: float | None
    """CPU time; None if it was not recorded. [s]"""
    time: FloatArray
    """Time since first contact. [s]"""
    depth_displacement: FloatArray
    """Displacement of the centre of gravity along the inward normal. [m]"""
    lateral_displacement: FloatArray
    """Displacement of the centre of gravity along the face. [m]"""
    rotation: FloatArray
    """Rotation, positive if the nose turns toward the face. [rad]"""
    depth_velocity: FloatArray
    """Velocity of the centre of gravity along the inward normal. [m/s]"""
    lateral_velocity: FloatArray
    """Velocity of the centre of gravity along the face. [m/s]"""
    angular_velocity: FloatArray
    """Rate of the rotation. [rad/s]"""

    @property
    def degrees(self) -> float:
        """Oblique angle. [°]"""
        return round(float(np.degrees(self.oblique_angle)), 6)


@cache
def paper_numbers() -> tuple[PaperNumber, ...]:
    """Return every number of the paper that the reports use, in the order of the file."""
    return tuple(
        PaperNumber(
            table=row["table"],
            quantity=row["quantity"],
            key=row["key"],
            value=float(row["value"]),
            unit=row["unit"],
        )
        for row in _rows("paper_tables.csv")
    )


def paper_value(quantity: str, key: str | None = None) -> float:
    """Return one number of the paper.

    Parameters
    ----------
    quantity, key
        Names in `paper_tables.csv`; `key` distinguishes several values of a quantity.
    """
    (found,) = (each for each in paper_numbers() if each.quantity == quantity and key in (None, each.key))
    return found.value


def table_1() -> tuple[PublishedShot, ...]:
    """Return the depth tests of the paper's Table 1, slowest first."""
    shots = []
    for each in paper_numbers():
        if each.table == "1":
            name, mass, velocity = re.findall(r"^(\S+) ([\d.]+)kg ([\d.]+)m/s", each.key)[0]
            shots.append(PublishedShot(name=name, mass=float(mass), velocity=float(velocity), depth=each.value))
    return tuple(shots)


def table_2() -> tuple[tuple[float, float], ...]:
    """Return oblique angles and strength factors of the paper's Table 2. [°, 1]"""
    return tuple((float(each.key.split()[-2]), each.value) for each in paper_numbers() if each.table == "2")


def equation_9() -> tuple[float, ...]:
    """Return the coefficients of the paper's eq. 9. [1, 1/°, 1/°²]"""
    return tuple(each.value for each in paper_numbers() if each.table == "eq9")


@cache
def penetration_tests() -> tuple[PenetrationTest, ...]:
    """Return all published depth tests, in the order of the file."""
    return tuple(
        PenetrationTest(
            series=row["series"],
            row=int(row["row"]),
            mass=float(row["mass_kg"]),
            diameter=float(row["diameter_m"]),
            length=float(row["length_m"]) if row["length_m"] else None,
            caliber_radius_head=float(row["caliber_radius_head"]),
            compressive_strength=float(row["compressive_strength_pa"]),
            density=float(row["density_kg_m3"]),
            target_diameter=float(row["target_diameter_m"]),
            velocity=float(row["striking_velocity_m_s"]),
            depth=float(row["penetration_depth_m"]),
        )
        for row in _rows("penetration_tests.csv")
    )


@cache
def depth_shots() -> tuple[DepthShot, ...]:
    """Return every row of the compilation of depth tests, in the order of the file."""
    return _depth_shots("depth_tests.csv")


@cache
def never_fitted_shots() -> tuple[DepthShot, ...]:
    """Return every row of the articles kept out of all fits for an external check, in the order of the file."""
    return _depth_shots("depth_tests_never_fitted.csv")


def _depth_shots(name: str) -> tuple[DepthShot, ...]:
    return tuple(
        DepthShot(
            row=int(row["row"]),
            article=int(row["article"]),
            concrete=row["concrete"],
            compressive_strength=float(row["compressive_strength_pa"]),
            density=float(row["density_kg_m3"]),
            thickness=_optional(row["target_thickness_m"]),
            area=_optional(row["target_area_m2"]),
            mass=_optional(row["mass_kg"]) or math.nan,
            diameter=float(row["diameter_m"]),
            length=float(row["length_m"]),
            caliber_radius_head=_optional(row["caliber_radius_head"]),
            projectile_density=float(row["projectile_density_kg_m3"]),
            velocity=_optional(row["striking_velocity_m_s"]) or math.nan,
            depth=_optional(row["penetration_depth_m"]) or math.nan,
        )
        for row in _rows(name)
    )


def _optional(text: str) -> float | None:
    """Return a number; None for an empty field or for 0, which both mean unknown."""
    return (float(text) or None) if text else None


@cache
def finite_element_runs(mesh: Mesh = "coarse") -> tuple[FiniteElementRun, ...]:
    """Return the runs with one mesh: normal impacts by velocity, then oblique impacts by angle."""
    return tuple(_finite_element_run(row) for row in _rows("finite_element/runs.csv") if row["mesh"] == mesh)


def finite_element_run(name: str) -> FiniteElementRun:
    """Return one run by its name, such as `oblique-45` or `fine-oblique-45`."""
    (found,) = (run for mesh in MESHES for run in finite_element_runs(mesh) if run.name == name)
    return found


def _finite_element_run(row: dict[str, str]) -> FiniteElementRun:
    rows = _rows(f"finite_element/{row['name']}.csv")
    table = {name: np.array([float(each[name]) for each in rows]) for name in rows[0]}
    return FiniteElementRun(
        name=row["name"],
        mesh="fine" if row["mesh"] == "fine" else "coarse",
        oblique_angle=float(np.radians(float(row["oblique_angle_deg"]))),
        velocity=float(row["velocity_m_s"]),
        greatest_tip_depth=float(row["greatest_tip_depth_m"]),
        outcome=row["outcome"],
        cpu_seconds=float(row["cpu_s"]) if row["cpu_s"] else None,
        time=table["time_s"],
        depth_displacement=table["depth_displacement_m"],
        lateral_displacement=table["lateral_displacement_m"],
        rotation=np.radians(table["rotation_deg"]),
        depth_velocity=table["depth_velocity_m_s"],
        lateral_velocity=table["lateral_velocity_m_s"],
        angular_velocity=np.radians(table["angular_velocity_deg_s"]),
    )


def _rows(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((DATA / name).read_text(encoding="utf-8").splitlines()))


def paper_strike(oblique_angle: float) -> Impact:
    """Return the paper's strike at an oblique angle. [rad]"""
    return Impact(velocity=PAPER_VELOCITY, oblique_angle=oblique_angle)


def impact_of(run: FiniteElementRun) -> Impact:
    """Return the strike of a finite element run."""
    return Impact(velocity=run.velocity, oblique_angle=run.oblique_angle)


def history_of(run: FiniteElementRun) -> MotionHistory:
    """Return the motion of a finite element run; in normal impact it has depths only."""
    depth_only = MotionHistory(time=run.time, depth_displacement=run.depth_displacement)
    if run.oblique_angle == 0.0:
        return depth_only
    return replace(depth_only, lateral_displacement=run.lateral_displacement, rotation=run.rotation)


@cache
def finite_element_fit(name: str) -> MotionFit:
    """Fit S to a finite element run until its nose tip is deepest."""
    run = finite_element_run(name)
    return fit_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact_of(run),
        history=history_of(run).until(time_of_deepest_tip(run)),
    )


@cache
def finite_element_depths(mesh: Mesh = "coarse") -> DepthFit:
    """Fit S to the greatest depths of the normal finite element runs."""
    normal = [run for run in finite_element_runs(mesh) if run.oblique_angle == 0.0]
    tests = [DepthTest(velocity=run.velocity, depth=float(run.depth_displacement.max())) for run in normal]
    return fit_depth(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, tests=tests)


def time_of_deepest_tip(run: FiniteElementRun) -> float:
    """Return the time at which the nose tip of a finite element run is deepest; the tail may sink for longer. [s]"""
    return float(run.time[int(np.argmax(path_of_run(run).depth))])


def path_of_run(run: FiniteElementRun) -> TipPath:
    """Return the path of the nose tip of a finite element run."""
    return tip_path(
        PAPER_PROJECTILE,
        time=run.time,
        depth_displacement=run.depth_displacement,
        lateral_displacement=run.lateral_displacement,
        axis_angle=run.oblique_angle + run.rotation,
    )


def motion_of(
    impact: Impact, *, strength_factor: float, times: FloatArray, free_surface: FreeSurface | None = None
) -> MotionHistory:
    """Return the motion of the paper's projectile by the adaptive method, with elastic-plastic decay by default."""
    return predict_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=impact,
        strength_factor=strength_factor,
        times=times,
        resistance=None if free_surface is None else Resistance(free_surface=free_surface),
    )


def path_of(history: MotionHistory, impact: Impact) -> TipPath:
    """Return the path of the nose tip in an oblique strike.

    Raises
    ------
    ValueError
        If the history lacks the depth, the lateral displacement or the rotation.
    """
    depth, lateral, rotation = history.depth_displacement, history.lateral_displacement, history.rotation
    if depth is None or lateral is None or rotation is None:
        raise ValueError("a path from the side needs depth, lateral displacement and rotation")
    return tip_path(
        PAPER_PROJECTILE,
        time=history.time,
        depth_displacement=depth,
        lateral_displacement=lateral,
        axis_angle=impact.axis_angle + rotation,
    )
