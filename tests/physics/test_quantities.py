"""Names, units and descriptions of quantities are defined once, in the fields of dataclasses."""

import subprocess
import sys
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

import solver
from service.columns import unit_end, unit_of
from service.operations import OPERATIONS
from service.schemas.quantities import Part, solver_class
from solver.quantities import described, quantities

INPUTS = (solver.Projectile, solver.Target, solver.Impact, solver.Numerics, solver.Resistance, solver.Search)
ANSWERS = (solver.Trajectory, solver.Motion, solver.Exit, solver.Protrusion, solver.CriticalAngle, solver.Trial)


@pytest.mark.parametrize("kind", [*INPUTS, *ANSWERS], ids=lambda kind: kind.__name__)
def test_every_number_has_its_unit(kind: type) -> None:
    assert is_dataclass(kind)
    units = {name: quantity.unit for name, quantity in quantities(kind).items()}
    numbers = [each.name for each in fields(kind) if each.type in (float, float | None)]
    assert [name for name in numbers if not units[name]] == []


def test_parameters_and_fields_describe_a_quantity_alike() -> None:
    thickness = quantities(solver.Target)["thickness"]
    assert (thickness.short, thickness.unit) == (
        "thickness of a wall, at least a tenth of the diameter of the projectile; a half-space when not given",
        "m",
    )
    depth = quantities(solver.Motion)["nose_tip_depth"]
    assert (depth.short, depth.unit) == ("depth of the nose tip, positive inside the target", "m")


@pytest.mark.parametrize(
    ("name", "kinds", "unit"),
    [
        ("final_axis_angle", (solver.Trajectory,), "rad"),
        ("bracket_low", (solver.CriticalAngle,), "rad"),
        ("projectile.nose.caliber_radius_head", (solver.Target, solver.Projectile), "1"),
        ("protrusion_final", (solver.Trajectory,), "m"),
        ("nothing", (solver.Target,), ""),
    ],
)
def test_columns_are_described_by_their_fields(name: str, kinds: tuple[type, ...], unit: str) -> None:
    assert described(name, *kinds).unit == unit


def models(model: type[Part]) -> set[type[Part]]:
    """Return a model and all its subclasses, direct and indirect."""
    return {model, *(inner for each in model.__subclasses__() for inner in models(each))}


WITH_SOLVER_CLASS = sorted(
    (model for model in models(Part) if is_dataclass(solver_class(model)) and model.__module__.startswith("service.")),
    key=lambda model: model.__name__,
)


@pytest.mark.parametrize("model", WITH_SOLVER_CLASS, ids=lambda model: model.__name__)
def test_contract_names_the_units_of_the_solver(model: type[Part]) -> None:
    kind: Any = solver_class(model)
    known = quantities(kind)
    for field in model.model_fields:
        unit = unit_of(field)
        found = known.get(field.removesuffix(unit_end(field)))
        if found and found.unit and unit:
            assert found.unit == {"°": "rad", "g": "m/s²"}.get(unit, unit), field


def test_operations_list_their_columns() -> None:
    assert OPERATIONS["trajectory"].columns[1].description == quantities(solver.Trajectory)["maximum_depth"].short


def test_classes_of_quantities_are_imported_without_numba() -> None:
    modules = sorted({kind.__module__ for kind in (*INPUTS, *ANSWERS)})
    code = f"import sys, solver, {', '.join(modules)}; print('numba' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"
