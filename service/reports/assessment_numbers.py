"""Format of the numbers in a report, each with its JSON pointer and full value, and the inputs of a case as rows."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from markupsafe import Markup, escape

from service.columns import unit_end, unit_of
from service.names import CHOICES, QUANTITIES

MINUS, NARROW = "\N{MINUS SIGN}", "\N{NARROW NO-BREAK SPACE}"


def lookup(content: Any, pointer: str) -> Any:
    """Return the value at a JSON pointer; None if there is none."""
    for step in pointer.split("/")[1:]:
        if isinstance(content, Mapping):
            content = content.get(step)
        elif isinstance(content, Sequence) and not isinstance(content, str):
            content = content[int(step)] if int(step) < len(content) else None
        else:
            return None
    return content


class Numbers:
    """Formatter of numbers from answers; the page keeps the pointer and all digits of each.

    Parameters
    ----------
    content
        Answers by name.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = content

    def at(self, pointer: str) -> Any:
        """Return the value at a JSON pointer; None if there is none."""
        return lookup(self._content, pointer)

    def fixed(self, pointer: str, decimals: int, *, factor: float = 1.0, unit: str = "") -> Markup:
        """Return a number, times a factor, with a fixed number of decimals; empty if there is no number."""
        return self._written(pointer, factor, f".{decimals}f", unit)

    def short(self, pointer: str, *, factor: float = 1.0, digits: int = 3, unit: str = "") -> Markup:
        """Return a number, times a factor, with the given significant digits; empty if there is no number."""
        return self._written(pointer, factor, f".{digits}g", unit)

    def upwards(self, pointer: str, *, factor: float = 1.0) -> Markup:
        """Return a number, times a factor, rounded up to an integer, as is usual for design values."""
        value = self.at(pointer)
        # Without the subtraction, a whole number that rounding made slightly too large would become the next one.
        return Markup() if value is None else self._data(pointer, factor, f"{math.ceil(value * factor - 1e-6)}", "")

    def angle(self, pointer: str, decimals: int = 2) -> Markup:
        """Return an angle with the sign of degrees."""
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
    """Rewrite a number: small exponents in full, others without leading zeros, and zero without a sign."""
    mantissa, exponent, power = text.partition("e")
    if exponent and 0 <= int(power) <= 6:
        text = f"{float(text):.0f}"
    elif exponent:
        text = f"{mantissa}e{int(power)}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def sentence(text: str) -> Markup:
    """Return a warning as a sentence, with a capital letter and a full stop."""
    return escape(text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else "."))


class Field(NamedTuple):
    """Format of an input: the number shown is `factor` times its value, in `unit`."""

    unit: str = ""
    factor: float = 1.0

    @property
    def written(self) -> str:
        """The unit with the space, if any, that separates it from the number."""
        return f" {self.unit}" if self.unit and self.unit != "°" else self.unit


class Row(NamedTuple):
    """A row of the table of inputs."""

    label: str
    value: Any
    note: str


MOST_SHOTS = 12
"""Largest number of shots listed in the report, where a list should stay within a few lines (a rough choice)."""
SHOT = ("velocity_m_s", "depth_m", "mass_kg", "diameter_m")
"""Fields of a shot, in the order in which they are shown."""
GROUPS: Final[Mapping[str, str]] = {
    "projectile": "Projectile",
    "target": "Target",
    "impact": "Strike",
    "resistance": "Model",
    "strength_scatter": "Model",
    "numerics": "Computation",
    "search": "Computation",
}
"""Title of the group of inputs for each part of the request, in the order of the report."""
BY_END: Final[Mapping[str, Field]] = {"_m": Field("mm", 1e3), "_pa": Field("MPa", 1e-6)}
"""Format of quantities by the end of their names; all others are shown in the unit of the contract."""
OTHER_FIELDS: Final[Mapping[str, Field]] = {
    "projectile.nose.points": Field("mm", 1e3),
    "target.youngs_modulus_pa": Field("GPa", 1e-9),
    "numerics.termination_time_s": Field("ms", 1e3),
    "numerics.retention_energy_fraction": Field("%", 100.0),
}
"""Format of the quantities that are shown neither by the end of their names nor in the unit of the contract."""


def field_of(name: str) -> Field:
    """Return the format of a quantity of the contract."""
    return OTHER_FIELDS.get(name) or BY_END.get(unit_end(name)) or Field(unit_of(name))


FIELDS: Final[Mapping[str, Field]] = {
    f"/{name.replace('.', '/')}": field_of(name) for name in QUANTITIES if name.partition(".")[0] in GROUPS
}
"""Format of each input, by its JSON pointer."""
UNUSED: Final = frozenset({"/numerics/panels", "/numerics/time_step_s", "/search/relative_tolerance"})
"""Settings that only the numerics and searches of the paper use, which a report therefore omits."""
ABSENT: Final[Mapping[str, tuple[str, str]]] = {
    "/target/thickness_m": ("half-space", "default"),
    "/impact/oblique_angle_deg": ("none", "not given"),
    "/resistance/crater/depth_diameters": ("no crater", "default"),
    "/resistance/rear_plug/cone_angle_deg": ("no plug", "default"),
}
"""Text and note shown for inputs that are not given and have no default value."""
ASSUMED: Final[Mapping[str, str]] = {
    "/projectile/center_of_gravity_m": "default: homogeneous",
    "/projectile/moment_of_inertia_kg_m2": "default: homogeneous",
    "/target/youngs_modulus_pa": "default: ACI 318-19",
}
"""Source of the value that the model assumes for an input that is not given."""
WORDS: Final[Mapping[str, str]] = {value: name for names in CHOICES.values() for value, name in names.items()}
"""Names of choices, such as models, in words. A value that is common to several fields has the same name in all."""


def label_of(pointer: str) -> str:
    """Return the name of an input in words."""
    return QUANTITIES[pointer[1:].replace("/", ".")]


def rows(numbers: Numbers, given: Mapping[str, Any], case: Mapping[str, Any]) -> Mapping[str, list[Row]]:
    """Return the rows of the inputs by group.

    Parameters
    ----------
    numbers
        Formatter of the numbers of the case and of the assumed values.
    given
        The request as received; inputs that it lacks are marked as defaults.
    case
        The request with defaults filled in.
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
    """Yield the pointer and the value of each input that the model uses."""
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
    """Return the given fields of a shot as text."""
    given = [(shot[name], field_of(name)) for name in SHOT if name in shot]
    return ", ".join(f"{value * field.factor:.6g}{field.written}" for value, field in given)


def _listed(values: Sequence[Any], factor: float) -> str:
    """Return the numbers in full, or how many there are if they are too many to list."""
    if values and isinstance(values[0], Mapping):
        more = f"; {len(values)} in all, as in the request" if len(values) > MOST_SHOTS else ""
        return "; ".join(map(_shot, values[:MOST_SHOTS])) + more
    if values and isinstance(values[0], Sequence):
        if len(values) > 6:
            return f"{len(values)} rows, as in the request"
        return "; ".join(_listed(row, factor) for row in values)
    return ", ".join(f"{value * factor:.12g}".replace("-", MINUS) for value in values)
