"""A room at a slant from above, ceiling and near walls cut away, and in it an agent on its way to a target.

The room is photographed once. What is drawn on the floor is found by where the ray of each pixel meets it, so it lies in the room's
perspective; what furniture hides of it, and of the agent, is faint instead of gone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.films.robots import robot
from tasks.films.rooms import FilmedRoom
from tasks.films.walks import FilmedBody
from tasks.geometry.rendering import Camera, RayScene
from tasks.stats.photographs import Paint, photograph
from tasks.stats.scenes import PictureConfig, corner_camera, fitting_camera, opened, shown

if TYPE_CHECKING:
    import trimesh

Floats = NDArray[np.float32]

TRACK, TARGET, START = (45, 120, 225), (235, 30, 125), (28, 36, 48)
"""Colors of the way so far, of the target and of the start, RGB."""

LINE_M, CASING_M = 0.05, 0.022
"""Width of the way on the floor, and of its white edges."""

RING_M = 0.12
"""Radius of the ring at the start."""

FAN_M = 1.2
"""So far reaches the fan that shows where the agent looks."""

FAINT = 0.34
"""How much is left of what is hidden."""

_LEVEL_M = 0.05
"""What is no higher is floor: rugs."""

_BIAS_M = 0.02
"""The agent stands on the floor: so much behind a surface it still is before it."""

_RAYS = 3
"""Rays along each side of a pixel of the agent."""


class ThirdPerson:
    """The pictures of one walk.

    camera: What they are taken by, world frame. target_box: Left, top, right and bottom of the target's silhouette [px], None where the
    target was not placed.
    """

    def __init__(self, room: FilmedRoom, walk: FilmedBody, look: PictureConfig) -> None:
        self._walk, self._poses = walk, walk.poses
        target = walk.target
        self.camera = _clearest(room, walk, look)
        parts, is_target = _parts(room, target, self.camera, look)
        self._ground = photograph(parts, self.camera, look, _tinted(is_target))
        rays = self.camera.rays()
        self._depth = RayScene(parts).cast(rays)["t_hit"].astype(np.float32)
        height, slope = self.camera.pose[2, 3], rays[..., 5]
        reach = np.where(slope < -1e-6, -height / np.minimum(slope, -1e-6), 0.0).astype(np.float32)
        self._floor: Floats = rays[..., :2] + rays[..., 3:5] * reach[..., None]
        with np.errstate(invalid="ignore"):
            is_level = np.isfinite(self._depth) & (height + self._depth * slope < _LEVEL_M)
        self._seen = np.where(is_level, 1.0, FAINT).astype(np.float32)
        across, down = np.gradient(self._floor, axis=1), np.gradient(self._floor, axis=0)
        self._pixel = np.sqrt(np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])).astype(np.float32) + np.float32(1e-6)
        self._away = np.full(self._depth.shape, np.inf, dtype=np.float32)
        self._passed = 0
        self._robot = RayScene(robot(walk.radius_m, walk.height_m))
        self._edge, self.target_box = _outline(room.objects.get(target, []), self.camera, self._depth)

    def picture(self, step: int) -> NDArray[np.uint8]:
        """The agent at a pose, by its number, and its way so far, shape (h, w, 3)."""
        self._walk_to(step)
        x, y, yaw = self._poses[step]
        image = self._ground.copy()
        self._draw_floor(image, np.array([x, y], dtype=np.float32), yaw)
        image += (np.array(TARGET, dtype=np.float32) - image) * self._edge[..., None]
        self._draw_agent(image, x, y, yaw)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def place(self, point: Sequence[float]) -> tuple[float, float]:
        """Where a point of the world [m], shape (3,), is in the picture: column and row [px]."""
        ((column, row),), _ = self.camera.project(np.array([point], dtype=np.float64))
        return float(column), float(row)

    def _walk_to(self, step: int) -> None:
        """Bring the distances from the way up to a step."""
        if step < self._passed:
            self._away[:], self._passed = np.inf, 0
        reach = LINE_M + CASING_M
        for begin, end in zip(self._poses[self._passed : step, :2], self._poses[self._passed + 1 : step + 1, :2], strict=True):
            at = self._around(np.array([begin, end]), reach + 0.02, 0.0)
            part = self._away[at]
            np.minimum(part, _distance(self._floor[at], begin, end), out=part)
        self._passed = step

    def _around(self, points: NDArray[np.float64], margin: float, height: float) -> tuple[slice, slice]:
        """Rows and columns of the picture around points of the floor, shape (n, 2) [m], up to a height [m]."""
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, height)])
        pixels, _ = self.camera.project(corners)
        size = np.array([self.camera.width, self.camera.height])
        first = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, size).astype(int)
        last = np.clip(np.ceil(pixels.max(axis=0)) + 3, 0, size).astype(int)
        return slice(first[1], last[1]), slice(first[0], last[0])

    def _draw_floor(self, image: Floats, here: Floats, yaw: float) -> None:
        """Start, way so far, where the agent looks, and its shadow."""
        start = self._around(self._poses[:1, :2], RING_M + 0.1, 0.0)
        away = np.hypot(*np.moveaxis(self._floor[start] - self._poses[0, :2].astype(np.float32), -1, 0))
        self._paint(image, start, START, self._within(start, away, RING_M))
        self._paint(image, start, (255, 255, 255), self._within(start, away, RING_M - 0.035))
        whole = (slice(None), slice(None))
        for color, width in (((255, 255, 255), LINE_M / 2 + CASING_M), (TRACK, LINE_M / 2)):
            self._paint(image, whole, color, self._within(whole, self._away, width))
        around = self._around(here[None].astype(np.float64), FAN_M + 0.1, 0.0)
        offset = self._floor[around] - here
        away = np.hypot(offset[..., 0], offset[..., 1])
        angle = np.arctan2(offset[..., 1], offset[..., 0]) - np.float32(yaw)
        angle = np.abs(np.arctan2(np.sin(angle), np.cos(angle)))
        inside = np.clip((0.5 * self._walk.camera.hfov_radians - angle) * away / self._pixel[around] + 0.5, 0, 1)
        self._paint(image, around, TRACK, 0.8 * inside * np.clip(1 - away / FAN_M, 0, 1))
        radius = self._walk.radius_m
        self._paint(image, around, (0, 0, 0), 0.45 * np.clip(1 - (away - 0.85 * radius) / (0.5 * radius), 0, 1))

    def _within(self, at: tuple[slice, slice], away: Floats, width: float) -> Floats:
        """How much of each pixel is nearer than a width [m], smooth over one pixel."""
        return np.clip((width - away) / self._pixel[at] + 0.5, 0, 1).astype(np.float32)

    def _paint(self, image: Floats, at: tuple[slice, slice], color: tuple[int, int, int], share: Floats) -> None:
        """Put a color on the floor, faintly where something hides it."""
        part = image[at]
        part += (np.array(color, dtype=np.float32) - part) * (share * self._seen[at])[..., None]

    def _draw_agent(self, image: Floats, x: float, y: float, yaw: float) -> None:
        """Put the agent's body before what is behind it, faintly over what hides it."""
        at = self._around(np.array([[x, y]]), 1.1 * self._walk.radius_m, 1.1 * self._walk.height_m)
        rows, columns = np.arange(at[0].start, at[0].stop), np.arange(at[1].start, at[1].stop)
        if not len(rows) or not len(columns):
            return
        inner = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
        v, u = np.meshgrid((rows[:, None] + inner).reshape(-1), (columns[:, None] + inner).reshape(-1), indexing="ij")
        camera = self.camera
        local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        rays = np.empty((*u.shape, 6), dtype=np.float32)  # in the frame of the robot
        rays[..., :3] = (camera.pose[:3, 3] - [x, y, 0.0]) @ turn
        rays[..., 3:] = local @ camera.pose[:3, :3].T @ turn
        hits = self._robot.cast(rays)
        depth = hits["t_hit"]
        color = self._robot.colors(hits).astype(np.float32) * _light(hits["primitive_normals"], rays, camera, turn)[..., None]
        behind = np.repeat(np.repeat(self._depth[at], _RAYS, axis=0), _RAYS, axis=1)
        share = np.where(np.isfinite(depth), np.where(depth < behind + _BIAS_M, 1.0, 2 * FAINT), 0.0).astype(np.float32)[..., None]
        blocks = (len(rows), _RAYS, len(columns), _RAYS, -1)
        weight = share.reshape(blocks).mean(axis=(1, 3))
        part = image[at]
        part *= 1 - weight
        part += (share * color).reshape(blocks).mean(axis=(1, 3))


def _light(normals: Floats, rays: Floats, camera: Camera, turn: NDArray[np.float64]) -> Floats:
    """Light on faces, shape (...): soft, from over the camera's left shoulder, as in the photograph."""
    key = (camera.pose[:3, :3] @ np.array([-0.45, -0.75, -0.5])) @ turn
    towards = np.where((normals * rays[..., 3:]).sum(axis=-1, keepdims=True) > 0, -normals, normals)
    light = 0.62 + 0.42 * np.clip(towards @ (key / np.linalg.norm(key)), 0, 1) + 0.08 * towards[..., 2]
    return np.asarray(light, dtype=np.float32)


def _distance(points: Floats, begin: NDArray[np.float64], end: NDArray[np.float64]) -> Floats:
    """How far points, shape (..., 2), are from a stretch of the way [m], shape (...)."""
    along = (end - begin).astype(np.float32)
    offset = points - begin.astype(np.float32)
    share = np.clip((offset @ along) / max(float(along @ along), 1e-9), 0, 1)
    rest = offset - share[..., None] * along
    return np.hypot(rest[..., 0], rest[..., 1]).astype(np.float32)


def _parts(room: FilmedRoom, target: str, camera: Camera, look: PictureConfig) -> tuple[list[trimesh.Trimesh], NDArray[np.bool_]]:
    """What a camera is shown of a room, and which parts are the target's; the target is whole whatever it hangs on."""
    parts = opened(room.walls, room.outline, camera, look)
    is_target = [False] * len(parts)
    for name, own in room.objects.items():
        kept = own if name == target else shown([own], room.outline, camera, look)
        parts += kept
        is_target += [name == target] * len(kept)
    return parts, np.array([*is_target, False], dtype=np.bool_)


def _tinted(is_target: NDArray[np.bool_]) -> Paint:
    """A paint that lets the target stand out."""

    def paint(colors: Floats, part: NDArray[np.int64]) -> Floats:
        tinted = 0.72 * colors + 0.28 * np.array(TARGET, dtype=np.float32)
        return np.where(is_target[part][..., None], tinted, colors).astype(np.float32)

    return paint


def _clearest(room: FilmedRoom, walk: FilmedBody, look: PictureConfig) -> Camera:
    """Of the four corner cameras the one from which most of the way and of the target is seen; the first of equals."""
    small = dataclasses.replace(look, width=160, height=round(160 * look.height / look.width), oversampling=1)
    poses, own = walk.poses, room.objects.get(walk.target, [])
    heights = np.array([0.02, 0.6 * walk.height_m])
    points = np.array([[x, y, z] for x, y, _ in poses for z in heights])
    best, most = 0, -1.0
    for corner in range(4):
        camera = _framed(room, corner, small)
        depth = RayScene(_parts(room, walk.target, camera, small)[0]).cast(camera.rays())["t_hit"]
        pixels, far = camera.project(points)
        column, row = np.clip(np.rint(pixels).astype(int), 0, [camera.width - 1, camera.height - 1]).T
        seen = float((depth[row, column] > far - 0.15).mean())
        alone = RayScene(own).cast(camera.rays())["t_hit"]
        silhouette = np.isfinite(alone)
        if silhouette.any():
            seen += float((alone[silhouette] <= depth[silhouette] + _BIAS_M).mean()) + 2e-4 * float(np.sqrt(silhouette.sum()))
        if seen > most + 1e-9:
            best, most = corner, seen
    return _framed(room, best, look)


def _framed(room: FilmedRoom, corner: int, look: PictureConfig) -> Camera:
    """A camera above a corner, by its number, as near as all that is left of the room after the cut allows."""
    camera = corner_camera(room.outline, corner, look)
    left = opened(room.walls, room.outline, camera, look)
    floor = np.column_stack([room.outline.ring, np.zeros(len(room.outline.ring))])
    points = np.concatenate([floor, *(np.asarray(part.vertices)[np.unique(part.faces)] for part in left)])
    return fitting_camera(points, points.mean(axis=0), -camera.pose[:3, 2], look)


def _outline(parts: Sequence[trimesh.Trimesh], camera: Camera, depth: Floats) -> tuple[Floats, tuple[float, float, float, float] | None]:
    """How much of each pixel is the line around an object, faint where it is hidden, shape (h, w), and the box of its silhouette [px]."""
    from scipy.ndimage import distance_transform_edt, uniform_filter

    if not parts:
        return np.zeros(depth.shape, dtype=np.float32), None
    fine = dataclasses.replace(
        camera, fx=2 * camera.fx, fy=2 * camera.fy, cx=2 * camera.cx + 0.5, cy=2 * camera.cy + 0.5, width=2 * camera.width,
        height=2 * camera.height,
    )  # fmt: skip
    alone = RayScene(parts).cast(fine.rays())["t_hit"]
    inside = np.isfinite(alone)
    if not inside.any():
        return np.zeros(depth.shape, dtype=np.float32), None
    scale = camera.width / 720
    line = np.clip(4.5 * max(scale, 0.6) - np.abs(distance_transform_edt(~inside) - 1.0), 0, 1) * ~inside
    before = inside & (alone <= np.repeat(np.repeat(depth, 2, axis=0), 2, axis=1) + 2 * _BIAS_M)
    near = uniform_filter(before.astype(np.float32), 15) > 1e-3
    share = np.where(near, line, FAINT * line).astype(np.float32)
    rows, columns = np.flatnonzero(inside.any(axis=1)) / 2, np.flatnonzero(inside.any(axis=0)) / 2
    box = (float(columns[0]), float(rows[0]), float(columns[-1]), float(rows[-1]))
    return share.reshape(camera.height, 2, camera.width, 2).mean(axis=(1, 3)), box
