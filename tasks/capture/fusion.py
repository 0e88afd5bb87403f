"""A scan mesh from posed depth and color: truncated signed distances in a sparse grid (Curless and Levoy, SIGGRAPH 1996)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.reading import FrameSource
from tasks.capture.views import chosen_frames
from tasks.meshes import Surface
from tasks.rendering import open3d


@dataclasses.dataclass(frozen=True)
class FusionConfig:
    """How frames are fused."""

    voxel_m: float = 0.02  # The resolution of ScanNet's own meshes in use; finer only resolves sensor noise.
    truncation_voxels: float = 4.0  # 8 cm: more than depth noise at 4 m, less than a table top's distance to what is under it.
    max_depth_m: float = 5.0  # Noise of structured light grows with the square of depth and exceeds the truncation beyond.
    max_frames: int = 400  # At walking speed a frame every few centimetres; more only cost time.
    min_weight: float = 0.5  # Every voxel seen at least once: plain folders may hold a handful of frames with little overlap.
    min_piece_faces: int = 200  # Smaller separate pieces are flying pixels along depth edges.


_FIRST_BLOCKS = 20_000
"""Room for the surfaces of a usual room; the grid grows by itself."""

_MIN_READINGS = 0.01
"""A depth image with fewer usable pixels than this share says nothing."""


def fused_surface(frames: Sequence[FrameSource], config: FusionConfig, name: str) -> tuple[Surface, list[str]]:
    """The fused mesh in the scan frame, and notes on frames that were left out.

    Raises:
        InputError: no frame has both a pose and usable depth.
    """
    o3d = open3d()
    volume = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"), attr_dtypes=(o3d.core.float32, o3d.core.uint16, o3d.core.uint16),
        attr_channels=((1,), (1,), (3,)), voxel_size=config.voxel_m, block_resolution=8, block_count=_FIRST_BLOCKS,
    )  # fmt: skip
    notes: list[str] = []
    used, medians = 0, []
    for index in chosen_frames(frames, config.max_frames):
        frame = frames[index]
        if frame.depth is None or frame.depth_size is None or frame.pose is None:
            continue
        depth = frame.depth()
        usable = (depth > 0.1) & (depth < config.max_depth_m)
        if depth.any():
            medians.append(float(np.median(depth[depth > 0])))
        if usable.mean() < _MIN_READINGS:
            notes.append(f"frame {frame.frame_id}: hardly any depth between 0.1 and {config.max_depth_m:g} m, not fused")
            continue
        # Depth and color become float images: the volume takes 16-bit depth only together with a whole-number scale.
        depth_image = o3d.t.geometry.Image(np.ascontiguousarray(np.where(usable, depth, 0), dtype=np.float32))
        color_image = o3d.t.geometry.Image(np.ascontiguousarray(frame.color()).astype(np.float32))
        cameras = [o3d.core.Tensor(_matrix(values)) for values in (frame.depth_intrinsics, frame.intrinsics)]
        pose = o3d.core.Tensor(np.linalg.inv(frame.pose))
        reach = (1.0, config.max_depth_m, config.truncation_voxels)
        blocks = volume.compute_unique_block_coordinates(depth_image, cameras[0], pose, *reach)
        volume.integrate(blocks, depth_image, color_image, *cameras, pose, *reach)
        used += 1
    if not used:
        if medians:
            problem = f"depth is {np.median(medians):.3g} m in the middle of a frame"
            raise InputError(name, "depth_scale", problem, "state the units per metre in intrinsics.json")
        raise InputError(name, "frames", "none has both a pose and depth", "add poses, or a mesh of the scan")
    surface = _extracted(volume, config)
    if not len(surface.faces):
        raise InputError(name, "depth", "no surface comes of the frames", "check depth scale, intrinsics and poses")
    return surface, notes


def _extracted(volume: object, config: FusionConfig) -> Surface:
    """The zero level as triangles, in an order of its own, without small separate pieces."""
    mesh = volume.extract_triangle_mesh(weight_threshold=config.min_weight)  # type: ignore[attr-defined]
    if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.uint8))
    vertices, faces = mesh.vertex.positions.numpy().astype(np.float64), mesh.triangle.indices.numpy().astype(np.int64)
    colors = np.clip(np.round(mesh.vertex.colors.numpy()), 0, 255).astype(np.uint8)
    # The volume hands out its blocks in the order of a hash table: sorted, the mesh is the same everywhere.
    order = np.lexsort(vertices.T[::-1])
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return without_small_pieces(Surface(vertices[order], _sorted_faces(place[faces]), colors[order]), config.min_piece_faces)


def _sorted_faces(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces turned so that the smallest index comes first (same winding), sorted."""
    first = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def without_small_pieces(surface: Surface, faces: int) -> Surface:
    """A surface without connected pieces of fewer than so many faces, and without vertices that no face uses."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(surface.vertices)
    edges = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, piece = connected_components(graph, directed=False)
    of_face = piece[surface.faces[:, 0]]
    keep = np.bincount(of_face, minlength=piece.max(initial=0) + 1)[of_face] >= faces
    used, dense = np.unique(surface.faces[keep], return_inverse=True)
    return Surface(surface.vertices[used], dense.reshape(-1, 3), surface.colors[used])


def _matrix(intrinsics: tuple[float, float, float, float]) -> NDArray[np.float64]:
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)
