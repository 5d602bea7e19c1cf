"""Results for tests of the cache."""

import hashlib
import resource
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import orjson

from service.cache.record import FloatColumns, Record
from service.cache.segments import DecodedSegment
from service.schemas.answers import MotionState

COLUMNS = list(MotionState.model_fields)


def key_of(number: int) -> str:
    return hashlib.sha256(b"%d" % number).hexdigest()


def made(
    key: str,
    operation: str,
    request: dict[str, Any],
    answer: dict[str, Any],
    history: FloatColumns | None = None,
    engine_version: str = "1",
) -> Record:
    content = orjson.dumps(request)
    return Record(key, operation, content, answer, history, engine_version=engine_version, schema_version="2")


@contextmanager
def full_disk(largest: int = 4096) -> Iterator[None]:
    """Limit the size of files that this process can write, so that writes fail as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def trajectory(number: int = 0, rows: int = 313) -> Record:
    values = np.random.default_rng(number)
    return made(
        key=key_of(number),
        operation="trajectory",
        request={"projectile": {"nose": {"shape": "ogive"}, "diameter_m": 0.08}, "impact": {"velocity_m_s": 238.0}},
        answer={
            "outcome": "ricochet",
            "maximum_depth_m": 0.1 + 0.2,
            "final": dict(zip(COLUMNS, values.normal(size=12).tolist(), strict=True)),
            "warnings": [{"code": "strength_fit_range", "detail": "used at 55°"}],
        },
        history={name: values.normal(size=rows) for name in COLUMNS},
    )


def critical_angle(number: int = 0) -> Record:
    """Return a result that has about the size and entropy of a real one."""
    values = np.random.default_rng(number)
    trials = [
        {
            "oblique_angle_deg": angle,
            "final_position_m": position,
            "outcome": "embedded" if position > 0.0 else "ricochet",
            "fine": row > 16,
        }
        for row, (angle, position) in enumerate(values.normal(size=(20, 2)).tolist())
    ]
    return made(
        key=key_of(number),
        operation="cra",
        request={"impact": {"velocity_m_s": 200.0 + number}, "search": {"method": "outcome", "tolerance_deg": 0.01}},
        answer={
            "status": "converged",
            "critical_angle_deg": 48.0 + values.random(),
            "bracket_deg": [48.0, 48.0 + values.random()],
            "iterations": trials,
            "other_crossings_deg": [],
            "warnings": [{"code": "strength_fit_range", "detail": "used at 55°"}, {"code": "second", "detail": ""}],
        },
    )


def critical_angle_with_motion() -> Record:
    plain = critical_angle(1)
    motion: dict[str, Any] = {"outcome": "ricochet", "final": {"time_s": 0.004}}
    answer = plain.answer | {"trajectory": motion}
    history = {name: np.linspace(0.0, 0.004, 5) for name in COLUMNS}
    return made(plain.key, "cra", plain.request, answer, history)


def without_angle() -> Record:
    answer = {"status": "no_ricochet", "iterations": [], "other_crossings_deg": [], "warnings": []}
    return made(key_of(-1), "cra", {}, answer)


def same(one: Record | None, other: Record) -> bool:
    """Return whether two records are bitwise equal."""
    return (
        one is not None
        and (one.key, one.json, one.request, one.answer) == (other.key, other.json, other.request, other.answer)
        and (one.history is None) == (other.history is None)
        and all(np.array_equal((one.history or {})[name], column) for name, column in (other.history or {}).items())
    )


def obliquity_fit(number: int = 0) -> Record:
    """Return the result of a calibration, which has residuals."""
    points = [{"oblique_angle_deg": angle, "strength_factor": 9.0 + number} for angle in (0.0, 20.0, 45.0)]
    return made(
        key=key_of(number),
        operation="calibration_obliquity",
        request={"points": points},
        answer={"degree": 1, "residuals": [0.1, -0.2, 0.1], "warnings": []},
    )


def read_records(data: bytes, rows: Iterable[int] | None = None) -> list[Record]:
    segment = DecodedSegment(data)
    return segment.records(range(len(segment.keys)) if rows is None else rows)
