"""The law of S from published tests: rows used, the mixed model, and predictions for series that were left out."""

import math
from itertools import permutations

import numpy as np
import pytest
from scipy import stats
from scipy.special import stdtrit

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
from validation.never_fitted import PROGRAMME, check, counted_rows, normal_half_width
from validation.reference import depth_shots, never_fitted_shots, penetration_tests
from validation.report import Section
from validation.strength_law import (
    CHOSEN,
    CONTRADICTED,
    NORMALISED,
    Coverage,
    SeriesScatter,
    UnseenSeries,
    chosen_law,
    chosen_misses,
    chosen_scatter,
    counted_shots,
    coverage,
    coverages,
    factor_of,
    fit_mixed,
    fit_scatter,
    law_with_article_71,
    likelihood,
    paper_range,
    reason_left_out,
    score,
    strength_law_section,
)


def test_compilation_contains_every_row_of_the_older_table_unchanged() -> None:
    rows = {shot.row: shot for shot in depth_shots()}
    for test in penetration_tests():
        shot = rows[test.row]
        assert (shot.mass, shot.diameter, shot.velocity, shot.depth) == (
            test.mass,
            test.diameter,
            test.velocity,
            test.depth,
        )


def test_rule_selects_only_tests_with_rigid_steel_bodies() -> None:
    shots = counted_shots()
    assert len(depth_shots()) == 751
    assert (len(shots), len({shot.article for shot in shots})) == (251, 34)
    assert f"{len(shots)} tests" in STRENGTH_LAWS[PublishedTests]()
    assert max(shot.velocity for shot in shots) <= 900.0
    assert all(shot.depth >= 2.0 * shot.diameter for shot in shots)
    assert all(shot.thickness is None or shot.thickness >= 1.5 * shot.depth for shot in shots)
    assert all(reason_left_out(shot) for shot in depth_shots() if shot.row in {*CONTRADICTED, *NORMALISED})


@pytest.mark.parametrize("place", [0, 50, 100, 150, 200])
def test_factor_of_a_shot_reproduces_its_depth(place: int) -> None:
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


def test_mixed_model_recovers_the_scatter_of_generated_data() -> None:
    random = np.random.default_rng(1)
    groups = np.repeat(np.arange(400), 5).tolist()
    matrix = np.column_stack([np.ones(2000), random.normal(size=2000)])
    series, shot = 0.4 * random.normal(size=400), 0.1 * random.normal(size=2000)
    found = fit_mixed(matrix @ [2.0, -0.3] + series[groups] + shot, matrix, groups)
    assert found.coefficients == pytest.approx([2.0, -0.3], abs=0.05)
    assert (found.between, found.within) == pytest.approx((0.4, 0.1), rel=0.06)


def test_mixed_model_of_balanced_groups_equals_the_analysis_of_variance() -> None:
    """For balanced groups and a constant mean, restricted maximum likelihood has this closed form."""
    values = np.array([[2.0, 2.1, 1.9], [2.6, 2.5, 2.7], [1.5, 1.7, 1.6], [2.2, 2.0, 2.4]])
    found = fit_mixed(values.ravel(), np.ones((12, 1)), np.repeat(range(4), 3).tolist())
    within = float(np.mean(values.var(axis=1, ddof=1)))
    between = float(values.mean(axis=1).var(ddof=1)) - within / 3.0
    assert found.within == pytest.approx(math.sqrt(within), rel=1e-3)
    assert found.between == pytest.approx(math.sqrt(between), rel=1e-3)
    assert found.coefficients == pytest.approx([values.mean()])


@pytest.mark.parametrize("by_article", [False, True])
def test_intervals_contain_the_shots_of_omitted_series(by_article: bool) -> None:
    without, after_one, after_two = coverages(by_article=by_article)
    for each in (without, after_one, after_two):
        assert isinstance(each, Coverage)
        assert each.series >= 25
    # An article contains several series, so leaving one out leaves less data for the prediction.
    least = 0.88 if by_article else 0.90
    for share in (without.covered, without.covered_shots):
        assert least <= share <= 0.96
    for each in (after_one, after_two):
        assert each.covered >= 0.85
        assert each.covered_shots >= 0.84
        assert each.half_width <= 0.25
    assert after_two.half_width < after_one.half_width < without.half_width


def test_coverage_counts_the_remaining_shots_within_the_interval() -> None:
    scatter = SeriesScatter(between=0.2, within=0.1)
    calm = UnseenSeries(misses=np.array([0.0, 0.0, 0.0]), scatter=scatter)
    wild = UnseenSeries(misses=np.array([-1.0, 1.0]), scatter=scatter)
    assert coverage([calm, wild], 0).covered == 0.5
    assert coverage([calm, wild], 0).covered_shots == 0.6
    assert coverage([calm, wild], 2).series == 1


def test_density_of_a_series_is_a_multivariate_student_distribution() -> None:
    misses = np.array([0.3, 0.1, 0.25])
    shape = 0.07**2 * np.eye(3) + 0.27**2
    expected = stats.multivariate_t(np.zeros(3), shape, df=3).logpdf(misses)
    assert SeriesScatter(between=0.27, within=0.07).log_density([misses]) == pytest.approx([expected])


def test_fit_of_scatter_recovers_the_scales_of_generated_data() -> None:
    random = np.random.default_rng(2)
    series = []
    for _ in range(2000):
        deviation = 0.07 * math.sqrt(3.0 / random.chisquare(3.0))
        series.append(deviation * (4.0 * random.normal() + random.normal(size=4)))
    found = fit_scatter(series)
    assert (found.between, found.within) == pytest.approx((0.28, 0.07), rel=0.05)


def test_three_degrees_of_freedom_are_likely_and_a_normal_scatter_is_not() -> None:
    assert likelihood(5.0) - 1.5 < likelihood(3.0) < likelihood(5.0)
    assert likelihood(1e6) < likelihood(3.0) - 10.0


def test_rows_of_one_article_move_the_diameter_exponent_beyond_its_standard_error() -> None:
    printed, read = (law_with_article_71(normalised=normalised) for normalised in (False, True))
    assert printed.coefficients[2] == pytest.approx(-0.05, abs=0.01)
    assert read.coefficients == pytest.approx([math.log(9.0), -0.18, -0.21], abs=0.03)
    assert read.between == pytest.approx(0.32, abs=0.005)
    assert chosen_law().standard_errors[2] < 0.03


def test_25_of_69_series_have_only_one_shot() -> None:
    assert (len(chosen_misses()), sum(len(each) == 1 for each in chosen_misses())) == (69, 25)


@pytest.mark.parametrize(
    ("without", "series", "share", "share_after_one"), [((), 17, 0.80, 0.80), (PROGRAMME, 14, 0.90, 0.80)]
)
def test_intervals_contain_the_shots_of_unseen_articles(
    without: frozenset[int], series: int, share: float, share_after_one: float
) -> None:
    none, one, _ = check(without)
    assert none.series == series
    assert none.covered >= share
    assert one.covered >= share_after_one
    assert none.half_width == pytest.approx(0.646, abs=0.001)
    assert normal_half_width() == pytest.approx(0.541, abs=0.001)


def test_unseen_articles_are_not_used_in_any_fit() -> None:
    fitted = {(shot.mass, shot.velocity, shot.depth, shot.compressive_strength) for shot in depth_shots()}
    articles = {shot.article for shot in depth_shots()}
    rows = counted_rows()
    assert (len(never_fitted_shots()), len({shot.article for shot in never_fitted_shots()})) == (261, 21)
    assert (len(rows), len({shot.article for shot in rows})) == (64, 13)
    assert not articles & {shot.article for shot in never_fitted_shots()}
    assert not fitted & {(shot.mass, shot.velocity, shot.depth, shot.compressive_strength) for shot in rows}


def test_strength_and_diameter_improve_the_fit() -> None:
    assert score(())[0] < score(CHOSEN)[0]
    assert score(("strength",))[0] < score(CHOSEN)[0] < score((*CHOSEN, "speed"))[0]
    assert score((*CHOSEN, "nose"))[0] < score(CHOSEN)[0]


@pytest.fixture(scope="module")
def section() -> Section:
    return strength_law_section()


def test_solver_uses_the_constants_and_the_range_of_the_fit(section: Section) -> None:
    assert all(each.holds for each in section.comparisons)
    shots = counted_shots()
    for limits, name in (
        (PublishedTests.compressive_strengths, "compressive_strength"),
        (PublishedTests.diameters, "diameter"),
        (PublishedTests.velocities, "velocity"),
    ):
        values = [getattr(shot, name) for shot in shots]
        assert limits == (min(values), max(values))


def test_interval_after_one_own_shot_contains_the_others_of_its_series() -> None:
    """`OwnTests` gets each shot of a series alone; its 90 % interval is compared with the other shots."""
    shares, widths = [], []
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
            half = found.scale * float(stdtrit(found.degrees_of_freedom, 0.95))
            inside.append(abs(math.log(factor_of(other) / found.median)) <= half)
            widths.append(half)
        if inside:
            shares.append(np.mean(inside))
    assert len(shares) == 44
    assert np.mean(shares) >= 0.84
    assert np.mean(widths) <= 0.30


def test_section_states_law_scatter_and_rule(section: Section) -> None:
    text = " ".join(section.text)
    assert "S = 8.84 (f'c / 39 MPa)^-0.18 (d / 76.2 mm)^-0.24" in text
    assert "0.31 between series and 0.10 within" in text
    assert "0.266 between series" in text
    assert "0.0677 within" in text
    assert "69 series, 25 of them with one shot" in text
    assert "± 0.04" in text
    tables = {table.name: table for table in section.tables}
    assert sum(int(str(row[1])) for row in tables["strength-law-rule"].rows) == 751
    assert sum(int(str(row[3])) for row in tables["strength-law-series"].rows) == len(counted_shots())
    assert chosen_law().between == pytest.approx(0.3130, abs=0.001)
    assert chosen_scatter().between == pytest.approx(PublishedTests.between_series, abs=0.0005)


def test_own_shots_narrow_the_range_of_the_paper_angle() -> None:
    widths = []
    for own_shots in (0, 1, 4):
        _, _, (low, middle, high) = paper_range(own_shots, ElasticPlastic())
        assert low < middle < high
        widths.append(high - low)
    assert widths == pytest.approx([10.9, 3.4, 2.7], abs=0.2)
