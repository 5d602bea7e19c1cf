"""Sweeps: one case over a grid of inputs, and under every decay law and every strength law on offer.

A grid comes as an ``xarray.Dataset``, for those who have xarray. The laws show how much the choice of model decides.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Generic, TypeVar

import numpy as np

from solver.checks import BOUNDS, ParameterError, RicochetError, require
from solver.free_surface import ElasticPlastic, MohrCoulomb, NoFreeSurface
from solver.many import columns, critical_angle_many, simulate_many
from solver.projectile import Projectile
from solver.resistance import EQUATION_9, ObliquityPolynomial, PublishedTests, Resistance, StrengthPowerLaw
from solver.search.types import CriticalAngle, Search
from solver.strike import Impact, Numerics, is_part, put, strike_parts
from solver.target import Target
from solver.trajectory import Trajectory

MOST_POINTS = 100_000
ANY_VELOCITY = 1.0
"""Velocity of a strike until the axis sets it. [m/s]"""
SWEPT = ("projectile", "target", "impact", "resistance")
"""Parts of a strike whose fields can be axes."""
QUANTITIES: Mapping[str, tuple[str, str]] = {
    "angle": ("rad", "critical angle from the normal"),
    "standard_error": ("rad", "standard error of the critical angle"),
    "bracket_low": ("rad", "lower end of the final bracket"),
    "bracket_high": ("rad", "upper end of the final bracket"),
    "maximum_depth": ("m", "greatest depth of the nose tip"),
    "strength_factor": ("1", "strength factor"),
    "final_time": ("s", "end of the run, since first contact"),
    "final_center_of_gravity_depth": ("m", "depth of the centre of gravity at the end"),
    "final_center_of_gravity_lateral": ("m", "way of the centre of gravity along the face"),
    "final_nose_tip_depth": ("m", "depth of the nose tip at the end"),
    "final_axis_angle": ("rad", "axis from the inward normal at the end"),
    "final_depth_velocity": ("m/s", "velocity along the inward normal at the end"),
    "final_lateral_velocity": ("m/s", "velocity along the face at the end"),
    "final_angular_velocity": ("rad/s", "angular velocity at the end"),
    "final_depth_force": ("N", "resistance along the inward normal at the end"),
    "final_lateral_force": ("N", "resistance along the face at the end"),
    "final_moment": ("N m", "moment of the resistance at the end"),
    "final_kinetic_energy": ("J", "kinetic energy at the end"),
}
"""Unit and description of a column of answers."""
DECAY_LAWS = {
    ElasticPlastic: "decay: theory",
    MohrCoulomb: "decay: theory, nearest to finite element motions",
    NoFreeSurface: "no decay",
}
"""Decay models, with what each was fitted to."""
STRENGTH_LAWS = {
    ObliquityPolynomial: "S: finite elements, 80 mm into 39 MPa, 0° to 45°",
    PublishedTests: "S: 213 tests at 0°, 10 to 203 mm, 13 to 108 MPa, over the angle as eq. 9",
    StrengthPowerLaw: "S: tests at 0° of Frew et al. (1998), over the angle constant",
}
"""Models of the strength factor with their default constants, with what each was fitted to."""

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
    threads: int = 1,
) -> Any:
    """Critical angles over every combination of the values of some inputs.

    Parameters
    ----------
    projectile, target, angle_of_attack, angular_velocity, resistance, numerics, search
        As for `critical_angle`. [SI, rad]
    axes
        Values by field: a dotted name, as in ``target.compressive_strength``, or its last part where that is clear.
        Models, as in ``resistance.free_surface`` or ``projectile.nose``, become coordinates by their names, those of
        one name with a number too.
    velocity
        As for `critical_angle`; not needed where it is an axis. [m/s]
    threads
        How many searches run at a time.

    Returns
    -------
    xarray.Dataset
        The columns of `solver.columns` over the axes, with ``units`` and ``long_name`` of each; ``to_netcdf`` writes
        it. A case that failed has NaN and its ``error``.

    Raises
    ------
    ParameterError
        If an axis is no field of a strike, or a value is outside what the model accepts.
    ModuleNotFoundError
        If xarray is not installed.

    Examples
    --------
    >>> sweep = critical_angle_sweep(
    ...     projectile=projectile, target=target,
    ...     axes={"velocity": [200.0, 250.0], "compressive_strength": [30e6, 40e6]},
    ... )
    >>> sweep.angle.sel(velocity=250.0), sweep.angle.plot()
    """
    values = {field: list(found) for field, found in axes.items()}
    impact = Impact(
        velocity=ANY_VELOCITY if velocity is None else velocity,
        oblique_angle=0.0,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
    )
    grid = _Grid(strike_parts(impact, projectile, target, resistance, numerics), values)
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
        threads=threads,
    )
    return grid.dataset(answers, "critical angles")


def simulate_sweep(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    axes: Mapping[str, Iterable[Any]],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    threads: int = 1,
) -> Any:
    """Trajectories over every combination of the values of some inputs, each by its end.

    Parameters
    ----------
    projectile, target, impact, resistance, numerics
        As for `simulate`. [SI, rad]
    axes
        Values by field, as for `critical_angle_sweep`.
    threads
        How many strikes run at a time.

    Returns
    -------
    xarray.Dataset
        As of `critical_angle_sweep`.

    Raises
    ------
    ParameterError
        If an axis is no field of a strike, or a value is outside what the model accepts.
    ModuleNotFoundError
        If xarray is not installed.
    """
    grid = _Grid(
        strike_parts(impact, projectile, target, resistance, numerics),
        {field: list(found) for field, found in axes.items()},
    )
    strikes = grid.strikes()
    columns_of: dict[str, Any] = {name: [strike[name] for strike in strikes] for name in SWEPT}
    answers = simulate_many(**columns_of, numerics=numerics, threads=threads)
    return grid.dataset(answers, "trajectories")


class _Grid:
    """A strike, and the values of the inputs that vary.

    Parameters
    ----------
    parts
        The strike.
    axes
        Values by field.

    Raises
    ------
    ParameterError
        If an axis is no field of the strike or has no values.
    """

    def __init__(self, parts: Mapping[str, Any], axes: Mapping[str, Sequence[Any]]) -> None:
        self._xarray = _xarray()
        self._parts = {name: parts[name] for name in SWEPT}
        require(len(axes) > 0, "axes", "must hold a field with its values")
        self.fields = [_resolved(self._parts, field) for field in axes]
        self._values = list(axes.values())
        require(len(set(self.fields)) == len(self.fields), "axes", "name a field twice")
        for field, values in zip(self.fields, self._values, strict=True):
            require(len(values) > 0, f"axes.{field}", "must have values")
        count = math.prod(map(len, self._values))
        require(count <= MOST_POINTS, "axes", f"must make {MOST_POINTS:,} points at most, got {count:,}")

    def strikes(self) -> list[dict[str, Any]]:
        """Return the parts of every strike, the last axis fastest."""
        found = []
        for values in itertools.product(*self._values):
            parts = dict(self._parts)
            for field, value in sorted(zip(self.fields, values, strict=True), key=lambda each: each[0].count(".")):
                name, *path = field.split(".")
                parts[name] = put(parts[name], path, value.item() if isinstance(value, np.generic) else value)
            found.append(parts)
        return found

    def dataset(self, answers: Iterable[Trajectory | CriticalAngle | RicochetError], title: str) -> Any:
        """Return the answers as a dataset."""
        last = [field.rpartition(".")[2] for field in self.fields]
        names = [name if last.count(name) == 1 else field for name, field in zip(last, self.fields, strict=True)]
        coordinates: dict[str, tuple[Any, ...]] = {}
        for name, field, values in zip(names, self.fields, self._values, strict=True):
            coordinates |= _coordinates(name, field, values)
        shape = tuple(map(len, self._values))
        variables = {}
        for name, column in columns(answers).items():
            unit, description = QUANTITIES.get(name, ("", name))
            attributes = {"long_name": description} | ({"units": unit} if unit else {})
            variables[name] = (names, column.reshape(shape), attributes)
        strike = {name: repr(part) for name, part in self._parts.items()}
        engine = import_module(__package__).ENGINE_VERSION  # the package imports this module
        attributes = {"title": title, "source": f"ricochet, engine {engine}"} | strike
        return self._xarray.Dataset(variables, coordinates, attributes)


def _resolved(parts: Mapping[str, Any], field: str) -> str:
    """Return the dotted name of a field that may be given by its last part.

    Raises
    ------
    ParameterError
        If there is no such field, or several.
    """
    known = list(_names(parts))
    found = [field] if field in known else [name for name in known if name.endswith(f".{field}")]
    if len(found) == 1:
        return found[0]
    what = f"may be {' or '.join(found)}" if found else f"is not there: known are {', '.join(known)}"
    raise ParameterError("axes", f"{field!r} {what}")


def _names(parts: Mapping[str, Any], before: str = "") -> Iterable[str]:
    """Yield the dotted names of the fields of a strike."""
    for name, part in parts.items():
        if before:
            yield f"{before}{name}"
        if is_part(part):
            fields = {each: getattr(part, each) for each in part.__dataclass_fields__}
            yield from _names(fields, f"{before}{name}.")


def _coordinates(name: str, field: str, values: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
    """Return the labels of an axis as a coordinate.

    Models of one name, and lists, are numbered, so that a label stands for one of them; a second coordinate has them in
    full.
    """
    plain = [_label(field, value) for value in values]
    labels = [
        f"{label} {plain[: place + 1].count(label)}" if isinstance(label, str) and plain.count(label) > 1 else label
        for place, label in enumerate(plain)
    ]
    found: dict[str, tuple[Any, ...]] = {name: (name, labels, _described(field))}
    if labels != plain:
        found[f"{name}_in_full"] = (name, list(map(repr, values)), {"long_name": f"{name}, in full"})
    return found


def _label(field: str, value: Any) -> Any:
    """Return a number or text as it is, the name of a model, and of a list that of its field."""
    if isinstance(value, list | tuple | np.ndarray):
        return field.rpartition(".")[2]
    return getattr(value, "name", value)


def _described(field: str) -> dict[str, str]:
    """Return the attributes of an axis."""
    name = field.rpartition(".")[2]
    described = {"long_name": name.replace("_", " ")}
    if field in BOUNDS:
        return described | {"units": BOUNDS[field].unit or "1"}
    return described | ({"units": "rad"} if field.startswith("impact.") else {})


def _xarray() -> Any:
    """Return xarray.

    Raises
    ------
    ModuleNotFoundError
        If it is not installed.
    """
    try:
        return import_module("xarray")
    except ModuleNotFoundError as error:
        if error.name != "xarray":
            raise
        raise ModuleNotFoundError(
            "a sweep needs xarray: pip install xarray; critical_angle_many and simulate_many need nothing more",
            name="xarray",
        ) from None


@dataclass(frozen=True, slots=True)
class Alternative(Generic[Answer]):
    """Answer to a case under one choice of the laws."""

    resistance: Resistance
    answer: Answer | RicochetError
    """The error, if the case cannot be computed with these laws."""

    @property
    def free_surface(self) -> str:
        """Name of the decay model."""
        return self.resistance.free_surface.name

    @property
    def strength_factor(self) -> str:
        """Name of the model of the strength factor."""
        return self.resistance.strength_factor.name

    @property
    def fitted_to(self) -> str:
        """What the laws were fitted to."""
        return fitted_to(self.resistance)


def alternatives(
    function: Callable[..., Answer], *, resistance: Resistance | None = None, **case: Any
) -> tuple[Alternative[Answer], ...]:
    """Answers to one case under each decay law with each strength law.

    Parameters
    ----------
    function
        `critical_angle` or `simulate`.
    resistance
        As in the case; only its inertia factor, and whether the decay includes inertia, are kept.
    **case
        The other arguments of the function.

    Returns
    -------
    tuple of Alternative
        Decay laws in the order elastic-plastic, Mohr-Coulomb, none; with each the strength laws of eq. 9, of the
        published tests, and of the strength alone.

    Examples
    --------
    >>> for each in alternatives(critical_angle, projectile=projectile, target=target, velocity=238.0):
    ...     print(each.free_surface, each.strength_factor, each.answer.angle, each.fitted_to)
    """
    return tuple(
        Alternative(choice, _attempt(function, case | {"resistance": choice}))
        for choice in alternative_resistances(resistance or EQUATION_9)
    )


def alternative_resistances(resistance: Resistance = EQUATION_9) -> tuple[Resistance, ...]:
    """Return each decay law with each strength law, with the inertia of the given resistance."""
    inertia = getattr(resistance.free_surface, "inertia", False)
    decays = (ElasticPlastic(inertia=inertia), MohrCoulomb(inertia=inertia), NoFreeSurface())
    return tuple(
        replace(resistance, free_surface=decay, strength_factor=strength())
        for decay in decays
        for strength in STRENGTH_LAWS
    )


def fitted_to(resistance: Resistance) -> str:
    """Return what the laws of one of these resistances were fitted to."""
    return f"{STRENGTH_LAWS[type(resistance.strength_factor)]}; {DECAY_LAWS[type(resistance.free_surface)]}"


def _attempt(function: Callable[..., Answer], case: dict[str, Any]) -> Answer | RicochetError:
    try:
        return function(**case)
    except RicochetError as error:
        return error
