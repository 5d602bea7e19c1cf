"""Columns of result tables in CSV, Parquet and HDF5, with their names in the contract, units and descriptions.

The command line loads this module at its start, so the module imports nothing that is slow to load.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

UNITS = {
    "_kg_m2": "kg m^2",
    "_m2": "m^2",
    "_kg_m3": "kg/m^3",
    "_pa": "Pa",
    "_kg": "kg",
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_n_m": "N m",
    "_deg": "deg",
    "_m": "m",
    "_s": "s",
    "_n": "N",
    "_j": "J",
    "_g": "g_0",
}
"""Units by suffix of a field name. A suffix that ends in another suffix precedes it, since the first match is used."""
WRITTEN = {"kg m^2": "kg m²", "m^2": "m²", "kg/m^3": "kg/m³", "deg": "°", "g_0": "g"}
SYMBOLS = {end: WRITTEN.get(unit, unit) for end, unit in UNITS.items()}
"""Units by suffix of a field name, as they are displayed, such as m² and °."""


def unit_end(name: str) -> str:
    """Return the suffix of a field name that denotes its unit, or an empty string."""
    return next((end for end in UNITS if name.endswith(end)), "")


def unit_of(name: str) -> str:
    """Return the unit of a field as it is displayed, or an empty string."""
    return SYMBOLS.get(unit_end(name), "")


BY_END = {"_m": "mm", "_pa": "MPa"}
"""SI units in which texts show quantities, by the suffix of their names; other quantities keep the unit of the
contract."""
OTHER_UNITS = {
    "projectile.nose.points": "mm",
    "target.youngs_modulus_pa": "GPa",
    "numerics.termination_time_s": "ms",
    "flight.height_m": "m",
    "numerics.retention_energy_fraction": "%",
}
"""Exceptions to `BY_END` and to the units of the contract: SI unit in which texts show a quantity, by its path."""


def shown_in(name: str) -> str:
    """Return the SI unit in which texts show a quantity of the contract; empty if it has none."""
    return OTHER_UNITS.get(name) or BY_END.get(unit_end(name)) or unit_of(name)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a result table.

    Parameters
    ----------
    name
        Name of the field in the contract.
    description
        Description without the unit.
    dtype
        NumPy dtype. Strings are UTF-8 of fixed length, padded with zeros that take hardly any space once compressed.
    """

    name: str
    description: str
    dtype: str = "<f8"

    @property
    def unit(self) -> str:
        """Unit of the numbers in the column, in ASCII."""
        return UNITS.get(unit_end(self.name), "")


IDENTITY = (
    Column("key", "key of the result; empty if the case has none", "S64"),
    Column("operation", "operation that computed the result", "S32"),
    Column("engine_version", "version of the solver", "S32"),
    Column("schema_version", "version of the contract", "S32"),
)
WARNINGS = Column("warnings", "codes of the warnings, separated by spaces", "S512")
NUMBERING = (
    Column("index", "number of the case in the batch, from 0", "<i8"),
    Column("custom_id", "name of the case in the batch", "S512"),
    Column("problem", "type of the problem, for a case without a result", "S128"),
)
"""Columns that only tables of batches have."""
CASE = Column("case", "row of the case in the summary, from 0", "<i8")
QUANTITIES = {
    "depth_displacement_m": "displacement of the centre of gravity along the inward normal of the face",
    "lateral_displacement_m": "displacement of the centre of gravity along the face",
    "rotation_deg": "change of the axis angle",
}
RUN = Column("run", "number of the run in the request, from 0", "<i8")
RESIDUALS = (
    RUN,
    Column("oblique_angle_deg", "angle from the inward normal of the face to the velocity"),
    Column("strength_factor", "strength factor, as given"),
    Column("residual", "given minus fitted strength factor"),
    Column("velocity_m_s", "speed at first contact"),
    Column("group", "name of the group of the test", "S512"),
    Column("depth_m", "greatest depth of the nose tip, as given"),
    Column("predicted_depth_m", "greatest depth of the nose tip, predicted with the fitted strength factor"),
    Column("residual_m", "given minus predicted depth"),
    Column("time_s", "time since first contact"),
    *(Column(name, f"{text}, as given") for name, text in QUANTITIES.items()),
    *(
        Column(f"predicted_{name}", f"{text}, predicted with the fitted strength factor")
        for name, text in QUANTITIES.items()
    ),
    *(Column(f"residual_{name}", f"{text}, given minus predicted") for name, text in QUANTITIES.items()),
    Column("quantity", "quantity of the row: the probability of an outcome, or a quantile", "S64"),
    Column("level", "level of the quantile"),
    Column("ricochet_probability", "probability of ricochet at the oblique angle"),
    Column("value", "probability, or quantile in the unit of the quantity"),
    Column("lower", "lower end of the confidence interval"),
    Column("upper", "upper end of the confidence interval"),
    Column("formula", "name of the formula in the answer", "S64"),
    Column("penetration_depth_m", "depth of penetration into concrete that is thick enough"),
    Column("scabbing_thickness_m", "least thickness of a wall whose rear face does not scab"),
    Column("perforation_thickness_m", "least thickness of a wall that is not perforated"),
    Column(
        "in_range",
        "yes or no: whether the strike is in the range of the formula; unknown if it has no stated range",
        "S8",
    ),
    Column("note", "doubts about the formula, or assumptions", "S256"),
    Column(
        "verified",
        "yes or no: whether the constants were compared with an original, a standard or a published shot",
        "S8",
    ),
    Column("source", "authors and year of the source", "S128"),
)
"""Columns of the detailed tables of calibrations (residuals), studies of uncertainty (curves) and empirical formulas.
Each table has some of these columns."""


def trial_columns(answer: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the trials of a search as columns, without the nested fields `exit` and `protrusion`."""
    trials = answer["iterations"]
    names = dict.fromkeys(name for trial in trials for name in trial if name not in {"exit", "protrusion"})
    return {name: [trial.get(name) for trial in trials] for name in names}


def summarize(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table row of an answer as values by column name; absent fields are left out.

    Numbers and strings at the top level of the answer are copied under their names. A column for a nested field needs a
    line in this function; without one the column stays empty.
    """
    row: dict[str, Any] = {name: value for name, value in answer.items() if isinstance(value, float | int | str)}
    for part in ("final", "exit", "protrusion"):
        row |= {f"{part}_{name}": value for name, value in answer.get(part, {}).items()}
    bending = answer.get("bending", {})
    row |= {f"bending_{name}": value for name, value in bending.items() if name != "history"}
    flight: dict[str, Any] = row.pop("exit_flight", {})
    row |= {f"exit_flight_{name}": value for name, value in flight.items()}
    # The ends are sorted, because a bracket may list its upper end first.
    for unit in ("deg", "m", "m_s"):
        if bracket := answer.get(f"bracket_{unit}"):
            row[f"bracket_low_{unit}"], row[f"bracket_high_{unit}"] = min(bracket), max(bracket)
    # A search for perforation returns either a thickness or a speed. Its fields have the same names in both cases, so
    # the names of the columns add the unit.
    if "variants" in answer and "iterations" in answer:
        unit = "m" if "thickness_m" in answer["iterations"][0] else "m_s"
        row |= {f"{name}_{unit}": value for name, value in answer["variants"].items()}
        ends = {name: answer.get("range", {}).get(end) for name, end in (("low", "lower"), ("high", "upper"))}
        row |= {f"range_{name}_{unit}": value for name, value in ends.items() if value is not None}
    if "iterations" in answer:
        row["trials"] = len(answer["iterations"])
    if (beside := row.pop("without_protrusion", None)) is not None:
        row["without_protrusion_m" if "thickness_m" in answer["iterations"][0] else "without_protrusion_m_s"] = beside
    if interval := answer.get("confidence_interval"):
        row["confidence_low"], row["confidence_high"] = interval
    angle = answer.get("critical_angle", {})
    row |= {name: angle[name]["value"] for name in ("mean_deg", "standard_deviation_deg") if name in angle}
    # The column that holds the probability of an outcome is named after the outcome.
    row |= {each["outcome"]: each["value"] for each in answer.get("outcomes", ()) if "value" in each}
    # Each code is listed once, in the order of the warnings; codes have no spaces.
    row["warnings"] = " ".join(dict.fromkeys(warning["code"] for warning in answer.get("warnings", ())))
    return row


def batch_columns(columns: Iterable[Column], axes: tuple[str, ...] = ()) -> tuple[Column, ...]:
    """Return the columns of a batch in CSV and Parquet. The axes of a sweep come after the index.

    Parameters
    ----------
    columns
        Columns of the answers.
    axes
        Fields that a sweep varies.
    """
    index, custom_id, problem = NUMBERING
    key, *_ = IDENTITY
    swept = tuple(Column(name, "value of the axis of the sweep") for name in axes)
    return (index, *swept, custom_id, key, *columns, WARNINGS, problem)


def base_of(base: Mapping[str, Any], axes: Sequence[str], before: str = "") -> dict[str, Any]:
    """Return the fields of a sweep's base that no axis replaces, keyed by dotted path; lists become JSON strings."""
    found: dict[str, Any] = {}
    for name, value in base.items():
        field = f"{before}{name}"
        if isinstance(value, Mapping):
            found |= base_of(value, axes, f"{field}.")
        elif field not in axes and value is not None:
            found[field] = value if isinstance(value, str | int | float) else json.dumps(value)
    return found


def batch_row(columns: Iterable[Column], item: Mapping[str, Any], point: tuple[float, ...] = ()) -> list[Any]:
    """Return the row of one case in the order of `batch_columns`; absent values are None.

    Parameters
    ----------
    columns
        Columns of the answers.
    item
        The case as in the JSON results of a batch: `index`, `custom_id` if it has one, and `result` or `problem`.
    point
        Values of the axes of a sweep.
    """
    answer = item.get("result")
    row = summarize(answer) if answer else {}
    middle = [row.get(column.name) for column in columns]
    problem = None if answer else (item.get("problem") or {}).get("type")
    return [item["index"], *point, item.get("custom_id"), row.get("key"), *middle, row.get("warnings"), problem]


FORMULA = re.compile("[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""Pattern of the first character of a cell that a spreadsheet may evaluate as a formula: one of `=+-@` or of their
full-width forms, or a tab or line break, which a spreadsheet skips."""
SIGNED_NUMBER = re.compile(r"[+-]\d+(\.\d*)?([eE][+-]?\d+)?", re.ASCII)
"""Pattern of a signed number, which a spreadsheet does not take for a formula."""


def csv_cells(row: Iterable[Any]) -> list[Any]:
    """Return the cells of a CSV row, with an apostrophe before each string that a spreadsheet would evaluate.

    Names of cases come from clients, and a formula in a name would run on the machine that opens the table (CSV
    injection).
    """
    return [f"'{value}" if isinstance(value, str) and _is_formula(value) else value for value in row]


def _is_formula(text: str) -> bool:
    return FORMULA.match(text) is not None and SIGNED_NUMBER.fullmatch(text) is None
