"""Results of calibrations, large ones included, are stored under their key and returned as tables."""

import json
from typing import Any

import httpx
import numpy as np
import pytest

from service.schemas.calibration_depth import TABLE_1
from service.schemas.calibration_motion import COMPARED_ROWS
from service.schemas.requests import MOST_ROWS

from .calibrations import BODY, POINTS, TESTS, answered, history_at, strike_at
from .many import file_at, rows_at


@pytest.fixture(scope="module")
def motion(client: httpx.Client) -> dict[str, Any]:
    """Request with a history that the service computed with a strength factor of 7.5."""
    return strike_at(30.0, history_at(client, 30.0, 7.5))


def test_group_that_a_spreadsheet_would_evaluate_is_quoted_in_the_table(client: httpx.Client) -> None:
    tests = [test | {"group": "=1+1" if number < 2 else "-A1"} for number, test in enumerate(TABLE_1)]
    key = answered(client, "/calibration/depth", BODY | {"tests": tests})["key"]
    rows = rows_at(client, f"/results/{key}")
    assert [row["group"] for row in rows] == ["'=1+1", "'=1+1"] + ["'-A1"] * (len(rows) - 2)
    assert min(float(row["residual_m"]) for row in rows) < 0.0


REQUESTED: dict[str, dict[str, Any]] = {"/calibration/depth": TESTS, "/calibration/obliquity": POINTS}


def body_of(path: str, motion: dict[str, Any]) -> dict[str, Any]:
    return REQUESTED.get(path, motion)


PATHS = ("/calibration/depth", "/calibration/motion", "/calibration/obliquity")


def table_of(client: httpx.Client, key: str) -> dict[str, list[str]]:
    rows = rows_at(client, f"/results/{key}")
    return {name: [row[name] for row in rows] for name in rows[0]}


COLUMNS = {
    "/calibration/depth": ["velocity_m_s", "depth_m", "predicted_depth_m", "residual_m"],
    "/calibration/obliquity": ["oblique_angle_deg", "strength_factor", "residual"],
    "/calibration/motion": [
        "time_s",
        *("depth_displacement_m", "lateral_displacement_m", "rotation_deg"),
        *("predicted_depth_displacement_m", "predicted_lateral_displacement_m", "predicted_rotation_deg"),
        *("residual_depth_displacement_m", "residual_lateral_displacement_m", "residual_rotation_deg"),
    ],
}


@pytest.mark.parametrize("path", PATHS)
def test_csv_of_a_calibration_lists_its_residuals(client: httpx.Client, path: str, motion: dict[str, Any]) -> None:
    answer = answered(client, path, body_of(path, motion) | ({"until_s": 0.001} if path.endswith("motion") else {}))
    table = table_of(client, answer["key"])
    assert list(table) == COLUMNS[path]
    numbers = {name: [float(cell) for cell in column] for name, column in table.items()}
    if path.endswith("motion"):
        for name in ("depth_displacement_m", "lateral_displacement_m", "rotation_deg"):
            left = np.subtract(numbers[name], numbers[f"predicted_{name}"])
            assert numbers[f"residual_{name}"] == answer["residuals"][name] == pytest.approx(left.tolist(), abs=1e-12)
    else:
        assert next(column for name, column in numbers.items() if name.startswith("residual")) == answer["residuals"]


@pytest.mark.parametrize("path", PATHS)
def test_hdf5_of_a_calibration_has_its_numbers(client: httpx.Client, path: str, motion: dict[str, Any]) -> None:
    answer = answered(client, path, body_of(path, motion))
    with file_at(client, f"/results/{answer['key']}") as file:
        summary, residuals = file["summary"], file["residuals"]
        assert summary["operation"].asstr()[()].tolist() == [path[1:].replace("/", "_")]
        assert list(residuals) == ["case", *COLUMNS[path]]
        units = {name: column.attrs["units"] for name, column in residuals.items()}
        stored = {name: residuals[name][()].tolist() for name in COLUMNS[path]}
        if "strength_factor" in answer:
            assert summary["strength_factor"][0] == answer["strength_factor"]
            assert [summary[f"confidence_{end}"][0] for end in ("low", "high")] == answer["confidence_interval"]
    assert {
        name: [float(cell) for cell in column] for name, column in table_of(client, answer["key"]).items()
    } == stored
    assert units.get("velocity_m_s", "m/s") == "m/s"
    assert units.get("residual_rotation_deg", "deg") == "deg"


def test_residuals_of_several_runs_are_in_one_table(client: httpx.Client, motion: dict[str, Any]) -> None:
    short = {name: motion["history"][name] for name in ("time_s", "rotation_deg")}
    runs = [{"impact": motion["impact"], "history": history} for history in (motion["history"], short)]
    answer = answered(client, "/calibration/motion", BODY | {"runs": runs, "until_s": 0.001})
    table = table_of(client, answer["key"])
    assert list(table) == ["run", *COLUMNS["/calibration/motion"]]
    assert table["run"] == ["0"] * 21 + ["1"] * 21
    assert [float(cell) for cell in table["residual_rotation_deg"][21:]] == answer["runs"][1]["residuals"][
        "rotation_deg"
    ]
    assert set(table["residual_depth_displacement_m"][21:]) == {"nan"}
    with file_at(client, f"/results/{answer['key']}") as file:
        assert file["residuals"]["run"][()].tolist() == [0] * 21 + [1] * 21
        assert file["summary"]["best_decay_law"].asstr()[()].tolist() == [answer["best_decay_law"]]
        assert file["summary"]["normalized_root_mean_square"][0] == answer["normalized_root_mean_square"]


def test_groups_are_a_column_of_the_residuals(client: httpx.Client) -> None:
    names = ["one", "one", "two", "two"]
    tests = [test | {"group": name} for test, name in zip(TABLE_1, names, strict=True)]
    answer = answered(client, "/calibration/depth", BODY | {"tests": tests})
    assert table_of(client, answer["key"])["group"] == names
    with file_at(client, f"/results/{answer['key']}") as file:
        assert file["residuals"]["group"].asstr()[()].tolist() == names


def test_history_with_the_most_rows_allowed_is_answered(client: httpx.Client) -> None:
    digits = np.random.default_rng(1)
    time = np.linspace(0.0, 0.003, MOST_ROWS) * (1.0 + 1e-15)
    columns = {
        name: (scale * time * (1.0 + 0.01 * digits.random(MOST_ROWS))).tolist()
        for name, scale in {"depth_displacement_m": 100.0, "lateral_displacement_m": 80.0}.items()
    }
    history = {"time_s": time.tolist(), "rotation_deg": (-1e-7 * digits.random(MOST_ROWS)).tolist()} | columns
    body = strike_at(30.0, history) | {"weights": {"rotation": 0.0}, "compare_strength_factors": [6.0, 9.0]}
    assert len(json.dumps(body)) > 1_500_000
    answer = answered(client, "/calibration/motion", body)
    assert len(answer["residuals"]["time_s"]) == MOST_ROWS
    for compared in answer["compared"]:
        chosen = compared["history"]["time_s"]
        assert len(chosen) == COMPARED_ROWS
        assert (chosen[0], chosen[-1]) == (history["time_s"][0], history["time_s"][-1])
