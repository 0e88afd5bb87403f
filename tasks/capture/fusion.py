"""A scan mesh from the posed depth and color of a scan's frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from schemas.errors import InputError
from tasks.capture.instances.views import chosen_frames
from tasks.capture.reading import FrameSource
from tasks.geometry.fusion import Volume
from tasks.geometry.meshes import Surface
from tasks.settings import Config, Count, Natural, NonNegative, Positive

_NEAREST_M = 0.1
"""Sensors of depth see nothing nearer."""

Depth = Annotated[float, Field(gt=_NEAREST_M)]


@dataclasses.dataclass(frozen=True)
class FusionConfig(Config):
    """How frames are fused."""

    voxel_m: Positive = 0.02  # The resolution of ScanNet's own meshes in use; finer only resolves sensor noise.
    truncation_voxels: Positive = 4.0  # 8 cm: more than depth noise at 4 m, less than a table top's distance to what is under it.
    max_depth_m: Depth = 5.0  # Noise of structured light grows with the square of depth and exceeds the truncation beyond.
    max_frames: Count = 400  # At walking speed a frame every few centimetres; more only cost time.
    min_weight: NonNegative = 0.5  # Every voxel seen at least once: plain folders may hold a handful of frames with little overlap.
    min_piece_faces: Natural = 200  # Smaller separate pieces are flying pixels along depth edges.


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
