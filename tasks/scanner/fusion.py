"""Frames into one mesh: truncated signed distances (Curless and Levoy, 1996) by open3d, then specks are swept away."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from schemas.errors import InputError
from tasks.meshes import Surface
from tasks.rendering import open3d
from tasks.scanner.sensor import Shot, depth_camera
from tasks.transforms import inverse

if TYPE_CHECKING:
    from tasks.scanner import ScannerConfig


_FIRST_BLOCKS = 30_000
"""Room for the surfaces of a large room in blocks of 8 voxels; the grid grows by itself."""


def fuse(shots: Iterable[Shot], config: ScannerConfig) -> Surface:
    """The fused surface in the scan frame [m] with vertex colors; components below `speck_faces` triangles are dropped.

    Vertices and faces are sorted: the grid hands its blocks out in an order that changes with the number of threads.
    """
    o3d = open3d()
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (core.float32,) * 3, ((1,), (1,), (3,)), config.voxel_m, 8, _FIRST_BLOCKS, core.Device("CPU:0")
    )
    intrinsic = core.Tensor(depth_camera(np.eye(4), config).intrinsic)
    step = config.color_width // config.depth_width
    reach = (1000.0, config.max_range_m + 0.5, config.truncation_voxels)
    for shot in shots:
        color = np.ascontiguousarray(shot.color[step // 2 :: step, step // 2 :: step], dtype=np.float32)
        images = [o3d.t.geometry.Image(core.Tensor(image)) for image in (shot.depth.astype(np.float32), color)]
        extrinsic = core.Tensor(inverse(shot.pose))
        blocks = grid.compute_unique_block_coordinates(images[0], intrinsic, extrinsic, *reach)
        grid.integrate(blocks, *images, intrinsic, intrinsic, extrinsic, *reach)
    mesh = grid.extract_triangle_mesh(config.least_looks)
    if "positions" not in mesh.vertex or not len(mesh.triangle.indices):
        raise InputError("scene", "surfaces", "no frame saw anything within the sensor's range", "is it in metres?")
    vertices, faces = mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy().astype(np.int64)
    order = np.lexsort(vertices.T)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    turned = place[faces]
    turned = np.take_along_axis(turned, (turned.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return _swept(vertices[order], turned[np.lexsort(turned.T[::-1])], mesh.vertex.colors.numpy()[order], config.speck_faces)


def _swept(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, least: int) -> Surface:
    """Without components of fewer than `least` faces, and without vertices that no face names."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    _, component = connected_components(graph, directed=False)
    of_face = component[faces[:, 0]]
    kept = np.bincount(of_face, minlength=component.max(initial=0) + 1)[of_face] >= least
    faces = faces[kept]
    # a sliver whose corners coincide would be refused by readers that check
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    used, dense = np.unique(faces, return_inverse=True)
    painted = np.clip(np.round(colors[used]), 0, 255).astype(np.uint8)
    return Surface(vertices[used].astype(np.float64), dense.reshape(-1, 3).astype(np.int64), painted)
