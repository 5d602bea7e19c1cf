"""docs/operating.md and the dashboard agree with the code."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.schemas.strike import PAPER
from service.settings import Settings

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "operating.md").read_text(encoding="utf-8")
DASHBOARD = json.loads((ROOT / "docs" / "grafana.json").read_text(encoding="utf-8"))
NAME = re.compile(r"\bricochet_[a-z_]+")


def table(name: str) -> list[str]:
    [found] = re.findall(rf"<!-- table: {name} -->\n(.*?)<!-- end of table -->", PAGE, re.DOTALL)
    return [line for line in str(found).splitlines() if line.startswith("| `")]


def first_cells(name: str) -> set[str]:
    return {line.split("|")[1].strip(" `") for line in table(name)}


@pytest.fixture(scope="module")
def families(live_url: str) -> dict[str, Any]:
    """Metric families of a service that has answered a request, by name."""
    httpx.post(f"{live_url}/cra", json=PAPER, timeout=60.0, trust_env=False)
    text = httpx.get(f"{live_url}/metrics", trust_env=False).text
    return {family.name: family for family in text_string_to_metric_families(text)}


def test_generated_tables_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, "docs/tables.py", "--check"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_table_lists_every_setting_with_its_reason() -> None:
    assert first_cells("settings") == {f"RICOCHET_{name.upper()}" for name in Settings.model_fields}
    assert all(len(line.split("|")[4]) > 20 for line in table("settings"))
    assert len(table("settings")) == len(Settings.model_fields)  # Each setting is in exactly one group of the table.


def test_every_setting_named_on_the_page_exists() -> None:
    assert set(re.findall(r"RICOCHET_[A-Z_]+", PAGE)) <= first_cells("settings")


def test_documented_metrics_match_a_running_service(families: dict[str, Any]) -> None:
    exposed = {name + {"counter": "_total"}.get(family.type, "") for name, family in families.items()}
    assert first_cells("metrics") == exposed


def test_documented_labels_match_a_running_service(families: dict[str, Any]) -> None:
    for line in table("metrics"):
        _, name, _, labels, *_ = (cell.strip() for cell in line.split("|"))
        family = families.get(name.strip("`")) or families[name.strip("`").removesuffix("_total")]
        if family.type == "gauge" and family.name.endswith("_info"):
            continue
        exported = {label for sample in family.samples for label in sample.labels} - {"le"}
        assert set(re.findall(r"`(\w+)`", labels)) == exported, name


def test_queries_of_the_dashboard_use_existing_metrics_and_labels(families: dict[str, Any]) -> None:
    samples = {sample.name: set(sample.labels) for family in families.values() for sample in family.samples}
    queries = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
    for query in queries:
        names = NAME.findall(query)
        assert names, query
        labels = set.union(*(samples[name] for name in names)) | {"instance"}  # Prometheus adds this label.
        assert set(re.findall(r"(\w+)=~?\"", query)) <= labels, query
        grouped = re.search(r"by \(([^)]*)\)", query)
        assert set(grouped[1].split(", ") if grouped else []) <= labels, query
        assert all(query.count(opening) == query.count(closing) for opening, closing in ("()", "{}", "[]")), query
    shown = {name.removesuffix("_bucket").removesuffix("_count") for query in queries for name in NAME.findall(query)}
    assert shown == first_cells("metrics")  # The dashboard shows every metric.


def test_panels_of_the_dashboard_do_not_overlap_and_use_the_chosen_source() -> None:
    numbers = [panel["id"] for panel in DASHBOARD["panels"]]
    taken: set[tuple[int, int]] = set()
    assert len(numbers) == len(set(numbers))
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert place["x"] + place["w"] <= 24
        assert not cells & taken, panel["title"]
        taken |= cells
        assert {target["datasource"]["uid"] for target in panel["targets"]} == {"${source}"}
    assert [variable["name"] for variable in DASHBOARD["templating"]["list"]] == ["source", "instance"]


def test_every_metric_named_on_the_page_exists(families: dict[str, Any]) -> None:
    samples = {sample.name for family in families.values() for sample in family.samples}
    assert {name for name in NAME.findall(PAGE) if name not in samples} <= first_cells("metrics")


def test_tests_named_in_the_table_of_failures_exist() -> None:
    rows = [line for line in PAGE.partition("## What happens when")[2].splitlines() if line.startswith("| ")][2:]
    assert len(rows) >= 12
    for row in rows:
        held = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", row)
        assert held, row
        for path, name in held:
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
            assert name in defined, f"{path} has no {name}"
