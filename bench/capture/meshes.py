"""Instances of bare meshes against the truth: hard rooms without their labels, by this code and the former one, and a drawn house."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.capture.former import FormerScan, former_scans, has_former
from bench.capture.truth import matches
from bench.dwellings import has_frames, make_scan
from bench.goals import goal
from tasks.capture.files.ply import read_ply
from tasks.capture.formats import find_scans, format_of
from tasks.capture.instances.segmentation import SegmentationConfig, geometry_instances
from tasks.capture.reading import Group
from tasks.capture.rooms.alignment import align
from tasks.furniture.dwellings import dwelling
from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import matrix, transform_points
from tasks.geometry.triangles import face_areas
from tasks.scanner import owners
from tasks.scanner.dwellings import HARD
from tasks.scanner.scenery import STRUCTURE, scenery_of
from tasks.scanner.truth import DwellingTruth

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ROOM = frozenset({"geometry:floor", "geometry:wall", "geometry:ceiling"})
"""Labels of what is part of a room, and of no instance."""

PIECE = 0.1
"""Of an object in a region, from which on it is a piece of the object."""

WANTED, WANTED_LOOSELY, MOST_REGIONS, MOST_SHARE, WANTED_DEGREES, WANTED_M = 1 / 3, 2 / 3, 4.0, 0.1, 1.0, 0.01
"""Of the objects that are found at an IoU of 0.5 and of 0.25, regions for an object, share of the surface in one, and how far off the floor
may be."""

REACH_M = 0.05
"""Between a vertex and the nearest one of another surface of the same frames, to be of the same thing: two voxels and a tracker's drift."""

HOUSE = Path("scene_aws_small_house", "house.glb")
"""Below the folder of real data: a house that somebody drew, whose nodes have names."""


@dataclasses.dataclass(frozen=True)
class MeshScore:
    """Of a mesh, or of several. objects: That are counted. regions: Found. half, quarter: Objects with a region of their own at an IoU of
    0.5 and of 0.25. in_pieces: Objects of which more than four regions have a tenth or more each. largest: Share of the surface in the
    largest region. degrees, off_m: How far the floor is off, at worst; None where it is not known."""

    objects: int
    regions: int
    half: int
    quarter: int
    in_pieces: int
    largest: float
    degrees: float | None
    off_m: float | None
    seconds: float

    def __add__(self, other: MeshScore) -> MeshScore:
        return MeshScore(
            self.objects + other.objects, self.regions + other.regions, self.half + other.half, self.quarter + other.quarter,
            self.in_pieces + other.in_pieces, max(self.largest, other.largest), _worst(self.degrees, other.degrees),
            _worst(self.off_m, other.off_m), self.seconds + other.seconds,
        )  # fmt: skip


def _worst(a: float | None, b: float | None) -> float | None:
    known = [value for value in (a, b) if value is not None]
    return max(known) if known else None


@dataclasses.dataclass(frozen=True)
class BareRoom:
    """A hard room as a scan that names nothing. mesh: Its file. folder: The same as a folder of ScanNet, for code that reads no other; of
    a room with frames, these alone. vertices: Of the mesh, scan frame [m], shape (n, 3). owner: Of each, -1 for nobody's, shape (n,).
    counted: Objects that the scan shows enough of. areas: Of each vertex [m2], shape (n,). floor: Those that are truly the floor's, shape
    (k,)."""

    mesh: Path
    folder: Path
    vertices: Array
    owner: Indices
    counted: Indices
    areas: Array
    floor: Indices
    truth: DwellingTruth


def meshes_report(rooms: int, seed: int, realdata: Path | None) -> dict[str, Any]:
    """Figures of hard rooms and, where it is there, of the drawn house."""
    with tempfile.TemporaryDirectory(prefix="meshes-", ignore_cleanup_errors=True) as temporary:
        place = Path(temporary)
        bare = [bare_room(place / "rooms", 2 * index + 1, seed) for index in range(rooms)]
        rows = [("hard rooms", "now", summed([score_now(room) for room in bare]))]
        if has_former():
            former = former_scans([room.folder for room in bare], place / "former")
            rows.insert(0, ("hard rooms", "before", summed([score_former(room, scan) for room, scan in zip(bare, former, strict=True)])))
    now = rows[-1][2]
    house = realdata / HOUSE if realdata is not None else None
    if house is not None and house.is_file():
        rows.append(("drawn house", "now", score_house(house)))
    return {
        "rows": [{"material": material, "code": code, "rooms": rooms} | dataclasses.asdict(score) for material, code, score in rows],
        "goals": [
            goal("bare meshes: objects at IoU 0.5 [share]", now.half / max(now.objects, 1), ">=", WANTED),
            goal("bare meshes: objects at IoU 0.25 [share]", now.quarter / max(now.objects, 1), ">=", WANTED_LOOSELY),
            goal("bare meshes: regions for an object", now.regions / max(now.objects, 1), "<=", MOST_REGIONS),
            goal("bare meshes: largest region [share of the surface]", now.largest, "<=", MOST_SHARE),
            goal("bare meshes: floor off at worst [degrees]", now.degrees, "<=", WANTED_DEGREES),
            goal("bare meshes: floor off at worst [m]", now.off_m, "<=", WANTED_M),
        ],
    }


def bare_room(folder: Path, number: int, seed: int) -> BareRoom:
    """A hard room of `metascenes bench rooms` of a seed, with its labels withheld; every other one is scanned with frames, the first, too,
    and then its mesh lies beside its folder."""
    truth = make_scan(folder, number, seed)
    scan = folder / truth.scan
    for path in [*scan.glob("*.json"), *scan.glob("*.txt")]:
        path.unlink()  # labels, segments, alignment
    ply = scan / f"{truth.scan}_vh_clean_2.ply"
    mesh = folder / f"bare_{number:04d}.ply"
    mesh.write_bytes(ply.read_bytes())
    surface = read_ply(ply, ply.name).surface
    if has_frames(number):
        ply.unlink()
    scenery = scenery_of(dwelling((seed, number)).furnished)
    owner = owners(scenery, transform_points(surface.vertices, matrix(truth.alignment)), HARD.owner_reach_m)
    observed = {obj.name: obj.observed for obj in truth.objects}
    shown = np.bincount(owner[owner >= 0], minlength=len(scenery.objects))
    counted = [
        number
        for number, obj in enumerate(scenery.objects)
        if obj.category not in STRUCTURE and shown[number] >= HARD.least_vertices and observed.get(obj.name, 0.0) >= HARD.least_share
    ]
    areas = np.bincount(
        surface.faces.ravel(), weights=np.repeat(face_areas(surface.vertices, surface.faces) / 3, 3), minlength=len(surface.vertices)
    )
    is_floor = np.array([obj.category == "floor" for obj in scenery.objects])
    floor = np.flatnonzero((owner >= 0) & is_floor[owner])
    return BareRoom(mesh, scan, surface.vertices, owner, np.array(counted, dtype=np.int64), areas.astype(np.float64), floor, truth)


def score_now(room: BareRoom) -> MeshScore:
    """What this code finds in a room's mesh."""
    clock = time.perf_counter()
    region, pose = found_in(room.mesh, room.vertices)
    return room_score(room, region, pose, time.perf_counter() - clock)


def found_in(path: Path, vertices: Array) -> tuple[Indices, Array]:
    """Region of each vertex of a mesh that names nothing, -1 for none and for the room, shape (n,); and scan frame to world frame, 4x4.
    vertices: As the file has them [m], shape (n, 3); what is read has one at each place."""
    (scan,), _ = find_scans(path, "bare_mesh")
    reading = format_of(scan).read(scan)
    assert reading.surface is not None
    pose = align(reading.surface).pose
    by_surface = geometry_instances(reading.surface.transformed(pose), SegmentationConfig(), reading.materials)
    region = regions_of(by_surface.groups, len(reading.surface.vertices))
    return carried(region, reading.surface.vertices, vertices), pose


def regions_of(groups: Sequence[Group], count: int) -> Indices:
    """Number of the object that each vertex is of, from 0, -1 for none and for what is part of the room, shape (count,)."""
    region = np.full(count, -1, dtype=np.int64)
    for number, group in enumerate(group for group in groups if group.raw_label not in ROOM):
        region[group.vertices] = number
    return region


def carried(region: Indices, vertices: Array, onto: Array) -> Indices:
    """Regions of a surface's vertices, shape (n, 3), at other points of the same place, shape (m, 3): those of the nearest vertex, -1 where
    none is within `REACH_M`, shape (m,)."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(vertices).query(onto, distance_upper_bound=REACH_M)
    return np.where(np.isfinite(distance), region[np.minimum(nearest, len(region) - 1)], -1)


def score_former(room: BareRoom, scan: FormerScan) -> MeshScore:
    """What the former code found in the same scan; nothing where it failed."""
    if scan.failure:
        return MeshScore(len(room.counted), 0, 0, 0, 0, 0.0, None, None, scan.seconds)
    objects = [number for number, label in enumerate(scan.labels) if label not in ROOM]
    place = np.full(len(scan.labels) + 1, -1, dtype=np.int64)
    place[objects] = np.arange(len(objects))
    return room_score(room, carried(place[scan.owner], scan.vertices, room.vertices), scan.pose, scan.seconds)


def room_score(room: BareRoom, region: Indices, pose: Array, seconds: float) -> MeshScore:
    """Figures of a room. region: Of its mesh's vertices, -1 for none and for what is part of the room, shape (n,). pose: Scan frame to what
    is taken for the world, 4x4 [m]."""
    score = mesh_score(room.owner, region, np.ones(len(region)), room.counted)
    share = np.bincount(region[region >= 0], weights=room.areas[region >= 0]).max(initial=0.0) / room.areas.sum()
    degrees = float(np.rad2deg(np.arccos(np.clip(pose[2, :3] @ matrix(room.truth.alignment)[2, :3], -1.0, 1.0))))
    off = abs(float(np.median(transform_points(room.vertices[room.floor], pose)[:, 2])))  # where the scan has it: drift moves all of it
    return dataclasses.replace(score, largest=float(share), degrees=degrees, off_m=off, seconds=seconds)


def mesh_score(owner: Indices, region: Indices, weights: Array, counted: Indices) -> MeshScore:
    """Regions against objects, by the weight of points. owner: Object of each point, -1 for nobody's, which say nothing, shape (n,). found:
    Region of each, -1 for none, shape (n,). counted: Objects that count."""
    regions, objects = int(region.max(initial=-1)) + 1, int(owner.max(initial=-1)) + 1
    known = owner >= 0
    keys = owner[known] * (regions + 1) + np.where(region[known] >= 0, region[known], regions)
    table = np.bincount(keys, weights=weights[known], minlength=objects * (regions + 1)).reshape(objects, regions + 1)
    shared = table[counted][:, :regions]
    sizes = table[counted].sum(axis=1)
    overlap = shared / np.maximum(sizes[:, None] + table[:, :regions].sum(axis=0)[None, :] - shared, 1e-12)
    pieces = (shared >= PIECE * np.maximum(sizes, 1e-12)[:, None]).sum(axis=1)
    largest = float(np.bincount(region[region >= 0], weights=weights[region >= 0]).max(initial=0.0) / weights.sum())
    return MeshScore(
        len(counted), regions, matches(overlap, 0.5), matches(overlap, 0.25), int((pieces > MOST_REGIONS).sum()), largest, None, None, 0.0
    )


def score_house(path: Path) -> MeshScore:
    """What is found in a drawn house whose names are withheld, by surface; objects are what its author named, but for walls and floor."""
    clock = time.perf_counter()
    (scan,), _ = find_scans(path, "bare_mesh")
    reading = format_of(scan).read(scan)
    assert reading.surface is not None
    surface = reading.surface.transformed(align(reading.surface).pose)
    groups = geometry_instances(surface, SegmentationConfig(), reading.materials).groups
    seconds = time.perf_counter() - clock
    names = [str(part.metadata["name"]).split("|")[0] for part in load_glb(path.read_bytes()) for _ in part.faces]
    named, owner = np.unique(names, return_inverse=True)
    region = np.full(len(surface.faces), -1, dtype=np.int64)
    for number, group in enumerate(group for group in groups if group.raw_label not in ROOM):
        region[group.faces] = number
    counted = np.array([k for k, name in enumerate(named) if "Wall" not in name and "Floor" not in name], dtype=np.int64)
    return dataclasses.replace(mesh_score(owner, region, face_areas(surface.vertices, surface.faces), counted), seconds=seconds)


def summed(scores: Sequence[MeshScore]) -> MeshScore:
    """Of several together."""
    total = scores[0]
    for score in scores[1:]:
        total = total + score
    return total
