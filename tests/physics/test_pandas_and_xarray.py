"""Tables and arrays of pandas and xarray as inputs and answers."""

import copy
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from importlib.util import find_spec
from inspect import isfunction, signature
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import solver
import solver.calibration
import solver.uncertainty
from solver import Resistance
from solver.calibration import DepthTest, MotionHistory, ObliquityPoint, fit_depth, fit_obliquity, penetration_depths
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.uncertainty import (
    Discrete,
    Normal,
    Sampling,
    Uncertain,
    critical_angle_uncertainty,
    trajectory_uncertainty,
)

from .strikes import CASE

xarray = pytest.importorskip("xarray")
ROUGH = solver.Search(tolerance=math.radians(0.5))
WALL = solver.Target(compressive_strength=39e6, density=2250.0, thickness=0.3)
IMPACTS = [paper_impact(oblique_angle_degrees=angle) for angle in (20.0, 60.0)]
SHOTS = [solver.Shot(velocity=238.1, depth=0.30), solver.Shot(velocity=250.0, depth=0.32)]
TESTS = [DepthTest(velocity=200.0, depth=0.20), DepthTest(velocity=250.0, depth=0.29)]


def held(values: Sequence[Any]) -> Any:
    """Return values as an array, which has the type object unless they are floats or tuples of floats."""
    return np.array(values, None if isinstance(values[0], float | tuple) else object)


HOLDERS: dict[str, Callable[[Sequence[Any]], Any]] = {
    "tuple": tuple,
    "array": held,
    "series": lambda values: pd.Series(list(values), index=range(7, 7 + len(values))),
    "data array": lambda values: xarray.DataArray(held(values)),
}
PLACES: dict[str, tuple[Callable[[Any], Any], list[Any]]] = {
    "critical_angle_many": (
        lambda values: list(solver.critical_angle_many(**CASE, velocity=values, search=ROUGH)),
        [200.0, 250.0],
    ),
    "critical_angle_many, another": (
        lambda values: list(solver.critical_angle_many(**CASE, velocity=238.0, angle_of_attack=values, search=ROUGH)),
        [0.0, 0.02],
    ),
    "simulate_many": (lambda values: list(solver.simulate_many(**CASE, impact=values)), IMPACTS),
    "least_thickness_many": (lambda values: list(solver.least_thickness_many(**CASE, impact=values)), IMPACTS[:1]),
    "limit_velocity_many": (
        lambda values: list(
            solver.limit_velocity_many(projectile=PAPER_PROJECTILE, target=WALL, oblique_angle=values, tolerance=0.1)
        ),
        [0.0, 0.1],
    ),
    "critical_angle_sweep": (
        lambda values: (
            solver.critical_angle_sweep(**CASE, axes={"velocity": values}, search=ROUGH).fillna(-1.0).to_dict()
        ),
        [200.0, 250.0],
    ),
    "simulate_sweep": (
        lambda values: (
            solver.simulate_sweep(**CASE, impact=IMPACTS[0], axes={"oblique_angle": values}).fillna(-1.0).to_dict()
        ),
        [0.3, 0.9],
    ),
    "coefficients": (lambda values: solver.ObliquityPolynomial(coefficients=values), [8.469, 0.0149, -0.0013]),
    "points": (lambda values: solver.Profile(points=values), [(0.0, 0.0), (0.13, 0.04)]),
    "shots": (lambda values: solver.OwnTests(shots=values), SHOTS),
    "discrete values": (lambda values: Discrete(values=values), [200.0, 250.0]),
    "weights": (lambda values: Discrete(values=[1.0, 2.0], weights=values), [0.25, 0.75]),
    "velocities": (lambda v: penetration_depths(**CASE, velocities=v, strength_factor=8.0).tolist(), [200.0, 250.0]),
    "masses": (
        lambda values: penetration_depths(
            **CASE, velocities=[200.0, 250.0], masses=values, strength_factor=8.0
        ).tolist(),
        [12.0, 13.0],
    ),
    "history": (
        lambda values: np.array(list(MotionHistory(time=values, rotation=values).columns.values())).tolist(),
        [0.0, 1e-3],
    ),
    "tests": (lambda values: fit_depth(**CASE, tests=values).estimate, TESTS),
}


@pytest.mark.parametrize("place", PLACES)
def test_sequence_may_be_an_array_a_series_or_a_data_array(place: str) -> None:
    function, values = PLACES[place]
    expected = function(values)
    for holder, hold in HOLDERS.items():
        assert function(hold(values)) == expected, holder


TWO_LAWS = [
    Resistance(crater=solver.Crater()),
    Resistance(strength_factor=solver.ConstantStrengthFactor(value=8.0), free_surface=solver.NoFreeSurface()),
]


@pytest.mark.parametrize(
    ("answers", "inputs"),
    [
        (
            lambda: solver.critical_angle_many(**CASE, velocity=pd.Series([200.0, -1.0], [5, 7]), search=ROUGH),
            {"velocity": [200.0, -1.0]},
        ),
        (
            lambda: solver.critical_angle_many(
                projectile=PAPER_PROJECTILE, target=[PAPER_TARGET, WALL], velocity=238.0, search=ROUGH, threads=2
            ),
            {
                "compressive_strength": [39e6, 39e6],
                "density": [2250.0, 2250.0],
                "poissons_ratio": [0.5, 0.5],
                "thickness": [math.nan, 0.3],
            },
        ),
        (
            lambda: solver.simulate_many(**CASE, impact=IMPACTS, resistance=TWO_LAWS),
            {
                "velocity": [238.0, 238.0],
                "oblique_angle": [math.radians(20.0), math.radians(60.0)],
                "angle_of_attack": [0.0, 0.0],
                "angular_velocity": [0.0, 0.0],
                "resistance.strength_factor": ["obliquity_polynomial", "constant"],
                "coefficients": ["(8.469, 0.0149, -0.0013)", ""],
                "inertia_factor": [1.0, 1.0],
                "free_surface": ["elastic_plastic", "none"],
                "inertia": [0.0, math.nan],
                "depth_diameters": [2.0, math.nan],
                "value": [math.nan, 8.0],
            },
        ),
        (lambda: solver.least_thickness_many(**CASE, impact=IMPACTS[0]), {}),
        (
            lambda: solver.limit_velocity_many(projectile=PAPER_PROJECTILE, target=WALL, oblique_angle=[0.0, 0.1]),
            {"oblique_angle": [0.0, 0.1]},
        ),
    ],
)
def test_tables_of_many_answers_begin_with_the_inputs(
    answers: Callable[[], Any], inputs: dict[str, list[float | str]]
) -> None:
    alone = solver.columns(list(answers()))
    table = solver.to_dataframe(answers())
    assert list(table.columns) == [*inputs, *alone]
    pd.testing.assert_frame_equal(table[list(alone)], pd.DataFrame(alone))
    for name, values in inputs.items():
        assert table[name].tolist() == pytest.approx(values, nan_ok=True), name


FRAME = {"velocity": [200.0, 250.0, 300.0], "depth": [0.20, 0.29, 0.40]}
ANGLES = pd.DataFrame({"oblique_angle": [0.0, 0.3, 0.6, 0.8], "strength_factor": [8.5, 8.2, 7.9, 6.5]})
ALL_COLUMNS = FRAME | {
    "mass": [math.nan, 12.9, 13.1],
    "weight": [1.0, math.nan, 2.0],
    "group": ["a", "a", pd.NA],
}


def test_rows_of_a_frame_are_accepted_as_tests_points_and_shots() -> None:
    frame = pd.DataFrame(FRAME, index=[3, 5, 7])
    tests = [DepthTest(velocity=row.velocity, depth=row.depth) for row in frame.itertuples()]
    assert fit_depth(**CASE, tests=frame).estimate == fit_depth(**CASE, tests=tests).estimate
    shots = solver.OwnTests(shots=frame).shots
    assert shots == tuple(solver.Shot(velocity=row.velocity, depth=row.depth) for row in frame.itertuples())
    points = [
        ObliquityPoint(oblique_angle=row.oblique_angle, strength_factor=row.strength_factor)
        for row in ANGLES.itertuples()
    ]
    assert fit_obliquity(points=ANGLES).model == fit_obliquity(points=points).model


def test_missing_values_of_a_frame_are_omitted_fields() -> None:
    found = fit_depth(**CASE, tests=pd.DataFrame(ALL_COLUMNS | {"group": ["a", "a", "b"]}))
    tests = [
        DepthTest(velocity=200.0, depth=0.20, group="a"),
        DepthTest(velocity=250.0, depth=0.29, mass=12.9, group="a"),
        DepthTest(velocity=300.0, depth=0.40, mass=13.1, weight=2.0, group="b"),
    ]
    assert found.estimate == fit_depth(**CASE, tests=tests).estimate
    assert list(found.groups) == ["a"]


@pytest.mark.parametrize(
    ("tests", "words"),
    [
        (
            pd.DataFrame(FRAME | {"mass_kg": 13.0}),
            "columns velocity, depth, and may have mass, weight, group; got velocity, depth, mass_kg",
        ),
        (pd.DataFrame({"velocity": [200.0, 250.0]}), "tests: must have the columns velocity, depth"),
        (
            pd.DataFrame(FRAME | {"velocity": [200.0, math.nan, 1.0]}),
            r"tests.1.velocity: must be 0.1 to 10,000 m/s, got nan m/s",
        ),
        (pd.DataFrame(ALL_COLUMNS), "tests.2.group: must be given"),
        ([{"velocity": 200.0, "depth": 0.2}], "tests.0: must be a DepthTest, got dict"),
        ([TESTS[0], 250.0], "tests.1: must be a DepthTest, got float"),
    ],
)
def test_invalid_tests_are_refused_with_the_accepted_types(tests: Any, words: str) -> None:
    with pytest.raises(solver.ParameterError, match=words):
        fit_depth(**CASE, tests=tests)


LAWS = [solver.ElasticPlastic(), solver.NoFreeSurface()]


@pytest.mark.parametrize(
    ("field", "values", "labels"),
    [
        ("velocity", xarray.DataArray([200.0, 250.0], dims="velocity"), [200.0, 250.0]),
        ("velocity", pd.Series([200, 250], [5, 7]), [200, 250]),
        ("velocity", range(200, 202), [200, 201]),
        ("free_surface", xarray.DataArray(held(LAWS)), ["elastic_plastic", "none"]),
        ("crater", [None, solver.Crater()], ["none", "Crater(depth_diameters=2.0)"]),
        ("thickness", [None, 0.5], ["none", "0.5"]),
        (
            "boat_tail",
            [None, solver.BoatTail(length=0.1, base_diameter=0.06)],
            ["none", "BoatTail(length=0.1, base_diameter=0.06)"],
        ),
        (
            "free_surface",
            [solver.ElasticPlastic(), solver.ElasticPlastic(inertia=True)],
            ["elastic_plastic inertia=False", "elastic_plastic inertia=True"],
        ),
        (
            "resistance.strength_factor",
            [solver.PublishedTests(), solver.StrengthPowerLaw()],
            ["published_tests", "strength_power_law"],
        ),
    ],
)
def test_axes_have_their_values_or_readable_labels(field: str, values: Any, labels: list[Any], tmp_path: Path) -> None:
    found = solver.simulate_sweep(**CASE, impact=IMPACTS[0], axes={field: values})
    assert found[field].values.tolist() == labels
    assert found.outcome.sel({field: labels[1]}).item()
    if find_spec("h5netcdf"):
        found.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


def test_labels_of_a_data_array_are_kept() -> None:
    coordinates = {"shot": ["a", "b"], "day": ("shot", [1, 2]), "angle": ("shot", [3, 4]), "site": "x"}
    velocities = xarray.DataArray([200.0, 250.0], dims="shot", coords=coordinates)
    axes: dict[str, Any] = {"velocity": velocities, "density": [2250.0]}
    found = solver.critical_angle_sweep(**CASE, axes=axes, search=ROUGH)
    assert set(found.coords) == {"velocity", "density", "shot", "day"}
    assert found.shot.dims == ("velocity",)
    assert found.angle.swap_dims(velocity="shot").sel(shot="b").item() == found.angle.sel(velocity=250.0).item()


@pytest.mark.parametrize(
    ("sweep", "varied", "kept"),
    [
        (
            lambda: solver.critical_angle_sweep(**CASE, axes={"velocity": [200.0]}, angle_of_attack=0.01, search=ROUGH),
            {"impact": "Impact(velocity=varied, oblique_angle=varied, angle_of_attack=0.01, angular_velocity=0.0)"},
            {"target": repr(PAPER_TARGET), "resistance": repr(Resistance())},
        ),
        (
            lambda: solver.simulate_sweep(
                **CASE, impact=IMPACTS[0], axes={"nose.caliber_radius_head": [2.0], "free_surface": LAWS}
            ),
            {
                "projectile": repr(PAPER_PROJECTILE).replace("caliber_radius_head=3.0", "caliber_radius_head=varied"),
                "resistance": repr(Resistance()).replace("ElasticPlastic(inertia=False)", "varied"),
            },
            {"impact": repr(IMPACTS[0])},
        ),
    ],
)
def test_provenance_omits_values_of_varied_fields(
    sweep: Callable[[], Any], varied: dict[str, str], kept: dict[str, str]
) -> None:
    attributes = sweep().attrs
    assert {name: attributes[name] for name in varied | kept} == varied | kept
    assert all("varied" in text for text in varied.values())


@pytest.mark.parametrize(
    ("table", "units"),
    [
        (
            lambda: solver.simulate(**CASE, impact=IMPACTS[1]).to_dataframe(),
            {"time": "s", "nose_tip_depth": "m", "axis_angle": "rad", "depth_force": "N", "angular_velocity": "rad/s"},
        ),
        (
            lambda: solver.critical_angle(**CASE, velocity=238.0, search=ROUGH).to_dataframe(),
            {"oblique_angle": "rad", "final_position": "m"},
        ),
        (
            lambda: solver.to_dataframe(solver.simulate_many(**CASE, impact=IMPACTS)),
            {"velocity": "m/s", "oblique_angle": "rad", "final_time": "s", "final_kinetic_energy": "J"},
        ),
        (
            lambda: solver.to_dataframe(solver.critical_angle_many(**CASE, velocity=[200.0], search=ROUGH)),
            {"velocity": "m/s", "angle": "rad", "strength_factor": "1"},
        ),
        (
            lambda: solver.to_dataframe(fit_depth(**CASE, tests=[DepthTest(velocity=238.0, depth=0.3)])),
            {"depth": "m", "predicted": "m", "residuals": "m"},
        ),
    ],
)
def test_tables_have_their_units(table: Callable[[], Any], units: dict[str, str]) -> None:
    frame = table()
    found = frame.attrs["units"]
    assert found | units == found
    numbers = {name for name, column in frame.reset_index().items() if column.dtype.kind == "f"}
    assert set(found) >= numbers - {"index"}
    assert not set(found) & {"outcome", "fine", "status", "warnings", "error"}


def answers_with_arrays() -> dict[str, Any]:
    trajectory = solver.simulate(**CASE, impact=IMPACTS[1])
    uncertain = [Uncertain("velocity", Normal(mean=238.0, standard_deviation=2.0))]
    few = Sampling(max_samples=320)
    return {
        "trajectory": trajectory,
        "history": trajectory.history,
        "motion": MotionHistory(time=np.array([0.0, 1e-3]), rotation=np.array([0.0, 0.1])),
        "depth fit": fit_depth(**CASE, tests=pd.DataFrame(FRAME)),
        "obliquity fit": fit_obliquity(points=ANGLES),
        "uncertainty": critical_angle_uncertainty(**CASE, velocity=238.0, uncertain=uncertain, sampling=few),
    }


def test_pickled_answers_with_arrays_equal_the_originals() -> None:
    for words, answer in answers_with_arrays().items():
        for copied in (copy.copy(answer), copy.deepcopy(answer), pickle.loads(pickle.dumps(answer))):  # noqa: S301
            assert answer == copied, words
        assert answer != words
    first, second = (solver.simulate(**CASE, impact=impact) for impact in IMPACTS)
    assert first != second
    assert first.final != second.final
    assert len({first.final, second.final, first.final}) == 2


def test_fitted_resistance_reproduces_the_depths() -> None:
    crater = Resistance(crater=solver.Crater())
    tests = pd.DataFrame(FRAME)
    found = fit_depth(**CASE, tests=tests, resistance=crater)
    assert found.resistance.crater == solver.Crater()
    for velocity, depth in zip(tests.velocity, found.predicted, strict=True):
        impact = solver.Impact(velocity=velocity, oblique_angle=0.0)
        run = solver.simulate(**CASE, impact=impact, resistance=found.resistance, sample_interval=None)
        assert run.maximum_depth == pytest.approx(depth, rel=1e-9)


def test_uncertain_inputs_have_the_short_names_of_axes() -> None:
    names = {
        "velocity": ("impact.velocity", 238.0),
        "compressive_strength": ("target.compressive_strength", 39e6),
        "nose.caliber_radius_head": ("projectile.nose.caliber_radius_head", 3.0),
        "strength_residual": ("resistance.strength_residual", 1.0),
        "retention_energy_fraction": ("numerics.retention_energy_fraction", 0.01),
    }
    normals = {short: Normal(mean=mean, coefficient_of_variation=0.01) for short, (_, mean) in names.items()}
    one, other = (
        trajectory_uncertainty(**CASE, impact=IMPACTS[1], uncertain=uncertain, sampling=Sampling(max_samples=320))
        for uncertain in (
            [Uncertain(short, normal) for short, normal in normals.items()],
            [Uncertain(names[short][0], normal) for short, normal in normals.items()],
        )
    )
    assert one == other


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("speed", "uncertain.0.field: 'speed' is unknown; expected projectile.nose"),
        ("oblique_angle", "uncertain.0.field: is what a search varies"),
        ("length", "'length' may be projectile.length or projectile.boat_tail.length"),
    ],
)
def test_ambiguous_short_names_are_refused(field: str, words: str) -> None:
    tail = solver.BoatTail(length=0.1, base_diameter=0.06)
    projectile = replace(PAPER_PROJECTILE, boat_tail=tail)
    uncertain = [Uncertain(field, Normal(mean=1.0, standard_deviation=0.1))]
    with pytest.raises(solver.ParameterError, match=words):
        critical_angle_uncertainty(projectile=projectile, target=PAPER_TARGET, velocity=238.0, uncertain=uncertain)


def takes_keywords_only(public: Any) -> bool:
    is_called = isfunction(public) or is_dataclass(public)
    found = signature(public).parameters.values() if is_called else ()
    return bool(found) and all(each.kind is each.KEYWORD_ONLY for each in found)


PUBLIC = [
    f"{package.__name__}.{name}"
    for package in (solver, solver.calibration, solver.uncertainty)
    for name in package.__all__
    if takes_keywords_only(getattr(package, name))
]


def test_most_public_callables_are_keyword_only() -> None:
    assert len(PUBLIC) > 60
    assert {"solver.simulate", "solver.Target", "solver.calibration.fit_depth", "solver.uncertainty.Normal"} <= set(
        PUBLIC
    )


@pytest.mark.parametrize("path", PUBLIC)
def test_error_about_positional_arguments_names_the_keywords(path: str) -> None:
    package, _, name = path.rpartition(".")
    public = getattr(sys.modules[package], name)
    words = rf"{public.__name__}\(\) takes keywords only: {', '.join(signature(public).parameters)}$"
    with pytest.raises(TypeError, match=words):
        public(1.0)
    assert pickle.loads(pickle.dumps(public)) is public  # noqa: S301


EVERYTHING = """
import math, sys
sys.modules.update(dict.fromkeys({blocked}))
import numpy as np
import solver
from solver.calibration import DepthTest, fit_depth
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
case = {{"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}}
rough = solver.Search(tolerance=math.radians(0.5))
strike = solver.simulate(**case, impact=paper_impact(oblique_angle_degrees=55.0))
found = solver.critical_angle(**case, velocity=238.0, search=rough)
fit = fit_depth(**case, tests=[DepthTest(velocity=200.0, depth=0.2), DepthTest(velocity=250.0, depth=0.29)])
columns = solver.columns(solver.critical_angle_many(**case, velocity=np.array([200.0, 250.0]), search=rough))
assert columns["velocity"].tolist() == [200.0, 250.0]
uses = {{
    "pandas": lambda: [strike.to_dataframe(), found.to_dataframe()],
    "xarray": lambda: solver.critical_angle_sweep(**case, axes={{"velocity": [238.0]}}, search=rough),
    "matplotlib": lambda: [strike.plot(PAPER_PROJECTILE), found.plot(), fit.plot()],
}}
for name in {blocked}:
    try:
        uses[name]()
    except ModuleNotFoundError as error:
        print(error)
for name in {used}:
    if sys.modules.get(name, sys) is None:
        del sys.modules[name]
    uses[name]()
"""
MISSED = {
    "pandas": "to_dataframe() needs pandas: pip install pandas; columns() gives the same as arrays",
    "xarray": "a sweep needs xarray: pip install xarray; critical_angle_many and",
    "matplotlib": "plot() needs matplotlib: pip install matplotlib; columns() returns the plotted data as arrays",
}


@pytest.mark.parametrize(
    ("blocked", "used"), [(list(MISSED), ["matplotlib", "pandas", "xarray"]), (["matplotlib"], ["pandas", "xarray"])]
)
def test_missing_package_is_named_only_by_functions_that_need_it(blocked: list[str], used: list[str]) -> None:
    """Packages are unblocked one by one; each step works without the packages that are still blocked."""
    command = [sys.executable, "-W", "error", "-c", EVERYTHING.format(blocked=blocked, used=used)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"MPLBACKEND": "agg"})
    assert ended.returncode == 0, ended.stderr
    for name, line in zip(blocked, ended.stdout.splitlines(), strict=True):
        assert line.startswith(MISSED[name])
