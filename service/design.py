"""The design value of a wall in words, as commands and the report say it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from solver.formulas import PERFORATION_MARGIN


def design_sentence(rows: Sequence[Mapping[str, Any]], wall: float | None) -> str:
    """Return the design value of a wall, and whether the wall of the case has it.

    Parameters
    ----------
    rows
        Formulas, as ``/formulas`` and ``/thickness`` answer them.
    wall
        Thickness of the wall of the case, None for a half-space. [m]
    """
    within = [row["perforation_thickness_m"] for row in rows if row["in_range"] and "perforation_thickness_m" in row]
    if not within:
        return "No design value: no formula is within the range of its tests."
    design = PERFORATION_MARGIN * max(within)
    judged = "" if wall is None else f"{1e3 * wall:g} mm: {'enough' if wall >= design else 'not enough'}. "
    least = math.ceil(1e3 * design - 1e-6)  # a design value is not rounded down
    return f"{judged}Design value at least {least:,} mm (largest formula within its range × {PERFORATION_MARGIN:g})."
