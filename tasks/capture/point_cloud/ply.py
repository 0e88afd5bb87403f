"""Points of PLY files without faces."""

from __future__ import annotations

import io
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.ply_elements import PlyColumn, read_elements
from tasks.capture.files.ply_header import AGAIN, check_counts, header
from tasks.capture.point_cloud.points import Points, points_of_columns
from tasks.capture.point_cloud.rows import read_rows

_SURFACES = ("face", "tristrips")
"""Elements that make a mesh."""


def is_cloud(data: bytes, name: str) -> bool:
    """True if a PLY has vertices and no surface between them.

    Raises:
        InputError: its header is broken.
    """
    counts = {element.name: element.count for element in header(data, name)[1]}
    return counts.get("vertex", 0) > 0 and not any(counts.get(surface, 0) for surface in _SURFACES)


def read_ply_points(path: Path, name: str) -> Points:
    """Points of a PLY.

    Raises:
        InputError: cut, broken, too large, or not points of a scan.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes, b"ply")
    order, elements, start = header(data, name)
    check_counts(data, name)
    if not is_cloud(data, name):
        raise InputError(name, "element face", "it is a mesh and not a point cloud", "read it as the scan format bare_mesh")
    fields = {field[0] for element in elements if element.name == "vertex" for field in element.fields}
    if "f_dc_0" in fields:
        remedy = "export a mesh or a point cloud instead"
        raise InputError(name, "element vertex", "holds Gaussian splats, which are not points of a surface", remedy)
    vertex = next(element for element in elements if element.name == "vertex")
    filled = [element for element in elements if element.fields]
    try:
        if order or filled[:1] != [vertex] or any(len(field) == 3 for field in vertex.fields):
            columns = read_elements(data, start, order, elements).get("vertex", {})
        else:
            file = io.BytesIO(data)
            file.seek(start)
            table = read_rows(file, name, len(vertex.fields), vertex.count)
            if len(table.values) < vertex.count:
                raise InputError(name, "element vertex", f"declares {vertex.count}, but the file ends after {len(table.values)}", AGAIN)
            columns = {field[0]: PlyColumn(table.values[:, i], field[1]) for i, field in enumerate(vertex.fields)}
    except (ValueError, OverflowError) as error:
        raise InputError(name, "content", f"is cut or broken ({str(error)[:120]})", AGAIN) from error
    further_elements = [f"element {element.name}" for element in elements if element is not vertex and element.count]
    return points_of_columns(columns, name, [f"{name}: {', '.join(further_elements)}: not used"] if further_elements else ())
