"""Sweeps in Python, which return xarray Datasets."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import solver
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import CASE

xarray = pytest.importorskip("xarray")
ROUGH = solver.Search(tolerance=math.radians(0.5))
VELOCITIES, STRENGTHS = [200.0, 250.0, 300.0], [30e6, 50e6]


@pytest.fixture(scope="module")
def angles() -> Any:
    axes: dict[str, Any] = {"velocity": np.array(VELOCITIES), "target.compressive_strength": STRENGTHS}
    return solver.critical_angle_sweep(**CASE, axes=axes, search=ROUGH, threads=2)


def test_each_point_equals_a_single_search(angles: Any) -> None:
    assert dict(angles.sizes) == {"velocity": 3, "compressive_strength": 2}
    for velocity in VELOCITIES:
        target = solver.Target(compressive_strength=50e6, density=PAPER_TARGET.density)
        alone = solver.critical_angle(projectile=PAPER_PROJECTILE, target=target, velocity=velocity, search=ROUGH)
        assert float(angles.angle.sel(velocity=velocity, compressive_strength=50e6)) == alone.angle
    assert bool((angles.status == "converged").all())


def test_every_number_has_its_unit(angles: Any) -> None:
    units = {name: angles[name].attrs.get("units") for name in angles.variables}
    assert units["velocity"] == "m/s"
    assert units["compressive_strength"] == "Pa"
    assert units["angle"] == units["bracket_low"] == "rad"
    for name, variable in angles.variables.items():
        assert (units[name] is not None) is (variable.dtype.kind == "f"), name
        assert variable.attrs["long_name"]


def test_netcdf_round_trip_is_exact(angles: Any, tmp_path: Path) -> None:
    pytest.importorskip("h5netcdf")
    file = tmp_path / "angles.nc"
    angles.to_netcdf(file, engine="h5netcdf")
    with xarray.open_dataset(file, engine="h5netcdf") as opened:
        xarray.testing.assert_identical(opened.load(), angles)
        assert opened.attrs["source"] == f"ricochet, engine {solver.ENGINE_VERSION}"
        assert "diameter=0.08" in opened.attrs["projectile"]


def test_sweep_can_be_plotted_as_curve_and_map(angles: Any, tmp_path: Path) -> None:
    figure = pytest.importorskip("matplotlib.figure")
    for shown in (angles.angle, angles.angle.isel(compressive_strength=0)):
        picture = figure.Figure(layout="constrained")
        panel = picture.subplots()
        shown.plot(ax=panel)
        assert "velocity [m/s]" in {panel.get_xlabel(), panel.get_ylabel()}
        picture.savefig(tmp_path / "sweep.png")


def test_models_are_coordinates_by_name() -> None:
    axes: dict[str, Any] = {
        "free_surface": [solver.ElasticPlastic(), solver.NoFreeSurface()],
        "oblique_angle": np.radians([10.0, 50.0]),
    }
    found = solver.simulate_sweep(**CASE, impact=paper_impact(oblique_angle_degrees=0.0), axes=axes)
    assert found.free_surface.values.tolist() == ["elastic_plastic", "none"]
    assert found.oblique_angle.attrs["units"] == "rad"
    outcomes = found.outcome.sel(oblique_angle=math.radians(50.0))
    assert outcomes.values.tolist() == ["ricochet", "embedded"]
    assert float(found.maximum_depth.max()) > 0.0


@pytest.mark.parametrize(
    ("axis", "values", "labels"),
    [
        (
            "nose",
            [solver.Ogive(caliber_radius_head=3.0), solver.Ogive(caliber_radius_head=4.5)],
            ["ogive ψ=3", "ogive ψ=4.5"],
        ),
        (
            "strength_factor",
            [
                solver.ConstantStrengthFactor(value=6.0),
                solver.ConstantStrengthFactor(value=9.0),
                solver.PublishedTests(),
            ],
            ["constant value=6", "constant value=9", "published_tests"],
        ),
        ("strength_factor", 2 * [solver.PublishedTests()], ["published_tests 1", "published_tests 2"]),
    ],
)
def test_models_of_one_name_are_labelled_by_their_differences(axis: str, values: list[Any], labels: list[str]) -> None:
    found = solver.simulate_sweep(**CASE, impact=paper_impact(oblique_angle_degrees=30.0), axes={axis: values})
    assert found.outcome[found.outcome.dims[0]].values.tolist() == labels


def test_angles_of_a_sweep_may_be_in_degrees() -> None:
    axes = {"angle_of_attack": [0.0, 0.02], "velocity": [238.0]}
    plain = solver.critical_angle_sweep(**CASE, axes=axes, search=ROUGH)
    found = solver.critical_angle_sweep(**CASE, axes=axes, search=ROUGH, degrees=True)
    assert found.angle_of_attack.values.tolist() == np.degrees([0.0, 0.02]).tolist()
    np.testing.assert_array_equal(found.angle, np.degrees(plain.angle))
    units = {name: found[name].attrs["units"] for name in ("angle", "bracket_low", "angle_of_attack", "velocity")}
    assert units == {"angle": "degree", "bracket_low": "degree", "angle_of_attack": "degree", "velocity": "m/s"}
    assert found.strength_factor.equals(plain.strength_factor.assign_coords(angle_of_attack=found.angle_of_attack))


CONE, TRUNCATED = ((0.0, 0.0), (0.13, 0.04)), ((0.0, 0.01), (0.06, 0.03), (0.12, 0.04))


def test_profiles_can_be_an_axis_with_distinct_labels(tmp_path: Path) -> None:
    noses: list[Any] = [
        solver.Profile(points=CONE),
        solver.Profile(points=np.array(TRUNCATED)),  # type: ignore[arg-type]
        PAPER_PROJECTILE.nose,
    ]
    found = solver.critical_angle_sweep(**CASE, axes={"nose": noses}, velocity=PAPER_VELOCITY, search=ROUGH)
    assert found.nose.values.tolist() == ["profile 1", "profile 2", "ogive"]
    for label, nose in zip(found.nose.values, noses, strict=True):
        projectile = replace(PAPER_PROJECTILE, nose=nose)
        alone = solver.critical_angle(projectile=projectile, target=PAPER_TARGET, velocity=PAPER_VELOCITY, search=ROUGH)
        assert float(found.angle.sel(nose=label)) == alone.angle
    assert str(found.nose_in_full.sel(nose="profile 2").item()) == repr(solver.Profile(points=TRUNCATED))
    pytest.importorskip("h5netcdf")
    found.to_netcdf(tmp_path / "noses.nc", engine="h5netcdf")


def test_points_of_a_profile_can_be_an_axis() -> None:
    projectile = replace(PAPER_PROJECTILE, nose=solver.Profile(points=CONE))
    axes: dict[str, Any] = {"nose.points": [CONE, [list(point) for point in TRUNCATED], np.array(CONE)]}
    found = solver.simulate_sweep(
        projectile=projectile, target=PAPER_TARGET, impact=paper_impact(oblique_angle_degrees=20.0), axes=axes
    )
    assert found.points.values.tolist() == ["points 1", "points 2", "points 3"]
    first, second, third = found.maximum_depth.values
    assert first == third != second


def test_failed_case_has_nan_and_its_error() -> None:
    law = solver.Resistance(strength_factor=solver.ObliquityPolynomial(coefficients=(6.0, -0.1)))
    found = solver.simulate_sweep(
        **CASE,
        impact=paper_impact(oblique_angle_degrees=0.0),
        axes={"oblique_angle": np.radians([10.0, 70.0])},
        resistance=law,
    )
    assert np.isnan(found.maximum_depth.values).tolist() == [False, True]
    assert [bool(text) for text in found.error.values] == [False, True]


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({}, "must hold a field"),
        ({"speed": [1.0]}, "'speed' is unknown; expected projectile.nose"),
        ({"velocity": []}, "must have values"),
        ({"velocity": [200.0], "impact.velocity": [300.0]}, "must not name a field twice"),
        ({"velocity": [200.0], "oblique_angle": [0.1]}, "is what a search varies"),
        ({"velocity": np.ones(400), "density": np.ones(400)}, "at most 100,000 points, got 160,000"),
        ({"velocity": [200.0], "poissons_ratio": [0.6]}, "poissons_ratio"),
        ({"density": [2000.0]}, "velocity: must be given, or be an axis"),
    ],
)
def test_invalid_axes_are_named(axes: dict[str, Any], words: str) -> None:
    with pytest.raises(solver.ParameterError, match=words):
        solver.critical_angle_sweep(**CASE, axes=axes)
