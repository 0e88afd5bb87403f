"""Where the image of a floor, wall or ceiling lies: from points in the room to places in the image, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.capture import RoomSurface
from tasks.shell import wall_of

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Chart:
    """A rectangle of a plane of the room, world frame [m]: lower left corner, directions to the right and up, shape (3,) each, and size.

    Who looks at it from the room sees it upright and not mirrored. fold: Height in the rectangle at which it turns over the top of an
    interior wall and comes down on its other side, and thickness of that wall; None for all else.
    """

    origin: Array
    u_axis: Array
    v_axis: Array
    width: float
    height: float
    fold: tuple[float, float] | None = None

    @property
    def normal(self) -> Array:
        """Unit vector into the room, of an interior wall to its left, shape (3,)."""
        return np.cross(self.u_axis, self.v_axis)

    def points(self, across: Array, up: Array) -> tuple[Array, Array]:
        """Points of the surface [m] and its normals there, shape (..., 3) each, at distances from the corner [m], shape (...)."""
        if self.fold is None:
            normals = np.broadcast_to(self.normal, (*np.shape(across), 3))
            return self.origin + across[..., None] * self.u_axis + up[..., None] * self.v_axis, normals
        top, thickness = self.fold
        behind = up > top
        level = np.where(behind, 2 * top - up, up)
        points = self.origin + across[..., None] * self.u_axis + level[..., None] * self.v_axis
        normals = np.where(behind[..., None], -self.normal, self.normal)
        return points - np.where(behind, thickness, 0.0)[..., None] * self.normal, normals

    def places(self, points: Array) -> Array:
        """Texture coordinates of points near the surface [m], shape (n, 3): shape (n, 2), 0..1 within, origin at the lower left."""
        away = np.asarray(points, dtype=np.float64) - self.origin
        across, up = away @ self.u_axis, away @ self.v_axis
        if self.fold is not None:
            top, thickness = self.fold
            up = np.where(away @ self.normal < -0.5 * thickness, 2 * top - up, up)
        return np.column_stack([across / self.width, up / self.height])


def chart_of(row: RoomSurface, thickness: float = 0.0) -> Chart:
    """The chart of a row. thickness: of the interior wall that it shows [m], if it is one."""
    fold = (0.5 * row.height_m, thickness) if row.surface.startswith("inner") else None
    return Chart(np.array(row.origin), np.array(row.u_axis), np.array(row.v_axis), row.width_m, row.height_m, fold)


def textured(
    shell: Sequence[tuple[str, trimesh.Trimesh]], surfaces: Sequence[RoomSurface], blobs: Mapping[str, bytes]
) -> list[tuple[str, trimesh.Trimesh]]:
    """The parts of `tasks.shell.room_shell` with the images of those that have one; the others stay as they are.

    Pieces of a wall share its image. What is turned away from the room has the colors of the nearest edge.
    """
    import trimesh

    from tasks.geometry.encoded_images import encoded_image

    rows = {row.surface: row for row in surfaces}
    materials: dict[str, Any] = {}
    painted = []
    for name, part in shell:
        row = rows.get(wall_of(name))
        if row is None:
            painted.append((name, part))
            continue
        if row.surface not in materials:
            image = encoded_image(blobs[row.texture_blob])
            materials[row.surface] = trimesh.visual.material.PBRMaterial(
                name=row.surface, baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0
            )
        vertices = np.asarray(part.vertices, dtype=np.float64)
        uv = chart_of(row, _thickness(row, vertices)).places(vertices)
        if row.surface.startswith(("wall", "inner")):  # what lies beyond the ends is seen by nobody
            uv = np.clip(uv, 0.0, 1.0)
        mesh = trimesh.Trimesh(vertices, np.asarray(part.faces), process=False)
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=materials[row.surface])
        painted.append((name, mesh))
    return painted


def _thickness(row: RoomSurface, vertices: Array) -> float:
    """How far a piece of a wall reaches behind its surface [m]."""
    return float(-((vertices - np.array(row.origin)) @ np.cross(row.u_axis, row.v_axis)).min())
