"""Numbers of answers as a report shows them, each with its pointer and full value, and the inputs of a case as rows."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from markupsafe import Markup, escape

from service.columns import unit_end, unit_of
from service.names import CHOICES, QUANTITIES

MINUS, NARROW = "\N{MINUS SIGN}", "\N{NARROW NO-BREAK SPACE}"


def lookup(content: Any, pointer: str) -> Any:
    """Return what stands at a JSON pointer, None if nothing does."""
    for step in pointer.split("/")[1:]:
        if isinstance(content, Mapping):
            content = content.get(step)
        elif isinstance(content, Sequence) and not isinstance(content, str):
            content = content[int(step)] if int(step) < len(content) else None
        else:
            return None
    return content


class Numbers:
    """Writes numbers that stand in answers; each keeps its pointer and all its digits in the page.

    Parameters
    ----------
    content
        The answers by name.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = content

    def at(self, pointer: str) -> Any:
        """Return what stands at a JSON pointer, None if nothing does."""
        return lookup(self._content, pointer)

    def fixed(self, pointer: str, decimals: int, *, factor: float = 1.0, unit: str = "") -> Markup:
        """Return a number, times a factor, with so many decimals; nothing if there is none."""
        return self._written(pointer, factor, f".{decimals}f", unit)

    def short(self, pointer: str, *, factor: float = 1.0, digits: int = 3, unit: str = "") -> Markup:
        """Return a number, times a factor, with so many significant digits; nothing if there is none."""
        return self._written(pointer, factor, f".{digits}g", unit)

    def upwards(self, pointer: str, *, factor: float = 1.0) -> Markup:
        """Return a number, times a factor, rounded up to a whole one as a design value is."""
        value = self.at(pointer)
        return Markup() if value is None else self._data(pointer, factor, f"{math.ceil(value * factor - 1e-6)}", "")

    def angle(self, pointer: str, decimals: int = 2) -> Markup:
        """Return an angle in degrees."""
        return self.fixed(pointer, decimals, unit="°")

    def _written(self, pointer: str, factor: float, spec: str, unit: str) -> Markup:
        value = self.at(pointer)
        if value is None:
            return Markup()
        return self._data(pointer, factor, _plain(format(value * factor, spec)).replace("-", MINUS), unit)

    def _data(self, pointer: str, factor: float, text: str, unit: str) -> Markup:
        value = self.at(pointer)
        return Markup('<data value="{}" data-from="{}" data-factor="{:g}">{}</data>{}').format(
            repr(float(value)), pointer, factor, text, unit.replace(" ", "\N{NO-BREAK SPACE}")
        )


def _plain(text: str) -> str:
    """Write a small power of ten in full, without a sign at zero."""
    mantissa, exponent, power = text.partition("e")
    if exponent and 0 <= int(power) <= 6:
        text = f"{float(text):.0f}"
    elif exponent:
        text = f"{mantissa}e{int(power)}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def sentence(text: str) -> Markup:
    """Return a warning as a sentence: with a capital and a full stop."""
    return escape(text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else "."))


class Field(NamedTuple):
    """How an input is shown: `factor` times its value is the number in the unit."""

    unit: str = ""
    factor: float = 1.0

    @property
    def written(self) -> str:
        """The unit as it stands behind a number."""
        return f" {self.unit}" if self.unit and self.unit != "°" else self.unit


class Row(NamedTuple):
    """An input as it is shown."""

    label: str
    value: Any
    note: str


MOST_SHOTS = 12
SHOT = ("velocity_m_s", "depth_m", "mass_kg", "diameter_m")
"""What is known of a shot, in the order in which it is shown."""
GROUPS: Final[Mapping[str, str]] = {
    "projectile": "Projectile",
    "target": "Target",
    "impact": "Strike",
    "resistance": "Model",
    "strength_scatter": "Model",
    "numerics": "Computation",
    "search": "Computation",
}
"""Group of inputs by the part of the request, in the order of the report."""
BY_END: Final[Mapping[str, Field]] = {"_m": Field("mm", 1e3), "_pa": Field("MPa", 1e-6)}
"""How quantities are shown by the end of their name, where not in the unit of the contract."""
OTHER_FIELDS: Final[Mapping[str, Field]] = {
    "projectile.nose.points": Field("mm", 1e3),
    "target.youngs_modulus_pa": Field("GPa", 1e-9),
    "numerics.termination_time_s": Field("ms", 1e3),
    "numerics.retention_energy_fraction": Field("%", 100.0),
}
"""How others are shown."""


def field_of(name: str) -> Field:
    """Return how a quantity of the contract is shown."""
    return OTHER_FIELDS.get(name) or BY_END.get(unit_end(name)) or Field(unit_of(name))


FIELDS: Final[Mapping[str, Field]] = {
    f"/{name.replace('.', '/')}": field_of(name) for name in QUANTITIES if name.partition(".")[0] in GROUPS
}
"""Inputs by their pointers."""
UNUSED: Final = frozenset({"/numerics/panels", "/numerics/time_step_s", "/search/relative_tolerance"})
"""Settings of the paper's numerics and searches."""
ABSENT: Final[Mapping[str, tuple[str, str]]] = {
    "/target/thickness_m": ("half-space", "default"),
    "/impact/oblique_angle_deg": ("none", "not given"),
    "/resistance/crater/depth_diameters": ("no crater", "default"),
    "/resistance/rear_plug/cone_angle_deg": ("no plug", "default"),
}
"""What stands for inputs that are not given and have no value."""
ASSUMED: Final[Mapping[str, str]] = {
    "/projectile/center_of_gravity_m": "default: homogeneous",
    "/projectile/moment_of_inertia_kg_m2": "default: homogeneous",
    "/target/youngs_modulus_pa": "default: ACI 318-19",
}
"""Sources of the values of inputs that are not given."""
WORDS: Final[Mapping[str, str]] = {value: name for names in CHOICES.values() for value, name in names.items()}
"""Names of models in words; a value that several fields have has the same name in each."""


def label_of(pointer: str) -> str:
    """Return the name of an input."""
    return QUANTITIES[pointer[1:].replace("/", ".")]


def rows(numbers: Numbers, given: Mapping[str, Any], case: Mapping[str, Any]) -> Mapping[str, list[Row]]:
    """Return the inputs by group.

    Parameters
    ----------
    numbers
        Numbers of the case and of what is assumed where it has none.
    given
        The request as received: what it lacks is a default.
    case
        The same with defaults filled in.
    """
    found: dict[str, list[Row]] = {group: [] for group in GROUPS.values()}
    values = dict(leaves(case))
    for pointer, field in FIELDS.items():
        group = found[GROUPS[pointer.split("/")[1]]]
        if pointer in values:
            note = "" if lookup(given, pointer) is not None else "default"
            group.append(Row(label_of(pointer), _shown(numbers, f"/case{pointer}", field), note))
        elif pointer in ASSUMED:
            shown = _shown(numbers, f"/assumed{pointer}", field, digits=4)
            group.append(Row(label_of(pointer), shown, ASSUMED[pointer]))
        elif pointer in ABSENT:
            group.append(Row(label_of(pointer), *ABSENT[pointer]))
    return found


def leaves(case: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield pointer and value of every input that the model uses."""
    for name, value in case.items():
        pointer = f"{before}/{name}"
        if isinstance(value, Mapping):
            yield from leaves(value, pointer)
        elif pointer not in UNUSED and not pointer.startswith("/output/"):
            yield pointer, value


def _shown(numbers: Numbers, pointer: str, field: Field, *, digits: int = 12) -> Any:
    value = numbers.at(pointer)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return WORDS.get(value, value)
    if isinstance(value, Sequence):
        return f"{_listed(value, field.factor)}{field.written}"
    return numbers.short(pointer, factor=field.factor, digits=digits, unit=field.written)


def _shot(shot: Mapping[str, float]) -> str:
    """Return a shot with what is given of it."""
    given = [(shot[name], field_of(name)) for name in SHOT if name in shot]
    return ", ".join(f"{value * field.factor:.6g}{field.written}" for value, field in given)


def _listed(values: Sequence[Any], factor: float) -> str:
    """Numbers in full, as long as they are few."""
    if values and isinstance(values[0], Mapping):
        more = f"; {len(values)} in all, as in the request" if len(values) > MOST_SHOTS else ""
        return "; ".join(map(_shot, values[:MOST_SHOTS])) + more
    if values and isinstance(values[0], Sequence):
        if len(values) > 6:
            return f"{len(values)} rows, as in the request"
        return "; ".join(_listed(row, factor) for row in values)
    return ", ".join(f"{value * factor:.12g}".replace("-", MINUS) for value in values)
