"""The check, in `make check`, that libraries are used through their public names."""

import subprocess
import sys

import pytest

from requirements.public_names import ALLOWED, MOST_EXCEPTIONS, findings_in_python, findings_in_scripts
from tests.conftest import ROOT

PRIVATE = {
    "import _thread_of_a_library": "_thread_of_a_library",
    "import library._part": "_part",
    "from library._part import name": "_part",
    "from library import _name": "_name",
    "import library\nlibrary.thing._cache.clear()": "_cache",
    "import library\ngetattr(library.thing, '_cache')": "_cache",
    "def test(monkeypatch): monkeypatch.setattr('library.thing._cache', None)": "_cache",
    "def test(monkeypatch, thing): monkeypatch.setattr(thing, '_cache', None)": "_cache",
    "import library\nlibrary.make(_cache=False)": "_cache",
    "import library\nOPTIONS = {'_cache': False}\nlibrary.make(**OPTIONS)": "_cache",
    "def made(thing: 'library._Thing') -> None: ...": "_Thing",
    "import argparse\nclass Parser(argparse.ArgumentParser):\n    def _get_formatter(self): ...": "_get_formatter",
    "from argparse import ArgumentParser as P\nclass Parser(P):\n    def _check_value(self): ...": "_check_value",
}
PUBLIC = (
    "import os\nos._exit(3)",
    "from service._own import name",
    "from . import _own",
    "import library\nlibrary.thing.__dict__",
    "class Own:\n    def __init__(self): self._cache = 1\ndef read(own): return own._cache",
    "class Own:\n    _cache: int = 1\ndef read(own): return getattr(own, '_cache')",
    "import argparse\nclass Parser(argparse.ArgumentParser):\n    def _own_method(self): ...",
    "UNITS = {'_m': 'metre'}",
    "print('a sentence with library._name in it')",
)


@pytest.mark.parametrize(("source", "name"), PRIVATE.items())
def test_private_names_of_libraries_are_found(source: str, name: str) -> None:
    assert {found.name for found in findings_in_python({"file.py": source})} == {name}


@pytest.mark.parametrize("source", PUBLIC)
def test_public_names_and_own_private_names_are_accepted(source: str) -> None:
    assert findings_in_python({"file.py": source}) == []


def test_private_names_in_the_page_are_found_outside_comments() -> None:
    source = "const { xaxis } = drawn._fullLayout; // not drawn._other\nthis.#own = 1;\n"
    assert [(each.line, each.name) for each in findings_in_scripts({"file.js": source})] == [(1, "_fullLayout")]


def test_project_uses_public_names_except_for_listed_exceptions() -> None:
    done = subprocess.run(
        [sys.executable, "requirements/public_names.py"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert len(ALLOWED) <= MOST_EXCEPTIONS
    assert all(len(use.reason) > 20 for use in ALLOWED)
