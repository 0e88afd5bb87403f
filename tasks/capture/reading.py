"""What every reader makes of a scan, before anything is estimated from it. All in the scan's own frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.storeys.levels import Levels
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import transform_points

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class FrameSource:
    """A frame as the scan has it. Pixels are read when asked for.

    intrinsics, depth_intrinsics: fx, fy, cx, cy [px]. depth_size: width, height [px]. depth_scale: units per metre.
    pose: OpenCV camera to scan frame, 4x4 [m], None when unreadable. pose_source: Whose
    the pose is, as rows say it. `color()` gives shape (h, w, 3) uint8,
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
    pose_source: str | None = "file"


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
class StatedRoom:
    """Facts about the room itself that files state, in the scan frame.

    openings: corners of each opening without a door or window [m], shapes (n, 3).
    outline: corners of the floor in order [m], shape (n, 3); None if it has several parts or holes.
    has_height: true if the file states how high its walls are.
    eyes: where the cameras of frames were [m], shape (n, 3).
    """

    openings: tuple[NDArray[np.float64], ...] = ()
    outline: NDArray[np.float64] | None = None
    has_height: bool = False
    eyes: NDArray[np.float64] = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))

    def seen_by(self, frames: Sequence[FrameSource]) -> StatedRoom:
        """The same facts, and where the cameras of frames were."""
        eyes = [frame.pose[:3, 3] for frame in frames if frame.pose is not None]
        return dataclasses.replace(self, eyes=np.array(eyes).reshape(-1, 3))

    def moved(self, pose: NDArray[np.float64]) -> StatedRoom:
        """The same facts in another frame. pose: scan frame to that frame, 4x4 [m]."""
        outline = None if self.outline is None else transform_points(self.outline, pose)
        openings = tuple(transform_points(corners, pose) for corners in self.openings)
        return StatedRoom(openings, outline, self.has_height, transform_points(self.eyes, pose))


@dataclasses.dataclass(frozen=True)
class Reading:
    """A scan as read.

    surface: Scan mesh in the scan frame; None when there are only frames, to be fused.
    parts: The same geometry with its textures, where the scan has any, with the faces of `surface` in their order; of vertices it may have
        more, where textures split them.
    groups: Instances; None when the scan names none, to be found in the geometry.
    alignment: Scan frame to an aligned frame, 4x4 [m], where the scan states one.
    glb: The scan's own file where it is a GLB, which can be kept as it is when nothing moves.
    from_file: The file's own units and axes to the scan frame, 4x4, where the reader changed them.
    materials: Which of its textures each face of `surface` has, shape (m,) int64, where the scan names no instances and has several.
    is_modelled: Of formats that state surfaces or boxes alone: whether it is boxes, which somebody drew; see `ScanFormat`.
    levels: Storeys of scans that state them, heights in the scan frame [m]; None to find them in the geometry.
    stated: Openings and outline of the room, where the file states them, and where its cameras were.
    is_dense: Vertices lie as densely as a depth sensor leaves them, so that they can stand for the surface.
    """

    surface: Surface | None
    parts: tuple[trimesh.Trimesh, ...] = ()
    groups: tuple[Group, ...] | None = None
    frames: tuple[FrameSource, ...] = ()
    alignment: NDArray[np.float64] | None = None
    room_type: str = ""
    license: str | None = None
    is_modelled: bool = False
    is_dense: bool = True
    degradations: tuple[str, ...] = ()
    glb: bytes | None = None
    materials: NDArray[np.int64] | None = None
    from_file: NDArray[np.float64] | None = None
    levels: Levels | None = None
    stated: StatedRoom = StatedRoom()

    @property
    def to_original(self) -> NDArray[np.float64]:
        """Scan frame to the file's own units and axes, 4x4."""
        return np.eye(4) if self.from_file is None else np.asarray(np.linalg.inv(self.from_file), dtype=np.float64)


def groups_of(named: Sequence[tuple[str, str, NDArray[np.int64]]], owner: NDArray[np.int64], surface: Surface) -> tuple[Group, ...]:
    """Instances with their faces: those whose corners all belong. `owner`: instance per vertex, -1 for none, shape (n,)."""
    corners = owner[surface.faces]
    own = np.where((corners[:, 0] == corners[:, 1]) & (corners[:, 0] == corners[:, 2]), corners[:, 0], -1)
    order = np.argsort(own, kind="stable")
    starts = np.searchsorted(own[order], np.arange(len(named) + 1))
    return tuple(
        Group(source_id, label, vertices, np.sort(order[starts[i] : starts[i + 1]])) for i, (source_id, label, vertices) in enumerate(named)
    )


def groups_of_faces(named: Sequence[tuple[str, str]], owner: NDArray[np.int64], surface: Surface) -> tuple[Group, ...]:
    """Instances of a mesh whose faces are labelled; those without a face are left out. A vertex is of the instance that most of its
    faces are of; one that loses all of its vertices to others keeps those of its faces that it has. named: Id and label of each
    instance. owner: Instance per face, -1 for none, shape (m,)."""
    of_vertex = _most_frequent(surface.faces, owner, len(surface.vertices))
    vertices, faces = by_owner(of_vertex, len(named)), by_owner(owner, len(named))
    groups = []
    for (source_id, label), own_vertices, own_faces in zip(named, vertices, faces, strict=True):
        if len(own_faces):
            own = own_vertices if len(own_vertices) else np.unique(surface.faces[own_faces])
            groups.append(Group(source_id, label, own, own_faces))
    return tuple(groups)


def _most_frequent(faces: NDArray[np.int64], owner: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Of each vertex the owner that most of its faces have, the lowest of several; -1 where none has one, shape (count,)."""
    labelled = owner >= 0
    pairs, votes = np.unique(np.stack([faces[labelled].ravel(), np.repeat(owner[labelled], 3)], axis=1), axis=0, return_counts=True)
    result = np.full(count, -1, dtype=np.int64)
    order = np.lexsort((-pairs[:, 1], votes)) if len(pairs) else np.zeros(0, dtype=np.int64)
    result[pairs[order, 0]] = pairs[order, 1]  # the last that is written stays: most votes, then the lowest number
    return result


def by_owner(owner: NDArray[np.int64], count: int) -> list[NDArray[np.int64]]:
    """Sorted indices of the elements of each owner."""
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(count + 1))
    return [order[starts[i] : starts[i + 1]] for i in range(count)]
