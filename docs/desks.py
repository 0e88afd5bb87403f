"""One desk of an office, furnished six times by the model that ships: finished scenes from one camera, three by two."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from flows.inputs.synthesis import SceneRequest, Synthesized, asked, drawing_model, synthesize
from schemas.candidates import Asset
from schemas.capture import Shell
from schemas.optimization import Placement
from tasks.geometry.rendering import Camera, RayScene
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.stats.photographs import photograph
from tasks.stats.scenes import PictureConfig, RoomOutline, fitting_camera, opened
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

MODEL = "physcene"
SIZE = (0.7, 1.4, 0.75)  # depth, width, height [m]
DESK_SEED = 10  # of a desk and a room of calm colors: neither black nor white things vanish on them
COUNT, COLUMNS = 6, 3
TILE, GAP_PX = (396, 296), 6
FINER = 2  # pixels that are drawn along each side of one that is shown
LOOK = PictureConfig(width=TILE[0] * FINER, height=TILE[1] * FINER, oversampling=4, horizontal_fov_radians=0.55)
AZIMUTH, ELEVATION = np.radians(-22), np.radians(36)  # from the desk's front to its side, from level upwards
LEGS_M = 0.22  # of the desk below its top that are in the picture
LIGHT = (-0.45, -0.75, -0.5)  # towards it, in the camera's frame: the renderer's own
LIGHT_RADIUS, LIGHT_RAYS, SHADOW = 0.12, 64, 0.34

Parts = list[trimesh.Trimesh]
Array = NDArray[np.float64]


def six_desks(seed: int, place: str) -> bytes:
    """A JPEG of layouts 0 to 5 of a seed on the same desk, made in a lake at `place`, which is empty."""
    lake = Lake.open(f"{place}/lake")
    model = drawing_model(lake, MODEL)
    first = made(synthesize(lake, asked(lake, SceneRequest("desk", "office", SIZE)), model, count=1, seed=DESK_SEED, name="desk"))
    desk = SceneRequest(instance=f"{first[0]}/0000")
    scenes = made(synthesize(lake, asked(lake, desk), model, count=COUNT, seed=seed, name="layout"))
    reader = lake.snapshot()
    drawn = [placed(lake, reader, scene) for scene in scenes]
    camera = camera_of([part for parts in drawn for part in parts])
    rows = -(-COUNT // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * (TILE[0] + GAP_PX) - GAP_PX, rows * (TILE[1] + GAP_PX) - GAP_PX), (255, 255, 255))
    for number, (scene, parts) in enumerate(zip(scenes, drawn, strict=True)):
        row, column = divmod(number, COLUMNS)
        tile = picture(parts, reader.rows(Shell, scene)[0], camera)
        sheet.paste(tile, (column * (TILE[0] + GAP_PX), row * (TILE[1] + GAP_PX)))
    file = io.BytesIO()
    sheet.save(file, "JPEG", quality=88, optimize=True)
    return file.getvalue()


def made(result: Synthesized) -> list[str]:
    """Ids of scenes that were made.

    Raises:
        SystemExit: one was not.
    """
    for scene in result.failed:
        raise SystemExit(f"{scene.scene_id}: {scene.error}")
    return [scene.scene_id for scene in result.scenes]


def placed(lake: Lake, reader: Reader, scene_id: str) -> Parts:
    """What stands in a scene in the end."""
    placements = reader.rows(Placement, scene_id)
    assets = {row.asset_id: row for row in reader.rows_by_key(Asset, sorted({row.asset_id for row in placements}))}
    return [part for row in placements for part in placed_parts(row, lake.blobs[assets[row.asset_id].mesh_blob])]


def camera_of(parts: Sequence[trimesh.Trimesh]) -> Camera:
    """A camera close to the desk, in whose picture is all of its top and all that stands on it in any scene."""
    low, high = np.min([part.bounds[0] for part in parts], axis=0), np.max([part.bounds[1] for part in parts], axis=0)
    corners = [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (SIZE[2] - LEGS_M, SIZE[2])]
    above = [part.bounds[:, 2].max() > SIZE[2] + 0.01 for part in parts]
    tops = [corner for part, is_above in zip(parts, above, strict=True) if is_above for corner in trimesh.bounds.corners(part.bounds)]
    direction = np.array([np.cos(AZIMUTH) * np.cos(ELEVATION), np.sin(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION)])
    return fitting_camera(np.array([*corners, *tops]), np.array([0.0, 0.0, SIZE[2]]), direction, LOOK)


def picture(parts: Parts, room: Shell, camera: Camera) -> Image.Image:
    """A tile: things in their room, as the report pictures scenes, and the shadows that they cast."""
    shell = opened([part for _, part in room_shell(room)], RoomOutline.of_room(room), camera, LOOK)
    image = photograph([*shell, *parts], camera, LOOK) * (1.0 - SHADOW * shadows(parts, [*shell, *parts], camera)[..., None])
    return Image.fromarray(np.clip(np.round(image), 0, 255).astype(np.uint8)).resize(TILE, Image.Resampling.LANCZOS)


def shadows(casting: Parts, seen: Parts, camera: Camera) -> Array:
    """Share of the light that things keep from what the camera sees, shape (height, width): less where a face is turned aside."""
    rays = camera.rays()
    hits = RayScene(seen).cast(rays)
    normal = hits["primitive_normals"]
    normal = normal * -np.sign(np.einsum("hwk,hwk->hw", normal, rays[..., 3:]))[..., None]
    depth = np.where(np.isfinite(hits["t_hit"]), hits["t_hit"], 0.0)[..., None]
    points = rays[..., :3] + depth * rays[..., 3:] + 0.002 * normal
    light = camera.pose[:3, :3] @ np.array(LIGHT) / np.linalg.norm(LIGHT)
    across = np.cross(light, [0.0, 0.0, 1.0])
    sides = np.array([across / np.linalg.norm(across), np.cross(light, across) / np.linalg.norm(across)])
    scene, kept = RayScene(casting), np.zeros(depth.shape[:2])
    for index in range(LIGHT_RAYS):  # points of a sunflower: evenly over a disk
        angle, radius = index * np.pi * (3 - np.sqrt(5)), LIGHT_RADIUS * np.sqrt((index + 0.5) / LIGHT_RAYS)
        towards = light + radius * np.array([np.cos(angle), np.sin(angle)]) @ sides
        kept += np.isfinite(scene.cast(np.concatenate([points, np.broadcast_to(towards, points.shape)], axis=-1))["t_hit"])
    return np.asarray(kept / LIGHT_RAYS * np.clip(normal @ light, 0, None))
