"""The page uses the same units as the texts of the solver and the file readers."""

import math
import re
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from service.api.page import FOLDER
from service.readers import table
from solver.units import SI_UNITS, US_UNITS

SOURCE = (FOLDER / "units.js").read_text(encoding="utf-8")
READERS = {
    "length": table.LENGTH,
    "speed": table.SPEED,
    "mass": table.MASS,
    "pressure": table.PRESSURE,
    "density": table.DENSITY,
    "inertia": table.INERTIA,
}
"""Units of the file readers, by the name of the quantity in the page."""


def table_of_page(name: str) -> dict[str, Any]:
    """Read an object literal of the page, which becomes valid Python once its bare keys are quoted."""
    found = re.search(rf"^const {name} = (\{{.*?\}});$", SOURCE, re.DOTALL | re.MULTILINE)
    assert found is not None
    quoted = re.sub(r"([{,]\s*)([A-Za-z_]\w*):", r'\1"\2":', found[1])
    content: dict[str, Any] = eval(quoted, {"Math": SimpleNamespace(PI=math.pi)})  # noqa: S307 (a file of this project)
    return content


KINDS: Mapping[str, Mapping[str, float]] = table_of_page("KINDS")
FACTORS = {unit: factor for units in KINDS.values() for unit, factor in units.items()}
"""Size of every unit of the page, in SI units without prefixes."""
US: Mapping[str, str] = table_of_page("US")
COLUMNS: Mapping[str, tuple[str, float]] = table_of_page("COLUMNS")


def close_to(factor: float) -> Any:
    # The tables round derived factors to thirteen digits or more.
    return pytest.approx(factor, rel=1e-12)


def spelled(unit: str) -> str:
    """Return the spelling of a unit in names of columns."""
    return re.sub("[/ ]", "_", unit).translate(str.maketrans("²³", "23"))


def test_page_and_solver_texts_have_the_same_us_units() -> None:
    # No text of the solver has a force or an energy.
    assert {si: us for si, us in US.items() if si not in {"N", "kN", "J", "kJ"}} == {
        si: unit.symbol for si, unit in US_UNITS.items()
    }


@pytest.mark.parametrize("units", [SI_UNITS, US_UNITS], ids=["SI", "US"])
def test_page_and_solver_texts_have_the_same_factors(units: Mapping[str, Any]) -> None:
    # A quantity of the contract that is in percent is not converted.
    expected = {unit.symbol: close_to(1.0 / unit.factor) for si, unit in units.items() if si != "percent"}
    expected.pop("ms", None)  # Users type no times into the page.
    assert {unit: FACTORS[unit] for unit in expected} == expected


def test_us_unit_and_si_unit_belong_to_the_same_quantity() -> None:
    assert [si for si, us in US.items() if not any(si in units and us in units for units in KINDS.values())] == []


def test_columns_converted_by_the_page_have_the_factors_of_its_units() -> None:
    by_spelling = {spelled(unit): factor for unit, factor in FACTORS.items()}
    assert dict(COLUMNS.values()) == {us: close_to(by_spelling[us]) for us, _ in COLUMNS.values()}
    alike = {spelled(si).lower(): spelled(us) for si, us in US.items()}
    # Columns give in metres what texts give in millimetres, so their US unit is the inch.
    assert {si: us for si, (us, _) in COLUMNS.items() if us != alike.get(si)} == {"m": "in", "n_m": "ft_lbf"}


@pytest.mark.parametrize("quantity", READERS)
def test_units_shared_by_page_and_readers_have_the_same_factors(quantity: str) -> None:
    typed = {spelled(unit).lower(): factor for unit, factor in KINDS[quantity].items()}
    shared = typed.keys() & READERS[quantity].keys()
    assert shared
    assert {unit: typed[unit] for unit in shared} == {unit: close_to(READERS[quantity][unit]) for unit in shared}
