"""Ray casting on Embree: depth, identity and color of a scene from a pinhole camera.

Used by the virtual scanner, by visibility tests and by the report's pictures.
"""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.meshes import material_of, sample_texture, vertex_colors

if TYPE_CHECKING:
    import trimesh


@cache
def open3d() -> Any:
    """The open3d module. It wants libusb from the system; the copy from PyPI is loaded first, so a bare machine works."""
    import libusb_package

    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), ctypes.RTLD_GLOBAL)
    import open3d as module

    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera. `pose`: OpenCV camera to world, 4x4 [m]; focal lengths and center in pixels."""

    pose: NDArray[np.float64]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def intrinsic(self) -> NDArray[np.float64]:
        """The 3x3 intrinsic matrix [px]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @staticmethod
    def with_fov(pose: NDArray[np.float64], width: int, height: int, horizontal_fov_radians: float) -> Camera:
        """A camera with square pixels, its center in the middle of the image."""
        focal = 0.5 * width / np.tan(0.5 * horizontal_fov_radians)
        return Camera(pose, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height)

    def rays(self) -> NDArray[np.float32]:
        """Origin and direction per pixel in the world frame, shape (height, width, 6). Directions have z = 1 in the
        camera frame, so a hit's parameter is its depth [m]."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        local = np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], axis=-1)
        rays = np.empty((self.height, self.width, 6), dtype=np.float32)
        rays[..., :3] = self.pose[:3, 3]
        rays[..., 3:] = local @ self.pose[:3, :3].T
        return rays

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixel coordinates, shape (n, 2), and depth [m], shape (n,), of world points, shape (n, 3)."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return np.stack([self.fx * local[:, 0] / safe + self.cx, self.fy * local[:, 1] / safe + self.cy], axis=1), depth


@dataclasses.dataclass(frozen=True)
class View:
    """What a camera sees, arrays of shape (height, width): depth [m] (inf where nothing is), part index (-1 where
    nothing is), and color, shape (height, width, 3) uint8."""

    depth: NDArray[np.float32]
    part: NDArray[np.int64]
    color: NDArray[np.uint8]
    normal: NDArray[np.float32]


class RayScene:
    """Parts (trimeshes in one frame) that rays can be cast at. `raycaster` is open3d's scene, for distances."""

    def __init__(self, parts: Sequence[trimesh.Trimesh]) -> None:
        o3d = open3d()
        self.parts = list(parts)
        self.raycaster = o3d.t.geometry.RaycastingScene(nthreads=1)
        for part in self.parts:
            self.raycaster.add_triangles(
                o3d.core.Tensor(np.ascontiguousarray(part.vertices, dtype=np.float32)),
                o3d.core.Tensor(np.ascontiguousarray(part.faces, dtype=np.uint32)),
            )
        self._looks: dict[int, tuple[Any, ...]] = {}

    def cast(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Hits of rays, shape (..., 6): `t_hit` (inf: none), `geometry_ids`, `primitive_ids`, `primitive_uvs`, `primitive_normals`."""
        o3d = open3d()
        return {
            name: value.numpy()
            for name, value in self.raycaster.cast_rays(o3d.core.Tensor(np.ascontiguousarray(rays, dtype=np.float32))).items()
        }

    def render(self, camera: Camera, background: tuple[int, int, int] = (255, 255, 255), shade: bool = True) -> View:
        """Depth, part and color from a camera. `shade` darkens faces that turn away from the camera and from above."""
        hits = self.cast(camera.rays())
        depth = hits["t_hit"].astype(np.float32)
        seen = np.isfinite(depth)
        part = np.where(seen, hits["geometry_ids"].astype(np.int64), -1)
        color = np.empty((*depth.shape, 3), dtype=np.uint8)
        color[:] = background
        face, bary = hits["primitive_ids"].astype(np.int64), hits["primitive_uvs"]
        for index in np.flatnonzero(np.bincount(part[seen], minlength=1)):
            where = part == index
            color[where] = self._hit_colors(int(index), face[where], bary[where])
        normal = hits["primitive_normals"].astype(np.float32)
        if shade:
            forward = camera.pose[:3, 2].astype(np.float32)
            facing = np.abs(normal @ forward)
            light = 0.55 + 0.3 * facing + 0.15 * np.abs(normal[..., 2])
            color[seen] = np.clip(color[seen] * light[seen][:, None], 0, 255).astype(np.uint8)
        return View(depth, part, color, normal)

    def _hit_colors(self, index: int, face: NDArray[np.int64], bary: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Color at hits on one part: faces (n,), barycentric coordinates of corners 1 and 2 (n, 2)."""
        part = self.parts[index]
        if index not in self._looks:
            visual: Any = part.visual
            textured = visual.kind == "texture" and visual.uv is not None and len(visual.uv) == len(part.vertices)
            image, factor = material_of(part) if textured else (None, None)
            self._looks[index] = (image, factor, np.asarray(visual.uv) if image is not None else vertex_colors(part))
        image, factor, values = self._looks[index]
        corners = values[np.asarray(part.faces)[face]]
        weights = np.column_stack([1 - bary.sum(axis=1), bary])
        blended = np.einsum("nk,nkd->nd", weights, corners.astype(np.float64))
        return sample_texture(image, blended, factor) if image is not None else np.clip(np.round(blended), 0, 255).astype(np.uint8)
