import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from solver import Exit, ParameterError
from solver.arrays import FloatArray
from solver.uncertainty import (
    AngleStudy,
    Crossings,
    Discrete,
    Ending,
    Normal,
    Sampling,
    TrajectoryStudy,
    Uncertain,
    Uniform,
)
from tests.physics.strikes import known
from tests.uncertainty.functions import Ishigami, Linear, answer_of, misses, run

EDGE = [Uncertain("x", Uniform(lower=0.0, upper=1.0))]
GRID = np.linspace(0.0, 1.0, 11)


def test_surrogate_of_a_smooth_function_is_exact() -> None:
    answer = run(Linear(), seed=3)
    assert answer.method == "surrogate"
    assert answer.surrogate_error == pytest.approx(0.0, abs=1e-12)
    assert known(answer.mean).value == pytest.approx(5.0)
    assert known(answer.standard_deviation).value == pytest.approx(math.sqrt(14.0))
    assert [known(each.total).value for each in answer.sensitivity] == pytest.approx([1 / 14, 4 / 14, 9 / 14])
    assert misses(Linear(), answer) == []


def test_surrogate_includes_the_share_its_samples_cannot_show() -> None:
    answer = run(Linear(), half_width=0.002)
    first, last = answer.convergence[0], answer.convergence[-1]
    assert answer.method == "surrogate"
    assert answer.converged
    assert first.samples < last.samples  # The 65,536 points at which the surrogate is evaluated do not count.
    unseen = answer.share_without.upper
    assert ((answer.upper - answer.probability)[answer.probability < 0.5] >= unseen).all()
    assert ((answer.probability - answer.lower)[answer.probability > 0.5] >= unseen).all()
    assert last.half_width >= unseen  # The share widens an intermediate interval on both sides.


@pytest.mark.parametrize("half_width", [0.1, 0.01])
def test_samples_correct_a_surrogate_with_a_persistent_error(half_width: float) -> None:
    """The function has a small step, where more samples do not reduce the error of the surrogate."""

    class Stepped(Linear):
        def __call__(self, x: FloatArray) -> FloatArray:
            return 0.01 * super().__call__(x) + 0.0015 * np.sign(x[:, 0])

        grid = 0.01 * Linear.grid

    answer = run(Stepped(), half_width=half_width, sensitivity=False)
    assert answer.converged
    assert 0.0 < known(answer.surrogate_error) < math.radians(0.1)
    values = np.sort(Stepped()(np.random.default_rng(1).standard_normal((400_000, 3))))
    truth = np.searchsorted(values, answer.oblique_angles, side="right") / values.size
    inside = (answer.lower - 2e-3 <= truth) & (truth <= answer.upper + 2e-3)
    assert inside.mean() >= 0.95


def test_counting_replaces_a_less_exact_surrogate() -> None:
    """The surrogate of a function with steps in one input is too inexact for a half width of 0.01."""

    class Stairs(Linear):
        distributions = (Uniform(lower=-1.0, upper=1.0),)
        grid = np.linspace(-0.05, 0.05, 21)

        def __call__(self, x: FloatArray) -> FloatArray:
            return np.asarray(0.05 * x[:, 0] + 0.0015 * np.sign(np.sin(40.0 * x[:, 0])), float)

    coarse, fine = (run(Stairs(), half_width=half_width, sensitivity=False) for half_width in (0.1, 0.01))
    assert (coarse.method, fine.method) == ("surrogate", "direct")
    assert fine.converged
    assert known(fine.surrogate_error) < math.radians(0.1)
    assert coarse.samples < fine.samples


def test_rough_function_is_sampled_directly() -> None:
    function = Ishigami()
    answer = run(function, seed=1)
    assert answer.method == "direct"
    assert answer.converged
    assert known(answer.surrogate_error) > math.radians(0.1)
    assert len(misses(function, answer)) <= 3  # There are 41 intervals at 95 %.


def test_convergence_ends_at_the_half_width_or_the_budget() -> None:
    answer = run(Ishigami(), half_width=0.02, sensitivity=False)
    widths = [each.half_width for each in answer.convergence]
    assert answer.converged
    assert widths[-1] <= 0.02 < widths[-2]
    assert answer.convergence[-1].samples == answer.samples
    poor = run(Ishigami(), half_width=1e-3, max_samples=1024, sensitivity=False)
    assert not poor.converged
    assert poor.samples == 1024
    assert (poor.upper - poor.lower).max() > 2e-3


@pytest.mark.parametrize("budget", [272, 512, 1024])
@pytest.mark.parametrize("method", ["auto", "direct"])
@pytest.mark.parametrize("models", [2, 14])
def test_study_never_takes_more_samples_than_its_budget(budget: int, method: str, models: int) -> None:
    inputs = [*EDGE, Uncertain("model", Discrete(values=[float(model) for model in range(models)]))]
    taken = 0

    def evaluate(points: Sequence[Any]) -> list[Crossings]:
        nonlocal taken
        taken += len(points)
        return [Crossings((0.5 * round(x) + 0.01 * model,)) for x, model in points]  # No surrogate fits a step.

    sampling = Sampling(max_samples=budget, half_width=1e-4, method=method)
    answer = answer_of(AngleStudy(inputs, GRID, sampling), evaluate)
    assert answer.samples == taken <= budget
    assert len(answer.sensitivity[1].swing) == models
    taken = 0
    ending = answer_of(TrajectoryStudy(inputs, sampling), lambda points: [Ending("embedded")] * len(points))
    assert ending.samples <= budget


def test_budget_below_the_fewest_samples_is_refused_with_the_least_one() -> None:
    inputs = [*EDGE, Uncertain("model", Discrete(values=[0.0, 1.0, 2.0]))]
    with pytest.raises(ParameterError, match=r"must be at least 261 for .*, got 260") as error:
        AngleStudy(inputs, GRID, Sampling(max_samples=260))
    assert error.value.field == "sampling.max_samples"
    AngleStudy(inputs, GRID, Sampling(max_samples=261))
    AngleStudy(inputs, GRID, Sampling(max_samples=256), sensitivity=False)


def test_study_without_budget_after_the_first_samples_has_no_indices() -> None:
    answer = run(Ishigami(), max_samples=262)
    assert answer.method == "direct"
    assert answer.samples == 262
    assert [each.total for each in answer.sensitivity] == [None] * 3
    assert [warning.code for warning in answer.warnings] == ["no_indices"]


def test_answer_depends_only_on_the_seed() -> None:
    first, second, other = (run(Ishigami(), seed=seed) for seed in (4, 4, 5))
    assert repr(first.quantiles) == repr(second.quantiles)
    assert first.probability.tobytes() == second.probability.tobytes()
    assert [each.total for each in first.sensitivity] == [each.total for each in second.sensitivity]
    assert first.probability.tobytes() != other.probability.tobytes()


def test_larger_sample_begins_with_the_smaller_one() -> None:
    def points(budget: int) -> list[tuple[float, ...]]:
        found: list[tuple[float, ...]] = []

        def evaluate(batch: Sequence[Any]) -> list[Crossings]:
            found.extend(batch)
            return [Crossings((float(y),)) for y in Ishigami()(np.array(batch, float))]

        inputs = [Uncertain(f"x.{i}", each) for i, each in enumerate(Ishigami.distributions)]
        sampling = Sampling(max_samples=budget, half_width=1e-3)
        answer_of(AngleStudy(inputs, Ishigami.grid, sampling, sensitivity=False), evaluate)
        return found

    few, many = points(512), points(2048)
    assert len(few) == 512
    assert many[:512] == few


def test_alternative_models_count_as_one_input() -> None:
    """y = x + z, where x is uniform in [-1, 1], and z is 0 or 3 with weights 0.8 and 0.2: Var x = 1/3, Var z = 1.44."""

    class Sum:
        grid = np.linspace(-2.0, 5.0, 29)
        distributions = (Uniform(lower=-1.0, upper=1.0), Discrete(values=[0.0, 3.0], weights=[0.8, 0.2]))

        def __call__(self, x: FloatArray) -> FloatArray:
            return np.asarray(x.sum(axis=1), float)

    exact = np.array([1 / 3, 1.44]) / (1 / 3 + 1.44)
    share = 0.8 * np.clip((Sum.grid + 1) / 2, 0, 1) + 0.2 * np.clip((Sum.grid - 2) / 2, 0, 1)
    for method in ("auto", "direct"):
        answer = run(Sum(), method=method)
        assert answer.method == ("surrogate" if method == "auto" else "direct")
        for each, value in zip(answer.sensitivity, exact, strict=True):
            first, total = known(each.first_order), known(each.total)
            assert first.lower <= first.value <= first.upper
            assert first.value == pytest.approx(value, abs=1e-9 if method == "auto" else 0.2)
            assert total.value == pytest.approx(value, abs=1e-9 if method == "auto" else 0.2)
        assert (answer.lower <= share + 1e-9).all()
        assert (share <= answer.upper + 1e-9).all()
        assert [change.value for change in answer.sensitivity[1].swing] == [0.0, 3.0]
        assert [change.angle for change in answer.sensitivity[1].swing] == pytest.approx([0.0, 3.0])


def outcome(crossings: Callable[[float], Crossings]) -> Callable[[Sequence[Any]], list[Crossings]]:
    return lambda points: [crossings(x) for (x,) in points]


def test_every_sample_is_counted_by_its_outcome_at_each_angle() -> None:
    def crossings(x: float) -> Crossings:
        if x < 0.25:
            return Crossings()  # never turned away
        if x < 0.5:
            return Crossings(starts_turned_away=True)  # always
        if x < 0.75:
            return Crossings((0.25, 0.45, 0.65))  # turned away in a band, and above a higher angle
        return Crossings((0.35, 0.55), starts_turned_away=True)  # turned away except in a band

    answer = answer_of(AngleStudy(EDGE, GRID, Sampling(half_width=0.05)), outcome(crossings))
    band = np.where(((GRID >= 0.25) & (GRID < 0.45)) | (GRID >= 0.65), 0.25, 0.0)
    retained = np.where((GRID >= 0.35) & (GRID < 0.55), 0.0, 0.25)
    assert answer.method == "direct"
    assert (np.abs(answer.probability - (0.25 + band + retained)) < 0.02).all()
    assert answer.share_without.value == pytest.approx(0.75, abs=0.02)
    assert {change.angle for change in answer.sensitivity[0].swing} <= {None, 0.25}
    assert "samples_without_angle" in {warning.code for warning in answer.warnings}
    assert np.isfinite(answer.lower).all()


@pytest.mark.parametrize(("crossings", "share"), [(Crossings(), 0.0), (Crossings(starts_turned_away=True), 1.0)])
def test_study_without_any_critical_angle_is_answered(crossings: Crossings, share: float) -> None:
    answer = answer_of(AngleStudy(EDGE, GRID, Sampling(half_width=0.05)), outcome(lambda _: crossings))
    assert answer.probability.tolist() == [share] * GRID.size
    assert answer.mean is None
    assert answer.quantiles == ()
    assert answer.share_without.value == 1.0
    assert "no critical angle" in repr(answer)


def test_samples_with_angles_in_a_single_scrambling_are_too_few_for_a_mean() -> None:
    """A single sample has an angle, so the summary must not say that none has one."""
    sampling = Sampling(half_width=0.05, max_samples=300)
    least = min(x for (x,) in next(AngleStudy(EDGE, GRID, sampling, sensitivity=False).steps()).points)
    study = AngleStudy(EDGE, GRID, sampling)
    answer = answer_of(study, outcome(lambda x: Crossings((0.25,)) if x <= least else Crossings()))
    assert answer.mean is None
    assert {estimate.value for _, estimate in answer.quantiles} == {0.25}
    assert answer.share_without.value < 1.0
    assert f"too few critical angles in {answer.samples} samples" in repr(answer)
    (detail,) = (warning.detail for warning in answer.warnings if warning.code == "samples_without_angle")
    assert detail.endswith("% of the samples have no critical angle: quantiles are of the others, too few for a mean")


def test_samples_without_an_outcome_widen_the_interval() -> None:
    def crossings(x: float) -> Crossings:
        return Crossings(problem="failed" if x < 0.05 else "outside") if x < 0.125 else Crossings((0.5,))

    answer = answer_of(AngleStudy(EDGE, GRID, Sampling(half_width=0.01, max_samples=1024)), outcome(crossings))
    assert not answer.converged
    assert answer.outside + answer.failed == pytest.approx(0.125 * answer.samples, rel=0.1)
    assert answer.probability[-1] == pytest.approx(0.875, abs=0.02)
    assert answer.lower[0] == 0.0
    assert answer.upper[0] >= 0.11
    assert answer.upper[-1] >= 0.98
    assert {"samples_outside", "samples_failed", "no_indices"} <= {warning.code for warning in answer.warnings}


def test_flights_have_quantiles_by_outcome_if_requested() -> None:
    """The body is turned away for x above 0.25 and perforates for x below 0.1. Its range is 100 x, at best 200 x."""
    inputs = [Uncertain("x", Uniform(lower=0.0, upper=1.0))]
    left = Exit(100.0, 0.8, 0.7, 0.1, 5.0, 1e3, 0.5)

    def ending(x: float) -> Ending:
        flown = {"range": 100.0 * x, "farthest_range": 200.0 * x}
        if x > 0.25:
            return Ending("ricochet", x, left, **flown)  # type: ignore[arg-type]
        return Ending("perforated", exit=left, **flown) if x < 0.1 else Ending("embedded", x)  # type: ignore[arg-type]

    sampling = Sampling(half_width=0.02)
    answer = answer_of(TrajectoryStudy(inputs, sampling), lambda points: [ending(x) for (x,) in points])
    for flights, middle in ((answer.ricochet_flight, 62.5), (answer.perforation_flight, 5.0)):
        near, far = (dict(flights[name])[0.5] for name in ("range", "farthest_range"))
        assert near.lower <= middle <= near.upper
        assert far.value == pytest.approx(2.0 * near.value)
    study = TrajectoryStudy(inputs, sampling)
    without = answer_of(study, lambda points: [Ending("ricochet", x, left) for (x,) in points])
    assert without.ricochet_flight == {}


def test_study_of_a_strike_has_outcomes_and_quantiles_of_its_end() -> None:
    """The body is turned away for x above 0.25, with a speed of 100 x. The depth is x."""
    inputs = [Uncertain("x", Uniform(lower=0.0, upper=1.0))]

    def ending(x: float) -> Ending:
        left = Exit(100.0 * x, math.atan2(80.0, 60.0), math.atan2(60.0, 80.0), -x, 5.0, 1e3 * x, x)
        return Ending("ricochet", x, left) if x > 0.25 else Ending("embedded", x)

    answer = answer_of(
        TrajectoryStudy(inputs, Sampling(half_width=0.02)), lambda points: [ending(x) for (x,) in points]
    )
    shares = dict(answer.outcomes)
    assert answer.converged
    assert shares["ricochet"].lower <= 0.75 <= shares["ricochet"].upper
    assert shares["in_motion"].value == 0.0
    depth, speed, angle = (dict(each)[0.5] for each in (answer.maximum_depth, answer.exit_speed, answer.exit_angle))
    assert depth.lower <= 0.5 <= depth.upper
    assert speed.lower <= 62.5 <= speed.upper
    assert angle.value == pytest.approx(math.atan2(80.0, 60.0))
    middle = {name: dict(quantiles)[0.5].value for name, quantiles in answer.ricochet_exit.items()}
    assert list(middle) == [each.name for each in fields(Exit)]
    assert middle["kinetic_energy"] == pytest.approx(625.0, abs=10.0)
    assert middle["axis_angle"] == pytest.approx(-0.625, abs=0.01)
    assert middle["elevation"] == pytest.approx(math.atan2(60.0, 80.0))
    assert answer.perforation_exit == {}


def test_invalid_sampling_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"sampling\.half_width"):
        Sampling(half_width=0.0)
    with pytest.raises(ParameterError, match=r"sampling\.max_samples"):
        Sampling(max_samples=10)
    with pytest.raises(ParameterError, match="oblique_angles"):
        AngleStudy(EDGE, np.array([0.5, 0.4]), Sampling())
    twice = [Uncertain("x", Normal(mean=0.0, standard_deviation=1.0))] * 2
    with pytest.raises(ParameterError, match=r"uncertain\.1\.field"):
        AngleStudy(twice, GRID, Sampling())
