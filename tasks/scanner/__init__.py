"""A virtual scanner: walks through a furnished scene, records noisy RGB-D frames, and writes a scan as ScanNet lays it out.

The scan says nothing that a real one would not say. What is true lies beside its folder, in `<scan>.truth.json`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.furniture.rooms import FurnishedRoom
from tasks.geometry.meshes import Surface
from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import flat, inverse, transform_points
from tasks.scanner.folder import LICENSE, write_aggregation, write_exported, write_mesh, write_metadata, write_segments, write_sens
from tasks.scanner.fusion import fuse
from tasks.scanner.route import plan_views, targets_of
from tasks.scanner.scenery import Paint, Scenery, SceneryObject, scenery_of
from tasks.scanner.segments import segment
from tasks.scanner.sensor import Shot, drift, scan_frame, shoot

Array = NDArray[np.float64]

__all__ = ["ScanTruth", "ScannerConfig", "TrueObject", "scan_scene"]


@dataclasses.dataclass(frozen=True)
class ScannerConfig:
    """How a scene is walked, recorded, fused and written."""

    depth_width: int = 320  # a quarter of the pixels of a structured-light sensor: enough for 2 cm voxels, four times faster
    depth_height: int = 240
    color_width: int = 320  # as the depth: one cast of rays serves both; 640 x 480 is possible
    color_height: int = 240
    fov_radians: float = 1.02  # 58.4 degrees, the horizontal field of view of a Structure sensor
    min_range_m: float = 0.4  # nearer, such a sensor finds no match
    max_range_m: float = 4.5  # farther, its noise exceeds the voxels
    depth_noise_m: float = 0.0012  # standard deviation near the sensor (Khoshelham and Elberink, 2012)
    depth_noise_per_m: float = 0.0008  # growth with the square of the distance: 0.0019 of one frame, fewer frames than a real walk has
    edge_jump: float = 0.04  # a jump of more than 4 % of the depth is an edge, where the sensor mixes two surfaces
    edge_dropout: float = 0.3  # a third of the pixels there get no depth
    speckle_dropout: float = 0.002  # and a few anywhere
    grazing_cosine: float = 0.08  # below about 5 degrees the pattern smears
    color_noise: float = 2.0  # of 255, an indoor exposure
    exposure_spread: float = 0.02  # automatic exposure wanders by some percent
    drift_m: float = 0.01  # what is left of a tracker's drift after loop closure
    drift_radians: float = 0.005  # 0.3 degrees, likewise
    tilt_radians: float = 0.04  # the scan frame's z is gravity as the device felt it, off by a degree or two
    eye_low_m: float = 1.2  # a scanner held low ...
    eye_high_m: float = 1.8  # ... and at the eyes
    pitches_degrees: tuple[float, ...] = (-40.0, -15.0, 10.0)  # floor and tops, furniture, upper walls
    yaws: int = 9  # every 40 degrees: neighboring views overlap by a third
    body_radius_m: float = 0.3  # a person needs that much around
    standpoint_spacing_m: float = 0.55  # a step
    standpoint_limit: int = 400  # a floor of 150 m2; more would only slow the choice down
    target_spacing_m: float = 0.12  # points that ask to be seen: coarser than furniture's parts, finer than furniture
    target_least: int = 60  # per object, so that a mug counts
    looks_wanted: float = 3.0  # full-quality looks per point, after which another averages no more than noise
    least_gain: float = 0.02  # of the first view's: the walk ends when views add less
    view_limit: int = 600  # a house
    voxel_m: float = 0.02  # the resolution of ScanNet's cleaned meshes
    truncation_voxels: float = 2.5  # 5 cm: a chair's leg is thinner than what lies between its two sides otherwise
    least_looks: float = 2.0  # a surface that only one frame saw may be a flying pixel
    speck_faces: int = 150  # smaller islands float in the air
    segment_threshold: float = 0.01  # as in the names of ScanNet's segment files
    segment_least: int = 20  # vertices per segment, likewise
    segment_color_weight: float = 0.35  # paint parts objects that geometry does not: a book on a table
    segment_owner_weight: float = 0.3  # how much a person's clean-up keeps segments from crossing objects
    owner_reach_m: float = 0.06  # a vertex farther from every true surface is nobody's
    least_vertices: int = 30  # an instance with fewer is not annotated: about 100 cm2
    least_share: float = 0.05  # nor one of which less has been seen
    scene_type: str = ""  # `sceneType` of the text file; a furnished room states its own
    frames: Literal["exported", "sens", "none"] = "exported"  # folders of files open anywhere
    axis_alignment: bool = True  # False omits it, as scans outside the annotated ones do
    aggregation: Literal["plain", "vh_clean"] = "plain"  # `<scan>.aggregation.json` or `<scan>_vh_clean.aggregation.json`
    prefix: str = ""  # before ids inside the JSON files: `scannet.` in released ones
    lost_poses: int = 0  # frames at which tracking was lost: their poses are -inf


@dataclasses.dataclass(frozen=True)
class TrueObject:
    """What is true of one object. pose: Object to world, 4x4 row by row [m], origin at the box's bottom center.

    object_id: Its number in the aggregation, None when it was not seen enough. observed: Share of its surface, within
    0..1, that the fused mesh covers to 5 cm.
    """

    name: str
    category: str
    object_id: int | None
    pose: tuple[float, ...]
    extents: tuple[float, float, float]
    parent: str
    observed: float


@dataclasses.dataclass(frozen=True)
class ScanTruth:
    """What is true of a scan. alignment: Scan frame to world, 4x4 row by row [m]; polygon: floor corners (x, y) [m], if known."""

    scan: str
    alignment: tuple[float, ...]
    room_type: str
    polygon: tuple[tuple[float, float], ...]
    height_m: float | None
    frame_count: int
    objects: tuple[TrueObject, ...]


def scan_scene(parts: FurnishedRoom | Sequence[Any], out: Path, scan: str, config: ScannerConfig, rng: np.random.Generator) -> ScanTruth:
    """Scan a scene in the world frame into the folder `<out>/<scan>`, and write what is true to `<out>/<scan>.truth.json`.

    `parts`: a furnished room, (node name, mesh) pairs, or meshes as `load_glb` gives them; floor at z = 0, +Z up, metres.
    The same scene, config and generator state write the same bytes.

    Raises:
        InputError: there is nothing to scan, nowhere to stand, or the folder is there already.
    """
    folder = out / scan
    if folder.exists():
        raise InputError(folder, "folder", "is there already", "remove it or choose another name")
    if config.color_width % config.depth_width or config.color_height * config.depth_width != config.depth_height * config.color_width:
        raise InputError("config", "color_width", "must be a whole multiple of depth_width", "use 320 x 240 or 640 x 480 color")
    scenery = scenery_of(parts)
    if scenery.room is not None and not config.scene_type:
        config = dataclasses.replace(config, scene_type=scenery.room.room_type.title())
    scene = RayScene(scenery.parts)
    targets = targets_of(scenery, config.target_spacing_m, config.target_least, rng)
    views = plan_views(scene, scenery, targets, config, rng)
    center = np.array([*targets.points.mean(axis=0)[:2], 0.0])
    to_scan = scan_frame(config, rng, center)
    paint = Paint(scene)
    offs = drift(len(views), config, rng)
    shots = [shoot(scene, paint, view, to_scan @ view @ off, config, rng) for view, off in zip(views, offs, strict=True)]
    surface = fuse(shots, config)
    alignment = inverse(to_scan)
    owner = owners(scenery, transform_points(surface.vertices, alignment), config.owner_reach_m)
    segments = segment(
        surface, config.segment_threshold, config.segment_least, config.segment_color_weight, owner, config.segment_owner_weight
    )
    observed = observed_shares(targets.points, targets.obj, len(scenery.objects), transform_points(surface.vertices, alignment))
    groups, object_ids = aggregate(scenery.objects, segments, owner, observed, config)
    poses = _written_poses(shots, config, rng)
    write_scan(folder, scan, config, shots, poses, surface, segments, groups, alignment)
    truth = _truth(scan, scenery, alignment, len(shots), observed, object_ids)
    (out / f"{scan}.truth.json").write_text(json.dumps(dataclasses.asdict(truth), indent=1))
    return truth


def owners(scenery: Scenery, points: Array, reach: float) -> NDArray[np.int64]:
    """Object whose true surface is nearest to each point [m], shape (n,); -1 where none is within `reach` [m]."""
    parts = [(np.asarray(part.vertices), np.asarray(part.faces)) for part in scenery.parts]
    corners = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    part_of = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])
    faces = np.concatenate([faces + at for (_, faces), at in zip(parts, corners[:-1], strict=True)])
    near = closest_points(np.concatenate([vertices for vertices, _ in parts]), faces, points)
    return np.where(near.distance <= reach, scenery.object_of[part_of[near.face]], -1)


def observed_shares(points: Array, obj: NDArray[np.int64], count: int, vertices: Array) -> Array:
    """Share of each object's surface points that have a mesh vertex within 5 cm, shape (count,)."""
    from scipy.spatial import cKDTree

    near = np.isfinite(cKDTree(vertices).query(points, distance_upper_bound=0.05)[0])
    total = np.bincount(obj, minlength=count)
    return np.asarray(np.bincount(obj, near, minlength=count) / np.maximum(total, 1), dtype=np.float64)


def aggregate(
    objects: list[SceneryObject], segments: NDArray[np.int64], owner: NDArray[np.int64], observed: Array, config: ScannerConfig
) -> tuple[list[tuple[str, list[int]]], dict[int, int]]:
    """Instances as (label, segments): every segment goes to the object that most of its vertices are of.

    Returns:
        The instances that were seen enough, and the number of each of their objects among them.
    """
    ids, dense = np.unique(segments, return_inverse=True)
    votes = np.zeros((len(ids), len(objects) + 1), dtype=np.int64)
    np.add.at(votes, (dense, owner), 1)
    winner = votes.argmax(axis=1)
    sizes = np.bincount(dense)
    groups: list[tuple[str, list[int]]] = []
    numbers: dict[int, int] = {}
    for index, obj in enumerate(objects):
        mine = winner == index
        if sizes[mine].sum() < config.least_vertices or observed[index] < config.least_share:
            continue
        numbers[index] = len(groups)
        groups.append((obj.category, [int(v) for v in ids[mine]]))
    return groups, numbers


def _written_poses(shots: list[Shot], config: ScannerConfig, rng: np.random.Generator) -> list[Array]:
    """Poses as the scan states them: believed ones, -inf where tracking was lost."""
    poses = [shot.pose for shot in shots]
    for index in rng.permutation(len(poses))[: config.lost_poses]:
        poses[int(index)] = np.full((4, 4), -np.inf)
    return poses


def write_scan(
    folder: Path,
    scan: str,
    config: ScannerConfig,
    shots: list[Shot],
    poses: list[Array],
    surface: Surface,
    segments: NDArray[np.int64],
    groups: list[tuple[str, list[int]]],
    alignment: Array,
) -> None:
    """Write a scan into a new folder. poses: as the scan states them; groups: instances as (label, segments); alignment: scan to world."""
    folder.mkdir(parents=True)
    write_metadata(folder / f"{scan}.txt", config, len(shots), alignment if config.axis_alignment else None)
    write_mesh(folder / f"{scan}_vh_clean_2.ply", surface)
    segments_file = f"{scan}_vh_clean_2.0.010000.segs.json"
    write_segments(folder / segments_file, scan, config, segments)
    name = f"{scan}.aggregation.json" if config.aggregation == "plain" else f"{scan}_vh_clean.aggregation.json"
    write_aggregation(folder / name, scan, config, segments_file, groups)
    match config.frames:
        case "exported":
            write_exported(folder, config, shots, poses)
        case "sens":
            write_sens(folder / f"{scan}.sens", config, shots, poses)
        case "none":
            pass
    (folder / "LICENSE.txt").write_text(f"{LICENSE}\nMade by a virtual scanner from a generated or named scene.\n")


def _truth(scan: str, scenery: Scenery, alignment: Array, frames: int, observed: Array, numbers: dict[int, int]) -> ScanTruth:
    objects = tuple(
        TrueObject(
            name=obj.name,
            category=obj.category,
            object_id=numbers.get(index),
            pose=flat(obj.pose),
            extents=(float(obj.extents[0]), float(obj.extents[1]), float(obj.extents[2])),
            parent=obj.parent,
            observed=round(float(observed[index]), 4),
        )
        for index, obj in enumerate(scenery.objects)
    )
    room = scenery.room
    return ScanTruth(
        scan=scan,
        alignment=flat(alignment),
        room_type=room.room_type if room else "",
        polygon=tuple((float(x), float(y)) for x, y in room.polygon) if room else (),
        height_m=room.height if room else None,
        frame_count=frames,
        objects=objects,
    )
