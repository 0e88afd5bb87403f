"""How far two surfaces agree: accuracy, completeness and F-score at distances, as in Knapitsch et al., "Tanks and Temples", 2017.

Both surfaces are sampled evenly by area and each sample is held against the other surface itself, not against its samples, so
that a share hangs on how many samples there are by their spread alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.fidelity.box_trees import distances_within
from tasks.geometry.meshes import Surface
from tasks.geometry.proximity import closest_points
from tasks.geometry.triangles import face_crosses, spread_by

Array = NDArray[np.float64]

THRESHOLDS_M = (0.02, 0.05, 0.10)
"""Distances at which surfaces count as the same [m]: the noise of a depth camera, a hand's breadth off, and the right place at all."""

SLACK_M = 1e-6
"""Rounding of coordinates that are kept as float32 [m]: a distance of a threshold is within it."""


@dataclasses.dataclass(frozen=True)
class SurfaceSamples:
    """Points of a surface [m], shape (n, 3), and the area that each stands for [m2], shape (n,)."""

    points: Array
    areas: Array

    @property
    def area(self) -> float:
        """Area of the surface [m2]."""
        return float(self.areas.sum())

    def __getitem__(self, which: NDArray[np.bool_]) -> SurfaceSamples:
        return SurfaceSamples(self.points[which], self.areas[which])


NO_SAMPLES = SurfaceSamples(np.zeros((0, 3)), np.zeros(0))


def sampled(surface: Surface, per_m2: float, least: int, most: int, rng: np.random.Generator) -> SurfaceSamples:
    """Points spread evenly over a surface, by the square metre, at least and at most so many; none of a surface without area."""
    twice = np.linalg.norm(face_crosses(surface.vertices, surface.faces), axis=1)
    area = float(0.5 * twice.sum())
    if not area > 0:
        return NO_SAMPLES
    count = int(np.clip(round(area * per_m2), least, most))
    face, weights = spread_by(twice, count, rng)
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[surface.faces[face]])
    return SurfaceSamples(points, np.full(count, area / count))


def joined(samples: Sequence[SurfaceSamples]) -> SurfaceSamples:
    """The points of several surfaces, in their order."""
    return SurfaceSamples(
        np.concatenate([NO_SAMPLES.points, *(s.points for s in samples)]), np.concatenate([np.zeros(0), *(s.areas for s in samples)])
    )


def distances(points: Array, surface: Surface, reach: float | None = None) -> Array:
    """Distance of each point, shape (n, 3), to the nearest place of a surface [m], shape (n,); infinite where it has no face.

    Those of more than `reach` [m] may be infinite, too: where nobody asks for them, large surfaces are searched in a fraction of the time.
    """
    if not len(surface.faces):
        return np.full(len(points), np.inf)
    if reach is not None:
        return distances_within(surface.vertices, surface.faces, points, reach)
    return closest_points(surface.vertices, surface.faces, points).distance


def share(areas: Array, which: NDArray[np.bool_]) -> float | None:
    """Share of the area for which something holds; None of no area. Shapes (n,)."""
    total = float(areas.sum())
    return min(float(areas[which].sum()) / total, 1.0) if total > 0 else None


def shares_within(areas: Array, distance: Array) -> tuple[float | None, ...]:
    """Share of the area within each of the thresholds. Areas [m2] and distances [m]: shape (n,)."""
    return tuple(share(areas, distance <= threshold + SLACK_M) for threshold in THRESHOLDS_M)


def f_score(accuracy: float | None, completeness: float | None) -> float | None:
    """Harmonic mean of accuracy and completeness, 0 when both are; None when either is missing."""
    if accuracy is None or completeness is None:
        return None
    total = accuracy + completeness
    return 2.0 * accuracy * completeness / total if total > 0 else 0.0
