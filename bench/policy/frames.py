"""The benchmark of cameras: pictures per second of one core, by the project's rasterizer, by rays, by MuJoCo and by pyrender."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.goals import goal
from bench.machine import machine
from bench.policy.renderers import RenderRequest, foreign_rates
from bench.realdata import HOUSE
from bench.replicas import as_drawn
from bench.rooms import scene_of_count
from bench.tables import add_row, as_text, goals_table, headline, table_of
from schemas.errors import InputError
from tasks import exports
from tasks.exports import ExportsConfig
from tasks.geometry.meshes import load_glb
from tasks.geometry.rendering import Camera, RayScene
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.simulation.cameras import camera_poses
from tasks.simulation.rasterizer import NEAR_M, Pictures, Rasterizer
from tasks.simulation.soups import soup_of
from tasks.stage import Context

if TYPE_CHECKING:
    import trimesh
    from rich.console import Console

Array = NDArray[np.float64]

HFOV = math.radians(79)
"""Field of view of ObjectNav's camera [rad]."""

HEIGHT_M = 0.88
"""Height of its camera [m]."""

CLEARANCE_M = 0.2
"""No camera is nearer to anything [m]: as wide as its robot."""

PICTURES_PER_SECOND = {"25 objects": {64: 8000.0, 256: 2000.0}, "house": {64: 2500.0}}
"""Pictures per second of one core that are wanted, by scene and size."""

EQUAL_PARTS, EQUAL_DEPTHS = 0.9999, 0.999
"""Shares of pixels that show the part that a ray meets, and its depth to a millimeter."""

RAYS_POSES = 8
"""Poses that rays are timed at: they take so long that the number does not matter."""


@dataclasses.dataclass(frozen=True)
class FramesBench:
    """What is measured. realdata: folder of the house, None for none."""

    objects: tuple[int, ...] = (25, 80)  # what a room of a scan has, and a full one
    sizes: tuple[int, ...] = (64, 128, 256)  # pixels of a side
    poses: int = 32  # as many as agents learn at once
    seconds: float = 4.0  # everything is repeated for so long, and the best round counts: others use the machine, too
    realdata: str | None = None
    seed: int = 0

    @property
    def scenes(self) -> int:
        """How many scenes are measured, for a progress bar."""
        return len(self.objects) + (self.realdata is not None)


@dataclasses.dataclass(frozen=True)
class BenchedScene:
    """A scene to look at. parts: World frame [m]. mjcf: The files of its export, the first of which is the scene; none for none."""

    name: str
    parts: Sequence[trimesh.Trimesh]
    mjcf: Mapping[str, bytes]


def measure_frames(config: FramesBench, advance: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Pictures per CPU second of one process, by scene, renderer and size of the picture, how they agree with rays, and goals.

    Raises:
        InputError: the house is not where it should be.
    """
    scenes, goals = [], []
    for scene in benched_scenes(config):
        figures = _measured(scene, config)
        scenes.append(figures)
        for size, limit in PICTURES_PER_SECOND.get(scene.name, {}).items():
            rate = figures["rates"]["rasterizer"].get(str(size))
            goals.append(goal(f"{scene.name}: pictures of {size} px per second", rate, ">=", limit))
        goals.append(goal(f"{scene.name}: share of pixels with the part that a ray meets", figures["equal_parts"], ">=", EQUAL_PARTS))
        goals.append(goal(f"{scene.name}: share of pixels with its depth to 1 mm", figures["equal_depths"], ">=", EQUAL_DEPTHS))
        advance()
    return {"machine": machine(), **dataclasses.asdict(config), "scenes": scenes, "goals": goals}


def benched_scenes(config: FramesBench) -> Iterator[BenchedScene]:
    """Furnished rooms with everything where the generator put it, and the house."""
    for count in config.objects:
        scene = scene_of_count(count, config.seed)
        rows, blobs = as_drawn(scene)
        meshes = {asset.asset_id: blobs[asset.mesh_blob] for asset in rows["assets"]}
        parts = [mesh for _, mesh in room_shell(rows["shells"][0])]
        for placement in sorted(rows["placements"], key=lambda row: row.instance_id):
            parts += placed_parts(placement, meshes[placement.asset_id])
        tables = {table: rows.get(table, []) for table in exports.STAGE.reads}
        made = exports.run(
            **tables, context=Context(scene.scene_id, "exports", config.seed, blobs), config=ExportsConfig(formats=("mjcf",))
        )
        files = sorted(made.rows["export_files"], key=lambda row: (not row.path.endswith("scene.xml"), row.path))
        yield BenchedScene(f"{count} objects", parts, {row.path: made.blobs[row.file_blob] for row in files})
    if config.realdata is not None:
        house = Path(config.realdata) / HOUSE
        if not house.is_file():
            raise InputError(config.realdata, "--realdata", f"holds no {HOUSE}", "name the folder that does, or leave the option out")
        yield BenchedScene("house", load_glb(house.read_bytes()), {})


def free_cameras(parts: Sequence[trimesh.Trimesh], count: int, seed: int) -> Array:
    """Cameras of robots at random places of a scene with room for one, between things, shape (count, 4, 4) [m].

    Raises:
        ValueError: there are no such places.
    """
    rays, rng = RayScene(parts), np.random.default_rng(seed)
    bounds = np.array([part.bounds for part in parts])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    angles = np.linspace(0.0, 2 * math.pi, 24, endpoint=False)
    around = np.array([[math.cos(a), math.sin(a), slope] for a in angles for slope in (-1.0, -0.3, 0.0, 0.3)])
    places: list[Array] = []
    for _ in range(1000 * count):
        x, y, yaw = rng.uniform([*low[:2], 0.0], [*high[:2], 2 * math.pi])
        origins = np.tile([x, y, HEIGHT_M], (len(around), 1))
        away = rays.cast(np.concatenate([origins, around], axis=1).astype(np.float32))["t_hit"]
        if away.min() > CLEARANCE_M and np.isfinite(away).mean() > 0.9:
            places.append(np.array([x, y, yaw]))
        if len(places) == count:
            return camera_poses(np.array(places), HEIGHT_M)
    raise ValueError(f"parts: have no {count} places with {CLEARANCE_M} m around them")


def seen_by_rays(rays: RayScene, camera: Camera) -> tuple[NDArray[np.int64], Array]:
    """Part of each pixel, -1 for none, and depth [m], 0 for none, shape (h, w) each: what rays meet beyond the near plane."""
    cast = camera.rays()
    cast[..., :3] += np.float32(NEAR_M) * cast[..., 3:]
    hits = rays.cast(cast)
    is_hit = np.isfinite(hits["t_hit"])
    depth = np.where(is_hit, hits["t_hit"].astype(np.float64) + NEAR_M, 0.0)
    return np.where(is_hit, hits["geometry_ids"].astype(np.int64), -1), depth


def _measured(scene: BenchedScene, config: FramesBench) -> dict[str, Any]:
    """Figures of one scene."""
    poses = free_cameras(scene.parts, config.poses, config.seed)
    soup, rays = soup_of(scene.parts), RayScene(scene.parts)
    clock = time.process_time()
    rasterizer = Rasterizer(soup)
    prepared = time.process_time() - clock
    rates: dict[str, dict[str, float]] = {"rasterizer": {}, "rasterizer, textured": {}, "rays": {}}
    equal = []
    for size in config.sizes:
        room = Pictures.empty(len(poses), size, size)
        draw = partial(rasterizer.render, poses, size, size, HFOV, room)
        for name, seconds in _best({"rasterizer": partial(draw, textured=False), "rasterizer, textured": draw}, config.seconds).items():
            rates[name][str(size)] = len(poses) / seconds
        cameras = [Camera.with_fov(pose, size, size, HFOV) for pose in poses]
        few = cameras[:RAYS_POSES]
        seconds = _best({"rays": partial(_each, rays.render, few)}, config.seconds)["rays"]
        rates["rays"][str(size)] = len(few) / seconds
        for index, camera in enumerate(cameras):
            part, depth = seen_by_rays(rays, camera)
            equal.append(((part == room.part[index]).mean(), (np.abs(depth - room.depth[index]) <= 1e-3).mean()))
    foreign, missing = foreign_rates(scene, RenderRequest(poses.tolist(), config.sizes, math.degrees(HFOV), config.seconds))
    parts, depths = np.mean(equal, axis=0)
    return {
        "scene": scene.name, "triangles": len(soup), "parts": len(scene.parts), "double_sided": float(soup.double_sided.mean()),
        "prepare_seconds": prepared, "equal_parts": float(parts), "equal_depths": float(depths), "rates": rates | foreign,
        "missing": missing,
    }  # fmt: skip


def _each(render: Callable[[Camera], object], cameras: Sequence[Camera]) -> None:
    for camera in cameras:
        render(camera)


def _best(ways: Mapping[str, Callable[[], object]], seconds: float) -> dict[str, float]:
    """CPU seconds of the best of the rounds that fit into some seconds, in which each is done once, after one that warms up."""
    best = dict.fromkeys(ways, math.inf)
    for do in ways.values():
        do()
    end = time.perf_counter() + seconds
    while max(best.values()) == math.inf or time.perf_counter() < end:
        for name, do in ways.items():
            clock = time.process_time()
            do()
            best[name] = min(best[name], time.process_time() - clock)
    return best


def print_frames(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables."""
    console.print(headline(report["machine"], report["seed"], 1))
    console.print(frames_table(report))
    console.print(goals_table(report["goals"]))


def frames_table(report: Mapping[str, Any]) -> Any:
    """Pictures per second, and how often they take as long as the rasterizer's."""
    sizes = [str(size) for size in report["sizes"]]
    columns = [(f"{size} px", True) for size in sizes]
    table = table_of("pictures per CPU second, and how many times as many the rasterizer draws", ("", False), ("by", False), *columns)
    for scene in report["scenes"]:
        for name, rates in scene["rates"].items():
            own = scene["rates"]["rasterizer"]
            cells = [f"{as_text(round(rates[size]), '')} ({own[size] / rates[size]:.1f})" for size in sizes]
            add_row(table, scene["scene"], name, *cells)
        for name, reason in scene["missing"].items():
            add_row(table, scene["scene"], f"{name}: {reason}", *[""] * len(sizes))
    return table
