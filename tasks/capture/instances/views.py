"""Which frames see an instance best, and where in them it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.lenses import scaled_intrinsics
from tasks.capture.reading import FrameSource
from tasks.geometry.meshes import Surface
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.windows import view_window
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

SEARCH_WIDTH = 160
"""Width of the images in which instances are looked for: an object of 5 cm still covers 6 pixels at 2 m."""

_MIN_SEARCH_PIXELS = 6
_MIN_PROBES = 3
"""Fewer pixels or points than these say nothing about how well a frame sees an instance."""

_MIN_DEPTH_M = 0.05


@dataclasses.dataclass(frozen=True)
class Sight:
    """An instance as one frame sees it.

    instance, frame: Indices. pixel_box: x0, y0, x1, y1 in the color image, the ends exclusive.
    mask: Pixels inside pixel_box, shape (y1 - y0, x1 - x0). visible_share, score: See `schemas.capture.Mask`.
    """

    instance: int
    frame: int
    pixel_box: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    visible_share: float
    score: float


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """A frame that may be one of an instance's best, from the small image."""

    score: float
    frame: int
    instance: int
    visible: float
    window: tuple[int, int, int, int]


def depth_tolerance(depth: Array) -> Array:
    """How far a measured depth may be from a point's own before something else is seen there [m]: 2 cm and 1 % of the depth."""
    return 0.02 + 0.01 * depth


def chosen_frames(frames: Sequence[FrameSource], most: int) -> list[int]:
    """Indices of frames with a pose, thinned evenly to at most `most`."""
    usable = [index for index, frame in enumerate(frames) if frame.pose is not None]
    if len(usable) <= most:
        return usable
    return [usable[i] for i in np.linspace(0, len(usable) - 1, most).round().astype(int)]


def best_sights(
    surface: Surface,
    face_instance: NDArray[np.int64],
    probes: Sequence[Array],
    frames: Sequence[FrameSource],
    alignment: Array,
    *,
    most_frames: int,
    per_instance: int,
) -> list[Sight]:
    """The best views of each instance, best first, sorted by instance.

    surface: Scan mesh in the world frame. face_instance: Instance of each face, -1 for none, shape (m,).
    probes: Some points of each instance in the world frame, shape (k, 3); instances without any are not looked for.
    alignment: Scan frame to world frame, 4x4.

    A view's score is the share of the instance's points inside the image that the depth test sees, times the square
    root of its mask's area, times one minus its contact with the image border.
    """
    indices = chosen_frames(frames, most_frames)
    if not indices or not probes:
        return []
    scene = RayScene([surface.to_trimesh()])
    owner = np.concatenate([np.full(len(p), i) for i, p in enumerate(probes)]).astype(np.int64)
    points = np.concatenate([np.asarray(p, dtype=np.float64).reshape(-1, 3) for p in probes])
    candidates: dict[int, list[_Candidate]] = {}
    for index in indices:
        for candidate in _search(scene, face_instance, frames[index], index, alignment, points, owner, len(probes)):
            candidates.setdefault(candidate.instance, []).append(candidate)
    chosen = [c for _, own in sorted(candidates.items()) for c in sorted(own, key=lambda c: (-c.score, c.frame))[:per_instance]]
    by_frame: dict[int, list[_Candidate]] = {}
    for candidate in chosen:
        by_frame.setdefault(candidate.frame, []).append(candidate)
    sights = [s for index, own in sorted(by_frame.items()) for s in _masks(scene, face_instance, frames[index], alignment, own)]
    return sorted(sights, key=lambda s: (s.instance, -s.score, s.frame))


def run_lengths(mask: NDArray[np.bool_]) -> tuple[int, ...]:
    """Lengths of alternating runs of a mask, row by row, the first one outside the mask (0 when it begins inside)."""
    values = np.concatenate([[False], mask.ravel(), [not mask.ravel()[-1]]])
    changes = np.flatnonzero(values[1:] != values[:-1])
    return tuple(int(v) for v in np.diff(np.concatenate([[0], changes])))


def _camera(frame: FrameSource, alignment: Array, size: tuple[int, int] | None = None) -> Camera:
    """The frame's color camera in the world frame, for an image shrunk to `size`."""
    assert frame.pose is not None
    width, height = size or (frame.width, frame.height)
    fx, fy, cx, cy = scaled_intrinsics(frame.intrinsics, (frame.width, frame.height), (width, height))
    return Camera(alignment @ frame.pose, fx, fy, cx, cy, width, height)


def _search(
    scene: RayScene, face_instance: NDArray[np.int64], frame: FrameSource, index: int, alignment: Array, points: Array,
    owner: NDArray[np.int64], count: int,
) -> list[_Candidate]:  # fmt: skip
    """How well one frame sees each instance, from a small image."""
    width = min(SEARCH_WIDTH, frame.width)
    height = max(1, round(frame.height * width / frame.width))
    camera = _camera(frame, alignment, (width, height))
    rendered, face = scene.first_faces(camera.rays())
    label = _labels(face, face_instance)
    inside, seen = _visible(camera, rendered, frame, alignment, points)
    in_image = np.bincount(owner[inside], minlength=count)
    visible = np.bincount(owner[seen], minlength=count)
    factor = frame.width / width
    views = []
    for instance, (size, touching, top, bottom, left, right) in enumerate(_compiled()["_extents"](label, count).tolist()):
        if size < _MIN_SEARCH_PIXELS or visible[instance] < _MIN_PROBES:
            continue
        fraction = float(visible[instance] / in_image[instance])
        score = fraction * np.sqrt(size) * factor * (1 - _contact(touching, size))
        window = (
            max(0, int((left - 1) * factor)), max(0, int((top - 1) * factor)),
            min(frame.width, int(np.ceil((right + 2) * factor))), min(frame.height, int(np.ceil((bottom + 2) * factor))),
        )  # fmt: skip
        if score > 0:
            views.append(_Candidate(score, index, instance, fraction, window))
    return views


def border_contact(mask: NDArray[np.bool_]) -> float:
    """Share of a mask's outline that lies on the image's border, its outline taken as that of a square of its area; 0 to 1."""
    return _contact(int(mask.sum()) - int(mask[1:-1, 1:-1].sum()), int(mask.sum()))


def _contact(touching: int, size: int) -> float:
    """`border_contact` of a mask of so many pixels, and so many at the border."""
    return min(1.0, touching / (4 * np.sqrt(max(size, 1))))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_extents)


def _extents(label: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Of each of `count` instances in an image of their numbers, shape (h, w), -1 for none: how many pixels it has, how many of them lie at
    the border, its first and last row, its first and last column; shape (count, 6)."""
    h, w = label.shape
    extents = np.zeros((count, 6), dtype=np.int64)
    extents[:, 2], extents[:, 4] = h, w
    for y in range(h):
        for x in range(w):
            if label[y, x] >= 0:
                own = extents[label[y, x]]
                own[0] += 1
                own[1] += y == 0 or y == h - 1 or x == 0 or x == w - 1
                own[2], own[3] = min(own[2], y), max(own[3], y)
                own[4], own[5] = min(own[4], x), max(own[5], x)
    return extents


def _visible(
    camera: Camera, rendered: NDArray[np.float32], frame: FrameSource, alignment: Array, points: Array
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which points lie inside the image, and which of them the depth test sees; both of shape (n,).

    The measured depth decides where the frame has one, else the depth of the mesh itself.
    """
    pixel, depth = camera.project(points)
    column, row = (np.round(np.clip(pixel[:, i], -1e6, 1e6)).astype(np.int64) for i in (0, 1))
    inside = (depth > _MIN_DEPTH_M) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    expected = np.zeros(len(points))
    if frame.depth is not None and frame.depth_size is not None and frame.pose is not None:
        measured = frame.depth()
        fx, fy, cx, cy = frame.depth_intrinsics
        sensor = Camera(alignment @ frame.pose, fx, fy, cx, cy, *frame.depth_size)
        pixel, depth = sensor.project(points)
        column, row = (np.round(np.clip(pixel[:, i], -1e6, 1e6)).astype(np.int64) for i in (0, 1))
        readable = inside & (column >= 0) & (column < sensor.width) & (row >= 0) & (row < sensor.height)
        expected[readable] = measured[row[readable], column[readable]]
    else:
        expected[inside] = rendered[row[inside], column[inside]]
    seen = inside & (expected > 0) & (np.abs(expected - depth) <= depth_tolerance(depth))
    return inside, seen


def _masks(
    scene: RayScene, face_instance: NDArray[np.int64], frame: FrameSource, alignment: Array, candidates: Sequence[_Candidate]
) -> list[Sight]:
    """Masks at the resolution of the color image: rays are cast only where the small image saw the instance."""
    camera = _camera(frame, alignment)
    sights = []
    for candidate in candidates:
        x0, y0, x1, y1 = candidate.window
        part = dataclasses.replace(camera, cx=camera.cx - x0, cy=camera.cy - y0, width=x1 - x0, height=y1 - y0)
        mask = _labels(scene.first_faces(part.rays())[1], face_instance) == candidate.instance
        if not mask.any():
            continue
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        box = (x0 + int(columns[0]), y0 + int(rows[0]), x0 + int(columns[-1]) + 1, y0 + int(rows[-1]) + 1)
        mask = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        touching = (
            mask[0].sum() * (box[1] == 0) + mask[-1].sum() * (box[3] == frame.height)
            + mask[:, 0].sum() * (box[0] == 0) + mask[:, -1].sum() * (box[2] == frame.width)
        )  # fmt: skip
        count = int(mask.sum())
        contact = min(1.0, float(touching) / (4 * np.sqrt(count)))
        score = candidate.visible * np.sqrt(count) * (1 - contact)
        sights.append(Sight(candidate.instance, candidate.frame, box, mask, candidate.visible, float(score)))
    return sights


def _labels(face: NDArray[np.int64], face_instance: NDArray[np.int64]) -> NDArray[np.int64]:
    """Instance at each ray's hit, -1 where there is none. face: -1 for none."""
    return np.where(face >= 0, face_instance[face], -1)


def view_of(image: NDArray[np.uint8], pixel_box: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    """The part of an image, shape (height, width, 3), around a box x0, y0, x1, y1 [px], with a margin."""
    x0, y0, x1, y1 = view_window(pixel_box, image.shape[1], image.shape[0])
    return image[y0:y1, x0:x1]


def camera_up(frames: Sequence[FrameSource]) -> Array | None:
    """Mean up direction of the cameras in the scan frame, shape (3,); None without poses, or when they disagree."""
    ups = [-frame.pose[:3, 1] for frame in frames if frame.pose is not None]
    mean = np.mean(ups, axis=0) if ups else np.zeros(3)
    return mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 0.3 else None
