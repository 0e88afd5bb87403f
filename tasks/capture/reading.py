"""What every reader makes of a scan, before anything is estimated from it. All in the scan's own frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class FrameSource:
    """A frame as the scan has it. Pixels are read when asked for.

    intrinsics, depth_intrinsics: fx, fy, cx, cy [px]. depth_size: width, height [px]. depth_scale: units per metre.
    pose: OpenCV camera to scan frame, 4x4 [m], None when unreadable. `color()` gives shape (h, w, 3) uint8,
    `depth()` metres, shape (h, w) float32, 0 where there is no reading; both raise InputError.
    """

    frame_id: str
    color_file: str
    depth_file: str | None
    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    depth_size: tuple[int, int] | None
    depth_intrinsics: tuple[float, float, float, float]
    depth_scale: float
    pose: NDArray[np.float64] | None
    color: Callable[[], NDArray[np.uint8]]
    depth: Callable[[], NDArray[np.float32]] | None


@dataclasses.dataclass(frozen=True)
class Group:
    """One instance as the scan names it: the vertices and faces of the scan mesh that are its own.

    vertices, faces: Sorted indices into the scan mesh, shapes (n,) and (m,) int64; n >= 1 but for what frames alone show.
    origin: File and field that the label was read from, for messages; empty for what was found in the geometry.
    """

    source_id: str
    raw_label: str
    vertices: NDArray[np.int64]
    faces: NDArray[np.int64]
    origin: str = ""


@dataclasses.dataclass(frozen=True)
class Reading:
    """A scan as read.

    surface: Scan mesh in the scan frame; None when there are only frames, to be fused.
    parts: The same geometry with its textures, where the scan has any, with the faces of `surface` in their order; of vertices it may have
        more, where textures split them.
    groups: Instances; None when the scan names none, to be found in the geometry.
    alignment: Scan frame to an aligned frame, 4x4 [m], where the scan states one.
    glb: The scan's own file where it is a GLB, which can be kept as it is when nothing moves.
    materials: Which of its textures each face of `surface` has, shape (m,) int64, where the scan names no instances and has several.
    is_dense: Vertices lie as densely as a depth sensor leaves them, so that they can stand for the surface.
    """

    surface: Surface | None
    parts: tuple[trimesh.Trimesh, ...] = ()
    groups: tuple[Group, ...] | None = None
    frames: tuple[FrameSource, ...] = ()
    alignment: NDArray[np.float64] | None = None
    room_type: str = ""
    license: str | None = None
    is_dense: bool = True
    degradations: tuple[str, ...] = ()
    glb: bytes | None = None
    materials: NDArray[np.int64] | None = None


def groups_of(named: Sequence[tuple[str, str, NDArray[np.int64]]], owner: NDArray[np.int64], surface: Surface) -> tuple[Group, ...]:
    """Instances with their faces: those whose corners all belong. `owner`: instance per vertex, -1 for none, shape (n,)."""
    corners = owner[surface.faces]
    own = np.where((corners[:, 0] == corners[:, 1]) & (corners[:, 0] == corners[:, 2]), corners[:, 0], -1)
    order = np.argsort(own, kind="stable")
    starts = np.searchsorted(own[order], np.arange(len(named) + 1))
    return tuple(
        Group(source_id, label, vertices, np.sort(order[starts[i] : starts[i + 1]])) for i, (source_id, label, vertices) in enumerate(named)
    )
