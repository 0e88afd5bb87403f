"""From the scan's frame to the world frame: gravity from floor and walls, yaw from the walls, the floor at z = 0."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.rooms.floor_levels import BAND_M, MIN_FLOOR_M2, Facets, SeenLevel, facets, floor_height, level_height, other_floor
from tasks.capture.rooms.sharpness import sharpness
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import flat, matrix, translation, yaw_pose
from tasks.geometry.triangles import face_areas

Array = NDArray[np.float64]

_ENOUGH_FACES = 150_000
"""Faces that the estimate is made of: a room's floor still has some ten thousand."""

_IDENTITY_YAW = np.deg2rad(1.0)
_IDENTITY_SHIFT_M = 0.02
"""A modelled scene nearer than this to the world frame is left exactly where it was authored."""


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How a scan is brought to the world frame.

    pose: Scan frame to world frame, 4x4 [m]. source: `file`, `estimated` or `identity`.
    floor_tilt: Angle between the scan's floor and its horizontal before alignment [rad].
    """

    pose: Array
    source: str
    floor_tilt: float
    notes: tuple[str, ...]


def align(
    surface: Surface,
    *,
    floor_faces: NDArray[np.bool_] | None = None,
    wall_faces: NDArray[np.bool_] | None = None,
    stated: Array | None = None,
    level: SeenLevel | None = None,
    is_authored: bool = False,
) -> Alignment:
    """The alignment of a scan.

    floor_faces, wall_faces: Faces that the scan itself calls floor and wall, shape (m,), where it names them.
    stated: The scan's own axis alignment, 4x4; only the floor's height is corrected then.
    level: What its frames say of up and floor, where it has nothing else to tell.
    is_authored: The scene was modelled, not scanned: its up axis is right, and it stays as it is when it is aligned already.
    """
    # Every k-th face tells as much as all of them.
    every = max(1, len(surface.faces) // _ENOUGH_FACES)
    surface_faces = surface.faces[::every]
    corners = surface.vertices[surface_faces]
    solid = face_areas(surface.vertices, surface_faces) > 0.5e-12
    faces = facets(corners, every)
    floor_faces, wall_faces = (mask[::every] if mask is not None else None for mask in (floor_faces, wall_faces))
    if not len(faces.areas):
        notes = ["mesh without area: not aligned"]
        return Alignment(np.eye(4) if stated is None else stated, "identity" if stated is None else "file", 0.0, tuple(notes))
    floor = faces.chosen(floor_faces[solid]) if floor_faces is not None and floor_faces[solid].any() else None
    walls = faces.chosen(wall_faces[solid]) if wall_faces is not None and wall_faces[solid].any() else faces
    if stated is not None:
        return _as_stated(faces, floor, stated)
    notes = []
    rotation = np.eye(3)
    if not is_authored:
        up, notes = _up(faces, floor, level)
        rotation = rotation_to_z(up)
    # Furniture says nothing about how a modeller meant the axes: only walls may turn a modelled scene.
    yaw = 0.0 if is_authored and wall_faces is None else dominant_yaw(walls.turned(rotation))
    if yaw is None:
        notes.append("no walls or other vertical faces seen: yaw left as scanned")
        yaw = 0.0
    height = level_height(faces.turned(rotation), floor.turned(rotation) if floor is not None else None, level, rotation[2])
    tilt = _tilt(floor or faces, rotation.T[:, 2])
    points = surface.vertices @ (yaw_pose(-yaw)[:3, :3] @ rotation).T
    if height is None:
        notes.append("no floor seen: the lowest points are taken for its height")
        height = float(np.percentile(points[:, 2], 0.5))
    if is_authored and abs(yaw) < _IDENTITY_YAW and abs(height) < _IDENTITY_SHIFT_M:
        return Alignment(np.eye(4), "identity", tilt, tuple(notes))
    low, high = np.percentile(points[:, :2], [1, 99], axis=0)
    pose = np.eye(4)
    pose[:3, :3] = yaw_pose(-yaw)[:3, :3] @ rotation
    pose[:3, 3] = [*(-(low + high) / 2), -height]
    return Alignment(matrix(flat(pose)), "estimated", tilt, tuple(notes))


def _as_stated(faces: Facets, floor: Facets | None, stated: Array) -> Alignment:
    """The stated alignment, its height corrected so that the floor is at z = 0."""
    rotation = stated[:3, :3]
    turned = faces.turned(rotation)
    height = floor_height(turned, floor.turned(rotation) if floor is not None else None)
    tilt = _tilt(floor or faces, rotation.T[:, 2])
    notes: list[str] = []
    if height is None:
        notes.append("no floor seen: height left as the axis alignment has it")
        return Alignment(stated, "file", tilt, tuple(notes))
    shift = -(height + stated[2, 3])
    remaining = _tilt((floor or faces).turned(rotation), np.array([0.0, 0.0, 1.0]))
    if remaining > np.deg2rad(5):
        notes.append(f"the axis alignment leaves the floor {np.rad2deg(remaining):.1f} degrees from horizontal")
    if abs(shift) > 0.3:
        notes.append(f"the axis alignment leaves the floor at {-shift:.2f} m: moved to 0")
    return Alignment(matrix(flat(translation([0, 0, shift]) @ stated)), "file", tilt, tuple(notes))


def _up(faces: Facets, floor: Facets | None, seen: SeenLevel | None) -> tuple[Array, list[str]]:
    """Up in the scan frame: from the first of the plausible guesses that a floor confirms."""
    guesses = [np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0])]
    band = BAND_M if seen is None else seen.band_m
    if seen is not None:
        guesses = [seen.up / np.linalg.norm(seen.up)]
    if floor is not None and floor.areas.sum() > MIN_FLOOR_M2:
        normal = fitted_normal(floor, (floor.normals * floor.areas[:, None]).sum(axis=0))
        if normal is not None:
            inside = faces.centers.mean(axis=0) - floor.centers.mean(axis=0)
            return (normal if normal @ inside > 0 else -normal), []
    if seen is not None and (normal := _level_normal(faces, seen, guesses[0])) is not None:
        return normal, []
    for guess in guesses:
        up = gravity_aligned(faces, guess)
        turned = faces.turned(rotation_to_z(up))
        if up @ guess > np.cos(np.deg2rad(35)) and (height := floor_height(turned, None, band)) is not None:
            near = (np.abs(turned.centers[:, 2] - height) < 2 * band) & (np.abs(turned.normals[:, 2]) > 0.9)
            normal = fitted_normal(faces.chosen(near), up)
            return (normal if normal is not None and normal @ up > np.cos(np.deg2rad(10)) else up), []
    return guesses[0], ["no floor seen: up taken from the " + ("frames" if seen is not None else "scan's z axis")]


def _level_normal(faces: Facets, seen: SeenLevel, guess: Array) -> Array | None:
    """Normal of the level that frames show, shape (3,); None if it spans no plane, or the surface has another floor.

    The fused surface near that level has tops of things on it: only the level's own points tell how it lies. A floor that
    lies elsewhere is larger than the patch that the frames show, and tells better.
    """
    normal = fitted_normal(seen.facets, guess)
    if normal is None or normal @ guess <= np.cos(np.deg2rad(10)):
        return None
    up = gravity_aligned(faces, guess)
    up = up if up @ guess > np.cos(np.deg2rad(10)) else normal
    level = seen.height_along(up)
    is_floor = level is None or other_floor(faces.turned(rotation_to_z(up)), level, seen.band_m) is None
    return normal if is_floor else None


def gravity_aligned(faces: Facets, guess: Array) -> Array:
    """Up direction, shape (3,), near `guess`, to which most faces are parallel or perpendicular.

    Iterates over shrinking angle thresholds; each step takes the eigenvector that is most along the normals of nearly
    horizontal faces and least along those of nearly vertical ones (Gupta, Arbelaez and Malik, CVPR 2013, section 3).
    """
    up = guess / np.linalg.norm(guess)
    for degrees in (40.0, 40.0, 25.0, 25.0, 15.0, 10.0, 7.0, 5.0, 5.0):
        cosine = np.abs(faces.normals @ up)
        level, upright = cosine > np.cos(np.deg2rad(degrees)), cosine < np.sin(np.deg2rad(degrees))
        scatter = np.zeros((3, 3))
        for where, sign in ((upright, 1.0), (level, -1.0)):
            n = faces.normals[where]
            scatter += sign * (n * faces.areas[where][:, None]).T @ n
        if not level.any() and not upright.any():
            break
        candidate = np.linalg.eigh(scatter)[1][:, 0]
        up = candidate * (1.0 if candidate @ up >= 0 else -1.0)
    return up


def dominant_yaw(faces: Facets) -> float | None:
    """Turn about z of the walls [rad], in (-pi/4, pi/4], in a frame whose z axis is up; None without vertical faces.

    The strongest direction modulo a right angle, by area; then the turn near it at which walls, seen along themselves, are
    thinnest. Normals of fused depth are off by ten degrees and more, the places of walls by a centimetre.
    """
    upright = np.abs(faces.normals[:, 2]) < np.sin(np.deg2rad(15))
    if not upright.any():
        return None
    angle = np.arctan2(faces.normals[upright, 1], faces.normals[upright, 0]) % (np.pi / 2)
    weight = faces.areas[upright]
    bins = 180
    histogram = np.bincount((angle / (np.pi / 2) * bins).astype(np.int64) % bins, weights=weight, minlength=bins)
    reach = np.arange(-8, 9)
    smooth = sum(np.roll(histogram, k) * np.exp(-0.5 * (k / 3.0) ** 2) for k in reach)
    peak = (int(np.argmax(smooth)) + 0.5) / bins * (np.pi / 2)
    plan, owner, weights = _plan_points(faces.corners[upright][:, :, :2], weight)
    plan = plan - plan.mean(axis=0)
    sides = faces.normals[upright, :2][owner]
    best = peak
    for span, step in ((6.0, 0.5), (0.5, 0.1), (0.1, 0.02)):
        turns = best + np.deg2rad(np.arange(-span, span + step / 2, step))
        best = float(turns[int(np.argmax(sharpness(plan, sides, weights, turns)))])
    return float((best + np.pi / 4) % (np.pi / 2) - np.pi / 4)


_COARSE_M = 0.25
"""Faces longer than this are drawn, not fused from depth."""

_MAX_DIVISIONS, _MAX_POINTS = 40, 1_000_000
"""A wall of 10 m has a point every quarter meter. All points together take a second."""


def _plan_points(corners: Array, areas: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Points of faces on the floor [m], shape (n, 2), the face of each, and its weight, shape (n,).

    Small faces are their corners. Corners of large ones would lie in line with those of other faces by chance.

    Args:
        corners: of upright faces on the floor [m], shape (m, 3, 2).
        areas: of the faces [m2], shape (m,).
    """
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    is_coarse = lengths > _COARSE_M
    small = np.flatnonzero(~is_coarse)
    places, owners = [corners[small].reshape(-1, 2)], [np.repeat(small, 3)]
    weights = [np.repeat(areas[small], 3)]
    most = int(np.clip((2 * _MAX_POINTS / max(int(is_coarse.sum()), 1)) ** 0.5, 1, _MAX_DIVISIONS))
    divisions = np.where(is_coarse, np.clip(np.ceil(lengths / _COARSE_M), 1, most), 0).astype(np.int64)
    for count in np.unique(divisions[is_coarse]):
        chosen = np.flatnonzero(divisions == count)
        steps = np.array([(i, j, count - 1 - i - j) for i in range(count) for j in range(count - i)])
        lattice = (steps + 1 / 3) / count
        places.append(np.einsum("pk,mkd->mpd", lattice, corners[chosen]).reshape(-1, 2))
        owners.append(np.repeat(chosen, len(lattice)))
        weights.append(np.repeat(3.0 * areas[chosen] / len(lattice), len(lattice)))
    return np.concatenate(places), np.concatenate(owners), np.concatenate(weights)


def rotation_to_z(up: Array) -> Array:
    """The shortest rotation, 3x3, that turns the unit vector `up` to +z; half a turn about x for -z."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)


def fitted_normal(faces: Facets, toward: Array) -> Array | None:
    """Normal, shape (3,), of the plane through faces, by area, pointing `toward`; None when they span no plane."""
    if not len(faces.areas):
        return None
    points = faces.corners.reshape(-1, 3)
    weights = np.repeat(faces.areas, 3)
    normal = None
    for _ in range(3):
        center = np.average(points, axis=0, weights=weights)
        spread = points - center
        values, vectors = np.linalg.eigh((spread * weights[:, None]).T @ spread / weights.sum())
        # The narrower extent in the plane must exceed the noise by far, or the normal is noise.
        if values[1] < 0.15**2:
            return normal
        normal = vectors[:, 0] * (1.0 if vectors[:, 0] @ toward >= 0 else -1.0)
        near = np.abs(spread @ normal) < max(2.0 * np.sqrt(max(values[0], 0.0)), 0.01)
        if near.sum() < 3:
            return normal
        points, weights = points[near], weights[near]
    return normal


def _tilt(faces: Facets, up: Array) -> float:
    """Angle [rad] between the scan's z axis and the normal of its floor, which `up` is near to."""
    turned = faces.turned(rotation_to_z(up))
    height = floor_height(turned, None)
    normal = None
    if height is not None:
        near = (np.abs(turned.centers[:, 2] - height) < 2 * BAND_M) & (np.abs(turned.normals[:, 2]) > 0.9)
        normal = fitted_normal(faces.chosen(near), up)
    return float(np.arccos(np.clip((normal if normal is not None else up)[2], -1.0, 1.0)))
