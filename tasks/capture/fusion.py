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
from tasks.capture.small_objects.lifting import depth_noise
from tasks.geometry.fusion import Volume
from tasks.geometry.meshes import Surface
from tasks.settings import Config, Count, Natural, NonNegative, Positive

_NEAREST_M = 0.1
"""Sensors of depth see nothing nearer."""

Depth = Annotated[float, Field(gt=_NEAREST_M)]


@dataclasses.dataclass(frozen=True)
class FusionConfig(Config):
    """How frames are fused."""

    voxel_m: Positive = 0.02  # The resolution of ScanNet's own meshes in use; finer only resolves sensor noise, but for what is near.
    finest_voxel_m: Positive = 0.005  # Of what is near: a table seen from 1 m; finer costs eight times the memory for each half.
    voxel_sigmas: Positive = 4.0  # Of depth noise at the median distance to a voxel's side: finer resolves noise.
    voxel_pixels: Positive = 2.5  # Of a pixel's size there to a voxel's side: finer leaves holes.
    truncation_voxels: Positive = 4.0  # 8 cm: more than depth noise at 4 m, less than a table top's distance to what is under it.
    max_depth_m: Depth = 5.0  # Noise of structured light grows with the square of depth and exceeds the truncation beyond.
    max_frames: Count = 400  # At walking speed a frame every few centimetres; more only cost time.
    min_weight: NonNegative = 0.5  # Every voxel seen at least once: plain folders may hold a handful of frames with little overlap.
    min_piece_faces: Natural = 200  # Smaller separate pieces are flying pixels along depth edges.


_LOOKS = 12
"""Frames by which the size of voxels is chosen."""

_MIN_READINGS = 0.01
"""A depth image with fewer usable pixels than this share says nothing."""


def fused_surface(frames: Sequence[FrameSource], config: FusionConfig, name: str) -> tuple[Surface, list[str]]:
    """The fused mesh in the scan frame, and notes on frames that were left out.

    Raises:
        InputError: no frame has both a pose and usable depth.
    """
    chosen = chosen_frames(frames, config.max_frames)
    volume = Volume(voxel_side(frames, chosen, config), config.truncation_voxels)
    notes: list[str] = []
    used, medians = 0, []
    for index in chosen:
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


def voxel_side(frames: Sequence[FrameSource], chosen: Sequence[int], config: FusionConfig) -> float:
    """Side of a voxel [m] that depth noise and pixels of some of the chosen frames can fill: a centimeter on a table, two in a room."""
    sides = []
    for index in chosen[:: max(1, len(chosen) // _LOOKS)]:
        frame = frames[index]
        if frame.depth is None or frame.pose is None:
            continue
        depth = frame.depth()
        usable = depth[(depth > _NEAREST_M) & (depth < config.max_depth_m)]
        if len(usable):
            median = float(np.median(usable))
            noise = config.voxel_sigmas * float(depth_noise(np.array(median)))
            sides.append(max(noise, config.voxel_pixels * median / frame.depth_intrinsics[0]))
    return float(np.clip(np.median(sides), min(config.finest_voxel_m, config.voxel_m), config.voxel_m)) if sides else config.voxel_m
