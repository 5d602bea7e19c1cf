"""Numbers formatted for a report, each with its JSON pointer and full value, and the inputs of a case as table rows."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from markupsafe import Markup, escape

from service.columns import shown_in
from service.names import CHOICES, QUANTITIES
from solver.units import fixed, number, rounded, shown_unit, with_symbol

MINUS, BLANK = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"
# Inputs in SI rarely have more digits, and further ones would show the rounding of the conversion.
INPUT_DIGITS = 6
"""Largest number of significant digits of a converted number. [1]"""


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
    """Formatter of numbers for the report. Attributes in the HTML hold the pointer and all digits of each number.

    Callers name SI units, such as ``mm``; numbers are shown in the system of units that is in use in `solver.units`.

    Parameters
    ----------
    content
        Answers by name, and the inputs of the case under `case` and `assumed`.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = content

    def at(self, pointer: str) -> Any:
        """Return the value at a JSON pointer; None if there is none."""
        return lookup(self._content, pointer)

    def fixed(self, pointer: str, decimals: int = 0, *, unit: str = "", bare: bool = False) -> Markup:
        """Return a number with `decimals` decimals in SI, and about the same resolution in other units.

        It is empty if there is no number. `bare` leaves out the unit.
        """
        value = self.at(pointer)
        return self._data(pointer, unit, "" if value is None else fixed(value, unit, decimals), bare=bare)

    def short(self, pointer: str, *, digits: int = 3, unit: str = "") -> Markup:
        """Return a number with the given significant digits; empty if there is no number."""
        value = self.at(pointer)
        shown = "" if value is None else number(value, unit, digits, converted_digits=INPUT_DIGITS)
        return self._data(pointer, unit, shown)

    def upwards(self, pointer: str, unit: str, *, times: float = 1.0) -> Markup:
        """Return a number times a factor, rounded up as is usual for a design value, without its unit."""
        value = self.at(pointer)
        shown = "" if value is None else rounded(value, unit, math.ceil, times)
        return self._data(pointer, unit, shown, times=times, bare=True)

    def angle(self, pointer: str, decimals: int = 2) -> Markup:
        """Return an angle with a degree sign."""
        return self.fixed(pointer, decimals, unit="°")

    def _data(self, pointer: str, unit: str, text: str, *, times: float = 1.0, bare: bool = False) -> Markup:
        if not text:
            return Markup()
        factor = shown_unit(unit).factor * times
        return Markup('<data value="{}" data-from="{}" data-factor="{:.12g}">{}</data>{}').format(
            repr(float(self.at(pointer))),
            pointer,
            factor,
            text.replace("-", MINUS),
            "" if bare else with_symbol("", unit).replace(" ", BLANK),
        )


def sentence(text: str) -> Markup:
    """Return a warning as a sentence, with a capital letter and a full stop."""
    return escape(text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else "."))


class Row(NamedTuple):
    """A row of the table of inputs."""

    label: str
    value: Any
    note: str


MOST_SHOTS = 12
"""Largest number of shots listed in the report, where a list should stay within a few lines (an arbitrary choice)."""
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
FIELDS: Final[Mapping[str, str]] = {
    f"/{name.replace('.', '/')}": shown_in(name) for name in QUANTITIES if name.partition(".")[0] in GROUPS
}
"""SI unit in which a report writes each input, by its JSON pointer."""
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
    for pointer, unit in FIELDS.items():
        group = found[GROUPS[pointer.split("/")[1]]]
        if pointer in values:
            note = "" if lookup(given, pointer) is not None else "default"
            group.append(Row(label_of(pointer), _shown(numbers, f"/case{pointer}", unit), note))
        elif pointer in ASSUMED:
            shown = _shown(numbers, f"/assumed{pointer}", unit, digits=4)
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


def _shown(numbers: Numbers, pointer: str, unit: str, *, digits: int = 12) -> Any:
    value = numbers.at(pointer)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return WORDS.get(value, value)
    if isinstance(value, Sequence):
        return with_symbol(_listed(value, unit), unit)
    return numbers.short(pointer, digits=digits, unit=unit)


def _shot(shot: Mapping[str, float]) -> str:
    given = [(shot[name], shown_in(name)) for name in SHOT if name in shot]
    return ", ".join(with_symbol(number(value, unit, 6, converted_digits=INPUT_DIGITS), unit) for value, unit in given)


def _listed(values: Sequence[Any], unit: str) -> str:
    """Return the values as text; a long list of shots is cut, and a large matrix is replaced by its number of rows."""
    if values and isinstance(values[0], Mapping):
        more = f"; {len(values)} in all, as in the request" if len(values) > MOST_SHOTS else ""
        return "; ".join(map(_shot, values[:MOST_SHOTS])) + more
    if values and isinstance(values[0], Sequence):
        if len(values) > 6:
            return f"{len(values)} rows, as in the request"
        return "; ".join(_listed(row, unit) for row in values)
    shown = (number(value, unit, 12, converted_digits=INPUT_DIGITS) for value in values)
    return ", ".join(each.replace("-", MINUS) for each in shown)
