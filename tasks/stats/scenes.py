"""A scan and its replica from the same camera: the room like a doll's house, and from above.

What hides the room is cut away in both pictures alike: the ceiling, and in the doll's house the walls between the
camera and the room. The cut is geometric, so it does not depend on how a scan's faces are wound.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tasks.stats.photographs import developed, photograph

if TYPE_CHECKING:
    import trimesh

    from schemas.capture import Shell
    from tasks.stats.style import Picture

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class PictureConfig:
    """How scenes are pictured."""

    width: int = 800  # two of them side by side fill a laptop's screen; a phone shows one
    height: int = 560
    oversampling: int = 2  # rays per pixel along each side: smooth edges at four times the rays
    horizontal_fov_radians: float = 0.7  # 40 degrees: a portrait lens, so that far walls do not shrink
    elevation_radians: float = 0.75  # 43 degrees: sees the floor behind a table and still the fronts of shelves
    ceiling_cut_m: float = 0.2  # fused ceilings are wavy by some centimetres; lamps below that stay
    wall_cut_m: float = 0.12  # as far inside the room as noise and skirting boards of a scanned wall reach
    hung_m: float = 0.25  # an object above the floor that is nowhere farther from a wall hangs on it: pictures, windows, shelves
    standing_m: float = 0.3  # what begins lower stands on the floor
    background: tuple[int, int, int] = (240, 242, 245)  # neither page color; both scan and replica stand out on it
    jpeg_quality: int = 84  # below that, edges of thin legs show blocks


@dataclasses.dataclass(frozen=True)
class ScenePictures:
    """JPEG files of a scene: its scan and its replica, from a corner and from above.

    before, after: the replica as proposed and as optimized, with what collides marked. loss_curve: the optimization's
    loss over its steps. plan: The floor with the navmesh and the paths on it. heat: Distances from the scan to
    the replica, from above. Missing where there is nothing to show.
    """

    corner_scan: bytes
    corner_replica: bytes
    top_scan: bytes
    top_replica: bytes
    before: bytes | None = None
    after: bytes | None = None
    loss_curve: Picture | None = None
    plan: Picture | None = None
    heat: Picture | None = None


@dataclasses.dataclass(frozen=True)
class RoomOutline:
    """What the cameras need to know of a room: floor ring (n, 2) [m], counter-clockwise, and height [m]."""

    ring: Array
    height: float

    @staticmethod
    def of_room(room: Shell) -> RoomOutline:
        """The outline of a row of `shells`."""
        ring = np.asarray(room.floor_polygon, dtype=np.float64).reshape(-1, 2)
        area = np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1))
        return RoomOutline(ring if area >= 0 else ring[::-1].copy(), room.height_m)

    @staticmethod
    def of_parts(parts: Sequence[trimesh.Trimesh]) -> RoomOutline:
        """The box around parts in the world frame, for a scene without a room."""
        low = np.min([part.bounds[0] for part in parts], axis=0)
        high = np.max([part.bounds[1] for part in parts], axis=0)
        ring = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
        return RoomOutline(ring, float(max(high[2], 0.1)))

    @property
    def corners(self) -> Array:
        """Corners of the room's box with its walls [m], shape (8, 3)."""
        (x0, y0), (x1, y1) = self.ring.min(axis=0) - 0.12, self.ring.max(axis=0) + 0.12
        return np.array([[x, y, z] for x in (x0, x1) for y in (y0, y1) for z in (0.0, self.height)])


def picture_scene(
    scan: Sequence[trimesh.Trimesh],
    shell: Sequence[trimesh.Trimesh],
    objects: Sequence[Sequence[trimesh.Trimesh]],
    outline: RoomOutline,
    config: PictureConfig | None = None,
    corner: Camera | None = None,
) -> ScenePictures:
    """Pictures of a scan and of its replica, `shell` and the parts of each of the `objects`, all in the world frame [m].

    The corner is the one from which most of the objects is seen; without objects, most of the scan. `corner` is its camera,
    where it is known already.
    """
    config = config or PictureConfig()
    corner = corner or best_corner(objects or [[part] for part in scan], shell, outline, config)
    files: list[bytes] = []
    for camera in (corner, top_camera(outline, config)):
        replica = [*opened(shell, outline, camera, config), *shown(objects, outline, camera, config)]
        for parts in (opened(scan, outline, camera, config), replica):
            files.append(render(parts, camera, config))
    corner_scan, corner_replica, top_scan, top_replica = files
    return ScenePictures(corner_scan, corner_replica, top_scan, top_replica)


def corner_pair(
    scan: Sequence[trimesh.Trimesh],
    shell: Sequence[trimesh.Trimesh],
    objects: Sequence[Sequence[trimesh.Trimesh]],
    outline: RoomOutline,
    config: PictureConfig,
) -> tuple[bytes, bytes]:
    """JPEG of a scan and of its replica from the corner that `picture_scene` takes."""
    camera = best_corner(objects or [[part] for part in scan], shell, outline, config)
    replica = [*opened(shell, outline, camera, config), *shown(objects, outline, camera, config)]
    return render(opened(scan, outline, camera, config), camera, config), render(replica, camera, config)


def corner_camera(outline: RoomOutline, corner: int, config: PictureConfig) -> Camera:
    """A camera above corner 0 to 3 of the room's box, counter-clockwise from (+x, +y), that sees the whole box."""
    corners = outline.corners
    center = corners.mean(axis=0) - [0.0, 0.0, 0.12 * outline.height]
    size = np.ptp(corners, axis=0)
    # towards the corner, but at least 30 degrees off each wall, so that long rooms are not seen end on
    azimuth = np.clip(np.arctan2(size[1], size[0]), np.radians(30), np.radians(60))
    turns = (azimuth, np.pi - azimuth, np.pi + azimuth, -azimuth)
    flat, rise = np.cos(config.elevation_radians), np.sin(config.elevation_radians)
    direction = np.array([np.cos(turns[corner]) * flat, np.sin(turns[corner]) * flat, rise])
    return fitting_camera(corners, center, direction, config)


def top_camera(outline: RoomOutline, config: PictureConfig) -> Camera:
    """A camera straight above the room, its long side across the picture."""
    corners = outline.corners
    size = np.ptp(corners, axis=0)
    camera = fitting_camera(corners, corners.mean(axis=0), np.array([0.0, 0.0, 1.0]), config)
    if size[1] <= size[0]:
        return camera
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = camera.pose.copy()
    pose[:3, :3] = turn @ pose[:3, :3]
    turned = dataclasses.replace(camera, pose=pose)
    return fitting_camera(corners, corners.mean(axis=0), np.array([0.0, 0.0, 1.0]), config, turned.pose[:3, :3])


def opened(parts: Sequence[trimesh.Trimesh], outline: RoomOutline, camera: Camera, config: PictureConfig) -> list[trimesh.Trimesh]:
    """Parts without the ceiling and without the walls that stand between the camera and the room."""
    kept = []
    hiding = _hiding_walls(outline, camera.pose[:3, 3])
    for part in parts:
        faces = ~_is_cut(part, outline, hiding, config)
        if faces.all():
            kept.append(part)
        elif faces.any():
            kept.append(_with_faces(part, faces))
    return kept


def shown(
    objects: Sequence[Sequence[trimesh.Trimesh]], outline: RoomOutline, camera: Camera, config: PictureConfig
) -> list[trimesh.Trimesh]:
    """Parts of the objects that do not go with what is cut away: not what hangs on a cut wall, nor what sticks in the ceiling.

    The others stay whole, however near to a cut wall they stand.
    """
    hiding = _hiding_walls(outline, camera.pose[:3, 3])
    hung = dataclasses.replace(config, wall_cut_m=config.hung_m)
    kept: list[trimesh.Trimesh] = []
    for parts in objects:
        stands = min(part.bounds[0, 2] for part in parts) < config.standing_m
        if stands or not all(_is_cut(part, outline, hiding, hung).all() for part in parts):
            kept.extend(parts)
    return kept


def render(parts: Sequence[trimesh.Trimesh], camera: Camera, config: PictureConfig) -> bytes:
    """JPEG of parts in the world frame from `camera`, softly lit from above and behind the camera."""
    return developed(photograph(parts, camera, config), config)


def fitting_camera(points: Array, target: Array, direction: Array, config: PictureConfig, rotation: Array | None = None) -> Camera:
    """The camera nearest to `target` along `direction` that has all points (n, 3) in its picture, with a small margin."""
    pose = look_at(target + direction, target)
    if rotation is not None:
        pose[:3, :3] = rotation
    tangent_x = np.tan(0.5 * config.horizontal_fov_radians) * 0.96
    tangent_y = tangent_x * config.height / config.width
    local = (points - target) @ pose[:3, :3]
    shift, distance = np.zeros(2), 1.0
    for _ in range(8):  # the middle of the picture depends on the distance, and the distance on the middle
        x, y, z = local[:, 0] - shift[0], local[:, 1] - shift[1], local[:, 2]
        # a point at depth distance + z is inside when |x| <= (distance + z) tan
        distance = float(max(0.5, np.max(np.maximum(np.abs(x) / tangent_x, np.abs(y) / tangent_y) - z)))
        for axis, values in enumerate((x, y)):
            seen = values / (distance + z)
            shift[axis] += 0.5 * (seen.max() + seen.min()) * distance
    pose[:3, 3] = target + direction * distance + pose[:3, :2] @ shift
    return Camera.with_fov(pose, config.width, config.height, config.horizontal_fov_radians)


def best_corner(
    objects: Sequence[Sequence[trimesh.Trimesh]], shell: Sequence[trimesh.Trimesh], outline: RoomOutline, config: PictureConfig
) -> Camera:
    """Of the four corner cameras the one that sees most of the objects, not all on one spot: pixels weigh by square root."""
    small = dataclasses.replace(config, width=120, height=84, oversampling=1)
    best, most = corner_camera(outline, 0, config), -1.0
    for corner in range(4):
        camera = corner_camera(outline, corner, small)
        visible = shown(objects, outline, camera, small)
        if not visible:
            continue
        part = RayScene([*visible, *opened(shell, outline, camera, small)]).cast(camera.rays())["geometry_ids"]
        pixels = np.bincount(part[part < len(visible)], minlength=1)
        seen = float(np.sqrt(pixels).sum())
        if seen > most:
            best, most = corner_camera(outline, corner, config), seen
    return best


def _hiding_walls(outline: RoomOutline, eye: Array) -> list[tuple[Array, Array, float]]:
    """Walls that `eye` sees from outside: start (2,), unit direction (2,) with the room on its left, length [m].

    A camera that stands over the room sees no wall from outside.
    """
    hiding = []
    for start, end in zip(outline.ring, np.roll(outline.ring, -1, axis=0), strict=True):
        length = float(np.linalg.norm(end - start))
        if length < 1e-6:
            continue
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        if float((eye[:2] - start) @ inward) < 0:
            hiding.append((start, along, length))
    return hiding


def _is_cut(
    part: trimesh.Trimesh, outline: RoomOutline, hiding: Sequence[tuple[Array, Array, float]], config: PictureConfig
) -> NDArray[np.bool_]:
    """Which faces of a part are ceiling or belong to a wall that hides the room, shape (faces,)."""
    vertices, faces = np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces)
    cut = (vertices[:, 2] > outline.height - config.ceiling_cut_m)[faces].all(axis=1)
    standing = (vertices[:, 2] > 0.04)[faces].any(axis=1)
    for start, along, length in hiding:
        offset = vertices[:, :2] - start
        inside = offset @ np.array([-along[1], along[0]])
        beside = offset @ along
        # the wall itself and whatever a scan has caught behind it, but no other wing of the room
        near = (inside < config.wall_cut_m) & (inside > -0.5) & (beside > -0.3) & (beside < length + 0.3)
        # the floor's own faces stay; the undersides of walls, which lie outside the room, do not
        cut |= near[faces].all(axis=1) & (standing | (inside < 1e-3)[faces].all(axis=1))
    return cut


def _with_faces(part: trimesh.Trimesh, keep: NDArray[np.bool_]) -> trimesh.Trimesh:
    """The part with some of its faces; vertices, colors and texture coordinates stay as they are."""
    kept = part.copy()
    kept.faces = np.asarray(part.faces)[keep]
    return kept
