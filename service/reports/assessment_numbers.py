"""Numbers of answers as a report shows them, each with its pointer and full value, and the inputs of a case as rows."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from markupsafe import Markup, escape

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

    def angle(self, pointer: str, decimals: int = 2) -> Markup:
        """Return an angle in degrees."""
        return self.fixed(pointer, decimals, unit="°")

    def _written(self, pointer: str, factor: float, spec: str, unit: str) -> Markup:
        value = self.at(pointer)
        if value is None:
            return Markup()
        text = _plain(format(value * factor, spec)).replace("-", MINUS)
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

    group: str
    unit: str = ""
    factor: float = 1.0


class Row(NamedTuple):
    """An input as it is shown."""

    label: str
    value: Any
    note: str


MM, MPA, GPA = 1e3, 1e-6, 1e-9
MOST_SHOTS = 12
SHOT: Final[Mapping[str, tuple[str, float]]] = {
    "velocity_m_s": ("m/s", 1.0),
    "depth_m": ("mm", MM),
    "mass_kg": ("kg", 1.0),
    "diameter_m": ("mm", MM),
}
"""Unit of what is known of a shot, and the factor to it."""
PROJECTILE, TARGET, STRIKE, MODEL, NUMERICS = "Projectile", "Target", "Strike", "Model", "Computation"
FIELDS: Final[Mapping[str, Field]] = {
    "/projectile/nose/shape": Field(PROJECTILE),
    "/projectile/nose/caliber_radius_head": Field(PROJECTILE),
    "/projectile/nose/length_to_diameter": Field(PROJECTILE),
    "/projectile/nose/points": Field(PROJECTILE, "mm", MM),
    "/projectile/diameter_m": Field(PROJECTILE, "mm", MM),
    "/projectile/length_m": Field(PROJECTILE, "mm", MM),
    "/projectile/mass_kg": Field(PROJECTILE, "kg"),
    "/projectile/boat_tail/length_m": Field(PROJECTILE, "mm", MM),
    "/projectile/boat_tail/base_diameter_m": Field(PROJECTILE, "mm", MM),
    "/projectile/center_of_gravity_m": Field(PROJECTILE, "mm", MM),
    "/projectile/moment_of_inertia_kg_m2": Field(PROJECTILE, "kg m²"),
    "/target/compressive_strength_pa": Field(TARGET, "MPa", MPA),
    "/target/density_kg_m3": Field(TARGET, "kg/m³"),
    "/target/youngs_modulus_pa": Field(TARGET, "GPa", GPA),
    "/target/poissons_ratio": Field(TARGET),
    "/target/thickness_m": Field(TARGET, "mm", MM),
    "/impact/velocity_m_s": Field(STRIKE, "m/s"),
    "/impact/oblique_angle_deg": Field(STRIKE, "°"),
    "/impact/angle_of_attack_deg": Field(STRIKE, "°"),
    "/impact/angular_velocity_rad_s": Field(STRIKE, "rad/s"),
    "/resistance/strength_factor/model": Field(MODEL),
    "/resistance/strength_factor/shots": Field(MODEL),
    "/resistance/strength_factor/value": Field(MODEL),
    "/resistance/strength_factor/coefficients": Field(MODEL),
    "/resistance/strength_factor/covariance": Field(MODEL),
    "/resistance/strength_factor/coefficient": Field(MODEL),
    "/resistance/strength_factor/exponent": Field(MODEL),
    "/resistance/strength_factor/reference_strength_pa": Field(MODEL, "MPa", MPA),
    "/resistance/strength_factor/diameter_exponent": Field(MODEL),
    "/resistance/strength_factor/reference_diameter_m": Field(MODEL, "mm", MM),
    "/resistance/strength_factor/obliquity_shape": Field(MODEL),
    "/resistance/inertia_factor": Field(MODEL),
    "/resistance/free_surface/model": Field(MODEL),
    "/resistance/free_surface/inertia": Field(MODEL),
    "/resistance/crater/depth_diameters": Field(MODEL),
    "/resistance/rear_plug/cone_angle_deg": Field(MODEL, "°"),
    "/numerics/method": Field(NUMERICS),
    "/numerics/termination_time_s": Field(NUMERICS, "ms", 1e3),
    "/numerics/relative_tolerance": Field(NUMERICS),
    "/numerics/retention_energy_fraction": Field(NUMERICS, "%", 100.0),
    "/search/method": Field(NUMERICS),
    "/search/lower_deg": Field(NUMERICS, "°"),
    "/search/upper_deg": Field(NUMERICS, "°"),
    "/search/tolerance_deg": Field(NUMERICS, "°"),
}
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
    found: dict[str, list[Row]] = {field.group: [] for field in FIELDS.values()}
    values = dict(leaves(case))
    for pointer, field in FIELDS.items():
        if pointer in values:
            note = "" if lookup(given, pointer) is not None else "default"
            found[field.group].append(Row(label_of(pointer), _shown(numbers, f"/case{pointer}", field), note))
        elif pointer in ASSUMED:
            shown = _shown(numbers, f"/assumed{pointer}", field, digits=4)
            found[field.group].append(Row(label_of(pointer), shown, ASSUMED[pointer]))
        elif pointer in ABSENT:
            found[field.group].append(Row(label_of(pointer), *ABSENT[pointer]))
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
    unit = f" {field.unit}" if field.unit and field.unit != "°" else field.unit
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return WORDS.get(value, value)
    if isinstance(value, Sequence):
        return f"{_listed(value, field.factor)}{unit}"
    return numbers.short(pointer, factor=field.factor, digits=digits, unit=unit)


def _shot(shot: Mapping[str, float]) -> str:
    """Return a shot with what is given of it."""
    return ", ".join(f"{shot[name] * factor:.6g} {unit}" for name, (unit, factor) in SHOT.items() if name in shot)


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
