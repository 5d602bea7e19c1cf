"""`ricochet init`, flags for noses and laws, completion, and errors with field, bound, unit and suggestion."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from service import cli
from service.cli.arguments import BODY, IMPACT, RESISTANCE, Flag
from service.columns import unit_of
from service.schemas import CriticalAngleRequest, TrajectoryRequest
from service.schemas.strike import PAPER

LAW = "resistance.strength_factor"


def test_init_writes_the_strike_of_the_paper_and_never_overwrites(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["init", "new.toml"]) == 0
    assert "ricochet cra new.toml" in capsys.readouterr().out
    found = tomllib.loads((here / "new.toml").read_text())
    assert found.pop("resistance") == {}
    assert found == PAPER
    (here / "new.toml").write_text("mine")
    assert cli.main(["init", "new.toml"]) == 2
    assert "new.toml: exists already" in capsys.readouterr().err
    assert (here / "new.toml").read_text() == "mine"
    assert cli.main(["init", "new.json"]) == 2
    assert cli.main(["init", "nowhere/new.toml"]) == 2


@pytest.mark.parametrize("name", ["cases.csv", "cases.xlsx"])
def test_init_writes_a_table_that_batch_accepts(served: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert cli.main(["init", "--table", name]) == 0
    assert f"ricochet batch {name}" in capsys.readouterr().out
    assert cli.main(["batch", name, "--csv"]) == 0
    assert [line.split(",")[1] for line in capsys.readouterr().out.splitlines()] == ["id", "shot-1", "shot-2", "shot-3"]
    assert cli.main(["init", "--table", name]) == 2
    assert f"{name}: exists already" in capsys.readouterr().err


def test_every_commented_line_of_init_is_a_field_of_the_contract(here: Path) -> None:
    assert cli.main(["init", "new.toml"]) == 0
    lines = (here / "new.toml").read_text().splitlines()
    optional = [number for number, line in enumerate(lines) if re.match(r"# \w+ = ", line)]
    assert len(optional) >= 16
    for number in optional:
        name = lines[number].split()[1]
        changed = [line for line in lines if not line.startswith(f"{name} = ")]
        text = "\n".join(changed).replace(lines[number], lines[number].removeprefix("# "))
        CriticalAngleRequest.model_validate(tomllib.loads(text))


def answer_of(arguments: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run `ricochet cra` with these arguments; return its JSON answer."""
    assert cli.main(["cra", *arguments.split(), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize(
    ("flags", "field", "value"),
    [
        ("--nose flat", "projectile.nose", {"shape": "flat"}),
        (
            "--nose spherical --caliber-radius-head 0.7",
            "projectile.nose",
            {"shape": "spherical", "caliber_radius_head": 0.7},
        ),
        ("--caliber-radius-head 2", "projectile.nose", {"shape": "ogive", "caliber_radius_head": 2.0}),
        ("--length-to-diameter 1.5", "projectile.nose", {"shape": "conical", "length_to_diameter": 1.5}),
        (
            "--boat-tail-length 0.1 --base-diameter 0.06",
            "projectile.boat_tail",
            {"length_m": 0.1, "base_diameter_m": 0.06},
        ),
        ("--profile 0,0.01:0.1,0.04", "projectile.nose", {"shape": "profile", "points": [[0.0, 0.01], [0.1, 0.04]]}),
        ("--strength-law published_tests", LAW, {"model": "published_tests"}),
        (
            "--strength-law published_tests --obliquity-shape constant",
            LAW,
            {"model": "published_tests", "obliquity_shape": "constant"},
        ),
        (
            "--reference-strength 39e6 --diameter-exponent -0.4 --reference-diameter 0.08 --obliquity-shape equation_9",
            LAW,
            {
                "model": "strength_power_law",
                "reference_strength_pa": 39e6,
                "diameter_exponent": -0.4,
                "reference_diameter_m": 0.08,
                "obliquity_shape": "equation_9",
            },
        ),
        ("--free-surface none", "resistance.free_surface", {"model": "none"}),
        ("--strength-scatter paper_table_1", "strength_scatter", "paper_table_1"),
        ("--free-surface mohr_coulomb", "resistance.free_surface", {"model": "mohr_coulomb"}),
        ("--strength-factor 8.5", LAW, {"model": "constant", "value": 8.5}),
        ("--strength-coefficients 8,0.01", LAW, {"model": "obliquity_polynomial", "coefficients": [8.0, 0.01]}),
        (
            "--strength-coefficient 72 --strength-exponent -0.5",
            LAW,
            {"model": "strength_power_law", "coefficient": 72.0, "exponent": -0.5},
        ),
    ],
)
def test_flags_can_set_every_nose_and_every_law(
    here: Path, capsys: pytest.CaptureFixture[str], flags: str, field: str, value: Any
) -> None:
    rough = "--set search.tolerance_deg=1"
    found = answer_of(f"strike.toml {rough} {flags}", capsys)
    expected = answer_of(f"strike.toml {rough} --set {field}={json.dumps(value, separators=(',', ':'))}", capsys)
    assert found["key"] == expected["key"]


BIN = Path(sys.executable).parent


def completed(here: Path, words: str) -> set[str]:
    """Return the completions that bash offers for the last of these words."""
    program = (
        'eval "$(ricochet completion bash)"; COMP_LINE="$1"; COMP_POINT=${#COMP_LINE}; COMP_TYPE=9; '
        "_python_argcomplete ricochet; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    environment = {**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}"}
    command = ["bash", "-c", program, "bash", words]
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=True)
    return {word.strip() for word in done.stdout.splitlines()}


def test_bash_completes_commands_flags_choices_and_files(here: Path) -> None:
    assert completed(here, "ricochet c") == {"cra", "cache", "calibrate", "completion"}
    assert completed(here, "ricochet cra --vel") == {"--velocity"}
    assert completed(here, "ricochet cra --nose ") == {"ogive", "conical", "spherical", "flat", "profile", "sphere"}
    assert completed(here, "ricochet jobs re") == {"results"}
    assert completed(here, "ricochet cra stri") == {"strike.toml"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script_of_each_shell_calls_the_command(capsys: pytest.CaptureFixture[str], shell: str) -> None:
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "ricochet" in script
    assert "_ARGCOMPLETE" in script


def nodes_at(schema: dict[str, Any], steps: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Return the schema of a field for each variant of its part that has the field; without variants the key is ""."""

    def resolved(node: dict[str, Any]) -> dict[str, Any]:
        while "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return node

    found = {"": schema}
    for step in steps:
        models = {
            name: resolved({"$ref": reference})
            for node in found.values()
            for name, reference in node.get("discriminator", {"mapping": {}})["mapping"].items()
        } or found
        found = {
            name: resolved(model["properties"][step])
            for name, model in models.items()
            if step in model.get("properties", {})
        }
    return found


@pytest.mark.parametrize("flag", [*IMPACT, *BODY, *RESISTANCE], ids=lambda flag: flag.name)
def test_flag_has_the_models_and_choices_of_its_field(flag: Flag) -> None:
    """Flags are defined separately from the models, because importing pydantic would delay `--help`."""
    found = nodes_at(TrajectoryRequest.model_json_schema(), flag.steps)
    if flag.implies:
        assert found.keys() == set(flag.implies)
    elif flag.choices and "" not in found:
        assert found.keys() == set(flag.choices)
    elif flag.choices:
        assert found[""]["enum"] == list(flag.choices)
    else:
        assert found.keys() == {""}
    if flag.implies and flag.choices:
        assert all(node["enum"] == list(flag.choices) for node in found.values())
    field = next(iter(found.values()))
    if field["type"] == "number":
        assert f"[{unit_of(flag.steps[-1]) or 1}]" in flag.help
        described = re.search(r"\(default: ([-\de.]+)\)", flag.help)
        assert (described and float(described[1])) == field.get("default")


BOUNDED = [flag for flag in (*IMPACT, *BODY, *RESISTANCE) if flag.read is float]
BOUNDS = {"minimum": -1.0, "exclusiveMinimum": 0.0, "maximum": 1.0, "exclusiveMaximum": 0.0}
"""Keywords for bounds in a schema, and the sign of the step to an invalid value; 0 if the bound itself is invalid."""


@pytest.mark.parametrize("flag", BOUNDED, ids=lambda flag: flag.name)
@pytest.mark.parametrize("keywords", [("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")], ids=min)
def test_flag_has_the_bounds_of_its_field(
    here: Path, capsys: pytest.CaptureFixture[str], flag: Flag, keywords: tuple[str, ...]
) -> None:
    field = next(iter(nodes_at(TrajectoryRequest.model_json_schema(), flag.steps).values()))
    keyword = next(each for each in keywords if each in field)
    outside = field[keyword] + BOUNDS[keyword] * max(1.0, abs(field[keyword]))
    command = ["trajectory", "strike.toml", "--angle", "45"]
    beside = ["--boat-tail-length", "0.1"] if flag.name == "--base-diameter" else []
    assert cli.main([*command, *beside, f"{flag.name}={outside!r}"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"ricochet trajectory: {flag.name}: ")
    assert field[keyword] in map(float, re.findall(r"-?\d[\d.]*(?:e[+-]?\d+)?", error.replace(",", "")))
    assert unit_of(flag.steps[-1]) in error
