"""One virtual scan from start to end: walk, shoot, fuse, segment, write."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.fusion import FusionConfig, fused_surface
from tasks.capture.reading import FrameSource
from tasks.meshes import Surface, parse_node_name, surface_of
from tasks.rendering import RayScene, open3d
from tasks.scanner import folder
from tasks.scanner.config import ScannerConfig
from tasks.scanner.segments import segments
from tasks.scanner.sensor import Shot, camera_at, drifted, shoot
from tasks.scanner.walk import camera_poses
from tasks.transforms import flat, inverse, translation, yaw_pose

if TYPE_CHECKING:
    import trimesh

MAX_STRAY_M = 0.05
"""A fused vertex farther than this from every true surface belongs to nothing."""

MIN_OBJECT_VERTICES = 40
"""An object of fewer fused vertices was not seen well enough for anybody to annotate it."""

STRUCTURE_WORDS = (("floor", "floor"), ("ceil", "ceiling"), ("window", "window"), ("door", "door"), ("wall", "wall"))
"""Words in a node's category that make it part of the shell, whatever else the word says (`housewallb` is a wall)."""


@dataclasses.dataclass(frozen=True)
class ScannedObject:
    """The truth about one object: name and label, box in the world frame [m], pose where it is known, and how much of it
    was seen: share of its surface near the fused mesh."""

    name: str
    label: str
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    pose: tuple[float, ...] | None
    observed_share: float
    is_annotated: bool


@dataclasses.dataclass(frozen=True)
class ScanTruth:
    """The truth about a scan: its objects, and the scan frame to the world frame, 4x4 row by row [m]."""

    scan: str
    alignment: tuple[float, ...]
    objects: tuple[ScannedObject, ...]
    frame_count: int
    floor_polygon: tuple[tuple[float, ...], ...] | None = None


def scan_scene(
    parts: Sequence[trimesh.Trimesh],
    out: Path,
    scan: str,
    config: ScannerConfig,
    rng: np.random.Generator,
    poses: Mapping[str, NDArray[np.float64]] | None = None,
    scene_type: str = "",
    license: str = "CC0-1.0",
) -> ScanTruth:
    """Scan a furnished scene and write `<out>/<scan>/`, and its truth as `<out>/<scan>.truth.json`.

    Args:
        parts: Meshes in the world frame [m], floor at z = 0; `metadata["name"]` is `model|category|part`, or any name.
        out: Folder that the scan's folder is made in.
        scan: Name of the scan, as ScanNet has them: `scene0000_00`.
        config: Camera, walk, noise and file variants.
        rng: The same generator state gives the same bytes.
        poses: Object to world, 4x4 [m], by model, where it is known; written into the truth.
        scene_type: Kind of room for the text file; '' leaves the line out.
        license: First line of LICENSE.txt.

    Raises:
        ValueError: there is no free floor to walk on.
    """
    names = [parse_node_name(str(part.metadata.get("name", f"part {i}"))) for i, part in enumerate(parts)]
    scene = RayScene(parts)
    truth_surface = surface_of(parts)
    true_poses = camera_poses(scene, truth_surface, config, rng)
    scan_from_world = _scan_frame(config, rng)
    tracked = [scan_from_world @ pose for pose in drifted(true_poses, config, rng)]
    shots = [shoot(scene, pose, seen, config, rng) for pose, seen in zip(true_poses, tracked, strict=True)]
    lost = set(rng.choice(len(shots), size=min(config.unreadable_poses, len(shots) // 10), replace=False).tolist())
    fused, _ = fused_surface([_source(i, s, config) for i, s in enumerate(shots) if i not in lost], _fusion(config), scan)
    owners, labels = _owners(scene, names, fused, scan_from_world)
    owner = _annotated(owners, labels)
    place = out / scan
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    folder.write_mesh(place, scan, fused, segments(fused, owner), owner, labels, config)
    folder.write_text(place, scan, config, inverse(scan_from_world), len(shots), scene_type)
    folder.write_frames(place, scan, shots, lost, config)
    (place / "LICENSE.txt").write_text(license + "\n")
    truth = ScanTruth(
        scan, flat(inverse(scan_from_world)), _truth(parts, names, fused, owner, labels, scan_from_world, poses or {}), len(shots)
    )
    (out / f"{scan}.truth.json").write_text(json.dumps(dataclasses.asdict(truth), indent=1))
    return truth


def label_of(category: str) -> str:
    """Label of a node's category: the shell's by the words in it, else the category itself."""
    return next((label for word, label in STRUCTURE_WORDS if word in category.lower()), category)


def _fusion(config: ScannerConfig) -> FusionConfig:
    return FusionConfig(voxel_m=config.voxel_m, max_depth_m=config.max_range_m, max_frames=100_000, min_weight=1.5)


def _scan_frame(config: ScannerConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """World to scan frame: turned anyhow, leaning a little, its origin somewhere."""
    from scipy.spatial.transform import Rotation

    lean = np.eye(4)
    angle = rng.uniform(0, 2 * np.pi)
    lean[:3, :3] = Rotation.from_rotvec(config.tilt_radians * np.array([np.cos(angle), np.sin(angle), 0.0])).as_matrix()
    return np.asarray(translation(rng.uniform(-2, 2, 3)) @ lean @ yaw_pose(rng.uniform(-np.pi, np.pi)))


def _source(index: int, shot: Shot, config: ScannerConfig) -> FrameSource:
    """A shot as the fusion reads frames."""
    camera = camera_at(shot.pose, config)
    height, width = shot.depth.shape
    depth_intrinsics = folder.depth_intrinsics(camera)
    return FrameSource(
        frame_id=f"{index:06d}", color_file="", depth_file="", width=camera.width, height=camera.height,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy), depth_size=(width, height), depth_intrinsics=depth_intrinsics,
        depth_scale=1000.0, pose=shot.pose, color=lambda: shot.color, depth=lambda: (shot.depth / 1000).astype(np.float32),
    )  # fmt: skip


def _owners(
    scene: RayScene, names: Sequence[Mapping[str, str]], fused: Surface, scan_from_world: NDArray[np.float64]
) -> tuple[NDArray[np.int64], list[tuple[str, str]]]:
    """Object per fused vertex, shape (n,), -1 for none, and (model, label) per object."""
    keys = list(dict.fromkeys((n["model"], label_of(n["category"])) for n in names))
    of_part = np.array([keys.index((n["model"], label_of(n["category"]))) for n in names])
    world = (fused.vertices - scan_from_world[:3, 3]) @ scan_from_world[:3, :3]
    o3d = open3d()
    near = scene.raycaster.compute_closest_points(o3d.core.Tensor(world.astype(np.float32)))
    distance = np.linalg.norm(near["points"].numpy() - world, axis=1)
    owner = of_part[near["geometry_ids"].numpy().astype(np.int64)]
    return np.where(distance < MAX_STRAY_M, owner, -1), keys


def _annotated(owner: NDArray[np.int64], labels: Sequence[tuple[str, str]]) -> NDArray[np.int64]:
    """Owners without those of whom too little was seen."""
    count = np.bincount(owner[owner >= 0], minlength=len(labels))
    return np.where((owner >= 0) & (count[np.maximum(owner, 0)] >= MIN_OBJECT_VERTICES), owner, -1)


def _truth(
    parts: Sequence[trimesh.Trimesh],
    names: Sequence[Mapping[str, str]],
    fused: Surface,
    owner: NDArray[np.int64],
    labels: Sequence[tuple[str, str]],
    scan_from_world: NDArray[np.float64],
    poses: Mapping[str, NDArray[np.float64]],
) -> tuple[ScannedObject, ...]:
    from scipy.spatial import cKDTree

    from tasks.meshes import sample_surface

    world = (fused.vertices - scan_from_world[:3, 3]) @ scan_from_world[:3, :3]
    tree = cKDTree(world)
    rng = np.random.default_rng(0)
    found: list[Any] = []
    for index, (model, label) in enumerate(labels):
        own = [p for p, n in zip(parts, names, strict=True) if (n["model"], label_of(n["category"])) == (model, label)]
        surface = surface_of(own)
        points, _, _ = sample_surface(surface, 500, rng)
        distance, _ = tree.query(points, distance_upper_bound=0.04)
        pose = poses.get(model)
        low, high = ([float(v) for v in corner] for corner in surface.bounds)
        found.append(
            ScannedObject(
                name=model,
                label=label,
                bounds=(tuple(low), tuple(high)),
                pose=None if pose is None else flat(pose),
                observed_share=float(np.isfinite(distance).mean()),
                is_annotated=bool((owner == index).any()),
            )
        )
    return tuple(found)
