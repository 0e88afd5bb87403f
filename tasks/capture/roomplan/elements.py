"""Elements of a captured room: where they are, how large, and what."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import json_floats, plain_text
from tasks.capture.roomplan.curves import Curve, curve_of
from tasks.geometry.transforms import Y_UP_TO_Z_UP, inverse, is_rigid, nearest_rigid, transform_points

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]
T = TypeVar("T")

LARGEST_M = 200.0
"""Larger than any room, and than any building that is scanned by hand."""

MAX_BEND_M = 0.05
"""Distance of corners from their plane, and of their extents from the stated size: RoomPlan's own error on walls."""

MAX_STOREYS = 100
"""Numbers of storeys below and above the first."""

_THIN_M = 0.005
"""Extent of a surface along its normal: RoomPlan states 0."""

_AGAIN = "export the room again"


@dataclasses.dataclass(frozen=True)
class RoomElement:
    """An element. pose: Its own frame (x along its width, y along its height, z its normal or depth) to the +Z-up frame, 4x4 [m].
    size: Width, height and depth [m], shape (3,). corners: Of its outline in its own frame [m], shape (n, 3), none where it is its
    rectangle. parent: Identifier of the wall that it is in. field: Where it stands in the file. curve: Of a wall that is not flat.
    story: Number of its storey, None where the file states none. outline: Of a floor with several pieces or holes, in x and y of its own
    frame [m]; None where its corners are the outline."""

    identifier: str
    category: str
    pose: Array
    size: Array
    corners: Array
    parent: str
    field: str
    curve: Curve | None = None
    story: int | None = None
    outline: shapely.MultiPolygon | None = None


def elements_of(value: Any, name: str, kind: str) -> tuple[list[RoomElement], list[str]]:
    """Elements of a list of the file, of which there may be none, and a note for each that is wrong and left out.

    Raises:
        InputError: it is not a list.
    """
    if value is None:
        return [], []
    if not isinstance(value, list):
        raise InputError(name, kind, "must be a list", "is it the right file?")
    elements: list[RoomElement] = []
    notes: list[str] = []
    for index, entry in enumerate(value):
        field = f"{kind}[{index}]"
        try:
            element = _element(entry, name, field)
        except InputError as error:
            notes.append(f"{error.file}: {error.field}: {error.problem}: left out")
            continue
        # A wrong detail costs the detail, not the element.
        story, story_note = _detail(_story, entry.get("story"), name, f"{field}.story", "not used")
        has_curve = kind == "walls"
        curve, curve_note = _detail(curve_of, entry.get("curve") if has_curve else None, name, f"{field}.curve", "the wall is flat")
        element = dataclasses.replace(element, story=story, curve=curve)
        notes += [*story_note, *curve_note]
        # The frame of an arc is the one that its curve is stated in.
        if kind != "objects" and curve is None:
            element, remark = in_plane(element)
            notes += [f"{name}: {remark}"] if remark else []
        elements.append(element)
    return elements, notes


def _detail(read: Callable[[Any, str, str], T], value: Any, name: str, field: str, effect: str) -> tuple[T | None, list[str]]:
    """A detail of an element, None with a note if it is wrong."""
    try:
        return read(value, name, field), []
    except InputError as error:
        return None, [f"{error.file}: {error.field}: {error.problem}: {effect}"]


def in_plane(element: RoomElement) -> tuple[RoomElement, str]:
    """A surface in a frame whose z axis is its normal, and a remark on contradictions, '' without any.

    Corners may lie in any plane of the element's own frame. Without corners, the axis of no extent is the normal.
    """
    field, corners = element.field, element.corners
    if len(corners) < 3:
        return _turned_to(element, _thin_axis(element.size)), ""
    area = 0.5 * np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    norm = float(np.linalg.norm(area))
    if norm < 1e-9:
        plain = dataclasses.replace(element, corners=corners[:0])
        return _turned_to(plain, _thin_axis(element.size)), f"{field}.polygonCorners: have no area: dimensions are used"
    normal = area / norm
    normal = normal * (1.0 if normal[np.abs(normal).argmax()] > 0 else -1.0)
    turned = _turned_to(element, normal)
    offset = turned.corners[:, 2]
    if float(np.ptp(offset)) > 2.0 * MAX_BEND_M:
        remark = f"{field}.polygonCorners: lie up to {float(np.ptp(offset)):.2f} m out of a plane: read as flat"
    else:
        extents, stated = np.ptp(turned.corners[:, :2], axis=0), turned.size[:2]
        differs = (np.abs(extents - stated) > np.maximum(MAX_BEND_M, 0.05 * stated)).any()
        spans = " x ".join(f"{value:.2f}" for value in extents)
        sizes = " x ".join(f"{value:.2f}" for value in stated)
        remark = f"{field}: corners span {spans} m, dimensions state {sizes} m: the corners are used" if differs else ""
        turned = dataclasses.replace(turned, size=np.append(np.maximum(extents, stated), turned.size[2])) if differs else turned
    return turned, remark


def _thin_axis(size: Array) -> Array:
    """The axis along which a surface has no extent: z, unless another one alone has none."""
    axis = int(size.argmin()) if size[2] > _THIN_M and size.min() <= _THIN_M else 2
    return np.eye(3)[axis]


def _turned_to(element: RoomElement, normal: Array) -> RoomElement:
    """An element in a frame whose z axis is a direction of its own frame, with its corners about z = 0."""
    middle = float((element.corners @ normal).mean()) if len(element.corners) else 0.0
    turn = np.eye(4)
    if normal[2] < 1.0 - 1e-12:
        across = np.eye(3)[0] if abs(normal[0]) < 0.9 else np.array([0.0, 0.0, -1.0])
        x = across - normal * float(across @ normal)
        x /= np.linalg.norm(x)
        turn[:3, :3] = np.column_stack([x, np.cross(normal, x), normal])
    elif abs(middle) < 1e-9:
        return element
    turn[:3, 3] = normal * middle
    back = inverse(turn)
    return dataclasses.replace(
        element,
        pose=element.pose @ turn,
        size=np.abs(turn[:3, :3].T) @ element.size,
        corners=transform_points(element.corners, back) if len(element.corners) else element.corners,
    )


def _element(entry: Any, name: str, field: str) -> RoomElement:
    if not isinstance(entry, dict):
        raise InputError(name, field, "must be an object", "is it the right file?")
    size = json_floats(entry.get("dimensions"), name, f"{field}.dimensions", 3)
    if (size < 0.0).any() or (size > LARGEST_M).any():
        raise InputError(name, f"{field}.dimensions", f"must be 0 to {LARGEST_M:g} m", _AGAIN)
    pose = json_floats(entry.get("transform"), name, f"{field}.transform", 16).reshape(4, 4).T  # columns come one after another
    if not is_rigid(pose, 0.01):
        raise InputError(name, f"{field}.transform", "is no rotation and translation", _AGAIN)
    corners = entry.get("polygonCorners") or []
    if not isinstance(corners, list) or len(corners) > 10_000:
        raise InputError(name, f"{field}.polygonCorners", "must be a list of corners", _AGAIN)
    outline = [json_floats(corner, name, f"{field}.polygonCorners[{at}]", 3) for at, corner in enumerate(corners)]
    return RoomElement(
        identifier=_text(entry.get("identifier")),
        category=_category(entry.get("category")),
        pose=Y_UP_TO_Z_UP @ nearest_rigid(pose),
        size=size,
        corners=np.array(outline, dtype=np.float64).reshape(-1, 3),
        parent=_text(entry.get("parentIdentifier")),
        field=field,
    )


def _story(value: Any, name: str, field: str) -> int | None:
    """Number of a storey, None where there is none."""
    if value is None:
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(name, field, "must be a whole number", _AGAIN)
    if abs(value) > MAX_STOREYS:
        raise InputError(name, field, f"must be at most {MAX_STOREYS}", _AGAIN)
    return value


def _category(value: Any) -> str:
    """`{"chair": {}}`, as Swift encodes it, or a plain word; an element without one is an object."""
    return _text(next(iter(value), "") if isinstance(value, dict) else value) or "object"


def _text(value: Any) -> str:
    return plain_text(value) if isinstance(value, str) else ""
