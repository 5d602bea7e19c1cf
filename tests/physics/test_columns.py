"""Answers as columns and as pandas data frames."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import solver
from solver import (
    CriticalAngle,
    Impact,
    ParameterError,
    Trajectory,
    critical_angle,
    critical_angle_many,
    simulate,
    simulate_many,
)
from solver.strike import PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import CASE, known, paper_run


def test_history_is_a_table_with_a_column_for_each_quantity() -> None:
    trajectory = paper_run(55.0)
    columns, table = trajectory.columns(), trajectory.to_dataframe()
    assert trajectory.history is not None
    assert columns["nose_tip_depth"] is trajectory.history.nose_tip_depth
    assert [table.index.name, *table.columns] == list(columns)
    assert len(table) == trajectory.history.time.size
    assert 0.0 < table["nose_tip_depth"].max() < known(trajectory.maximum_depth)  # The flank is deeper than the tip.
    assert table.iloc[-1].to_dict() == trajectory.final.to_dataframe().iloc[0].to_dict()
    assert table.index[-1] == trajectory.final.time


def test_error_about_columns_without_a_history_names_the_remedy() -> None:
    trajectory = paper_run(55.0, sample_interval=None)
    with pytest.raises(ParameterError, match="sample_interval: must be given"):
        trajectory.columns()


def test_trials_of_a_search_are_a_table() -> None:
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY)
    table = found.to_dataframe()
    assert len(table) == len(found.iterations)
    fine = table[table["fine"]]
    assert fine[fine["outcome"] == "ricochet"]["oblique_angle"].min() == known(found.angle)


def test_table_of_critical_angles_includes_failed_cases() -> None:
    velocities = [200.0, -1.0, 300.0]
    answers = critical_angle_many(**CASE, velocity=velocities)
    table = solver.to_dataframe(answers)
    assert list(table["status"]) == ["converged", "", "converged"]
    assert np.isnan(table["angle"][1])
    assert "impact.velocity" in table["error"][1]
    assert table["angle"][0] < table["angle"][2]
    assert (table["bracket_low"] <= table["angle"])[[0, 2]].all()
    assert "strength_fit_extrapolated" in table["warnings"][0].split()


def test_trajectories_become_columns() -> None:
    impacts = [paper_impact(oblique_angle_degrees=angle) for angle in (30.0, 60.0)]
    answers = list(simulate_many(**CASE, impact=impacts))
    columns = solver.columns(answers)
    assert columns["outcome"].tolist() == ["embedded", "ricochet"]
    assert columns["final_depth_velocity"][1] < 0.0 < columns["maximum_depth"][1] < columns["maximum_depth"][0]
    assert {len(values) for values in columns.values()} == {2}
    pd.testing.assert_frame_equal(solver.to_dataframe(answers), pd.DataFrame(columns))


def test_answers_of_different_kinds_are_refused() -> None:
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=0.5)
    answers: list[Trajectory | CriticalAngle] = [
        simulate(**CASE, impact=impact),
        critical_angle(**CASE, velocity=PAPER_VELOCITY),
    ]
    with pytest.raises(ParameterError, match="must be of one kind"):
        solver.columns(answers)


@pytest.mark.parametrize("table", [solver.columns, solver.to_dataframe])
@pytest.mark.parametrize("given", [[PAPER_TARGET], PAPER_TARGET])
def test_object_that_is_not_an_answer_is_refused(table: Callable[[Any], Any], given: Any) -> None:
    with pytest.raises(ParameterError, match=r"^answers: must .*, got Target"):
        table(given)


def test_empty_list_of_answers_gives_an_empty_table() -> None:
    assert {name: len(values) for name, values in solver.columns([]).items()} == {"warnings": 0, "error": 0}
