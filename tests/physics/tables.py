"""The paper's tables and published penetration tests, as the tests of calibration use them."""

import csv
import math
from pathlib import Path

from solver.calibration import DepthTest, ObliquityPoint

REFERENCE = Path(__file__).parents[2] / "validation" / "data"


def rows(name: str) -> list[dict[str, str]]:
    with (REFERENCE / name).open(newline="") as file:
        return list(csv.DictReader(file))


def table_1(*, with_masses: bool) -> list[DepthTest]:
    """Depths of normal impact; the keys read ``SNL-00-11/3 12.923kg 238.1m/s``."""
    tests = []
    for row in rows("paper_tables.csv"):
        if row["table"] == "1":
            _, mass, speed, *_ = row["key"].split()
            tests.append(
                DepthTest(
                    velocity=float(speed.removesuffix("m/s")),
                    depth=float(row["value"]),
                    mass=float(mass.removesuffix("kg")) if with_masses else None,
                )
            )
    return tests


def table_2() -> list[ObliquityPoint]:
    """Strength factors by oblique angle; the keys read ``oblique angle 15 deg``."""
    return [
        ObliquityPoint(oblique_angle=math.radians(float(row["key"].split()[2])), strength_factor=float(row["value"]))
        for row in rows("paper_tables.csv")
        if row["table"] == "2"
    ]


def equation_9() -> list[float]:
    return [float(row["value"]) for row in rows("paper_tables.csv") if row["table"] == "eq9"]
