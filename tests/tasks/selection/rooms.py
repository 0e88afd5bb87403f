"""A room of scanned objects with their candidates, as the stages before selection leave it."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
import trimesh

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.record import check
from schemas.selection import Selection
from tasks.capture.files.images import encode_jpeg
from tasks.capture.instances.views import run_lengths, view_of
from tasks.geometry.meshes import canonical, dump_glb, dump_points, sample_surface, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import flat, look_at, transform_points, yaw_of, yaw_pose
from tasks.selection import SelectionConfig, run
from tasks.selection.methods.geometric import Geometric
from tasks.stage import Blobs, Context

GEOMETRIC = SelectionConfig(provider=Geometric())
SCENE = "test/room"
WOOD, GRAY, RED = (150, 105, 60), (120, 120, 125), (190, 40, 40)


def part(size: tuple[float, float, float], center: tuple[float, float, float], color: tuple[int, int, int] = WOOD) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size).subdivide()
    mesh.apply_translation(center)
    mesh.visual.vertex_colors = np.tile([*color, 255], (len(mesh.vertices), 1)).astype(np.uint8)
    return mesh


def chair(color: tuple[int, int, int] = WOOD) -> list[trimesh.Trimesh]:
    """Seat, four legs, a back at -x and one arm at +y: no symmetry in yaw."""
    legs = [part((0.04, 0.04, 0.44), (x, y, 0.22), color) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    return [
        *legs, part((0.46, 0.46, 0.05), (0, 0, 0.45), color), part((0.05, 0.46, 0.45), (-0.2, 0, 0.7), color),
        part((0.4, 0.05, 0.05), (0, 0.21, 0.66), color),
    ]  # fmt: skip


def table(color: tuple[int, int, int] = WOOD) -> list[trimesh.Trimesh]:
    legs = [part((0.06, 0.06, 0.7), (x, y, 0.35), color) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    return [*legs, part((0.46, 0.51, 0.04), (0, 0, 0.72), color)]


def cabinet(color: tuple[int, int, int] = WOOD) -> list[trimesh.Trimesh]:
    return [part((0.46, 0.46, 0.92), (0, 0, 0.46), color)]


def shelf(color: tuple[int, int, int] = WOOD) -> list[trimesh.Trimesh]:
    """Open at +x."""
    boards = [part((0.3, 0.8, 0.02), (0, 0, z), color) for z in (0.01, 0.5, 1.0, 1.49)]
    sides = [part((0.3, 0.02, 1.5), (0, y, 0.75), color) for y in (-0.39, 0.39)]
    return [*boards, *sides, part((0.02, 0.8, 1.5), (-0.14, 0, 0.75), color)]


class Room:
    """Instances, candidates and assets under construction, with the blobs they name."""

    def __init__(self) -> None:
        self.blobs = Blobs()
        self.instances: list[Instance] = []
        self.candidates: list[Candidate] = []
        self.assets: dict[str, Asset] = {}
        self.captions: list[Caption] = []
        self.frames: list[Frame] = []
        self.masks: list[Mask] = []

    def asset(self, parts: list[trimesh.Trimesh], name: str, provider: str = "library", watertight: bool = False) -> str:
        data = dump_glb(canonical(parts))
        asset_id = hashlib.sha256(data).hexdigest()
        surface = surface_of(canonical(parts))
        self.assets[asset_id] = Asset(
            asset_id=asset_id, provider=provider, name=name, category=name, source="test", license="CC0-1.0", author=None,
            mesh_blob=self.blobs.add(data, "glb"), pieces_blob=None, extents=tuple(map(float, surface.bounds[1] - surface.bounds[0])),
            volume_m3=1.0, is_watertight=watertight, vertex_count=len(surface.vertices), face_count=len(surface.faces),
            open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
        )  # fmt: skip
        return asset_id

    def instance(self, points: np.ndarray, colors: np.ndarray, yaw: float, category: str = "thing", structure: bool = False) -> Instance:
        """An instance whose box is the box of its points, turned by `yaw`."""
        local = transform_points(points, yaw_pose(-yaw))
        low, high = local.min(axis=0), local.max(axis=0)
        center = transform_points([(low + high) / 2], yaw_pose(yaw))[0]
        row = Instance(
            scene_id=SCENE, instance_id=f"{len(self.instances):04d}", source_id="1", raw_label=category, category=category, nyu40_id=0,
            nyu40_label="unlabeled", is_structure=structure, found_by=None, category_probability=None,
            room_index=None, box_pose=flat(yaw_pose(yaw, center)),
            box_size=tuple(map(float, high - low)),
            box_volume_m3=float(np.prod(high - low)), hidden_m=None, point_count=len(points),
            points_blob=self.blobs.add(dump_points(points, colors), "ply"), mesh_blob=None, view_blob=None, best_frames=(),
        )  # fmt: skip
        self.instances.append(row)
        return row

    def candidate(self, instance: Instance, slot: int, asset_id: str | None, provider: str = "library") -> None:
        outcome = "filled" if asset_id else "empty"
        self.candidates.append(
            Candidate(
                scene_id=SCENE, instance_id=instance.instance_id, slot=slot, provider=provider, provider_version="1", is_fallback=False,
                outcome=outcome, reason=None if asset_id else "nothing", asset_id=asset_id, seed=None, call_id=None,
                library=None, library_file=None, library_score=None,
                twin_of=None, seen_share=None, seconds=None,
            )
        )  # fmt: skip

    def select(self, config: SelectionConfig | None = None, seed: int = 0, **more: Any) -> tuple[list[Selection], tuple[str, ...]]:
        context = more.pop("context", None) or Context(scene_id=SCENE, stage="selection", seed=seed, blobs=self.blobs)
        outcome = run(
            instances=self.instances, candidates=self.candidates, assets=list(self.assets.values()), captions=self.captions,
            frames=self.frames, masks=self.masks, context=context, config=config or GEOMETRIC, **more,
        )  # fmt: skip
        rows = outcome.rows["selections"]
        check(rows, Selection)
        return rows, outcome.degradations


def scan(
    parts: list[trimesh.Trimesh],
    pose: np.ndarray,
    scale: tuple[float, float, float],
    rng: np.random.Generator,
    noise: float = 0.006,
    view: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What a scanner saw: points whose normals face the half space of direction `view` [rad] or up, with noise; never undersides."""
    placed = surface_of(canonical(parts)).transformed(pose, scale)
    points, colors, normals = sample_surface(placed, 6000, rng)
    seen = normals[:, 2] > -0.5
    if view is not None:
        seen &= (normals @ [np.cos(view), np.sin(view), 0.6]) > -0.1
    return (points + rng.normal(0, noise, points.shape))[seen], colors[seen]


def yaw_error(pose: np.ndarray, truth: np.ndarray) -> float:
    return abs(float(np.degrees(np.angle(np.exp(1j * (yaw_of(pose) - yaw_of(truth)))))))


def photographed(
    room: Room, instance: Instance, parts: list[trimesh.Trimesh], pose: np.ndarray, eye: tuple[float, float, float]
) -> tuple[Instance, Frame, Mask]:
    """An instance with the crop of a frame that sees its parts, and that frame, from an eye [m] in the world frame."""
    placed = [part.copy() for part in canonical(parts)]
    for each in placed:
        each.apply_transform(pose)
    middle = np.mean([each.bounds.mean(axis=0) for each in placed], axis=0)
    camera = Camera.with_fov(look_at(eye, middle), 640, 480, 1.0)
    drawn = RayScene(placed).render(camera, background=(90, 110, 90))
    rows, columns = np.flatnonzero((drawn.part >= 0).any(axis=1)), np.flatnonzero((drawn.part >= 0).any(axis=0))
    box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    frame = Frame(
        scene_id=SCENE, frame_id=f"{int(instance.instance_id):06d}", color_file="0.jpg", depth_file=None, width=640, height=480,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy), depth_scale=1000.0, pose=flat(camera.pose),
        pose_source="file",
    )  # fmt: skip
    silhouette = drawn.part[box[1] : box[3], box[0] : box[2]] >= 0
    mask = Mask(
        scene_id=SCENE, frame_id=frame.frame_id, instance_id=instance.instance_id, found_by="surface",
        pixel_box=box, pixel_count=int(silhouette.sum()),
        visible_share=1.0, score=1.0, run_lengths=run_lengths(silhouette),
    )  # fmt: skip
    view = room.blobs.add(encode_jpeg(view_of(drawn.color, box), 256), "jpg")
    seen = dataclasses.replace(instance, view_blob=view, best_frames=(frame.frame_id,))
    room.instances[room.instances.index(instance)] = seen
    room.frames.append(frame)
    room.masks.append(mask)
    return seen, frame, mask


def photographed_chair() -> Room:
    """A room with one red chair, seen by one frame."""
    made, pose = Room(), yaw_pose(0.4)
    points, colors = scan(chair(RED), pose, (1, 1, 1), np.random.default_rng(0))
    photographed(made, made.instance(points, colors, 0.4, category="chair"), chair(RED), pose, (2.4, 1.3, 1.6))
    return made
