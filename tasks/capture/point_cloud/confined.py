"""Points of LAS, LAZ and E57 files, read in a process with limits on time and memory."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file, read_file
from schemas.machine.scratch import temporary_folder
from tasks.capture.files.ply_elements import as_bytes
from tasks.capture.point_cloud.child import COLUMNS
from tasks.capture.point_cloud.points import INSTANCE_NAMES, LABEL_NAMES, Points, labelled, whole_numbers
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
    columns = {}
    for key, (dtype, width, start) in facts["columns"].items():
        kind_of = np.dtype(dtype)
        ends = [other[2] for other in facts["columns"].values() if other[2] > start]
        column = np.frombuffer(data, kind_of, (min(ends, default=len(data)) - start) // kind_of.itemsize, start)
        columns[key] = column.reshape(-1, width) if width > 1 else column
    if "positions" not in columns:
        raise InputError(name, "points", "are none", "export the points again")
    points = Points(columns["positions"], notes=tuple(map(str, facts["notes"])), unit_m=facts["unit_m"])
    colors = columns.get("colors")
    if colors is not None and colors.any():  # all black is what programs write that have no colors
        points = dataclasses.replace(points, colors=as_bytes(colors, colors.dtype.str[1:]))
    instance = next((columns[word] for word in INSTANCE_NAMES if word in columns), None)
    if instance is not None:
        label = next((columns[word] for word in LABEL_NAMES if word in columns), None)
        objects = labelled(whole_numbers(instance), None if label is None else whole_numbers(label))
        points = dataclasses.replace(points, objects=objects)
    sensors = np.array(facts["sensors"], dtype=np.float64).reshape(-1, 3)
    if len(sensors):
        points = dataclasses.replace(points, sensors=sensors, sensor_of=columns["sensor_of"])
    return points
