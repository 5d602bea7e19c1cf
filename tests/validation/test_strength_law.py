"""The law of S over the literature: its rows, the mixed model, and what it is worth for a series left out."""

import math
from itertools import permutations

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    ElasticPlastic,
    Ogive,
    OwnTests,
    Projectile,
    PublishedTests,
    Resistance,
    Shot,
    Target,
)
from solver.calibration import penetration_depths
from solver.sweeps import STRENGTH_LAWS
from validation.reference import depth_shots, penetration_tests
from validation.report import Section
from validation.strength_law import (
    CHOSEN,
    CONTRADICTED,
    NORMAL_QUANTILE,
    Coverage,
    UnseenSeries,
    chosen_law,
    counted_shots,
    coverage,
    coverages,
    factor_of,
    fit_mixed,
    paper_range,
    reason_left_out,
    score,
    strength_law_section,
)


def test_every_row_of_the_older_table_is_in_the_compilation_with_the_same_numbers() -> None:
    rows = {shot.row: shot for shot in depth_shots()}
    for test in penetration_tests():
        shot = rows[test.row]
        assert (shot.mass, shot.diameter, shot.velocity, shot.depth) == (
            test.mass,
            test.diameter,
            test.velocity,
            test.depth,
        )


def test_rule_leaves_only_what_a_rigid_body_of_steel_can_show() -> None:
    shots = counted_shots()
    assert len(depth_shots()) == 751
    assert (len(shots), len({shot.article for shot in shots})) == (251, 34)
    assert f"{len(shots)} tests" in STRENGTH_LAWS[PublishedTests]
    assert max(shot.velocity for shot in shots) <= 900.0
    assert all(shot.depth >= 2.0 * shot.diameter for shot in shots)
    assert all(shot.thickness is None or shot.thickness >= 1.5 * shot.depth for shot in shots)
    assert all(reason_left_out(shot) for shot in depth_shots() if shot.row in CONTRADICTED)


@pytest.mark.parametrize("place", [0, 50, 100, 150, 200])
def test_factor_of_a_shot_brings_the_trajectory_to_its_depth(place: int) -> None:
    shot = counted_shots()[place]
    assert shot.caliber_radius_head is not None
    (depth,) = penetration_depths(
        projectile=Projectile(
            nose=Ogive(caliber_radius_head=shot.caliber_radius_head),
            diameter=shot.diameter,
            length=shot.length,
            mass=shot.mass,
        ),
        target=Target(compressive_strength=shot.compressive_strength, density=shot.density),
        velocities=[shot.velocity],
        strength_factor=factor_of(shot),
        resistance=Resistance(strength_factor=ConstantStrengthFactor(value=1.0)),
    )
    assert depth == pytest.approx(shot.depth, rel=1e-3)


def test_mixed_model_finds_the_scatter_that_made_the_data() -> None:
    random = np.random.default_rng(1)
    groups = np.repeat(np.arange(400), 5).tolist()
    matrix = np.column_stack([np.ones(2000), random.normal(size=2000)])
    series, shot = 0.4 * random.normal(size=400), 0.1 * random.normal(size=2000)
    found = fit_mixed(matrix @ [2.0, -0.3] + series[groups] + shot, matrix, groups)
    assert found.coefficients == pytest.approx([2.0, -0.3], abs=0.05)
    assert (found.between, found.within) == pytest.approx((0.4, 0.1), rel=0.06)


def test_mixed_model_of_balanced_groups_is_the_analysis_of_variance() -> None:
    """For balanced groups with a mean only, restricted maximum likelihood has a closed form."""
    values = np.array([[2.0, 2.1, 1.9], [2.6, 2.5, 2.7], [1.5, 1.7, 1.6], [2.2, 2.0, 2.4]])
    found = fit_mixed(values.ravel(), np.ones((12, 1)), np.repeat(range(4), 3).tolist())
    within = float(np.mean(values.var(axis=1, ddof=1)))
    between = float(values.mean(axis=1).var(ddof=1)) - within / 3.0
    assert found.within == pytest.approx(math.sqrt(within), rel=1e-3)
    assert found.between == pytest.approx(math.sqrt(between), rel=1e-3)
    assert found.coefficients == pytest.approx([values.mean()])


@pytest.mark.parametrize("by_article", [False, True])
def test_intervals_hold_the_shots_of_series_left_out(by_article: bool) -> None:
    without, after_one, after_two = coverages(by_article=by_article)
    for each in (without, after_one, after_two):
        assert isinstance(each, Coverage)
        assert each.series >= 25
    # An article left out takes all its series along: the rest knows less of it.
    least = 0.84 if by_article else 0.85
    for share in (without.covered, without.covered_shots):
        assert least <= share <= 0.95
    for each in (after_one, after_two):
        assert each.covered >= 0.80
        assert each.covered_shots >= 0.80
        assert each.dispersion <= 0.20
    assert after_two.dispersion < after_one.dispersion < without.dispersion


def test_coverage_counts_the_other_shots_in_the_interval() -> None:
    calm = UnseenSeries(misses=np.array([0.0, 0.0, 0.0]), between=0.2, within=0.1)
    wild = UnseenSeries(misses=np.array([-1.0, 1.0]), between=0.2, within=0.1)
    assert coverage([calm, wild], 0).covered == 0.5
    assert coverage([calm, wild], 0).covered_shots == 0.6
    assert coverage([calm, wild], 2).series == 1


def test_strength_and_diameter_earn_their_place() -> None:
    assert score(())[0] < score(CHOSEN)[0]
    assert score(("strength",))[0] < score(CHOSEN)[0] < score((*CHOSEN, "speed"))[0]
    assert score((*CHOSEN, "nose"))[0] < score(CHOSEN)[0]


@pytest.fixture(scope="module")
def section() -> Section:
    return strength_law_section()


def test_solver_has_the_constants_and_the_range_of_the_fit(section: Section) -> None:
    assert all(each.holds for each in section.comparisons)
    shots = counted_shots()
    for limits, name in (
        (PublishedTests.compressive_strengths, "compressive_strength"),
        (PublishedTests.diameters, "diameter"),
        (PublishedTests.velocities, "velocity"),
    ):
        values = [getattr(shot, name) for shot in shots]
        assert limits == (min(values), max(values))


def test_one_own_shot_in_the_solver_holds_the_others_of_its_series() -> None:
    """By the strength law of the product, each shot of a series given in turn."""
    shares, dispersions = [], []
    for name in {shot.series for shot in counted_shots()}:
        members = [shot for shot in counted_shots() if shot.series == name]
        inside = []
        for given, other in permutations(members, 2):
            assert other.caliber_radius_head is not None
            nose = Ogive(caliber_radius_head=other.caliber_radius_head)
            found = OwnTests(
                shots=(Shot(velocity=given.velocity, depth=given.depth, mass=given.mass, diameter=given.diameter),)
            ).posterior(
                target=Target(compressive_strength=other.compressive_strength, density=other.density),
                projectile=Projectile(nose=nose, diameter=other.diameter, length=other.length, mass=other.mass),
            )
            inside.append(abs(math.log(factor_of(other) / found.median)) <= NORMAL_QUANTILE * found.dispersion)
            dispersions.append(found.dispersion)
        if inside:
            shares.append(np.mean(inside))
    assert len(shares) == 44
    assert np.mean(shares) >= 0.80
    assert np.mean(dispersions) <= 0.20


def test_section_states_law_scatter_and_rule(section: Section) -> None:
    text = " ".join(section.text)
    assert "S = 8.84 (f'c / 39 MPa)^-0.18 (d / 76.2 mm)^-0.24" in text
    assert "0.31 between series" in text
    assert "0.10 within" in text
    tables = {table.name: table for table in section.tables}
    assert sum(int(str(row[1])) for row in tables["strength-law-rule"].rows) == 751
    assert sum(int(str(row[3])) for row in tables["strength-law-series"].rows) == len(counted_shots())
    assert chosen_law().between == pytest.approx(0.3130, abs=0.001)


def test_own_shots_narrow_the_range_of_the_papers_angle() -> None:
    widths = []
    for own_shots in (0, 1, 4):
        _, _, (low, middle, high) = paper_range(own_shots, ElasticPlastic())
        assert low < middle < high
        widths.append(high - low)
    assert widths == pytest.approx([8.9, 4.2, 3.3], abs=0.2)
