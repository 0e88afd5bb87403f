"""Readings of a recording that exporters confuse: direction and axes of poses, order of quaternions, depth unit, focal length."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from tasks.capture.consistency.reprojection import Hypothesis
from tasks.capture.files.trajectory import REAL_FIRST, REAL_LAST, as_described, as_written, convention_of, quaternion_order
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import inverse, pose_from_quaternion_wxyz, quaternion_wxyz, quaternion_xyzw

Array = NDArray[np.float64]

USUAL = "camera-to-world"
"""Words for poses of an OpenCV camera to the scan frame, which nothing needs to state."""

CONVENTIONS = (USUAL, "world-to-camera", "OpenGL", "OpenGL world-to-camera", "left-handed", "left-handed world-to-camera")
"""Meanings of a pose, in the words of `trajectory`."""

UNITS = {1.0: "meters", 100.0: "centimeters", 1000.0: "millimeters", 4000.0: "1/4000 m", 5000.0: "1/5000 m", 10000.0: "1/10000 m"}
"""Depth units per meter that sensors, benchmarks and exporters write."""

_SAME = 0.05
"""Two factors are one within this."""


def pose_hypotheses(described: str, has_quaternions: bool, from_file: Array | None) -> list[Hypothesis]:
    """Other readings of poses than the one that was taken.

    Args:
        described: words of the scan or its format about its poses; without any they are read as `USUAL`.
        has_quaternions: the file states quaternions, whose order may be another.
        from_file: axes of the file to the scan frame, 4x4; None for the same axes.
    """
    to_scan = np.eye(4) if from_file is None else from_file
    is_first = quaternion_order(described) == REAL_FIRST
    hypotheses = []
    for order in ("", REAL_LAST if is_first else REAL_FIRST) if has_quaternions else ("",):
        for meaning in CONVENTIONS:
            if order or convention_of(meaning) != convention_of(described):
                words = order if order and meaning == USUAL else f"{order} {meaning}".strip()
                hypotheses.append(Hypothesis(words, partial(_reread, to_scan, described, order, meaning)))
    return hypotheses


def _reread(to_scan: Array, described: str, order: str, meaning: str, pose: Array) -> Array:
    """A pose in the scan frame under another description. order: other order of its quaternion, empty for the same."""
    own = as_written(inverse(to_scan) @ pose, described)
    if order == REAL_FIRST:
        own = pose_from_quaternion_wxyz(quaternion_xyzw(own), own[:3, 3])
    elif order == REAL_LAST:
        w, x, y, z = quaternion_wxyz(own)
        own = pose_from_quaternion_wxyz((z, w, x, y), own[:3, 3])
    return to_scan @ as_described(own, meaning)


MIN_MOTION_M = 0.05
"""Smallest extent of camera positions [m] in another unit: without motion, equal frames agree under any unit."""


def unit_hypotheses(scale: float, max_factor: float, extent_m: float) -> list[Hypothesis]:
    """Other depth units than `scale` units per meter, and positions of poses in other units than meters.

    max_factor: largest factor that leaves depth possible; beyond it, positions are in a smaller unit.
    extent_m: extent of the stated positions [m]; in a smaller unit, cameras must still have moved.
    """
    factors = [(scale / units, f"{units:g} units per meter ({name})") for units, name in UNITS.items()]
    factors = [(factor, words) for factor, words in factors if abs(factor - 1) > _SAME and factor < max_factor]
    hypotheses = [Hypothesis(words, depth_factor=factor) for factor, words in factors]
    smaller = [(factor, name) for factor, name in ((100.0, "centimeters"), (1000.0, "millimeters")) if factor > max_factor]
    smaller = [(factor, name) for factor, name in smaller if extent_m / factor >= MIN_MOTION_M]
    return hypotheses + [Hypothesis(f"positions of poses in {name}", depth_factor=factor) for factor, name in smaller]


def lens_hypotheses(frame: FrameSource) -> list[Hypothesis]:
    """Focal lengths of other image sizes than that of a frame's depth."""
    assert frame.depth_size is not None
    ratio = frame.width / frame.depth_size[0]
    factors = [factor for factor in (0.5, 2.0, ratio, 1 / ratio) if abs(factor - 1) > _SAME]
    distinct = [factor for index, factor in enumerate(factors) if all(abs(factor / other - 1) > _SAME for other in factors[:index])]
    fx = frame.depth_intrinsics[0]
    return [Hypothesis(f"fx {fx * factor:.1f}", focal_factor=factor) for factor in distinct]
