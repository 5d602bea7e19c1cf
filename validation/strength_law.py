"""The law of S fitted to a compilation of 68 articles: rows used, a mixed model, and predictions for unseen series."""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln, stdtrit

from solver import (
    Crater,
    ElasticPlastic,
    MohrCoulomb,
    Ogive,
    OwnTests,
    Projectile,
    PublishedTests,
    Resistance,
    Shot,
    StrengthPowerLaw,
    Target,
    critical_angle,
    strength_factor_of_depth,
)
from solver.arrays import FloatArray
from solver.free_surface import FreeSurface
from solver.resistance import ObliquityShape, ShotPrediction, predict_shot
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from validation.depth_tests import percent
from validation.reference import DepthShot, depth_shots, table_1
from validation.report import Comparison, ReportTable, Section, paragraphs

REFERENCE_STRENGTH, REFERENCE_DIAMETER = 39e6, 0.0762
"""Strength and diameter at which S equals the coefficient of the law. [Pa, m]"""
RIGID_UP_TO = 900.0
"""Speed above which noses of steel erode. [m/s]"""
HEAVIEST_STEEL = 9000.0
"""Density above which a projectile cannot be of steel. [kg/m³]"""
STRENGTHS = (10e6, 110e6)
"""Range of the strengths used. [Pa]"""
LEAST_CALIBERS = 2.0
"""Ratio of depth to diameter below which the front crater governs the depth. [1]"""
LEAST_THICKNESS = 1.5
"""Ratio of thickness to depth below which the rear face weakens the target. [1]"""
OTHER_MATERIAL = re.compile(
    r"UHP|UHMWPE|UHTCC|FRC|FRH|RPC|Reactive|Fib|SHCC|VHSC|HSSB|NSSB|Steel|Granite|G Mix", re.IGNORECASE
)
"""Pattern of the names of fibre, reactive powder and ultra-high-performance mixes, of targets with steel bars, and of
rock."""
CONTRADICTED: Mapping[int, str] = {
    **dict.fromkeys((9, 10), "the same body at the same speed went 2 to 3 times as deep in rows 6 to 8"),
    55: "590 m/s is probably a slip for 690 m/s",
}
"""Rows that contradict other rows of their article, with the reason."""
NORMALISED = frozenset((*range(721, 734), 735, 737, 738))
"""Rows of article 71 whose depths seem to be normalised to its 29.9 mm body. In targets that are thick enough, bodies
of 0.04, 0.12, 1 and 8 kg all have a depth of 0.6 to 0.8 m at 650 m/s, so S would be up to 22 for the largest and down
to 2.4 for the smallest."""
NORMALISED_TO = 0.0299
"""Diameter of the body to which these depths seem to be normalised. If each depth is multiplied by the diameter of its
row over this one, S is 6 to 12. [m]"""
MEASURED_IN_GRAMS = 100.0
"""Ratio of the mass to the mass of a solid cylinder, above which the mass must have been given in grams. [1]"""
HEAVIEST = 1.05
"""Ratio of the mass to the mass of a solid cylinder, above which mass, size or material of a row must be wrong. [1]"""
FREEDOM = PublishedTests.degrees_of_freedom
FREEDOMS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 1e6)
"""Degrees of freedom that are compared; the last value is practically a normal distribution. [1]"""


def reason_left_out(shot: DepthShot) -> str | None:
    """Return the first reason why a law for rigid bodies must not be fitted to a row; None if there is no reason."""
    lowest, highest = STRENGTHS
    reasons = {
        "mass, speed or depth unknown": math.isnan(shot.mass * shot.velocity * shot.depth),
        "nose unknown or flat": shot.caliber_radius_head is None,
        "projectile not of steel": shot.projectile_density > HEAVIEST_STEEL,
        f"above {RIGID_UP_TO:g} m/s, where noses erode": shot.velocity > RIGID_UP_TO,
        "fibres, reactive powder, ultra-high performance, steel bars or rock": bool(
            OTHER_MATERIAL.search(shot.concrete)
        ),
        f"strength outside {lowest / 1e6:g} to {highest / 1e6:g} MPa": not (
            lowest <= shot.compressive_strength <= highest
        ),
        f"shallower than {LEAST_CALIBERS:g} diameters": shot.depth < LEAST_CALIBERS * shot.diameter,
        f"target thinner than {LEAST_THICKNESS:g} depths": shot.thickness is not None
        and shot.thickness < LEAST_THICKNESS * shot.depth,
        "mass in grams": shot.mass > MEASURED_IN_GRAMS * _heaviest(shot),
        "contradicted by other rows of the article": shot.row in CONTRADICTED,
        "depth normalised to another body, as it seems": shot.row in NORMALISED,
    }
    return next((reason for reason, applies in reasons.items() if applies), None)


def _heaviest(shot: DepthShot) -> float:
    """Return the mass of a solid cylinder of the size and material of a row. [kg]"""
    return shot.projectile_density * math.pi / 4.0 * shot.diameter**2 * shot.length


@cache
def counted_shots() -> tuple[DepthShot, ...]:
    """Return the rows to which laws are fitted."""
    return tuple(shot for shot in depth_shots() if reason_left_out(shot) is None)


def factor_of(
    shot: DepthShot, *, inertia_factor: float = 1.0, crater: Crater | None = None, depth: float | None = None
) -> float:
    """Return the strength factor with which the model gives the depth of a shot. [1]"""
    nose = Ogive(caliber_radius_head=shot.caliber_radius_head or math.nan)
    # Only the nose is loaded in normal impact, so a length too short for the nose of the row does not matter.
    length = max(shot.length, 1.01 * nose.length(shot.diameter / 2.0))
    return strength_factor_of_depth(
        projectile=Projectile(nose=nose, diameter=shot.diameter, length=length, mass=shot.mass),
        target=Target(compressive_strength=shot.compressive_strength, density=shot.density),
        velocity=shot.velocity,
        depth=depth or shot.depth,
        inertia_factor=inertia_factor,
        crater=crater,
    )


COVARIATES: Mapping[str, Callable[[DepthShot], float]] = {
    "strength": lambda shot: shot.compressive_strength / REFERENCE_STRENGTH,
    "diameter": lambda shot: shot.diameter / REFERENCE_DIAMETER,
    "speed": lambda shot: shot.velocity / 400.0,
    "nose": lambda shot: (shot.caliber_radius_head or math.nan) / 3.0,
    "sectional mass": lambda shot: shot.mass / shot.diameter**3 / 2e4,
    "target size": lambda shot: math.sqrt(shot.area) / shot.diameter / 20.0 if shot.area else 1.0,
}
"""Quantities on which S may depend by a power law. A target of unknown size counts as 20 diameters wide."""
CHOSEN = ("strength", "diameter")


def design(shots: Sequence[DepthShot], names: Sequence[str]) -> FloatArray:
    """Return the design matrix: a column of ones, and the logarithms of the named quantities, a row for each shot."""
    columns = [np.ones(len(shots)), *(np.log([COVARIATES[name](shot) for shot in shots]) for name in names)]
    return np.column_stack(columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class MixedModel:
    """The model ``ln S = X b + series + shot``, in which the effects of series and shot are normally distributed."""

    coefficients: FloatArray
    """Coefficients b."""
    standard_errors: FloatArray
    between: float
    """Standard deviation between series. [ln]"""
    within: float
    """Standard deviation of shots within a series. [ln]"""


def fit_mixed(values: FloatArray, matrix: FloatArray, groups: Sequence[object]) -> MixedModel:
    """Fit the mixed model by restricted maximum likelihood.

    Parameters
    ----------
    values
        ln S, (n,).
    matrix
        X, (n, p).
    groups
        Series of each value, (n,).
    """
    names = {name: index for index, name in enumerate(dict.fromkeys(groups))}
    member = np.zeros((len(names), len(values)))
    member[[names[name] for name in groups], np.arange(len(values))] = 1.0
    counts, sums, totals = member.sum(1), member @ matrix, member @ values
    gram, moment, square = matrix.T @ matrix, matrix.T @ values, float(values @ values)

    def solve(between: float, within: float) -> tuple[FloatArray, FloatArray, float]:
        # The covariance of a series is within² I + between² 1 1ᵀ, whose inverse and determinant have closed forms.
        variance = within**2 + counts * between**2
        weights = between**2 / variance
        information = (gram - (sums.T * weights) @ sums) / within**2
        right = (moment - (sums.T * weights) @ totals) / within**2
        best = np.linalg.solve(information, right)
        rest = (square - weights @ totals**2) / within**2 - float(right @ best)
        logs = float(np.sum((counts - 1.0) * math.log(within**2) + np.log(variance)))
        return best, information, logs + float(np.linalg.slogdet(information)[1]) + rest

    def deviance(logarithms: FloatArray) -> float:
        return solve(*np.exp(logarithms).tolist())[2]

    found = minimize(deviance, np.log([0.3, 0.1]), method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-7})
    between, within = np.exp(found.x).tolist()
    best, information, _ = solve(between, within)
    errors = np.sqrt(np.diagonal(np.linalg.inv(information)))
    return MixedModel(coefficients=best, standard_errors=errors, between=between, within=within)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesScatter:
    """Scatter of ln S about a law, with Student's distributions between and within series, as in `PublishedTests`."""

    between: float
    """Scale between series. [ln]"""
    within: float
    """Scale within a series. [ln]"""
    degrees_of_freedom: float = FREEDOM
    """Degrees of freedom of Student's distributions. [1]"""

    def log_density(self, series: Sequence[FloatArray]) -> FloatArray:
        """Return, for each series, the logarithm of the joint density of its residuals."""
        count = np.array([len(each) for each in series], float)
        mean = np.array([each.mean() for each in series])
        squares = np.array([float(((each - each.mean()) ** 2).sum()) for each in series])
        prior, freedom = (self.within / self.between) ** 2, self.degrees_of_freedom
        squares += prior * count / (prior + count) * mean**2
        logs = gammaln(0.5 * (freedom + count)) - gammaln(0.5 * freedom) - 0.5 * count * math.log(freedom * math.pi)
        logs -= count * math.log(self.within) + 0.5 * np.log1p(count / prior)
        logs -= 0.5 * (freedom + count) * np.log1p(squares / (freedom * self.within**2))
        return np.asarray(logs, float)


def fit_scatter(series: Sequence[FloatArray], degrees_of_freedom: float = FREEDOM) -> SeriesScatter:
    """Fit the two scales to the residuals of all series by maximum likelihood."""

    def scatter(logarithms: FloatArray) -> SeriesScatter:
        between, within = np.exp(logarithms).tolist()
        return SeriesScatter(between=between, within=within, degrees_of_freedom=degrees_of_freedom)

    def deviance(logarithms: FloatArray) -> float:
        return -2.0 * float(scatter(logarithms).log_density(series).sum())

    found = minimize(
        deviance,
        np.log([0.3, 0.1]),
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-7},
    )
    return scatter(found.x)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenSeries:
    """Residuals of a series about a law fitted without it, and the scatter of that law."""

    misses: FloatArray
    """Residuals: ln S of each shot minus ln S of the law, (n,)."""
    scatter: SeriesScatter

    def after(self, given: Sequence[int]) -> ShotPrediction:
        """Return the prediction of the next shot, given the shots with these indices."""
        return predict_shot(
            self.misses[list(given)],
            between=self.scatter.between,
            within=self.scatter.within,
            degrees_of_freedom=self.scatter.degrees_of_freedom,
        )

    def covered_after(self, count: int) -> tuple[float, float]:
        """Return the fraction of the other shots in the 90 % interval, and its half width. [1, ln]

        Both are means over all choices of `count` given shots.
        """
        covered: list[bool] = []
        widths = []
        for given in combinations(range(len(self.misses)), count):
            found = self.after(given)
            widths.append(found.scale * float(stdtrit(found.degrees_of_freedom, 0.95)))
            covered += (np.abs(np.delete(self.misses, given) - found.location) <= widths[-1]).tolist()
        return float(np.mean(covered)), float(np.mean(widths))


def in_series(values: FloatArray, names: Sequence[object]) -> list[FloatArray]:
    """Split values by the name of their series."""
    return [values[[place for place, each in enumerate(names) if each == name]] for name in dict.fromkeys(names)]


def unseen_series(
    shots: Sequence[DepthShot], values: FloatArray, names: Sequence[str], *, by_article: bool
) -> list[UnseenSeries]:
    """Fit the law without each series, or each article, in turn, and return the residuals of the series left out."""
    matrix, series = design(shots, names), [shot.series for shot in shots]
    folds = [shot.article for shot in shots] if by_article else series
    found = []
    for fold in dict.fromkeys(folds):
        kept = [place for place, each in enumerate(folds) if each != fold]
        names_kept = [series[place] for place in kept]
        model = fit_mixed(values[kept], matrix[kept], names_kept)
        scatter = fit_scatter(in_series(values[kept] - matrix[kept] @ model.coefficients, names_kept))
        for name in dict.fromkeys(each for each, where in zip(series, folds, strict=True) if where == fold):
            places = [place for place, each in enumerate(series) if each == name]
            misses = values[places] - matrix[places] @ model.coefficients
            found.append(UnseenSeries(misses=misses, scatter=scatter))
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """Shares of the shots of unseen series that are in the 90 % interval, given some other shots of the same series."""

    shots_given: int
    series: int
    """Number of series with more than `shots_given` shots."""
    covered: float
    """Mean over these series of the share of their other shots in the interval. [1]"""
    covered_shots: float
    """Share of the other shots of all series in the interval. [1]"""
    half_width: float
    """Mean half width of the interval, over these series. [ln]"""


def coverage(found: Sequence[UnseenSeries], shots_given: int) -> Coverage:
    """Return the coverage, given a number of shots of each series."""
    enough = [each for each in found if len(each.misses) > shots_given]
    shares, widths = zip(*(each.covered_after(shots_given) for each in enough), strict=True)
    others = [len(each.misses) if shots_given == 0 else len(each.misses) - shots_given for each in enough]
    return Coverage(
        shots_given=shots_given,
        series=len(enough),
        covered=float(np.mean(shares)),
        covered_shots=float(np.average(shares, weights=others)),
        half_width=float(np.mean(widths)),
    )


@cache
def chosen_law() -> MixedModel:
    """Return the law of strength and diameter, fitted to the counted rows."""
    shots = counted_shots()
    return fit_mixed(logarithms(shots), design(shots, CHOSEN), [shot.series for shot in shots])


@cache
def chosen_scatter(degrees_of_freedom: float = FREEDOM) -> SeriesScatter:
    """Return the scatter about `chosen_law`, fitted to the counted rows."""
    return fit_scatter(chosen_misses(), degrees_of_freedom)


@cache
def chosen_misses() -> tuple[FloatArray, ...]:
    """Return the residuals of `chosen_law`, i.e. measured minus fitted ln S, for the shots of each series."""
    shots = counted_shots()
    misses = logarithms(shots) - design(shots, CHOSEN) @ chosen_law().coefficients
    return tuple(in_series(misses, [shot.series for shot in shots]))


def likelihood(degrees_of_freedom: float) -> float:
    """Return the log-likelihood of the counted rows with `chosen_scatter`."""
    return float(chosen_scatter(degrees_of_freedom).log_density(chosen_misses()).sum())


def law_with_article_71(*, normalised: bool) -> MixedModel:
    """Fit the law with the rows of article 71 too, with depths as printed or scaled back from its 29.9 mm body."""
    others = [shot for shot in depth_shots() if shot.row in NORMALISED]
    if normalised:
        others = [replace(shot, depth=shot.depth * shot.diameter / NORMALISED_TO) for shot in others]
    usable = [shot for shot in others if reason_left_out(replace(shot, row=0)) is None]
    shots = (*counted_shots(), *usable)
    return fit_mixed(logarithms(shots), design(shots, CHOSEN), [shot.series for shot in shots])


def logarithms(shots: Sequence[DepthShot], *, inertia_factor: float = 1.0, crater: Crater | None = None) -> FloatArray:
    """Return the logarithm of the strength factor of each shot."""
    return np.log([factor_of(shot, inertia_factor=inertia_factor, crater=crater) for shot in shots])


@cache
def coverages(*, by_article: bool) -> tuple[Coverage, ...]:
    """Return the coverage for unseen series, or series of unseen articles, given no, one and two of their shots."""
    shots = counted_shots()
    found = unseen_series(shots, logarithms(shots), CHOSEN, by_article=by_article)
    return tuple(coverage(found, count) for count in range(3))


def score(names: Sequence[str], *, inertia_factor: float = 1.0, crater: Crater | None = None) -> tuple[float, float]:
    """Return the mean log density of ln depth in unseen articles, and the half width of the interval after one shot."""
    shots = counted_shots()
    values = logarithms(shots, inertia_factor=inertia_factor, crater=crater)
    found = unseen_series(shots, values, names, by_article=True)
    # Laws with different inertia factors B or craters give different S for a shot, so their densities of ln S are not
    # comparable. They are converted to densities of ln depth.
    step = 1.001
    deeper = np.log(
        [factor_of(shot, inertia_factor=inertia_factor, crater=crater, depth=step * shot.depth) for shot in shots]
    )
    slopes = np.log(np.abs((deeper - values) / math.log(step)))
    density = sum(float(each.scatter.log_density([each.misses])[0]) for each in found) / len(shots)
    return density + float(slopes.mean()), coverage(found, 1).half_width


CANDIDATES: Mapping[str, tuple[Sequence[str], float, Crater | None]] = {
    "nothing": ((), 1.0, None),
    "strength": (("strength",), 1.0, None),
    "strength, diameter": (CHOSEN, 1.0, None),
    **{f"strength, diameter, {name}": ((*CHOSEN, name), 1.0, None) for name in COVARIATES if name not in CHOSEN},
    **{f"strength, diameter, with B = {factor:g}": (CHOSEN, factor, None) for factor in (0.5, 1.5, 2.0)},
    "strength, diameter, with a crater of 2 diameters": (CHOSEN, 1.0, Crater()),
}
"""Candidate laws by name: quantities on which S depends, the inertia factor B, and the crater."""


def strength_law_section() -> Section:
    """Return the section on the law of S, its scatter, and how often its intervals contain shots of unseen series."""
    shots, law = counted_shots(), chosen_law()
    values = logarithms(shots)
    constant, strength, diameter = law.coefficients.tolist()
    errors = law.standard_errors.tolist()
    without, after_one, _ = coverages(by_article=False)
    light = [shot for shot in shots if shot.mass <= HEAVIEST * _heaviest(shot)]
    narrow = fit_mixed(logarithms(light), design(light, CHOSEN), [shot.series for shot in light])
    printed, read = (law_with_article_71(normalised=normalised) for normalised in (False, True))
    scatter, likely = chosen_scatter(), max(FREEDOMS, key=likelihood)
    text = f"""
        {len(shots)} of {len(depth_shots())} rows of the compilation may be used for a rigid body, by the rule in the
        table below: {len({shot.article for shot in shots})} articles, {len({shot.series for shot in shots})} series,
        {sum(len(each) == 1 for each in chosen_misses())} of them with one shot. A series is what one article fired into
        concrete of one strength. S of each shot follows from its depth in closed form, B = 1, no crater.

        A mixed model, with a random intercept for each series and restricted maximum likelihood, gives
        **S = {math.exp(constant):.2f} (f'c / 39 MPa)^{strength:.2f} (d / 76.2 mm)^{diameter:.2f}**, with standard
        errors of {percent(errors[0])}, {errors[1]:.2f} and {errors[2]:.2f}. The standard deviation of ln S is
        {law.between:.2f} between series and {law.within:.2f} within one.

        **The exponent of the diameter is less sure than its standard error says.** The depths of article 71 seem to be
        normalised to its {1e3 * NORMALISED_TO:g} mm body, and its rows stay out. With them as printed the exponent
        would be {printed.coefficients[2]:.2f}; with every depth times d / {1e3 * NORMALISED_TO:g} mm the law would be
        {math.exp(read.coefficients[0]):.2f} (f'c / 39 MPa)^{read.coefficients[1]:.2f}
        (d / 76.2 mm)^{read.coefficients[2]:.2f}, with {read.between:.2f} between series. That one choice moves the
        exponent by {abs(read.coefficients[2] - diameter):.2f}, twice its standard error: allow
        ± {math.hypot(errors[2], read.coefficients[2] - diameter):.2f}, and more where the reading is wrong.

        **Tails.** About this law, the variance within a series is scaled inverse chi-square and the next shot has
        Student's distribution. With {FREEDOM:g} degrees of freedom the scales are **{scatter.between:.3f} between
        series** and **{scatter.within:.4f} within one**. {likely:g} degrees of freedom are likeliest, by
        {likelihood(likely) - likelihood(FREEDOM):.1f} in the logarithm over {FREEDOM:g}, and the normal distribution
        is less likely than that by {likelihood(FREEDOM) - likelihood(FREEDOMS[-1]):.1f}. {FREEDOM:g} was chosen after
        the series of the next section were looked at.

        Each series left out in turn, {percent(without.covered)} of the shots of a series lie in the 90 % interval
        without tests (half width {without.half_width:.2f}, {without.series} series; {percent(without.covered_shots)}
        of all shots), and {percent(after_one.covered)} of the others after one shot (half width
        {after_one.half_width:.2f}, {after_one.series} series; {percent(after_one.covered_shots)} of all shots).

        **What the scatter depends on.** {len(shots) - len(light)} of the rows are heavier than a solid cylinder of
        their size and material, so that one of these numbers is wrong, and S with it as a rule. They stay in: nobody
        knows which number it is, slips that leave a body light enough stay in unseen, and a rule made after looking at
        what stands apart flatters the scatter. Without them the law would be
        {math.exp(narrow.coefficients[0]):.2f} (f'c / 39 MPa)^{narrow.coefficients[1]:.2f}
        (d / 76.2 mm)^{narrow.coefficients[2]:.2f}, with a standard deviation of {narrow.between:.2f} between series and
        {narrow.within:.2f} within one. The scatter between series is therefore that of concretes and of reports
        together, and the largest single part of it is not the concrete.

        Speed would earn a place: S grows with it, as it would with B above 1 or a crater. It has none, since S is one
        number for a concrete and a projectile in the paper's law, and since it takes a tenth off the scatter only.
        Nose, sectional mass and size of the target earn none.
    """
    return Section(
        title="Strength factor over the tests of the literature",
        text=paragraphs(text),
        comparisons=_comparisons(law),
        tables=(_rule_table(), _score_table(), _coverage_table(), _series_table(values), _own_shots_table()),
    )


def _comparisons(law: MixedModel) -> tuple[Comparison, ...]:
    constant, strength, diameter = law.coefficients.tolist()
    numbers = (
        ("coefficient", math.exp(constant), PublishedTests.law.coefficient, 0.01),
        ("exponent of the strength", strength, PublishedTests.law.exponent, 0.005),
        ("exponent of the diameter", diameter, PublishedTests.law.diameter_exponent, 0.005),
        ("scale between series", chosen_scatter().between, PublishedTests.between_series, 0.0005),
        ("scale within a series", chosen_scatter().within, PublishedTests.within_series, 0.00005),
    )
    return tuple(
        Comparison(
            what=f"law of the published tests, {what}",
            ours=ours,
            reference=reference,
            unit="1",
            tolerance=tolerance,
            reference_source="`published_tests` of the solver",
        )
        for what, ours, reference, tolerance in numbers
    )


def _rule_table() -> ReportTable:
    counts = Counter(reason_left_out(shot) or "counted" for shot in depth_shots())
    return ReportTable(
        name="strength-law-rule",
        caption="Rows of the compilation by the first reason why they are left out.",
        columns=("reason", "rows"),
        rows=counts.most_common(),
    )


def _score_table() -> ReportTable:
    rows = []
    for name, (names, factor, crater) in CANDIDATES.items():
        density, half_width = score(names, inertia_factor=factor, crater=crater)
        rows.append((name, round(density, 3), round(half_width, 3)))
    return ReportTable(
        name="strength-law-scores",
        caption="Each article left out in turn: mean logarithm of the density that the law gives to ln depth, a shot; "
        "larger is better. Half width of the 90 % interval of ln S after one shot.",
        columns=("S goes with", "score", "half width after one shot"),
        rows=rows,
    )


def _coverage_table() -> ReportTable:
    rows = [
        (
            "article" if by_article else "series",
            *(each.shots_given, each.series),
            *(round(value, 3) for value in (each.covered, each.covered_shots, each.half_width)),
        )
        for by_article in (False, True)
        for each in coverages(by_article=by_article)
    ]
    columns = ("left out", "own shots", "series", "covered, mean of series", "covered, of all shots", "half width")
    return ReportTable(
        name="strength-law-coverage",
        caption="Shots of series left out in their 90 % interval of S, before and after shots of the same series.",
        columns=columns,
        rows=rows,
    )


def _series_table(values: FloatArray) -> ReportTable:
    shots = counted_shots()
    misses = values - design(shots, CHOSEN) @ chosen_law().coefficients
    rows = []
    for name in sorted({shot.series for shot in shots}):
        places = [place for place, shot in enumerate(shots) if shot.series == name]
        diameters = sorted({shots[place].diameter * 1e3 for place in places})
        mean = round(math.exp(float(np.mean(values[places]))), 2)
        off = round(math.exp(float(np.mean(misses[places]))), 2)
        rows.append((name[0], name[1] / 1e6, ", ".join(f"{each:g}" for each in diameters), len(places), mean, off))
    return ReportTable(
        name="strength-law-series",
        caption="Geometric mean of S in each series, and its ratio to the law. Articles: `depth_tests_articles.csv`.",
        columns=("article", "f'c [MPa]", "d [mm]", "shots", "S", "over the law"),
        rows=rows,
    )


def paper_range(own_shots: int, law: FreeSurface) -> tuple[float, float, tuple[float, float, float]]:
    """Return the median of S, the scale of ln S, and quantiles of the angle [°], after some of the paper's shots.

    The 5, 50 and 95 % quantiles of the angle are the angles for the 95, 50 and 5 % quantiles of S, because a larger S
    gives a smaller critical angle.
    """
    own = tuple(Shot(velocity=shot.velocity, depth=shot.depth, mass=shot.mass) for shot in table_1())
    found = OwnTests(shots=own[: max(own_shots, 1)]).posterior(target=PAPER_TARGET, projectile=PAPER_PROJECTILE)
    known = predict_shot(np.log(found.factors[:own_shots]) - math.log(found.prior_median))
    median, scale = found.prior_median * math.exp(known.location), known.scale
    shape: ObliquityShape = "finite_elements" if isinstance(law, MohrCoulomb) else "equation_9"
    angles = []
    for quantile in stdtrit(known.degrees_of_freedom, (0.95, 0.5, 0.05)).tolist():
        factor = StrengthPowerLaw(coefficient=median * math.exp(quantile * scale), exponent=0.0, obliquity_shape=shape)
        angle = critical_angle(
            projectile=PAPER_PROJECTILE,
            target=PAPER_TARGET,
            velocity=PAPER_VELOCITY,
            resistance=Resistance(strength_factor=factor, free_surface=law),
        ).angle
        angles.append(math.nan if angle is None else math.degrees(angle))
    return median, scale, (angles[0], angles[1], angles[2])


def _own_shots_table() -> ReportTable:
    rows = []
    for own_shots in (0, 1, 4):
        for law in (ElasticPlastic(), MohrCoulomb()):
            median, scale, angles = paper_range(own_shots, law)
            rows.append((own_shots, law.name, round(median, 2), round(scale, 3), *(round(x, 1) for x in angles)))
    return ReportTable(
        name="strength-law-own-shots",
        caption="The paper's angle by the scatter of S alone, each decay with its own S(θ), without and with shots of "
        "its Table 1.",
        columns=("own shots", "decay", "S", "scale", "5 % [°]", "50 % [°]", "95 % [°]"),
        rows=rows,
    )
