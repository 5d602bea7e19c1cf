import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from solver import (
    ElasticPlastic,
    MohrCoulomb,
    ParameterError,
    Profile,
    PublishedTests,
    critical_angle,
    strength_factor,
)
from solver.checks import BOUNDS
from solver.resistance import EQUATION_9
from solver.strength_scatter import TABLE_1
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.uncertainty import (
    RESIDUAL,
    Discrete,
    Lognormal,
    Normal,
    Sampling,
    TruncatedNormal,
    Uncertain,
    Uniform,
    critical_angle_uncertainty,
    scaled,
    trajectory_uncertainty,
)
from tests.physics.strikes import CASE, known, paper_run

PAPER: dict[str, Any] = CASE | {"velocity": PAPER_VELOCITY}
SPEED = Uncertain("impact.velocity", Normal(mean=238.0, coefficient_of_variation=0.01))
STRENGTH = Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=0.12))
DENSITY = Uncertain("target.density", Normal(mean=2250.0, coefficient_of_variation=0.02))
MASS = Uncertain("projectile.mass", Normal(mean=13.0, coefficient_of_variation=0.005))
ATTACK = Uncertain("impact.angle_of_attack", Normal(mean=0.0, standard_deviation=math.radians(1.0)))
SCATTER = [SPEED, STRENGTH, DENSITY, MASS, ATTACK]
ANGLES = np.radians(np.linspace(30.0, 70.0, 81))


def test_study_of_one_input_gives_the_angles_at_its_quantiles() -> None:
    answer = critical_angle_uncertainty(**PAPER, uncertain=[ATTACK], oblique_angles=ANGLES)
    assert answer.method == "surrogate"
    assert answer.converged
    for level, estimate in answer.quantiles:
        attack = math.radians(stats.norm.ppf(1.0 - level))  # The critical angle falls with the angle of attack.
        exact = critical_angle(**PAPER, angle_of_attack=attack).angle
        assert estimate.value == pytest.approx(exact, abs=math.radians(0.05))
    below = answer.probability[answer.quantiles[0][1].value > ANGLES]
    assert (np.diff(answer.probability) >= 0.0).all()
    assert (below <= 0.03).all()
    assert "surrogate" in repr(answer)
    assert len(repr(answer)) < 100
    assert "impact.angle_of_attack" in answer._repr_html_()


def test_alternative_models_and_scatter_are_compared_in_one_study() -> None:
    models = Uncertain(
        "resistance.free_surface", Discrete(values=[ElasticPlastic(), MohrCoulomb()], weights=[0.8, 0.2])
    )
    answer = critical_angle_uncertainty(
        **PAPER, uncertain=[ATTACK, models], sampling=Sampling(half_width=0.05), oblique_angles=ANGLES
    )
    elastic, mohr = (change.angle for change in answer.sensitivity[1].swing)
    assert elastic == critical_angle(**PAPER).angle
    assert mohr == critical_angle(**PAPER, resistance=replace(EQUATION_9, free_surface=MohrCoulomb())).angle
    attack, model = (known(each.total).value for each in answer.sensitivity)
    assert model > attack


def test_nose_can_be_an_uncertain_input() -> None:
    """The points may be a tuple or an array. The angle for each nose equals that of a search with this nose."""
    cones = [Profile(points=((0.0, 0.0), (0.13, 0.04))), Profile(points=np.array([[0.0, 0.01], [0.12, 0.04]]))]  # type: ignore[arg-type]
    body = replace(PAPER_PROJECTILE, nose=cones[1])
    noses = Uncertain("projectile.nose", Discrete(values=cones))
    answer = critical_angle_uncertainty(
        **(PAPER | {"projectile": body}),
        uncertain=[SPEED, noses],
        sampling=Sampling(half_width=0.2, max_samples=1024),
        oblique_angles=ANGLES,
    )
    for change, nose in zip(answer.sensitivity[1].swing, cones, strict=True):
        assert change.value == nose
        assert change.angle == critical_angle(**(PAPER | {"projectile": replace(body, nose=nose)})).angle
    assert (answer.failed, answer.outside) == (0, 0)


@pytest.mark.parametrize("law", [EQUATION_9.strength_factor, PublishedTests(), TABLE_1])
def test_residual_multiplies_the_strength_factor(law: Any) -> None:
    for angle in (0.0, 0.7):
        values = [
            strength_factor(
                resistance=replace(EQUATION_9, strength_factor=each),
                oblique_angle=angle,
                target=PAPER_TARGET,
                projectile=PAPER_PROJECTILE,
            )
            for each in (law, scaled(law, 1.1))
        ]
        assert values[1] == pytest.approx(1.1 * values[0])


def test_scatter_of_the_residual_scatters_the_angle() -> None:
    residual = Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.1))
    answer = critical_angle_uncertainty(**PAPER, uncertain=[residual], sampling=Sampling(half_width=0.1))
    low, high = (change.angle for change in answer.sensitivity[0].swing)
    assert known(high) < known(low)  # Stronger concrete has a smaller critical angle.


def test_surrogate_follows_a_widely_scattered_strength_factor() -> None:
    """S varies by a factor of five, in addition to the usual scatter and both theories.

    The expected values are from 6,000 random searches.
    """
    theories = Discrete(values=[ElasticPlastic(), MohrCoulomb()], weights=[0.8, 0.2])
    uncertain = [
        Uncertain("impact.velocity", Normal(mean=238.0, coefficient_of_variation=0.02)),
        replace(STRENGTH, distribution=Lognormal(median=39e6, dispersion=0.0796)),
        *(DENSITY, MASS, ATTACK),
        Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.52)),
        Uncertain("resistance.free_surface", theories),
    ]
    answer = critical_angle_uncertainty(**PAPER, uncertain=uncertain, sampling=Sampling(half_width=0.05))
    assert answer.method == "surrogate"
    assert answer.samples <= 270
    assert known(answer.surrogate_error) <= math.radians(0.1)
    levels = dict(answer.quantiles)
    found = [math.degrees(levels[level].value) for level in (0.05, 0.95)]
    assert found == pytest.approx([41.8, 59.1], abs=0.5)  # The random searches give 41.6 to 42.0 and 58.6 to 59.5.


def test_samples_outside_the_model_are_counted() -> None:
    wide = Uncertain("target.density", Normal(mean=2250.0, standard_deviation=1500.0))
    answer = critical_angle_uncertainty(
        **PAPER, uncertain=[wide], oblique_angles=ANGLES, sampling=Sampling(max_samples=256), sensitivity=False
    )
    share = stats.norm.cdf((BOUNDS["target.density"].lower - 2250.0) / 1500.0)
    assert answer.outside == pytest.approx(256 * share, abs=3)
    assert answer.upper[0] >= 0.9 * share
    assert "samples_outside" in {warning.code for warning in answer.warnings}


@pytest.mark.parametrize(
    ("field", "distribution", "parameter", "requirement"),
    [
        ("target.density", Uniform(lower=-500.0, upper=-100.0), "lower", "must be 100 to 20,000 kg/m³, got -500"),
        ("target.density", Normal(mean=-1.0, standard_deviation=1.0), "mean", "got -1"),
        ("target.density", TruncatedNormal(mean=2e3, standard_deviation=9.0, upper=3e4), "upper", "got 30,000"),
        ("impact.velocity", Lognormal(median=1e5, dispersion=0.1), "median", "got 100,000"),
        ("impact.velocity", Discrete(values=[238.0, -5.0]), "values.1", "got -5"),
        (RESIDUAL, Uniform(lower=-0.5, upper=2.0), "lower", "greater than 0"),
    ],
)
def test_distribution_of_invalid_values_is_refused(
    field: str, distribution: Any, parameter: str, requirement: str
) -> None:
    uncertain = [ATTACK, Uncertain(field, distribution)]
    with pytest.raises(ParameterError) as error:
        critical_angle_uncertainty(**PAPER, uncertain=uncertain)
    assert error.value.field == f"uncertain.1.distribution.{parameter}"
    assert requirement in error.value.requirement


def test_surrogate_points_out_of_bounds_count_as_unknown() -> None:
    """The lower bound is 3.3 standard deviations below the mean, so 0.05 % of the surrogate's points are below it."""
    deviation = (2250.0 - BOUNDS["target.density"].lower) / 3.3
    density = Uncertain("target.density", Normal(mean=2250.0, standard_deviation=deviation))
    sampling = Sampling(half_width=0.5)
    wide, narrow = (
        critical_angle_uncertainty(**PAPER, uncertain=[each], oblique_angles=ANGLES, sampling=sampling)
        for each in (density, DENSITY)
    )
    assert wide.method == narrow.method == "surrogate"
    assert wide.outside == 0
    [warning] = [each for each in wide.warnings if each.code == "samples_outside"]
    counted = int(warning.detail.split()[0])
    assert counted == pytest.approx(65_536 * stats.norm.cdf(-3.3), abs=6)
    assert wide.upper[0] - narrow.upper[0] == pytest.approx(counted / 65_536)
    assert narrow.warnings == ()


def test_outcome_of_the_paper_strike_near_its_angle_is_uncertain() -> None:
    answer = trajectory_uncertainty(
        **CASE,
        impact=paper_impact(oblique_angle_degrees=48.7),
        uncertain=[ATTACK],
        sampling=Sampling(half_width=0.05),
    )
    shares = dict(answer.outcomes)
    assert 0.3 < shares["ricochet"].value < 0.7
    assert shares["ricochet"].value + shares["embedded"].value == pytest.approx(1.0)
    middle = paper_run(48.7, sample_interval=None)
    assert dict(answer.maximum_depth)[0.5].value == pytest.approx(middle.maximum_depth, rel=0.02)
    assert answer.exit_speed[0][1].value > 20.0
    assert answer.residual_speed == ()


def test_wall_is_perforated_with_a_probability_and_a_residual_speed() -> None:
    answer = trajectory_uncertainty(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, thickness=0.24),
        impact=paper_impact(oblique_angle_degrees=0.0),
        uncertain=[Uncertain("impact.velocity", Normal(mean=PAPER_VELOCITY, standard_deviation=4.0))],
        sampling=Sampling(half_width=0.05),
    )
    shares = dict(answer.outcomes)
    assert 0.4 < shares["perforated"].value < 0.65  # The limit velocity of this wall is 0.1 m/s below the mean.
    assert shares["perforated"].value + shares["embedded"].value == pytest.approx(1.0)
    assert answer.exit_speed == ()
    low, high = (dict(answer.residual_speed)[level].value for level in (0.05, 0.95))
    assert 20.0 < low < high < 80.0  # An exit speed is at least a tenth of the impact speed.


@pytest.mark.parametrize(
    ("field", "requirement"),
    [
        ("impact.speed", "is unknown; expected velocity"),
        ("target", "is no number"),
        ("projectile.nose", "is no number"),
        ("weather", "is unknown"),
        ("impact.oblique_angle", "what a search varies"),
    ],
)
def test_field_that_is_not_a_number_is_refused(field: str, requirement: str) -> None:
    uncertain = [Uncertain(field, Uniform(lower=1.0, upper=2.0))]
    with pytest.raises(ParameterError, match=requirement) as error:
        critical_angle_uncertainty(**PAPER, uncertain=uncertain)
    assert error.value.field == "uncertain.0.field"


@pytest.mark.parametrize(
    ("uncertain", "found"),
    [
        ("impact.velocity", "got 'impact.velocity'"),
        (["impact.velocity"], "got 'impact.velocity'"),
        ({"impact.velocity": Normal(mean=238.0, standard_deviation=2.0)}, "got dict"),
        ([stats.norm(238.0, 2.0)], "got rv_continuous_frozen"),
        (Normal(mean=238.0, standard_deviation=2.0), "got Normal"),
    ],
)
def test_unknown_input_is_refused_with_the_accepted_ones(uncertain: Any, found: str) -> None:
    with pytest.raises(ParameterError, match=r"must be a sequence of inputs such as Uncertain\(.*" + found):
        critical_angle_uncertainty(
            projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY, uncertain=uncertain
        )


@pytest.mark.parametrize("distribution", [stats.norm(238.0, 2.0), "normal", 238.0])
def test_unknown_distribution_is_refused_with_the_known_ones(distribution: Any) -> None:
    with pytest.raises(ParameterError, match=r"must be one of solver\.uncertainty: Normal, .* or Discrete, got "):
        Uncertain("impact.velocity", distribution)
