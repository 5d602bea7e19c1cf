"""A request under other laws, and what the answer says of each."""

from collections.abc import Mapping
from typing import Any, TypeVar, cast

import orjson

from service.schemas.requests import CriticalAngleRequest, TrajectoryRequest
from service.schemas.resistance import Resistance
from solver import alternative_resistances
from solver.alternatives import fitted_to

Request = TypeVar("Request", bound=TrajectoryRequest | CriticalAngleRequest)

FOUND = ("status", "outcome", "critical_angle_deg")
"""Fields of an answer that stand in the list of alternatives."""


def alternative_requests(request: Request) -> list[tuple[dict[str, Any], Request]]:
    """Return the laws and the request of each alternative: the same case, with its inertia, under other laws."""
    found = []
    for each in alternative_resistances(request.resistance.to_solver()):
        laws = {"free_surface": each.free_surface.name, "strength_factor": each.strength_factor.name}
        decay = {"model": each.free_surface.name, "inertia": getattr(each.free_surface, "inertia", False)}
        law = Resistance.model_validate(
            {"strength_factor": {"model": each.strength_factor.name}, "free_surface": decay}
        )
        resistance = request.resistance.model_copy(
            update={"strength_factor": law.strength_factor, "free_surface": law.free_surface}
        )
        other = cast("Request", request.model_copy(update={"resistance": resistance, "alternatives": False}))
        found.append((laws | {"fitted_to": fitted_to(each)}, other))
    return found


def answered_alternative(laws: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return an alternative with what its answer says."""
    return {**laws, **{name: answer[name] for name in FOUND if name in answer}}


def with_alternatives(answer: bytes, alternatives: list[dict[str, Any]]) -> bytes:
    """Return the JSON of an answer with its alternatives behind the other fields."""
    return b'%b,"alternatives":%b}' % (answer[:-1], orjson.dumps(alternatives))
