"""Bodies of calibration requests, and motions computed by the service to calibrate on."""

import copy
from typing import Any

import httpx
import numpy as np

from service.schemas.calibration_depth import TABLE_1, TABLE_2
from service.schemas.strike import PAPER

BODY = {"projectile": PAPER["projectile"], "target": PAPER["target"]}
TESTS = BODY | {"tests": TABLE_1}
POINTS = {"points": TABLE_2}


def answered(client: httpx.Client, path: str, body: Any) -> dict[str, Any]:
    response = client.post(path, json=body)
    assert response.status_code == 200, response.text
    answer: dict[str, Any] = response.json()
    return answer


def history_at(
    client: httpx.Client, oblique_angle_deg: float, strength_factor: float, **resistance: Any
) -> dict[str, Any]:
    """Return the motion that the model computes, as a history to calibrate on."""
    body = BODY | {
        "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": oblique_angle_deg},
        "resistance": {"strength_factor": {"model": "constant", "value": strength_factor}} | resistance,
        "output": {"sample_interval_s": 5e-5},
    }
    history = answered(client, "/trajectory", body)["history"]
    depth, angle = np.array(history["center_of_gravity_depth_m"]), np.array(history["axis_angle_deg"])
    return {
        "time_s": history["time_s"],
        "depth_displacement_m": (depth - depth[0]).tolist(),
        "lateral_displacement_m": history["center_of_gravity_lateral_m"],
        "rotation_deg": (angle - angle[0]).tolist(),
    }


def strike_at(oblique_angle_deg: float, history: dict[str, Any]) -> dict[str, Any]:
    impact = {"velocity_m_s": 238.0, "oblique_angle_deg": oblique_angle_deg}
    return copy.deepcopy(BODY) | {"impact": impact, "history": history}
