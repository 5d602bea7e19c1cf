"""Sweeps of a case over a grid of inputs, and its answers with alternative decay and strength laws.

A sweep returns an ``xarray.Dataset``, which requires xarray. Answers with several laws show how much the law matters.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from solver.checks import RicochetError, plain, require
from solver.display import Row, column_attributes, optional
from solver.free_surface import ElasticPlastic, FreeSurface, MohrCoulomb, NoFreeSurface, decay_laws
from solver.many import ANSWERS, INPUTS, attempt, columns, critical_angle_many, simulate_many
from solver.projectile import Projectile
from solver.resistance import (
    EQUATION_9,
    FINITE_ELEMENTS_TO,
    ObliquityPolynomial,
    ObliquityShape,
    PublishedTests,
    Resistance,
    StrengthFactor,
    StrengthPowerLaw,
    shaped_as_finite_elements,
    usual_unless_given,
)
from solver.search.types import CriticalAngle, Search
from solver.strength_scatter import ScatterSource
from solver.strike import Impact, Numerics, full_name, is_part, label, put, short_names, strike_parts
from solver.target import Target
from solver.trajectory import Trajectory
from solver.units import WHOLE_DIGITS, Amount, interval, quantity
from solver.warnings import EQUATION_9_DIAMETER, EQUATION_9_STRENGTH

if TYPE_CHECKING:
    import xarray

# A sweep over 100,000 points takes minutes to hours; a larger one is probably a mistake in the axes.
MOST_POINTS = 100_000
"""Largest number of points of a grid."""
# The value is never used, and only has to be valid as a velocity.
ANY_VELOCITY = 1.0
"""Placeholder for the velocity where it is an axis. [m/s]"""
SWEPT = ("projectile", "target", "impact", "resistance")
"""Parts of a strike whose fields a sweep may vary."""
SYMBOLS = {"caliber_radius_head": "ψ"}
"""Symbols of fields in labels."""
DECAY_LAWS = {
    ElasticPlastic: "decay: theory",
    MohrCoulomb: "decay: theory, nearest to finite element motions",
    NoFreeSurface: "no decay",
}
"""Decay laws, each with a string that names its basis."""


def _data_of_equation_9() -> str:
    diameter, strength = quantity(EQUATION_9_DIAMETER, "mm"), quantity(EQUATION_9_STRENGTH, "MPa")
    fitted_to = math.degrees(ObliquityPolynomial.fitted_to)
    return f"S: finite elements, {diameter} into {strength}, 0° to {fitted_to:g}°"


def _data_of_published_tests() -> str:
    # The bounds of the tests are not round, so they are rounded to whole millimetres and megapascals.
    (thin, thick), (weak, strong) = PublishedTests.diameters, PublishedTests.compressive_strengths
    diameters = interval(round(thin, 3), round(thick, 3), "mm")
    strengths = interval(round(weak, -6), round(strong, -6), "MPa")
    return f"S: 251 tests at 0°, {diameters}, {strengths}, over the angle as eq. 9"


def _data_of_power_law() -> str:
    return "S: tests at 0° of Frew et al. (1998), over the angle constant"


STRENGTH_LAWS = {
    ObliquityPolynomial: _data_of_equation_9,
    PublishedTests: _data_of_published_tests,
    StrengthPowerLaw: _data_of_power_law,
}
"""Laws of the strength factor, each with a function that names the data to which its default constants were fitted."""
FINITE_ELEMENT_MOTIONS = (
    f"S: eq. 9 at 0°, over the angle finite element motions with this decay, to {math.degrees(FINITE_ELEMENTS_TO):g}°"
)
"""String that names the data to which `FINITE_ELEMENT_LAW` was fitted."""
FINITE_ELEMENT_LAW = shaped_as_finite_elements(ObliquityPolynomial())
"""Law with the S of eq. 9 in normal impact, and S(θ)/S(0) fitted to finite element motions with the decay law in
use."""

Answer = TypeVar("Answer")


def critical_angle_sweep(
    *,
    projectile: Projectile,
    target: Target,
    axes: Mapping[str, Iterable[Any]],
    velocity: float | None = None,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
    strength_scatter: ScatterSource = "law",
    degrees: bool = False,
    threads: int = 1,
) -> "xarray.Dataset":
    """Find the critical angle for every combination of the values of some inputs.

    Parameters
    ----------
    projectile, target, angle_of_attack, angular_velocity, resistance, numerics, search, strength_scatter
        As for `critical_angle`. [SI, rad]
    axes
        Values of each input, by its dotted name, such as ``target.compressive_strength``, or the last part of that name
        where it is unambiguous. Models, as for ``resistance.free_surface`` or ``projectile.nose``, are labelled by
        name, and models of the same name also by the values in which they differ, as in ``ogive ψ=3``. Other objects
        are labelled by ``repr``. A DataArray keeps the coordinates along its dimension.
    velocity
        As for `critical_angle`; not needed if it is an axis. [m/s]
    degrees
        Return angles in degrees, for example for plots; the values in `axes` remain in radians.
    threads
        Number of searches computed in parallel.

    Returns
    -------
    xarray.Dataset
        The columns of `solver.columns` over the axes, each with ``units`` and ``long_name``; ``to_netcdf`` writes them
        to a file. The attributes of the dataset hold the rest of the strike. A case that failed has NaN and its
        ``error``.

    Raises
    ------
    ParameterError
        If an axis is not a field of a strike, or a value is outside its range.
    ModuleNotFoundError
        If xarray is not installed.

    Examples
    --------
    >>> sweep = critical_angle_sweep(
    ...     projectile=projectile, target=target,
    ...     axes={"velocity": [200.0, 250.0], "compressive_strength": [30e6, 40e6]},
    ... )
    >>> sweep.angle.sel(velocity=250.0)

    With ``degrees=True``, ``sweep.angle.plot()`` shows degrees.
    """
    impact = Impact(
        velocity=ANY_VELOCITY if velocity is None else velocity,
        oblique_angle=0.0,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
    )
    grid = _Grid(strike_parts(impact, projectile, target, resistance, numerics), axes)
    require("impact.oblique_angle" not in grid.fields, "axes", "oblique_angle is what a search varies")
    swept = "impact.velocity" in grid.fields
    require(swept or velocity is not None, "velocity", "must be given, or be an axis")
    strikes = grid.strikes()
    answers = critical_angle_many(
        **{name: [strike[name] for strike in strikes] for name in ("projectile", "target", "resistance")},
        **{
            name: [getattr(strike["impact"], name) for strike in strikes]
            for name in ("velocity", "angle_of_attack", "angular_velocity")
        },
        numerics=numerics,
        search=search,
        strength_scatter=strength_scatter,
        threads=threads,
    )
    dataset = grid.dataset(answers, "critical angles", ["impact.oblique_angle"])
    return _in_degrees(dataset) if degrees else dataset


def simulate_sweep(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    axes: Mapping[str, Iterable[Any]],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    strength_scatter: ScatterSource = "law",
    degrees: bool = False,
    threads: int = 1,
) -> "xarray.Dataset":
    """Compute the trajectory for every combination of the values of some inputs, and return the final states.

    Parameters
    ----------
    projectile, target, impact, resistance, numerics, strength_scatter
        As for `simulate`. [SI, rad]
    axes
        Values by field, as for `critical_angle_sweep`.
    degrees
        Return the angles in degrees.
    threads
        Number of strikes computed in parallel.

    Returns
    -------
    xarray.Dataset
        The columns of `solver.columns` over the axes, as for `critical_angle_sweep`.

    Raises
    ------
    ParameterError
        If an axis is not a field of a strike, or a value is outside its range.
    ModuleNotFoundError
        If xarray is not installed.
    """
    grid = _Grid(strike_parts(impact, projectile, target, resistance, numerics), axes)
    strikes = grid.strikes()
    columns_of: dict[str, Any] = {name: [strike[name] for strike in strikes] for name in SWEPT}
    answers = simulate_many(**columns_of, numerics=numerics, strength_scatter=strength_scatter, threads=threads)
    dataset = grid.dataset(answers, "trajectories")
    return _in_degrees(dataset) if degrees else dataset


class _Grid:
    """Grid of strikes: a strike, and the values of the inputs that vary.

    Parameters
    ----------
    parts
        Parts of the strike by name.
    axes
        Values by field.

    Raises
    ------
    ParameterError
        If an axis is not a field of the strike or has no values.
    """

    def __init__(self, parts: Mapping[str, Any], axes: Mapping[str, Iterable[Any]]) -> None:
        self._xarray = optional("xarray", "a sweep", "critical_angle_many and simulate_many need nothing more")
        self._parts = {name: parts[name] for name in SWEPT}
        require(len(axes) > 0, "axes", "must hold a field with its values")
        self.fields = [full_name(self._parts, field, "axes") for field in axes]
        self._given: list[Any] = list(axes.values())
        self._values = [list(map(plain, plain(given))) for given in self._given]
        require(len(set(self.fields)) == len(self.fields), "axes", "must not name a field twice")
        for field, values in zip(self.fields, self._values, strict=True):
            require(len(values) > 0, f"axes.{field}", "must have values")
        count = math.prod(map(len, self._values))
        amounts = Amount(MOST_POINTS, "", WHOLE_DIGITS), Amount(count, "", WHOLE_DIGITS)
        require(count <= MOST_POINTS, "axes", "must make at most {} points, got {}", *amounts)

    def strikes(self) -> list[dict[str, Any]]:
        """Return the parts of every strike; the last axis varies fastest."""
        found = []
        for values in itertools.product(*self._values):
            parts = dict(self._parts)
            # An object is replaced before its own fields, which may be axes too.
            for field, value in sorted(zip(self.fields, values, strict=True), key=lambda each: each[0].count(".")):
                name, *path = field.split(".")
                parts[name] = put(parts[name], path, value)
            found.append(parts)
        return found

    def dataset(
        self, answers: Iterable[Trajectory | CriticalAngle | RicochetError], title: str, found: Sequence[str] = ()
    ) -> "xarray.Dataset":
        """Return the answers as a dataset; `found` names fields of the strike that the answers determine."""
        table = columns(list(answers))
        names = short_names(self.fields, table)
        coordinates: dict[str, tuple[Any, ...]] = {}
        for name, field, values, given in zip(names, self.fields, self._values, self._given, strict=True):
            coordinates |= _coordinates(name, field, values)
            for other, along in getattr(given, "coords", {}).items():  # a DataArray may label its values
                if other not in {*names, *table, *coordinates} and along.dims == given.dims:
                    coordinates[str(other)] = (name, along.values, along.attrs)
        shape = tuple(map(len, self._values))
        variables = {
            name: (names, each.reshape(shape), column_attributes(name, each, *ANSWERS)) for name, each in table.items()
        }
        varied = dict.fromkeys((*self.fields, *found), "varied")
        strike = {name: _in_full(part, name, varied) for name, part in self._parts.items()}
        engine = import_module(__package__).ENGINE_VERSION  # imported late, since the package imports this module
        attributes = {"title": title, "source": f"ricochet, engine {engine}"} | strike
        dataset: xarray.Dataset = self._xarray.Dataset(variables, coordinates, attributes)
        return dataset


def _in_full(value: Any, name: str, instead: Mapping[str, str]) -> str:
    """Return the `repr` of an object, with other strings for the fields in `instead`."""
    if name in instead:
        return instead[name]
    if not is_part(value):
        return repr(value)
    inside = (
        f"{field.name}={_in_full(getattr(value, field.name), f'{name}.{field.name}', instead)}"
        for field in fields(value)
    )
    return f"{type(value).__name__}({', '.join(inside)})"


def _in_degrees(dataset: "xarray.Dataset") -> "xarray.Dataset":
    """Return the dataset with angles and their rates in degrees."""
    units = {"rad": "degree", "rad/s": "degree/s"}
    angles = [name for name, variable in dataset.variables.items() if variable.attrs.get("units") in units]
    changed = {
        name: (
            dataset[name].dims,
            np.degrees(dataset[name].values),
            dataset[name].attrs | {"units": units[dataset[name].attrs["units"]]},
        )
        for name in angles
    }
    return dataset.assign_coords({name: changed.pop(name) for name in angles if name in dataset.coords}).assign(changed)


def _coordinates(name: str, field: str, values: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
    """Return the labels of an axis as a coordinate.

    Models of the same name get a suffix that distinguishes them: the numbers in which they differ or, if they differ in
    other values, a serial number. A second coordinate has their full representation.
    """
    texts = [field.rpartition(".")[2] if isinstance(value, list | tuple) else label(value) for value in values]
    if any(isinstance(each, str) for each in texts):
        texts = list(map(str, texts))
    labels = list(texts)
    for text in {each for each in texts if isinstance(each, str) and texts.count(each) > 1}:
        places = [place for place, each in enumerate(texts) if each == text]
        for place, difference in zip(places, _differences([values[place] for place in places]), strict=True):
            labels[place] = f"{text} {difference}"
    found: dict[str, tuple[Any, ...]] = {name: (name, labels, column_attributes(field, labels, *INPUTS))}
    if labels != texts:
        found[f"{name}_in_full"] = (name, list(map(repr, values)), {"long_name": f"{name}, in full"})
    return found


def _differences(models: Sequence[Any]) -> list[str]:
    """Return the numbers that distinguish each model from all others, or else serial numbers."""
    numbered = [str(number) for number in range(1, len(models) + 1)]
    if not all(is_part(model) for model in models) or len(set(map(type, models))) > 1:
        return numbered
    names = [each.name for each in fields(models[0])]
    varied = [name for name in names if any(getattr(model, name) != getattr(models[0], name) for model in models)]
    if not all(isinstance(getattr(model, name), int | float) for model in models for name in varied):
        return numbered
    found = [
        ", ".join(f"{SYMBOLS.get(name, name)}={_digits(getattr(model, name))}" for name in varied) for model in models
    ]
    return found if len(set(found)) == len(found) else numbered


def _digits(value: float) -> str:
    return str(value) if isinstance(value, bool) else f"{value:g}"


@dataclass(frozen=True, slots=True)
class Alternative(Generic[Answer]):
    """Answer to a case with one choice of laws."""

    resistance: Resistance
    """Resistance with these laws."""
    answer: Answer | RicochetError
    """Answer, or the error if the case cannot be computed with these laws."""

    def laws(self) -> Row:
        """Return the names of the laws, and the data and theory behind them, as columns of a table."""
        return {
            "decay_law": self.free_surface,
            "strength_law": self.strength_factor,
            "obliquity_shape": self.obliquity_shape,
            "fitted_to": self.fitted_to,
        }

    @property
    def free_surface(self) -> str:
        """Name of the decay law."""
        return self.resistance.free_surface.name

    @property
    def strength_factor(self) -> str:
        """Name of the law of the strength factor."""
        return self.resistance.strength_factor.name

    @property
    def obliquity_shape(self) -> ObliquityShape:
        """Dependence of S on the oblique angle."""
        return obliquity_shape(self.resistance)

    @property
    def fitted_to(self) -> str:
        """Data to which the strength law was fitted, and basis of the decay law."""
        return fitted_to(self.resistance)


def alternatives(
    function: Callable[..., Answer], *, resistance: Resistance | None = None, **case: Any
) -> tuple[Alternative[Answer], ...]:
    """Compute the answers to a case with each decay law and each of several strength laws.

    Parameters
    ----------
    function
        Function to call: `critical_angle` or `simulate`.
    resistance
        Resistance of the case. Its strength law and its decay law are replaced; other fields, and the inertia of the
        decay, are kept.
    **case
        Other arguments of the function.

    Returns
    -------
    tuple of Alternative
        Answers with elastic-plastic, Mohr-Coulomb and no decay, in this order. Each is combined with eq. 9, the law of
        published tests, and the power law of the strength alone (`StrengthPowerLaw`). With elastic-plastic and
        Mohr-Coulomb decay, eq. 9 is followed by the law whose S(θ) was fitted to finite element motions with that
        decay.

    Examples
    --------
    >>> for each in alternatives(critical_angle, projectile=projectile, target=target, velocity=238.0):
    ...     print(each.free_surface, each.strength_factor, each.answer.angle, each.fitted_to)
    """
    return tuple(
        Alternative(choice, attempt(function, case | {"resistance": choice}))
        for choice in alternative_resistances(usual_unless_given(resistance))
    )


def alternative_resistances(resistance: Resistance = EQUATION_9) -> tuple[Resistance, ...]:
    """Return the resistances that `alternatives` uses: the given one with each choice of the laws of decay and of S."""
    resistance = usual_unless_given(resistance)
    inertia = getattr(resistance.free_surface, "inertia", False)
    return tuple(
        replace(resistance, free_surface=decay, strength_factor=strength)
        for decay in decay_laws(inertia=inertia)
        for strength in _strength_laws(decay)
    )


def _strength_laws(decay: FreeSurface) -> tuple[StrengthFactor, ...]:
    first, *others = (law() for law in STRENGTH_LAWS)
    own = () if isinstance(decay, NoFreeSurface) else (FINITE_ELEMENT_LAW,)
    return (first, *own, *others)


def obliquity_shape(resistance: Resistance) -> ObliquityShape:
    """Return the dependence of S on the oblique angle for one of the alternative resistances."""
    model = resistance.strength_factor
    return model.obliquity_shape if isinstance(model, PublishedTests | StrengthPowerLaw) else "equation_9"


def fitted_to(resistance: Resistance) -> str:
    """Return the data to which the strength law of an alternative was fitted, and the basis of its decay law."""
    model = resistance.strength_factor
    strength = FINITE_ELEMENT_MOTIONS if model == FINITE_ELEMENT_LAW else STRENGTH_LAWS[type(model)]()
    return f"{strength}; {DECAY_LAWS[type(resistance.free_surface)]}"
