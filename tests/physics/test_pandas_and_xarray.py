"""Tables and arrays of pandas and xarray, as inputs and as answers."""

import math
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import solver
from solver import Resistance
from solver.calibration import DepthTest, MotionHistory, ObliquityPoint, fit_depth, fit_obliquity, penetration_depths
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.uncertainty import Discrete

xarray = pytest.importorskip("xarray")
CASE: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
ROUGH = solver.Search(tolerance=math.radians(0.5))
WALL = solver.Target(compressive_strength=39e6, density=2250.0, thickness=0.3)
IMPACTS = [paper_impact(oblique_angle_degrees=angle) for angle in (20.0, 60.0)]
SHOTS = [solver.Shot(velocity=238.1, depth=0.30), solver.Shot(velocity=250.0, depth=0.32)]
TESTS = [DepthTest(velocity=200.0, depth=0.20), DepthTest(velocity=250.0, depth=0.29)]


def held(values: Sequence[Any]) -> Any:
    """Return values as an array, which holds objects as they are."""
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
        lambda values: solver.simulate_sweep(**CASE, impact=IMPACTS[0], axes={"oblique_angle": values}).to_dict(),
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
def test_a_sequence_may_be_an_array_a_series_or_a_data_array(place: str) -> None:
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
    rest = answers()
    next(rest)
    for name, column in solver.columns(rest).items():
        if name in inputs:
            assert column.tolist() == pytest.approx(inputs[name][1:], nan_ok=True), name


FRAME = {"velocity": [200.0, 250.0, 300.0], "depth": [0.20, 0.29, 0.40]}
ALL_COLUMNS = FRAME | {
    "mass": [math.nan, 12.9, 13.1],
    "weight": [1.0, math.nan, 2.0],
    "group": ["a", "a", pd.NA],
}


def test_rows_of_a_frame_are_tests_points_and_shots() -> None:
    frame = pd.DataFrame(FRAME, index=[3, 5, 7])
    tests = [DepthTest(velocity=row.velocity, depth=row.depth) for row in frame.itertuples()]
    assert fit_depth(**CASE, tests=frame).estimate == fit_depth(**CASE, tests=tests).estimate
    shots = solver.OwnTests(shots=frame).shots
    assert shots == tuple(solver.Shot(velocity=row.velocity, depth=row.depth) for row in frame.itertuples())
    angles = pd.DataFrame({"oblique_angle": [0.0, 0.3, 0.6, 0.8], "strength_factor": [8.5, 8.2, 7.9, 6.5]})
    points = [
        ObliquityPoint(oblique_angle=row.oblique_angle, strength_factor=row.strength_factor)
        for row in angles.itertuples()
    ]
    assert fit_obliquity(points=angles).model == fit_obliquity(points=points).model


def test_gaps_of_a_frame_are_what_a_test_does_not_have() -> None:
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
            r"tests.1.velocity: must be greater than 0, got nan",
        ),
        (pd.DataFrame(ALL_COLUMNS), "tests.2.group: must be given"),
        ([{"velocity": 200.0, "depth": 0.2}], "tests.0: must be a DepthTest, got dict"),
        ([TESTS[0], 250.0], "tests.1: must be a DepthTest, got float"),
    ],
)
def test_tests_that_are_none_say_what_they_take(tests: Any, words: str) -> None:
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
            ["elastic_plastic 1", "elastic_plastic 2"],
        ),
        (
            "resistance.strength_factor",
            [solver.PublishedTests(), solver.StrengthPowerLaw()],
            ["published_tests", "strength_power_law"],
        ),
    ],
)
def test_axes_keep_their_values_or_readable_labels(field: str, values: Any, labels: list[Any], tmp_path: Path) -> None:
    found = solver.simulate_sweep(**CASE, impact=IMPACTS[0], axes={field: values})
    assert found[field].values.tolist() == labels
    assert found.outcome.sel({field: labels[1]}).item()
    if find_spec("h5netcdf"):
        found.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


def test_labels_of_a_data_array_stay_beside_its_values() -> None:
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
def test_provenance_has_no_value_of_what_varies(
    sweep: Callable[[], Any], varied: dict[str, str], kept: dict[str, str]
) -> None:
    attributes = sweep().attrs
    assert {name: attributes[name] for name in varied | kept} == varied | kept
    assert all("varied" in text for text in varied.values())
