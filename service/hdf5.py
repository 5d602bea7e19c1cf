"""A record as an HDF5 file that explains itself: request, answer and versions as text, numbers as tables with units.

Before the HDF5 data stands a block of 512 bytes, which HDF5 allows for and its tools skip, with the hash of all that
follows. So every byte is checked before the HDF5 library, which does not take damage well, gets to see any.
"""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
import orjson

from service.record import Record

BLOCK = 512
"""Smallest place HDF5 keeps free for others at the start of a file. [bytes]"""

UNITS = {
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_n_m": "N m",
    "_deg": "deg",
    "_m": "m",
    "_s": "s",
    "_n": "N",
    "_j": "J",
}
"""Unit by the end of a name, longer ends first."""

DESCRIPTIONS = {
    "time_s": "since first contact",
    "center_of_gravity_depth_m": "depth of the centre of gravity, positive inside the target",
    "center_of_gravity_lateral_m": "way of the centre of gravity along the face since first contact",
    "nose_tip_depth_m": "depth of the nose tip, positive inside the target",
    "axis_angle_deg": "from the inward normal of the face to the axis; grows as the nose turns toward the face",
    "depth_velocity_m_s": "of the centre of gravity, along the inward normal",
    "lateral_velocity_m_s": "of the centre of gravity, along the face",
    "angular_velocity_rad_s": "rate of the axis angle",
    "depth_force_n": "resistance along the inward normal",
    "lateral_force_n": "resistance along the face",
    "moment_n_m": "moment of the resistance about the centre of gravity",
    "kinetic_energy_j": "of translation and rotation",
    "outcome": "how the run ended",
    "maximum_depth_m": "greatest depth of the nose tip",
    "status": "how the search ended",
    "critical_angle_deg": "smallest oblique angle, from the normal, at which the projectile is turned away",
    "oblique_angle_deg": "angle tried, from the inward normal of the face to the velocity",
    "final_position_m": "depth of the nose tip at the end of the trial",
    "fine": "whether the trial was computed as finely as asked for, or only to see where to look",
}
TABLES = {
    "summary": "the answer in short",
    "final": "the motion at the event that ended the run",
    "iterations": "every trial of the search, in order",
    "history": "the motion at even intervals and at the event that ended the run",
}

Columns = Mapping[str, Sequence[Any] | np.ndarray[Any, Any]]


class DamagedFileError(Exception):
    """The file is not what was written."""


def to_hdf5(record: Record) -> bytes:
    """Content of the file of a record; the same record gives the same bytes."""
    with h5py.File(record.key, "w", driver="core", backing_store=False) as file:
        file.attrs["title"] = "ricochet result"
        for name in ("operation", "key", "engine_version", "schema_version"):
            file.attrs[name] = getattr(record, name)
        _write_text(file, "request", record.request, "canonical request, JSON: every default filled in")
        _write_text(file, "answer", record.answer, "answer, JSON: without the history, which is a table of this file")
        for name, columns in _tables(record).items():
            _write_table(file, name, columns)
        file.flush()
        image: bytes = file.id.get_file_image()
    return _seal(image) + image


def from_hdf5(data: bytes) -> Record:
    """Read the record back.

    Raises
    ------
    DamagedFileError
        If a single byte differs from what was written.
    """
    image = data[BLOCK:]
    if data[:BLOCK] != _seal(image):
        raise DamagedFileError("the content does not match its checksum")
    try:
        with h5py.File.in_memory(image) as file:
            return Record(
                request=orjson.loads(file["request"][()]),
                answer=orjson.loads(file["answer"][()]),
                history=_read_history(file),
                **{name: file.attrs[name] for name in ("operation", "key", "engine_version", "schema_version")},
            )
    except (KeyError, OSError, TypeError, ValueError) as error:  # sealed, but not by this version of the service
        raise DamagedFileError(str(error)) from error


def _seal(image: bytes) -> bytes:
    return f"ricochet result, HDF5 from byte {BLOCK}, sha256 {hashlib.sha256(image).hexdigest()}\n".encode().ljust(
        BLOCK
    )


def _write_text(file: h5py.File, name: str, content: dict[str, Any], description: str) -> None:
    file.create_dataset(name, data=orjson.dumps(content).decode()).attrs["description"] = description


def _write_table(file: h5py.File, name: str, columns: Columns) -> None:
    arrays = {column: _as_array(values) for column, values in columns.items()}
    table = np.empty(len(next(iter(arrays.values()))), dtype=[(column, a.dtype) for column, a in arrays.items()])
    for column, array in arrays.items():
        table[column] = array
    attributes = file.create_dataset(name, data=table).attrs
    attributes["description"] = TABLES[name]
    attributes["column_units"] = np.array([_units(column) for column in arrays], dtype="S")
    attributes["column_descriptions"] = np.array([DESCRIPTIONS.get(column, "") for column in arrays], dtype="S")


def _as_array(values: Sequence[Any] | np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    array = np.asarray(values)
    return np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array


def _units(column: str) -> str:
    return next((unit for end, unit in UNITS.items() if column.endswith(end)), "")


def _tables(record: Record) -> dict[str, Columns]:
    motion = record.motion or {}
    tables: dict[str, Columns] = {
        "summary": {name: [value] for name, value in record.answer.items() if isinstance(value, float | int | str)},
        "final": {name: [value] for name, value in motion.get("final", {}).items()},
        "history": record.history or {},
    }
    if trials := record.answer.get("iterations"):
        names = dict.fromkeys(name for trial in trials for name in trial)
        tables["iterations"] = {name: [trial.get(name, np.nan) for trial in trials] for name in names}
    return {name: columns for name, columns in tables.items() if columns}


def _read_history(file: h5py.File) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]] | None:
    if "history" not in file:
        return None
    table = file["history"][()]
    return {name: np.ascontiguousarray(table[name]) for name in table.dtype.names}
