"""Citation file, workflow and templates agree with pyproject.toml and the Makefile."""

import re
import tomllib

import pytest
import yaml

from requirements.public_names import FOLDERS
from service.version import VERSION
from solver import ENGINE_VERSION
from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_citation_file_is_valid_and_names_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "title", "message", "authors"} <= citation.keys()
    assert (citation["version"], citation["license"]) == (VERSION, PROJECT["license"])
    assert citation["keywords"] == PROJECT["keywords"]


def test_examples_of_deployment_and_citation_name_this_version() -> None:
    for name in ("deploy/kubernetes.yaml", "deploy/kubernetes-key.yaml", "docs/operating.md"):
        assert set(re.findall(r"ricochet:(\d[\w.]*)", (ROOT / name).read_text(encoding="utf-8"))) == {VERSION}
    cited = (ROOT / "docs" / "explanation" / "source.md").read_text(encoding="utf-8")
    assert f"ricochet {VERSION}, engine {ENGINE_VERSION}:" in cited


def test_workflow_runs_existing_make_targets_on_every_python() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "check.yml").read_text(encoding="utf-8"))
    [job] = workflow["jobs"].values()
    named = "Programming Language :: Python :: 3."
    assert [f"{named}{each[2:]}" for each in job["strategy"]["matrix"]["python"]] == [
        each for each in PROJECT["classifiers"] if each.startswith(named)
    ]
    [command] = [step["run"] for step in job["steps"] if "run" in step]
    goals = re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
    assert command == "make check test"
    assert {"check", "test"} <= set(goals)


def test_templates_name_existing_targets_and_files() -> None:
    templates = list((ROOT / ".github").rglob("*.md"))
    assert {path.parent.name for path in templates} == {".github", "ISSUE_TEMPLATE"}
    for path in templates:
        text = path.read_text(encoding="utf-8")
        goals = {word for each in re.findall(r"`make ([a-z -]+)`", text) for word in each.split()}
        assert goals <= set(re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8")))
        assert all((ROOT / name).exists() for name in re.findall(r"\b([A-Z]+\.md)\b", text))


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/explanation/architecture.md"])
def test_files_and_names_in_pages_for_contributors_exist(page: str) -> None:
    """Constants and classes in backquotes occur in the sources, and file names in backquotes end an existing path."""
    files = [path for folder in (*FOLDERS, "openapi") for path in (ROOT / folder).rglob("*") if path.is_file()]
    paths = [path.relative_to(ROOT).as_posix() for path in [*files, *ROOT.iterdir()]]
    sources = "\n".join(path.read_text(encoding="utf-8") for path in files if path.suffix in {".py", ".js"})
    text = (ROOT / page).read_text(encoding="utf-8")
    named = re.findall(r"`([\w/.-]+)`", text)
    missing = [each for each in named if re.search(r"\w\.(py|js|csv|md|toml|json)$", each) and not ends(paths, each)]
    names = [each for each in named if re.fullmatch(r"[A-Z][A-Za-z]+|[A-Z_]{4,}", each)]
    assert missing + [each for each in names if not re.search(rf"\b{each}\b", sources)] == []


def ends(paths: list[str], name: str) -> bool:
    return any(f"/{path}".endswith(f"/{name}") for path in paths)
