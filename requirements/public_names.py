"""Check that Python code and the page use libraries only through their public names.

Modules and attributes whose names begin with an underscore are private: a library may change them in any version.
Names that a class of the project defines are not reported here, because ruff's rule SLF001 checks their use.
"""

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("benchmarks", "clients", "docs", "examples", "requirements", "service", "solver", "tests", "validation")
DOCUMENTED = frozenset({"_exit", "_ipython_display_"})
"""Names with an underscore that the documentation of Python or IPython describes."""
BY_NAME = frozenset({"getattr", "setattr", "hasattr", "delattr"})
"""Functions that take the name of an attribute as an argument."""
TYPE_IN_QUOTES = re.compile(r"[a-z]\w*(\.\w+)*\._\w+")
PRIVATE_IN_SCRIPT = re.compile(r"\.(_\w+)")
MOST_EXCEPTIONS = 5


@dataclass(frozen=True)
class AllowedUse:
    """Private names that may be used in some files, and the reason."""

    names: frozenset[str]
    paths: tuple[str, ...]
    reason: str

    def covers(self, path: str, name: str) -> bool:
        """Return whether this name may be used in this file."""
        return name in self.names and path.startswith(self.paths)


ALLOWED = (
    AllowedUse(
        frozenset({"_nrt"}),
        ("solver/compilation.py",),
        "numba: no public option keeps compiled functions from counting references to their array arguments",
    ),
    AllowedUse(
        frozenset({"_actions"}),
        ("tests/cli/test_outputs.py",),
        "argparse: it has no public list of the arguments of a parser, which the test goes through",
    ),
    AllowedUse(
        frozenset({"_Hash"}), ("service/api/batch_body.py",), "hashlib: the type of hash objects has no public name"
    ),
)
"""Exceptions to the rule, at most `MOST_EXCEPTIONS`."""


@dataclass(frozen=True, order=True)
class Finding:
    """A private name of a library, and where it is used."""

    path: str
    line: int
    name: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.name} is a private name of a library"


def is_private(name: str) -> bool:
    """Return whether a name is private; names that begin with two underscores do not count."""
    return name.startswith("_") and name != "_" and not name.startswith("__") and name not in DOCUMENTED


def is_own(module: str) -> bool:
    """Return whether a module belongs to the project."""
    return module.partition(".")[0] in {*FOLDERS, "ricochet_command"}


def attributes_defined(tree: ast.Module) -> Iterator[str]:
    """Yield the names of methods and attributes that the classes of a file define."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(body=body):
                for each in body:
                    yield from (name.id for name in ast.walk(each) if isinstance(name, ast.Name))
                    if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
                        yield each.name
            case ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name, ctx=ast.Store()):
                yield name


class PrivateNames(ast.NodeVisitor):
    """Collects the private names of libraries in a file.

    Parameters
    ----------
    tree
        The file.
    own
        Private names that the project defines.
    """

    def __init__(self, tree: ast.Module, own: set[str]) -> None:
        self.tree = tree
        self.own = own
        self.found: list[tuple[int, str]] = []
        self.options = {
            keyword.value.id
            for call in ast.walk(tree)
            if isinstance(call, ast.Call)
            for keyword in call.keywords
            if keyword.arg is None and isinstance(keyword.value, ast.Name)
        }
        """Names of dictionaries that are unpacked into the arguments of a call."""
        self.visit(tree)

    def visit_Import(self, node: ast.Import) -> None:
        """Check `import a._b`."""
        self._note(node, (part for name in node.names for part in name.name.split(".")))

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        """Check `from a._b import _c`."""
        if node.level == 0 and not is_own(node.module or ""):
            self._note(node, [*(node.module or "").split("."), *(name.name for name in node.names)])

    def visit_Attribute(self, node: ast.Attribute) -> None:
        """Check `a._b`."""
        self._note(node, [node.attr])
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        """Check `getattr(a, "_b")`, `monkeypatch.setattr("a._b", ...)` and keyword arguments such as `f(_a=...)`."""
        function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if function in BY_NAME:
            words = (each.value for each in node.args[:2] if isinstance(each, ast.Constant))
            self._note(node, (part for word in words if isinstance(word, str) for part in word.split(".")))
        self._note(node, (keyword.arg for keyword in node.keywords if keyword.arg))
        self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        """Check the keys of `options = {"_a": ...}` if a call unpacks them."""
        match node:
            case ast.Assign(targets=[ast.Name(id=target)], value=ast.Dict(keys=keys)) if target in self.options:
                words = (key.value for key in keys if isinstance(key, ast.Constant))
                self._note(node, (word for word in words if isinstance(word, str)))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Check a type in quotation marks, such as "argparse._ArgumentGroup"."""
        if isinstance(node.value, str) and TYPE_IN_QUOTES.fullmatch(node.value):
            self._note(node, node.value.split("."))

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """Check that no method overrides a private method of a library."""
        bases = [base for base in (library_class(self.tree, base) for base in node.bases) if base is not None]
        methods = [each for each in node.body if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
        for method in methods:
            if is_private(method.name) and any(hasattr(base, method.name) for base in bases):
                self.found.append((method.lineno, method.name))
        self.generic_visit(node)

    def _note(self, node: ast.AST, names: Iterable[str]) -> None:
        line = getattr(node, "lineno", 0)
        self.found += [(line, name) for name in names if is_private(name) and name not in self.own]


def library_class(tree: ast.Module, base: ast.expr) -> type | None:
    """Return the class of a library that an expression for a base class refers to; None if it is not of a library."""
    first, *rest = ast.unparse(base).partition("[")[0].split(".")
    for node in tree.body:
        module, names = "", rest
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            for name in node.names:
                if (name.asname or name.name) == first:
                    module, names = node.module or "", [name.name, *rest]
        elif isinstance(node, ast.Import) and any(name.name == first for name in node.names):
            module = first
        if module and not is_own(module):
            found: object = import_module(module)
            for part in names:
                found = getattr(found, part, None)
            return found if isinstance(found, type) else None
    return None


def findings_in_python(sources: dict[str, str]) -> list[Finding]:
    """Return all private names of libraries in these files."""
    trees = {path: ast.parse(text) for path, text in sources.items()}
    own = {name for tree in trees.values() for name in attributes_defined(tree) if is_private(name)}
    return [Finding(path, line, name) for path, tree in trees.items() for line, name in PrivateNames(tree, own).found]


def findings_in_scripts(sources: dict[str, str]) -> list[Finding]:
    """Return all private names in these scripts, whose own private names begin with # and are not matched."""
    return [
        Finding(path, number, found[1])
        for path, text in sources.items()
        for number, line in enumerate(text.splitlines(), 1)
        for found in PRIVATE_IN_SCRIPT.finditer(line.partition("//")[0])
    ]


def sources(*endings: str) -> dict[str, str]:
    """Return the text of the files of the project with these endings, by path."""
    files = [*ROOT.glob("*.py"), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*"))]
    kept = (path for path in files if path.suffix in endings and "node_modules" not in path.parts)
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted(kept)}


def main() -> int:
    """Print private names that are not allowed, and faults of the list of exceptions; return 1 if there are any."""
    found = findings_in_python(sources(".py")) + findings_in_scripts(sources(".js", ".ts"))
    wrong = [str(each) for each in sorted(set(found)) if not any(use.covers(each.path, each.name) for use in ALLOWED)]
    wrong += [
        f"exception no longer needed: {use.reason}"
        for use in ALLOWED
        if not any(use.covers(each.path, each.name) for each in found)
    ]
    if len(ALLOWED) > MOST_EXCEPTIONS:
        wrong.append(f"{len(ALLOWED)} exceptions; at most {MOST_EXCEPTIONS} may stay")
    print("\n".join(wrong), end="\n" if wrong else "", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
