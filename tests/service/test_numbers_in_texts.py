"""Numbers in sentences have commas between thousands only if they have five or more digits before the decimal point."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.cli.outputs import sentence_number
from solver.units import number, whole_number

ROOT = Path(__file__).parents[2]
QUOTED = re.compile(r"'[^']*'|`[^`]*`|\"[^\"]*\"|\([^()]*characters\)")
"""Texts of a request or a file that a message repeats."""
ASSIGNED = re.compile(r"\S+[=:]\S+|\S+ = [-+.\de]+|\.[\w,.]+:\d+")
"""Values of flags and axes, and lines of files, as they were given."""
NUMBER = re.compile(r"(?<![\w.,/°-])-?(\d[\d,]*)(?:\.\d+)?(?![\w,]*[A-Za-z_]|[/:]\d)")
SENTENCES = {"detail", "sentence", "note", "fitted_to", "source"}


def wrong_numbers(text: str) -> list[str]:
    """Return the numbers of a text that are not grouped as they should be."""
    plain = ASSIGNED.sub(" ", QUOTED.sub(" ", text))
    found = (each.strip(",") for each in NUMBER.findall(plain))
    return [each for each in found if each != whole_number(int(each.replace(",", "")))]


def sentences(content: Any, name: str = "") -> Iterator[str]:
    if isinstance(content, dict):
        for key, value in content.items():
            yield from sentences(value, key)
    elif isinstance(content, list):
        for value in content:
            yield from sentences(value, name)
    elif isinstance(content, str) and name in SENTENCES:
        yield content


def test_rule_finds_numbers_that_break_it() -> None:
    text = "from 1,200 to 10000 m/s, 12,345.6 mm, 1170 mm; '10000' and axis.a = 10000, and 9,99"
    assert wrong_numbers(text) == ["1,200", "10000", "9,99"]


@pytest.mark.parametrize("surface", ["api", "cli"])
def test_messages_keep_the_rule(surface: str) -> None:
    lines = (ROOT / f"tests/{surface}/messages.txt").read_text(encoding="utf-8").splitlines()
    answers = [line for line in lines if not line.startswith(("> ", "$ "))]
    assert len(answers) > 100
    assert {line: wrong for line in answers if (wrong := wrong_numbers(line))} == {}


def test_answers_keep_the_rule() -> None:
    texts = list(sentences(json.loads((ROOT / "openapi/openapi.json").read_text(encoding="utf-8"))))
    for file in (ROOT / "tests/api/golden").glob("*.txt"):
        for line in file.read_text(encoding="utf-8").splitlines():
            field, _, value = line.partition(": ")
            if field.rpartition(".")[2] in SENTENCES and value.startswith('"'):
                texts.append(json.loads(value))
    assert len(texts) > 500
    assert {text: wrong for text in texts if (wrong := wrong_numbers(text))} == {}


def test_page_and_service_group_by_one_function_each() -> None:
    scripts = list((ROOT / "service/page").rglob("*.js"))
    assert len(scripts) > 50
    assert [file.name for file in scripts if "toLocaleString" in file.read_text(encoding="utf-8")] == []
    own = [file for folder in ("solver", "service/schemas", "service/api") for file in (ROOT / folder).rglob("*.py")]
    grouping = [file.name for file in own if re.search(r"\{[^{}\"]+:,", file.read_text(encoding="utf-8"))]
    assert grouping == ["units.py"]


def test_sentences_of_commands_have_the_same_numbers() -> None:
    for value in (0, 7, 999, 1000, 9999, 10_000, 1_234_567, 0.25, 12.5, 1234.5, 12_345.6, 0.00012):
        assert sentence_number(value) == number(value, "", 16)
    for value in (1.234, 12_345.6, 1234.56, 0.012_345):
        assert sentence_number(value, 3) == number(value, "", 3)
