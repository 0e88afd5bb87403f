"""Mass properties of solids: volume, center of mass, inertia."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from tasks.geometry.hulls import Hull


GRAVITY_M_S2 = 9.81
"""Standard gravity, rounded as engines do."""


@dataclasses.dataclass(frozen=True)
class MassProperties:
    """Of a uniform solid: volume [m3], center of mass [m] (3,), inertia about it for unit density [kg m2], shape (3, 3)."""

    volume: float
    center: NDArray[np.float64]
    inertia: NDArray[np.float64]

    def scaled(self, scale: ArrayLike) -> MassProperties:
        """Those of the solid stretched along its axes by positive factors, shape (3,)."""
        s = np.asarray(scale, dtype=np.float64)
        grown = float(np.prod(s))
        second = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia  # integral of x x^T
        stretched = grown * second * np.outer(s, s)
        return MassProperties(grown * self.volume, self.center * s, np.trace(stretched) * np.eye(3) - stretched)


def mass_properties(hulls: Sequence[Hull]) -> MassProperties:
    """Mass properties of the union of hulls, as a uniform solid of density 1 kg/m3, in the hulls' frame."""
    solids = [_manifold(hull) for hull in hulls]
    if len(solids) > 1:
        import manifold3d

        union = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
        mesh = union.to_mesh64()
        vertices, faces = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64)
    else:
        vertices, faces = hulls[0].vertices, hulls[0].faces
    return solid_properties(vertices, faces)


def solid_properties(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> MassProperties:
    """Mass properties of a closed surface with outward triangles, density 1 kg/m3: integrals over signed tetrahedra.

    Shapes (n, 3) and (m, 3).
    """
    origin = vertices.mean(axis=0)  # near the solid: less cancellation than with the frame's origin
    a, b, c = (vertices[faces[:, i]] - origin for i in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    volume = float(volumes.sum())
    center = (volumes[:, None] * (a + b + c)).sum(axis=0) / (4.0 * volume)
    total = a + b + c
    second = np.einsum("n,ni,nj->ij", volumes, total, total)
    for corner in (a, b, c):
        second += np.einsum("n,ni,nj->ij", volumes, corner, corner)
    second = second / 20.0 - volume * np.outer(center, center)
    inertia = np.trace(second) * np.eye(3) - second
    return MassProperties(volume, center + origin, inertia)


def principal_axes(inertia: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Principal moments, shape (3,), and rotation from principal axes to the frame, shape (3, 3), nearest to identity."""
    moments, axes = np.linalg.eigh(0.5 * (inertia + inertia.T))
    best: tuple[float, NDArray[np.float64], NDArray[np.float64]] | None = None
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        turned = axes[:, order] * np.where(np.diag(axes[:, order]) < 0, -1.0, 1.0)
        if np.linalg.det(turned) < 0:  # mirror the axis that says least about its own direction
            weakest = int(np.argmin(np.abs(np.diag(turned))))
            turned[:, weakest] *= -1.0
        score = float(np.trace(turned))
        if best is None or score > best[0] + 1e-9:
            best = (score, moments[list(order)], turned)
    assert best is not None
    # The last bits of axes hang on the processor's kernels; without them the same body has the same axes on all machines.
    return best[1], np.round(best[2], 12) + 0.0


def _manifold(hull: Hull) -> Any:
    """A hull as a solid of manifold3d."""
    import manifold3d

    return manifold3d.Manifold(manifold3d.Mesh64(vert_properties=hull.vertices, tri_verts=hull.faces.astype(np.uint64)))
