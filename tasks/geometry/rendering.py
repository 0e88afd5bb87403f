"""Ray casting on Embree: depth, identity and color of a scene from a pinhole camera.

Used by the virtual scanner, by visibility tests and by the report's pictures.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import material_of, sample_texture, vertex_colors
from tasks.kernels import Kernels, compile_kernels

if TYPE_CHECKING:
    import trimesh


NOTHING = 0xFFFFFFFF
"""Part and face of a ray that hits nothing."""

TOUCH_M = 0.003
"""What lies so little behind what a ray meets is met by it: rays are single precision, and sheets have that thickness."""


Window = tuple[slice, slice]
"""Rows and columns of a picture."""

WHOLE: Window = (slice(None), slice(None))
"""The window that is the whole picture."""


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

    def rays(self, window: Window = WHOLE) -> NDArray[np.float32]:
        """Origin and direction per pixel of a window in the world frame, shape (rows, columns, 6). Directions have z = 1 in the
        camera frame, so a hit's parameter is its depth [m]."""
        rows, columns = np.arange(self.height, dtype=np.float64)[window[0]], np.arange(self.width, dtype=np.float64)[window[1]]
        local = np.ones((len(rows), len(columns), 3))
        local[..., 0], local[..., 1] = (columns - self.cx) / self.fx, ((rows - self.cy) / self.fy)[:, None]
        rays = np.empty((len(rows), len(columns), 6), dtype=np.float32)
        rays[..., :3] = self.pose[:3, 3]
        rays[..., 3:] = local @ self.pose[:3, :3].T
        return rays

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixel coordinates, shape (n, 2), and depth [m], shape (n,), of world points, shape (n, 3)."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return np.stack([self.fx * local[:, 0] / safe + self.cx, self.fy * local[:, 1] / safe + self.cy], axis=1), depth

    def window(self, points: NDArray[np.float64]) -> Window:
        """Pixels that may show what lies within the convex hull of points, shape (n, 3): all of them where one is not before the camera."""
        pixel, depth = self.project(points)
        if not len(points) or depth.min() <= TOUCH_M:
            return WHOLE
        low, high = np.floor(pixel.min(axis=0)) - 1, np.ceil(pixel.max(axis=0)) + 2  # rays are single precision
        (left, top), (right, bottom) = np.clip([low, high], 0, [self.width, self.height]).astype(np.int64).tolist()
        return slice(top, max(bottom, top)), slice(left, max(right, left))


@dataclasses.dataclass(frozen=True)
class Rendering:
    """What a camera sees, arrays of shape (height, width): depth [m] (inf where nothing is), part index (-1 where
    nothing is), and color, shape (height, width, 3) uint8."""

    depth: NDArray[np.float32]
    part: NDArray[np.int64]
    color: NDArray[np.uint8]
    normal: NDArray[np.float32]

    def framed(self, height: int, width: int, window: Window, background: tuple[int, int, int]) -> Rendering:
        """What is seen in a window as a whole picture, with nothing around it."""
        depth, part = np.full((height, width), np.inf, dtype=np.float32), np.full((height, width), -1, dtype=np.int64)
        color, normal = np.empty((height, width, 3), dtype=np.uint8), np.zeros((height, width, 3), dtype=np.float32)
        color[:] = background
        depth[window], part[window], color[window], normal[window] = self.depth, self.part, self.color, self.normal
        return Rendering(depth, part, color, normal)


class RayScene:
    """Parts (trimeshes in one frame) that rays can be cast at. Both sides of a face are hit; casting takes one thread."""

    def __init__(self, parts: Sequence[trimesh.Trimesh]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.parts = list(parts)
        self._looks: dict[int, tuple[Any, ...]] = {}
        counts = np.array([len(part.faces) for part in self.parts], dtype=np.int64)
        self._part_of = np.repeat(np.arange(len(self.parts)), counts).astype(np.uint32)
        self._first = np.cumsum(counts) - counts
        self._scene = None
        if not counts.sum():
            return
        corners = np.cumsum([0, *(len(part.vertices) for part in self.parts)])
        vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float32).reshape(-1, 3) for part in self.parts])
        faces = np.concatenate(
            [np.asarray(part.faces, dtype=np.int64).reshape(-1, 3) + at for part, at in zip(self.parts, corners[:-1], strict=True)]
        )
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int32))

    def cast(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """The first hit of rays (origin and direction of any length), shape (..., 6).

        Returns:
            `t_hit`: in lengths of the direction, inf where there is none, shape (...). `geometry_ids`: part, and
            `primitive_ids`: face of the part, uint32, `NOTHING` where there is none. `primitive_uvs`: barycentric
            coordinates of the face's corners 1 and 2, shape (..., 2). `primitive_normals`: unit, by the face's winding,
            shape (..., 3); 0 where there is none.
        """
        shape, n = rays.shape[:-1], math.prod(rays.shape[:-1])
        hits: dict[str, NDArray[Any]] = {
            "t_hit": np.full(n, np.inf, dtype=np.float32),
            "geometry_ids": np.full(n, NOTHING, dtype=np.uint32),
            "primitive_ids": np.full(n, NOTHING, dtype=np.uint32),
            "primitive_uvs": np.zeros((n, 2), dtype=np.float32),
            "primitive_normals": np.zeros((n, 3), dtype=np.float32),
        }
        answer = self._answer(rays)
        if answer is not None:
            face = np.asarray(answer["primID"], dtype=np.int64)
            hit = np.flatnonzero(face >= 0)
            face = face[hit]
            part = self._part_of[face]
            normal = np.asarray(answer["Ng"], dtype=np.float32)[hit]
            length = np.sqrt(np.einsum("nd,nd->n", normal, normal))[:, None]
            hits["t_hit"][hit] = answer["tfar"][hit]
            hits["geometry_ids"][hit] = part
            hits["primitive_ids"][hit] = face - self._first[part]
            hits["primitive_uvs"][hit] = np.column_stack([answer["u"][hit], answer["v"][hit]])
            hits["primitive_normals"][hit] = normal / np.where(length > 0, length, 1)
        return {name: values.reshape(*shape, *values.shape[1:]) for name, values in hits.items()}

    def first_faces(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """How far rays get, as `t_hit` of `cast`, and the face of the scene that they meet, counted over all parts, -1 for none, shapes
        (...): for who asks for nothing else."""
        answer = self._answer(rays)
        if answer is None:
            return np.full(rays.shape[:-1], np.inf, dtype=np.float32), np.full(rays.shape[:-1], -1, dtype=np.int64)
        face = np.asarray(answer["primID"], dtype=np.int64)
        far = np.where(face >= 0, answer["tfar"], np.float32(np.inf))
        return far.reshape(rays.shape[:-1]), face.reshape(rays.shape[:-1])

    def _answer(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]] | None:
        """What Embree says of each ray, shape (n,) or (n, 3); None without faces or rays."""
        flat = np.asarray(rays, dtype=np.float32).reshape(-1, 6)
        if self._scene is None or not len(flat):
            return None
        answer: dict[str, NDArray[Any]] = self._scene.run(np.ascontiguousarray(flat[:, :3]), np.ascontiguousarray(flat[:, 3:]), output=True)
        return answer

    def render(
        self,
        camera: Camera,
        background: tuple[int, int, int] = (255, 255, 255),
        shade: bool = True,
        rays: NDArray[np.float32] | None = None,
        window: Window = WHOLE,
    ) -> Rendering:
        """Depth, part and color from a camera. `shade` darkens faces that turn away from the camera and from above.

        `rays` are the camera's, where they are known already. Outside of a window nothing is seen.
        """
        hits = self.cast(camera.rays(window) if rays is None else rays[window])
        seen = np.isfinite(hits["t_hit"])
        color, normal = self.colors(hits, background), hits["primitive_normals"]
        if shade:
            met, forward = normal[seen], camera.pose[:3, 2].astype(np.float32)
            light = 0.55 + 0.3 * np.abs(met @ forward) + 0.15 * np.abs(met[:, 2])
            color[seen] = np.clip(color[seen] * light[:, None], 0, 255).astype(np.uint8)
        drawn = Rendering(hits["t_hit"], np.where(seen, hits["geometry_ids"].astype(np.int64), -1), color, normal)
        return drawn if window == WHOLE else drawn.framed(camera.height, camera.width, window, background)

    def colors(self, hits: dict[str, NDArray[Any]], background: tuple[int, int, int] = (255, 255, 255)) -> NDArray[np.uint8]:
        """Color of the surface at hits of `cast`, shape (..., 3); the background where there is none."""
        seen = np.isfinite(hits["t_hit"])
        color = np.empty((*seen.shape, 3), dtype=np.uint8)
        color[:] = background
        part, face = hits["geometry_ids"].reshape(-1), hits["primitive_ids"].reshape(-1)
        bary, painted = hits["primitive_uvs"].reshape(-1, 2), color.reshape(-1, 3)
        hit = np.flatnonzero(seen)
        if len(self.parts) > 1:
            kind = np.uint16 if len(self.parts) < 2**16 else np.uint32  # short numbers are sorted in one pass
            hit = hit[np.argsort(part[hit].astype(kind), kind="stable")]  # pixels part by part
        ends = np.cumsum(np.bincount(part[hit].astype(np.int64), minlength=1))
        for index, (start, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
            if end > start:
                where = hit[start:end]
                painted[where] = self._hit_colors(index, face[where].astype(np.int64), bary[where])
        return color

    def _hit_colors(self, index: int, face: NDArray[np.int64], bary: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Color at hits on one part: faces (n,), barycentric coordinates of corners 1 and 2 (n, 2)."""
        part = self.parts[index]
        if index not in self._looks:
            visual: Any = part.visual
            textured = visual.kind == "texture" and visual.uv is not None and len(visual.uv) == len(part.vertices)
            image, factor = material_of(part) if textured else (None, None)
            colors = np.asarray(visual.uv) if image is not None else np.ascontiguousarray(vertex_colors(part))
            self._looks[index] = (image, factor, colors)
        image, factor, values = self._looks[index]
        corners = np.asarray(part.faces, dtype=np.int64)[face]
        if image is None:
            return np.asarray(_compiled()["_blended"](values, corners, bary))
        weights = np.column_stack([1 - bary.sum(axis=1), bary])
        return sample_texture(image, np.einsum("nk,nkd->nd", weights, values[corners].astype(np.float64)), factor)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_blended)


def _blended(colors: NDArray[np.uint8], corners: NDArray[np.int64], bary: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colors of vertices, shape (n, 3), at places in triangles, whose corners have shape (m, 3)."""
    blended = np.empty((len(corners), 3), dtype=np.uint8)
    for i in range(len(corners)):
        second, third = bary[i, 0], bary[i, 1]
        first = np.float32(1.0) - (second + third)
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        for k in range(3):
            value = np.float64(first) * colors[a, k] + np.float64(second) * colors[b, k] + np.float64(third) * colors[c, k]
            blended[i, k] = np.uint8(min(max(np.rint(value), 0.0), 255.0))
    return blended


def in_picture(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points lie in a camera's picture, nothing between, shape (n,)."""
    pixel, depth = camera.project(points)
    u, v = pixel[:, 0], pixel[:, 1]
    return (depth > TOUCH_M) & (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)


def reach(camera: Camera, points: NDArray[np.float64], scene: RayScene) -> NDArray[np.float64]:
    """How far the rays from a camera through points get before they meet something [m], infinite where they do not, shape (n,)."""
    eye = camera.pose[:3, 3]
    way = points - eye
    length = np.linalg.norm(way, axis=1)
    rays = np.empty((len(points), 6), dtype=np.float32)
    rays[:, :3] = eye
    rays[:, 3:] = way / np.maximum(length, 1e-9)[:, None]
    return scene.cast(rays)["t_hit"].astype(np.float64)
