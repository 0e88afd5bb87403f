"""A scan as it is read: what its files say, what its labels mean, and which way is up in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.formats import format_of, left_out
from tasks.capture.labels import FLOOR, WALL, Label, LabelMap
from tasks.capture.premises import REMEDY
from tasks.capture.reading import FrameSource, Group, Reading
from tasks.capture.rooms.alignment import Alignment, align
from tasks.capture.scan import Scan
from tasks.capture.segmentation.gravity import scan_level
from tasks.capture.segmentation.votes import VoteConfig, spacing_of
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import face_areas

_ONE_FLOOR_M = 1.8
"""Floors of one storey lie within so much."""

_LEVEL_M, _LEVEL_SHARE = 0.5, 0.25
"""What lies within so much is a level, and has at least so much of the largest one's area: less is stray, or called a floor by mistake."""


def read_scan(scan: Scan) -> Reading:
    """What the reader of its format makes of a scan; links that were left out are a degradation, or a part of its error.

    Raises:
        InputError: a file of the scan cannot be used; names the file and the field.
    """
    format = format_of(scan)
    note = left_out(scan)
    try:
        reading = format.read(scan)
    except InputError as error:
        if not note:
            raise
        raise InputError(error.file, error.field, f"{error.problem} ({note})", f"{error.remedy}; {REMEDY}") from error
    return dataclasses.replace(reading, degradations=(*reading.degradations, note)) if note else reading


def read_with_meanings(scan: Scan, labels: LabelMap) -> tuple[Reading, list[Label], bool]:
    """What the files of a scan say, what its labels mean, and whether somebody drew it: a drawing whose nodes name no objects is a mesh."""
    format, reading = format_of(scan), read_scan(scan)
    meanings = [_meaning(group, labels, format.is_modelled) for group in reading.groups or ()]
    bare = format.bare(scan, reading, meanings) if format.bare is not None else None
    return (reading, meanings, format.is_modelled or reading.is_modelled) if bare is None else (bare, [], False)


def _meaning(group: Group, labels: LabelMap, is_node: bool) -> Label:
    return labels.of_node(group.raw_label, group.source_id) if is_node else labels[group.raw_label]


def aligned(reading: Reading, surface: Surface, meanings: Sequence[Label], votes: VoteConfig, is_authored: bool) -> Alignment:
    """How a scan is brought to the world frame. surface: Its mesh, or what was fused from its frames. meanings: Of its instances."""
    masks = {}
    for nyu40 in (FLOOR, WALL):
        mask = np.zeros(len(surface.faces), dtype=bool)
        for group, label in zip(reading.groups or (), meanings, strict=True):
            if label.nyu40_id == nyu40:
                mask[group.faces] = True
        masks[nyu40] = mask if mask.any() else None
    floor = masks[FLOOR]
    if floor is not None:  # of several storeys the lowest: no plane goes through the floors of all
        height = surface.vertices[surface.faces, 2].mean(axis=1)
        floor &= height < _lowest_floor(height[floor], face_areas(surface.vertices, surface.faces[floor])) + _ONE_FLOOR_M
    # A scan with a mesh of its own has its z axis up already; fused frames have only what they see to tell.
    level = scan_level(reading.frames, spacing_of(surface), votes.frame) if reading.surface is None else None
    return align(surface, floor_faces=masks[FLOOR], wall_faces=masks[WALL], stated=reading.alignment, level=level, is_authored=is_authored)


MIN_CAMERA_M, MAX_CAMERA_M = -0.3, 3.0
"""Heights over the floor of the lowest tenth of cameras: people hold them below 3 m, and scans of floors are off by a few cm."""


def height_notes(frames: Sequence[FrameSource], pose: NDArray[np.float64]) -> list[str]:
    """A line if the cameras of a scan are not where a person holds them over its floor. pose: scan frame to world frame, 4x4 [m]."""
    heights = [float((pose @ frame.pose)[2, 3]) for frame in frames if frame.pose is not None]
    lowest = float(np.quantile(heights, 0.1)) if heights else 0.0
    if MIN_CAMERA_M <= lowest <= MAX_CAMERA_M:
        return []
    side = f"{lowest:.1f} m above" if lowest > 0 else f"{-lowest:.1f} m below"
    line = f"cameras are {side} the floor, which no person holds so: the floor, the poses or the depth unit is wrong"
    return [f"{line}; check depth_scale, the unit of the poses and pose_format"]


def _lowest_floor(height: NDArray[np.float64], areas: NDArray[np.float64]) -> float:
    """Where the lowest level begins that has a real share of the floor [m]. height: Of its faces [m], shape (m,). areas: Of these [m2]."""
    order = np.argsort(height, kind="stable")
    ordered, below = height[order], np.append(0.0, np.cumsum(areas[order]))
    ends = np.searchsorted(ordered, ordered + _LEVEL_M, side="right")
    level = below[ends] - below[:-1]  # area from each face up
    return float(ordered[np.argmax(level >= _LEVEL_SHARE * level.max())])
