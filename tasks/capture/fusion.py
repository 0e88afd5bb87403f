"""A scan mesh from the posed depth and color of a scan's frames."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from schemas.errors import InputError
from tasks.capture.reading import FrameSource
from tasks.capture.views import chosen_frames
from tasks.fusion import Volume
from tasks.meshes import Surface


@dataclasses.dataclass(frozen=True)
class FusionConfig:
    """How frames are fused."""

    voxel_m: float = 0.02  # The resolution of ScanNet's own meshes in use; finer only resolves sensor noise.
    truncation_voxels: float = 4.0  # 8 cm: more than depth noise at 4 m, less than a table top's distance to what is under it.
    max_depth_m: float = 5.0  # Noise of structured light grows with the square of depth and exceeds the truncation beyond.
    max_frames: int = 400  # At walking speed a frame every few centimetres; more only cost time.
    min_weight: float = 0.5  # Every voxel seen at least once: plain folders may hold a handful of frames with little overlap.
    min_piece_faces: int = 200  # Smaller separate pieces are flying pixels along depth edges.

    def __post_init__(self) -> None:
        for name in ("voxel_m", "truncation_voxels"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0, is {getattr(self, name):g}")
        if not _NEAREST_M < self.max_depth_m < math.inf:
            raise ValueError(f"max_depth_m: must be above {_NEAREST_M:g}, is {self.max_depth_m:g}")
        if self.max_frames < 1:
            raise ValueError(f"max_frames: must be at least 1, is {self.max_frames}")
        if not 0 <= self.min_weight < math.inf:
            raise ValueError(f"min_weight: must be at least 0, is {self.min_weight:g}")
        if self.min_piece_faces < 0:
            raise ValueError(f"min_piece_faces: must be at least 0, is {self.min_piece_faces}")


_NEAREST_M = 0.1
"""Sensors of depth see nothing nearer."""

_MIN_READINGS = 0.01
"""A depth image with fewer usable pixels than this share says nothing."""


def fused_surface(frames: Sequence[FrameSource], config: FusionConfig, name: str) -> tuple[Surface, list[str]]:
    """The fused mesh in the scan frame, and notes on frames that were left out.

    Raises:
        InputError: no frame has both a pose and usable depth.
    """
    volume = Volume(config.voxel_m, config.truncation_voxels)
    notes: list[str] = []
    used, medians = 0, []
    for index in chosen_frames(frames, config.max_frames):
        frame = frames[index]
        if frame.depth is None or frame.depth_size is None or frame.pose is None:
            continue
        depth = frame.depth()
        usable = (depth > _NEAREST_M) & (depth < config.max_depth_m)
        if depth.any():
            medians.append(float(np.median(depth[depth > 0])))
        if usable.mean() < _MIN_READINGS:
            notes.append(f"frame {frame.frame_id}: hardly any depth between {_NEAREST_M:g} and {config.max_depth_m:g} m, not fused")
            continue
        volume.integrate(
            np.where(usable, depth, 0), frame.color(), frame.depth_intrinsics, frame.intrinsics, frame.pose, config.max_depth_m
        )
        used += 1
    if not used:
        if medians:
            problem = f"depth is {np.median(medians):.3g} m in the middle of a frame"
            raise InputError(name, "depth_scale", problem, "state the units per metre in intrinsics.json")
        raise InputError(name, "frames", "none has both a pose and depth", "add poses, or a mesh of the scan")
    surface = volume.surface(config.min_weight, config.min_piece_faces)
    if not len(surface.faces):
        raise InputError(name, "depth", "no surface comes of the frames", "check depth scale, intrinsics and poses")
    return surface, notes
