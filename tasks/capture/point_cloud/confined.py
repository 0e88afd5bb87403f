"""Points of LAS, LAZ and E57 files, read in a process with limits on time and memory."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file, read_file
from schemas.machine.scratch import temporary_folder
from tasks.capture.files.ply_elements import as_bytes
from tasks.capture.point_cloud.child import COLUMNS
from tasks.capture.point_cloud.points import Points, check_count, labelled, whole_numbers
from tasks.capture.point_cloud.projections import MAX_UNIT_M
from tasks.confinement import Limits, run_child

_CODE = "from tasks.capture.point_cloud.child import main; main()"

_READERS = {"las": ("laspy", b"LASF", ""), "e57": ("pye57", b"ASTM-E57", "pip install 'metascenes[e57]'")}
"""Package, first bytes and set-up of each kind of file."""


def read_confined(path: Path, name: str, kind: str) -> Points:
    """Points of a file of the kind `las` or `e57`.

    Raises:
        InputError: the file is cut, broken or too large, or its reader is not installed.
    """
    package, magic, setup = _READERS[kind]
    try:
        with open_file(path, name, BUDGET.scene_bytes) as file:
            if file.read(len(magic)) != magic:
                raise InputError(name, "content", f"does not begin with {magic.decode()!r}", "is it the right file?")
    except OSError as error:
        raise InputError(name, "file", f"cannot be read ({error.strerror or error})", "check its permissions") from error
    if importlib.util.find_spec(package) is None:
        raise InputError(name, "file", f"needs the package {package}", setup or f"pip install {package}")
    limits = Limits.of_file(path.stat().st_size, BUDGET.scene_bytes)
    with temporary_folder() as folder:
        arguments = [kind, str(path.resolve()), name, str(folder), str(limits.written)]
        facts = run_child(_CODE, arguments, folder, limits, name)
        data = read_file(folder / COLUMNS, name, BUDGET.scene_bytes) if facts.get("columns") else b""
    stated = _checked(facts, name)
    columns = _columns(stated, data, name)
    factor = stated.height_factor
    points = Points(
        columns["positions"],
        notes=stated.notes,
        unit_m=stated.unit_m,
        from_file=None if factor == 1.0 else np.diag([1.0, 1.0, factor, 1.0]),
    )
    colors = columns.get("colors")
    if colors is not None and colors.any():  # all black is what programs write that have no colors
        points = dataclasses.replace(points, colors=as_bytes(colors, colors.dtype.str[1:]))
    if "instance" in columns:
        label = columns.get("label")
        objects = labelled(whole_numbers(columns["instance"]), None if label is None else whole_numbers(label))
        points = dataclasses.replace(points, objects=objects)
    if stated.sensors:
        sensors = np.array(stated.sensors, dtype=np.float64)
        sensor_of = columns.get("sensor_of")
        if sensor_of is None or sensor_of.min(initial=0) < -1 or sensor_of.max(initial=-1) >= len(sensors):
            raise _wrong_answer(name, "sensors")
        points = dataclasses.replace(points, sensors=sensors, sensor_of=sensor_of)
    return points


_KINDS = {
    "positions": (("<f8",), 3),
    "colors": (("|u1", "<u2"), 3),
    "instance": (("<f8",), 1),
    "label": (("<f8",), 1),
    "sensor_of": (("<i4",), 1),
}
"""Types and width of each column that a child may leave."""

MAX_NOTES = 10_000
"""A file has a note for each scan without coordinates, and some more."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Note = Annotated[str, Field(max_length=20_000)]


class _Facts(BaseModel, strict=True):
    """The answer of a child. columns: type, width and offset [bytes] of each."""

    columns: dict[str, tuple[str, int, int]]
    unit_m: Annotated[float, Field(gt=0.0, lt=MAX_UNIT_M)] | None
    height_factor: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    notes: Annotated[tuple[Note, ...], Field(max_length=MAX_NOTES)]
    sensors: list[tuple[Finite, Finite, Finite]]


def _checked(facts: Mapping[str, Any], name: str) -> _Facts:
    """The answer of a child with the types that it should have, and notes of one line each."""
    try:
        stated = _Facts.model_validate_json(json.dumps(dict(facts)))
    except (ValidationError, ValueError) as error:
        places = error.errors()[0]["loc"] if isinstance(error, ValidationError) else ()
        raise _wrong_answer(name, str(places[0]) if places else "content") from error
    return stated.model_copy(update={"notes": tuple(" ".join(note.split()) for note in stated.notes)})


def _columns(stated: _Facts, data: bytes, name: str) -> dict[str, NDArray[Any]]:
    """Columns of one length that cover the data of a child, one after the other."""
    if not stated.columns:
        raise InputError(name, "points", "the file has none that can be used", "export the points again")
    for key, (dtype, width, _) in stated.columns.items():
        if key not in _KINDS or dtype not in _KINDS[key][0] or width != _KINDS[key][1]:
            raise _wrong_answer(name, f"column {key[:40]!r}")
    sizes = {key: np.dtype(dtype).itemsize * width for key, (dtype, width, _) in stated.columns.items()}
    rows, rest = divmod(len(data), sum(sizes.values()))
    if "positions" not in sizes or rest:
        raise _wrong_answer(name, "size of columns")
    check_count(rows, name)
    columns, end = {}, 0
    for key, (dtype, width, start) in sorted(stated.columns.items(), key=lambda entry: entry[1][2]):
        if start != end and rows:
            raise _wrong_answer(name, f"place of column {key!r}")
        end += rows * sizes[key]
        column = np.frombuffer(data, dtype, rows * width, end - rows * sizes[key])
        columns[key] = column.reshape(-1, width) if width > 1 else column
    return columns


def _wrong_answer(name: str, part: str) -> InputError:
    return InputError(name, "content", f"its reader gave a wrong answer ({part})", "export it again")
