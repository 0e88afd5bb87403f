"""Pictures of triangles, many a second: a rasterizer in machine code that draws clusters of triangles from near to far.

A pixel shows what a ray through its middle would meet first, from the near plane on. Faces that have a solid behind them are not drawn from
behind, unless the camera is inside of a solid or the near plane cuts one open: rays would meet its inside there.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.simulation.rasterizer import drawing
from tasks.simulation.rasterizer.clusters import cluster
from tasks.simulation.rasterizer.painting import looks_of

if TYPE_CHECKING:
    from tasks.simulation.soups import Soup

NEAR_M = drawing.NEAR_M
"""Nothing nearer to the plane of the camera is drawn [m]."""


@dataclasses.dataclass(frozen=True)
class Pictures:
    """What cameras see, one behind another: b pictures of h by w pixels.

    rgb: Shape (b, h, w, 3), uint8; black where nothing is. depth: Along the axis of the camera [m], 0 where nothing is, shape (b, h, w).
    part: Part of the soup, -1 where nothing is, shape (b, h, w).
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    part: NDArray[np.int32]

    @staticmethod
    def empty(count: int, width: int, height: int) -> Pictures:
        """Room for so many pictures."""
        size = (count, height, width)
        return Pictures(np.empty((*size, 3), np.uint8), np.empty(size, np.float32), np.empty(size, np.int32))


class Rasterizer:
    """A soup of triangles that cameras look at. Any number of threads may ask at once: drawing lets go of the interpreter."""

    def __init__(self, soup: Soup) -> None:
        self._clusters, order = cluster(soup)
        self._looks = looks_of(soup, order)
        self._plain = self._looks._replace(texels=self._looks.texels[:0])

    def render(
        self, poses: ArrayLike, width: int, height: int, hfov_radians: float, out: Pictures | None = None, *, textured: bool = True
    ) -> Pictures:
        """What cameras with square pixels and their center in the middle of the picture see.

        Args:
            poses: OpenCV camera to world [m], shape (b, 4, 4).
            width: Of a picture [px].
            height: Of a picture [px].
            hfov_radians: Angle that a picture spans from left to right, below pi.
            out: Pictures to draw into; new ones where there are none.
            textured: Whether faces have their textures, or each one color: where all have some, that takes a fifth longer at 64 px, and
                two thirds at 256.
        """
        cameras = np.ascontiguousarray(np.asarray(poses, dtype=np.float64).reshape(-1, 4, 4))
        pictures = out if out is not None else Pictures.empty(len(cameras), width, height)
        if pictures.depth.shape != (len(cameras), height, width):
            raise ValueError(f"out: has room for {pictures.depth.shape}, {(len(cameras), height, width)} is asked for")
        focal = 0.5 * width / np.tan(0.5 * hfov_radians)
        looks = self._looks if textured else self._plain
        drawing.compiled()["render"](cameras, focal, self._clusters, looks, pictures.rgb, pictures.depth, pictures.part)
        return pictures
