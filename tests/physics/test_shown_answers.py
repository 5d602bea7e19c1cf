"""Display of answers: one line in a console, a card in a notebook, and a figure."""

import math
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import pytest

import solver
from solver.calibration import DepthTest, fit_depth
from solver.display import card
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.uncertainty import Normal, Sampling, Uncertain, critical_angle_uncertainty, trajectory_uncertainty
from solver.warnings import ModelWarning

from .strikes import CASE, known


@pytest.fixture(scope="module")
def trajectory() -> solver.Trajectory:
    return solver.simulate(**CASE, impact=paper_impact(oblique_angle_degrees=55.0))


@pytest.fixture(scope="module")
def found() -> solver.CriticalAngle:
    return solver.critical_angle(**CASE, velocity=PAPER_VELOCITY)


@pytest.fixture(scope="module")
def answers(trajectory: solver.Trajectory, found: solver.CriticalAngle) -> dict[str, Any]:
    uncertain = [Uncertain("impact.velocity", Normal(mean=PAPER_VELOCITY, coefficient_of_variation=0.01))]
    few = Sampling(max_samples=320)
    return {
        "ricochet": trajectory,
        "critical angle": found,
        "no critical angle": solver.critical_angle(
            **CASE, velocity=PAPER_VELOCITY, search=solver.Search(upper=math.radians(20.0))
        ),
        "m deep": solver.simulate(**CASE, impact=paper_impact(oblique_angle_degrees=10.0), sample_interval=None),
        "least thickness": solver.least_thickness(**CASE, impact=paper_impact(oblique_angle_degrees=0.0)),
        "samples": critical_angle_uncertainty(**CASE, velocity=PAPER_VELOCITY, uncertain=uncertain, sampling=few),
        "embedded": trajectory_uncertainty(
            **CASE, impact=paper_impact(oblique_angle_degrees=48.6), uncertain=uncertain, sampling=few
        ),
        "instants": trajectory.history,
        "axis_angle": trajectory.final,
    }


@pytest.fixture
def pyplot() -> Iterator[Any]:
    """The module pyplot, with a backend that needs no display; figures are closed after the test."""
    found = pytest.importorskip("matplotlib.pyplot")
    found.switch_backend("agg")
    yield found
    found.close("all")


class Balanced(HTMLParser):
    """HTML parser that fails if tags are not properly nested."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_every_answer_is_printed_as_one_short_line(answers: dict[str, Any]) -> None:
    for words, answer in answers.items():
        text = repr(answer)
        assert "\n" not in text
        assert len(text) < (400 if words == "axis_angle" else 160)
        assert text.startswith(f"<{type(answer).__name__}: ")
        assert words in text


def test_line_of_an_angle_has_the_value_and_the_method(found: solver.CriticalAngle) -> None:
    text = repr(found)
    assert f"critical angle {math.degrees(known(found.angle)):.2f}°, converged, strength factor" in text
    assert f"{len(found.iterations)} trials" in text


def test_line_of_a_trajectory_has_outcome_angle_and_depth(trajectory: solver.Trajectory) -> None:
    text = repr(trajectory)
    for part in (
        trajectory.outcome,
        f"{trajectory.maximum_depth:.3f} m deep",
        f"{math.degrees(trajectory.final.axis_angle):.1f}°",
    ):
        assert part in text


def test_cards_are_well_formed_small_and_without_colours(answers: dict[str, Any]) -> None:
    for answer in answers.values():
        if isinstance(answer, solver.Motion):
            continue
        html = answer._repr_html_()
        parser = Balanced()
        parser.feed(html)
        assert parser.open == []
        assert len(html) < 6000
        assert not re.search(r"colou?r:(?!inherit)|background|<script|class=", html)
        for warning in answer.warnings:
            assert warning.code in html


def test_card_separates_special_warnings_from_common_notes() -> None:
    found = [ModelWarning("one", "special"), ModelWarning("two", "usual", standing=True)]
    html = card("title", {}, found)
    assert re.findall(r"<summary>(.*?)</summary>", html) == ["1 warning", "Standing notes"]
    assert "warning<" not in card("title", {}, found[1:])


def test_text_of_a_card_is_escaped() -> None:
    html = card("a < b", {"<b>": "1 & 2"}, [ModelWarning("x<y", '"<script>"')])
    assert "<script>" not in html
    assert "a &lt; b" in html
    assert "1 &amp; 2" in html


@pytest.fixture(scope="module")
def drawn(answers: dict[str, Any]) -> dict[str, Any]:
    tests = [DepthTest(velocity=200.0, depth=0.20), DepthTest(velocity=250.0, depth=0.29)]
    return answers | {"depths": fit_depth(**CASE, tests=tests)}


LABELS = {
    "ricochet": "depth [m]",
    "critical angle": "oblique angle from the normal [°]",
    "no critical angle": "oblique angle from the normal [°]",
    "samples": "probability of ricochet",
    "least thickness": "speed behind the wall [m/s]",
    "embedded": "greatest depth [m]",
    "depths": "measured depth [m]",
}
"""A label that the plot of each answer must have, by name of the answer."""


@pytest.mark.parametrize("words", LABELS)
def test_plots_of_answers_are_pyplot_figures(drawn: dict[str, Any], words: str, pyplot: Any, tmp_path: Any) -> None:
    figure = drawn[words].plot()
    assert pyplot.gcf() is figure
    figure.savefig(tmp_path / "figure.svg")
    shown = {axis.get_label().get_text() for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)}
    assert LABELS[words] in shown
    assert (tmp_path / "figure.svg").stat().st_size > 5000


@pytest.mark.parametrize("words", LABELS)
def test_answers_are_drawn_into_given_axes(drawn: dict[str, Any], words: str, pyplot: Any) -> None:
    ours, (left, right) = pyplot.subplots(1, 2)
    assert drawn[words].plot(ax=right) is ours
    assert ours.axes == [left, right]
    assert right.get_xlabel()
    assert right.get_title(loc="left")
    assert not left.has_data()
    assert right.has_data()
    assert len(pyplot.get_fignums()) == 1


@pytest.mark.parametrize(("backend", "stays"), [("agg", True), ("module://matplotlib_inline.backend_inline", False)])
def test_figure_returned_by_a_notebook_cell_is_shown_once(
    found: solver.CriticalAngle, backend: str, stays: bool, pyplot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = found.plot()
    monkeypatch.setattr(pyplot, "get_backend", lambda: backend)
    with pytest.raises(NotImplementedError):  # IPython shows the figure itself after this error.
        figure._ipython_display_()  # type: ignore[attr-defined]
    assert pyplot.fignum_exists(figure.number) is stays
    pickle.loads(pickle.dumps(figure))  # noqa: S301


def test_plot_of_a_limit_has_every_trial_on_the_right_side(answers: dict[str, Any], pyplot: Any) -> None:
    limit = answers["least thickness"]
    shown = {each.get_label(): each for each in limit.plot().axes[0].lines}
    through, stopped = shown["perforated"], shown["embedded"]
    assert len(through.get_xdata()) + len(stopped.get_xdata()) == len(limit.iterations)
    assert max(through.get_xdata()) <= limit.bracket[0] < limit.bracket[1] <= min(stopped.get_xdata())
    assert min(through.get_ydata()) > 0.0 == max(stopped.get_ydata())


def test_plot_of_outcomes_has_the_probability_of_each(answers: dict[str, Any], pyplot: Any) -> None:
    endings = answers["embedded"]
    shares, depth, speed = endings.plot().axes
    assert [bar.get_width() for bar in shares.patches] == [each.value for _, each in endings.outcomes]
    assert list(depth.lines[0].get_xdata()) == [each.value for _, each in endings.maximum_depth]
    assert list(speed.lines[0].get_xdata()) == [each.value for _, each in endings.exit_speed]


def test_side_view_has_the_outline_of_the_given_projectile(trajectory: solver.Trajectory, pyplot: Any) -> None:
    side = trajectory.plot(PAPER_PROJECTILE).axes[0]
    bodies = [
        patch.get_xy() for patch in side.patches if isinstance(patch, pyplot.Polygon) and len(patch.get_xy()) > 10
    ]
    assert len(bodies) == 5
    for body in bodies:
        reach = max(math.dist(a, b) for a in body for b in body)
        assert PAPER_PROJECTILE.length <= reach <= math.hypot(PAPER_PROJECTILE.length, PAPER_PROJECTILE.diameter)


def test_motion_without_a_history_cannot_be_drawn(answers: dict[str, Any]) -> None:
    with pytest.raises(solver.ParameterError, match="sample_interval"):
        answers["m deep"].plot()


@pytest.mark.parametrize(
    ("nose", "search", "reason"),
    [
        (solver.Flat(), solver.Search(), "embedded at 85° too"),
        (PAPER_PROJECTILE.nose, solver.Search(lower=math.radians(60.0)), "turned away at 60° already"),
    ],
)
def test_search_without_an_angle_displays_the_reason(nose: Any, search: solver.Search, reason: str) -> None:
    projectile = replace(PAPER_PROJECTILE, nose=nose)
    found = solver.critical_angle(projectile=projectile, target=PAPER_TARGET, velocity=PAPER_VELOCITY, search=search)
    assert f"no critical angle: {reason}" in repr(found)
