"""Floors that a MetaScenes release states, `Layout/Heuristic` and `Layout/RoomFormer`, in the frame of its objects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import InputError
from schemas.files import stays_in
from tasks.capture.files.documents import name_of
from tasks.ingestion.scene import Array, FinishedObject, FloorLayout
from tasks.ingestion.values import json_document

_CEILING_M = 0.5
"""Corners of a layout above this are the ceiling's; the floor's are at 0."""

_SHARE_INSIDE = 0.5
"""A layout around fewer of the scene's objects than this is another frame's, or another room's."""


def read_layout(files: Sequence[Path], root: Path, objects: Sequence[FinishedObject]) -> tuple[FloorLayout | None, list[str]]:
    """The first of the layouts around the scene's objects, None when none is; and why others were passed over, a line each.

    Raises:
        InputError: a file is no layout.
    """
    import shapely

    notes: list[str] = []
    centers = [(float(instance.pose[0, 3]), float(instance.pose[1, 3])) for instance in objects]
    for file in files:
        name = name_of(file, root)
        layout, problem = _layout(file, root, name)
        if layout is not None:
            polygon = shapely.Polygon(layout.polygon)
            inside = sum(polygon.covers(shapely.Point(center)) for center in centers)
            if inside >= _SHARE_INSIDE * len(centers):
                return layout, notes
            problem = f"lies around {inside} of {len(centers)} objects"
        notes.append(f"{name}: layout not taken: {problem}")
    return None, notes


def _layout(file: Path, root: Path, name: str) -> tuple[FloorLayout | None, str]:
    """The floor of a layout file, or why it has none that can be used."""
    import shapely
    from shapely.geometry.polygon import orient

    if not stays_in(file, root):
        raise InputError(name, "file", "lies outside the dataset's folder", "copy it in")
    document = json_document(file, root)
    key = next((key for key in ("verts", "vert") if isinstance(document, dict) and key in document), None)
    if key is None:
        raise InputError(name, "verts", "is missing", "give the corners of the layout")
    corners = _corners(document[key], name, key)
    floor, height = corners, None
    if key == "verts":  # a model's layout, in a frame of its own: the viewers center it and turn it by a quarter
        low = corners[np.abs(corners[:, 2]) < 1e-9]
        if len(low) < 3:
            return None, "has no corners at height 0"
        center = (low[:, :2].min(axis=0) + low[:, :2].max(axis=0)) / 2
        turned = np.column_stack([-(corners[:, 1] - center[1]), corners[:, 0] - center[0], corners[:, 2]])
        floor = turned[_first_quad(document.get("quads"), len(corners), name)]
        top = float(corners[:, 2].max())
        height = top if top > _CEILING_M else None
    if len(floor) < 3 or np.abs(floor[:, 2]).max() > _CEILING_M:
        return None, "its first face is no floor"
    polygon = shapely.Polygon(floor[:, :2])
    if not polygon.is_valid or polygon.area < 0.1:
        return None, "its floor crosses itself or has no area"
    return FloorLayout(np.asarray(orient(polygon).exterior.coords)[:-1], height), ""


def _corners(value: Any, name: str, key: str) -> Array:
    try:
        corners = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    if corners.ndim != 2 or corners.shape[1] not in (2, 3) or not len(corners) or not np.isfinite(corners).all():
        raise InputError(name, key, "is no list of corners x, y, z", "give finite numbers in metres")
    if np.abs(corners).max() > 1e4:
        raise InputError(name, key, f"reaches {np.abs(corners).max():.3g} m", "give metres")
    return np.column_stack([corners[:, :2], corners[:, 2] if corners.shape[1] == 3 else np.zeros(len(corners))])


def _first_quad(quads: Any, count: int, name: str) -> list[int]:
    """Corners of the first face, which is the floor."""
    first = quads[0] if isinstance(quads, list) and quads else None
    if not isinstance(first, list) or not all(isinstance(i, int) and not isinstance(i, bool) and 0 <= i < count for i in first):
        raise InputError(name, "quads", "does not name corners of the layout", "give faces as lists of corner numbers, the floor first")
    return first
