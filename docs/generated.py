"""Generated text of the manual: routes, objects, help of the commands, names, codes, problem types, critical angles.

The build replaces each comment `<!-- generated: NAME -->` by a text of `TEXTS`. The files of the pages are not changed.
"""

import ast
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from docs.figures import manual
from service import cli
from service.cli.parser import Parser
from service.errors import problem_types
from service.names import CHOICES, FORMULAS, QUANTITIES

ROOT = Path(__file__).parents[1]
PLACE = re.compile(r"<!-- generated: ([\w-]+) -->")
REFERENCE = "#/components/schemas/"
BOUNDS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
    "minItems": "at least {} items",
    "maxItems": "at most {} items",
    "minLength": "at least {} characters",
    "maxLength": "at most {} characters",
}


def filled(page: str) -> str:
    """Return a page with generated texts in place of its comments `<!-- generated: NAME -->`."""
    return PLACE.sub(lambda place: TEXTS[place[1]](), page)


def contract() -> Any:
    """Return the OpenAPI contract that is committed in `openapi`."""
    return json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))


def routes() -> str:
    """Return the routes of the contract, grouped by tag, as Markdown."""
    read = contract()
    by_tag: dict[str, list[str]] = {}
    for path, operations in read["paths"].items():
        for method, operation in operations.items():
            by_tag.setdefault(operation["tags"][0], []).append(
                "\n\n".join(route(method.upper(), path, operation, read["components"]["schemas"]))
            )
    return "\n\n".join(f"## {tag[:1].upper()}{tag[1:]}\n\n" + "\n\n".join(texts) for tag, texts in by_tag.items())


def route(method: str, path: str, operation: dict[str, Any], schemas: dict[str, Any]) -> Iterator[str]:
    """Yield the heading, description, parameters, body and responses of one route, as Markdown."""
    yield f"({operation['operationId'].replace('_', '-')})="
    yield f"### `{method} {path}`"
    yield prose(operation.get("description", ""))
    rows = [
        (f"`{each['name']}`", each["in"], kind(each["schema"]), limits(each["schema"]), cell(each.get("description")))
        for each in operation.get("parameters", ())
    ]
    if rows:
        yield table(("parameter", "in", "type", "bounds", "description"), rows)
    if "requestBody" in operation:
        content = operation["requestBody"]["content"]
        forms = [f"{kind(form['schema'])} as `{media_type}`" for media_type, form in content.items()]
        yield f"Body: {', or '.join(forms)}."
        example = first_example(content.get("application/json", {}).get("schema", {}), schemas)
        if example is not None:
            yield f"```json\n{json.dumps(example, indent=2, ensure_ascii=False)}\n```"
    answers, problems = [], []
    for status, response in operation["responses"].items():
        if status >= "400":
            problems.append(f"{status}")
            continue
        content = response.get("content", {})
        forms = [f"{kind(form.get('schema', {}))} as `{media_type}`" for media_type, form in content.items()]
        answers.append((status, cell(response["description"]), "; ".join(forms)))
    yield table(("status", "answer", "body"), answers)
    scopes = [scope for each in operation.get("security", ()) for scope in each.get("key", ())]
    access = f"Needs the scope `{scopes[0]}` where keys are required. " if scopes else ""
    yield f"{access}Problems ({link('Problem')}): {', '.join(problems)}."


def objects() -> str:
    """Return the objects of the contract in alphabetical order, as Markdown."""
    schemas = contract()["components"]["schemas"]
    return "\n\n".join("\n\n".join(described(name, schemas[name])) for name in sorted(schemas))


def described(name: str, schema: dict[str, Any]) -> Iterator[str]:
    """Yield the heading, description and fields of one object, as Markdown."""
    yield f"({target(name)})="
    yield f"## {name}"
    yield prose(schema.get("description", ""))
    if "properties" not in schema:
        yield f"{kind(schema)[:1].upper()}{kind(schema)[1:]}."
        return
    required = set(schema.get("required", ()))
    rows = [
        (
            f"`{field}`" + (" *" if field in required else ""),
            kind(each),
            limits(each),
            cell(each.get("description")),
        )
        for field, each in schema["properties"].items()
    ]
    yield table(("field", "type", "bounds, default", "description"), rows)


def target(name: str) -> str:
    """Return the name of the link target of an object."""
    return f"object-{name.lower()}"


def link(name: str) -> str:
    """Return a Markdown link to an object."""
    return f"[{name}](#{target(name)})"


def kind(schema: dict[str, Any]) -> str:
    """Return the type of a value as Markdown, with links to objects."""
    if "$ref" in schema:
        return link(schema["$ref"].removeprefix(REFERENCE))
    if union := schema.get("oneOf", schema.get("anyOf")):
        return " or ".join(dict.fromkeys(map(kind, union)))
    if values := schema.get("enum", [schema["const"]] if "const" in schema else ()):
        return " or ".join(f"`{value}`" for value in values)
    if schema.get("type") == "array":
        return f"list of {kind(schema.get('items', {}))}"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"object of {kind(schema['additionalProperties'])}"
    return str(schema.get("type", "any"))


def limits(schema: dict[str, Any]) -> str:
    """Return the bounds and the default of a value as text."""
    found = [text.format(f"{schema[name]:g}") for name, text in BOUNDS.items() if name in schema]
    if "x-default" in schema:
        found.append(f"default `{json.dumps(schema['x-default'])}`")
    return cell(", ".join(found))


def first_example(schema: dict[str, Any], schemas: dict[str, Any]) -> Any:
    """Return the first example of the object that a schema refers to, or None."""
    found = schemas.get(schema.get("$ref", "").removeprefix(REFERENCE), {})
    return next(iter(found.get("examples", ())), None)


def prose(text: str) -> str:
    """Escape a text of the contract for Markdown, where brackets around a unit could be read as a link."""
    return text.replace("<", "\\<").replace("[", "\\[")


def cell(text: str | None) -> str:
    """Escape a text for a cell of a Markdown table, or return an empty cell for None."""
    return prose(text or "").replace("\n", " ").replace("|", "\\|")


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ("---",) * len(head), *rows))


def commands() -> str:
    """Return the help of every command and its subcommands, as Markdown."""
    texts = []
    for command in cli.COMMANDS:
        parser = Parser(prog=f"ricochet {command.name}")
        cli.define(command, parser)
        texts += [f"## {command.name}", f"```text\n{parser.format_help()}```"]
        for name, subparser in parser.subcommands.items():
            texts += [f"### {command.name} {name}", f"```text\n{subparser.format_help()}```"]
    return "\n\n".join(texts)


def names() -> str:
    """Return the display names of inputs, their choices and formulas, as Markdown."""
    rows = [
        f"| {label} | `{path}` | {', '.join(f'{name}: `{value}`' for value, name in CHOICES.get(path, {}).items())} |"
        for path, label in QUANTITIES.items()
    ]
    formulas = ", ".join(f"{name}: `{key}`" for key, name in FORMULAS.items())
    return "\n".join(["| shown as | field | choices |", "|---|---|---|", *rows, "", f"Formulas: {formulas}."])


def warning_codes() -> str:
    """Return the codes of all model warnings that the solver gives, as Markdown."""
    codes = {code for path in (ROOT / "solver").rglob("*.py") for code in _codes_in(path.read_text(encoding="utf-8"))}
    return ", ".join(f"`{code}`" for code in sorted(codes))


def _codes_in(source: str) -> set[str]:
    """Return the codes that a module passes to `ModelWarning`, either as literals or by constants of the module."""
    tree = ast.parse(source)
    texts: dict[str, set[str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            values = value.elts if isinstance(value, ast.Tuple) else [value]
            for name, text in zip(names, values, strict=False):
                if isinstance(name, ast.Name) and isinstance(text, ast.Constant) and isinstance(text.value, str):
                    texts.setdefault(name.id, set()).add(text.value)
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "ModelWarning":
            code = node.args[0]
            found |= texts[code.id] if isinstance(code, ast.Name) else {ast.literal_eval(code)}
    return found


def terms() -> str:
    """Return the critical angles with one input or law changed at a time, as Markdown tables."""
    texts = []
    for group, angles in manual.terms().items():
        rows = [(label, f"{angle:.1f}") for label, angle in angles.items()]
        texts += [f"### {group}", table(("change", "critical angle [°]"), rows)]
    return "\n\n".join(texts)


def problems() -> str:
    """Return the types of problems, with status and title, as a Markdown table."""
    rows = [(f"`{each.type}`", str(int(each.status)), each.title) for each in problem_types()]
    return table(("type", "status", "title"), rows)


TEXTS = {
    "terms": terms,
    "routes": routes,
    "objects": objects,
    "commands": commands,
    "names": names,
    "warning-codes": warning_codes,
    "problems": problems,
}
