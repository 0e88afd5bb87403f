"""Storeys of generated houses against the truth: dwellings above one another, as drawn and seen on a walk, and as hard rooms; galleries."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.dwellings import make_scan
from bench.goals import goal
from tasks.capture.files.ply import read_ply
from tasks.capture.reading import Reading
from tasks.capture.rooms.alignment import align, rotation_to_z
from tasks.capture.storeys.levels import StoreyConfig, levels
from tasks.capture.storeys.pieces import storeys_of
from tasks.furniture.dwellings import dwelling
from tasks.geometry.meshes import Surface, surface_of, union_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import matrix, transform_points, yaw_pose
from tasks.geometry.triangles import face_areas, face_normals
from tasks.scanner.dwellings import HARD
from tasks.scanner.route import Targets, looks, standpoints
from tasks.scanner.scenery import STRUCTURE, Scenery, scenery_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

EVERY_HARD = 8
"""Of so many houses the last is made of hard rooms, which take a minute for each storey."""

MOST_STOREYS = 3
SLABS_M = (0.25, 0.45)
"""Between a ceiling and the floor above it."""

EDGE_M = 0.2
"""Longest edge of what was seen of a drawn dwelling."""

STOPS = 12
"""Of a walk through a dwelling, from which all is seen that is near and not hidden."""

NOISE_M, DRIFT_M, DRIFT = 0.004, 0.03, 0.003
"""Of vertices, and of a storey as a whole: moved, and turned [rad]."""

TILT = 0.02
"""Of the scan's frame, whose z axis is the gravity that the device felt [rad]."""

MISSING = 0.1
"""Share of patches of half a metre that nobody scanned."""

GALLERY = (0.2, 0.45)
"""Share of a hall that a gallery in it covers."""

NOBODYS = -1
"""Storey of what reaches from one to the next."""


@dataclasses.dataclass(frozen=True)
class House:
    """A house as it was scanned. surface: In the scan's own frame [m]. storey: Of each face, `NOBODYS` for stairs, shape (m,). middles: Of
    the slabs above the lowest floor, shape (n - 1,), and how thick they are [m]."""

    kind: str
    surface: Surface
    storey: Integers
    middles: Array
    slabs: Array


@dataclasses.dataclass(frozen=True)
class HouseScore:
    """What was made of a house. storeys, counted: How many it has, and how many were found. off_m: How far the cuts are from the middles of
    their slabs, at worst, and beside_m from the slabs; None where not as many were found. lost: Share of the surface that no storey has.
    misplaced: Share that is in another storey than its own."""

    kind: str
    storeys: int
    counted: int
    off_m: float | None
    beside_m: float | None
    lost: float
    misplaced: float
    seconds: float


def storeys_report(houses: int, seed: int) -> dict[str, Any]:
    """Figures of generated houses, by kind."""
    scores = []
    with tempfile.TemporaryDirectory(prefix="houses-", ignore_cleanup_errors=True) as temporary:
        for index in range(houses):
            scores.append(scored(made_house(Path(temporary), index, seed)))
    rows = [_row(kind, storeys, scores) for kind, storeys in sorted({(score.kind, score.storeys) for score in scores})]
    return {
        "rows": rows,
        "goals": [
            goal("storeys: houses divided right [share]", _share([score.counted == score.storeys for score in scores]), ">=", 0.95),
            goal("storeys: cut beside its slab at worst [m]", _most([score.beside_m for score in scores]), "<=", 0.05),
            goal("storeys: surface lost at worst [share]", _most([score.lost for score in scores]), "<=", 1e-6),
            goal("storeys: surface in another storey at worst [share]", _most(
                [score.misplaced for score in scores if score.counted == score.storeys]), "<=", 0.02),
        ],
    }  # fmt: skip


def _row(kind: str, storeys: int, scores: Sequence[HouseScore]) -> dict[str, Any]:
    own = [score for score in scores if (score.kind, score.storeys) == (kind, storeys)]
    right = [score for score in own if score.counted == storeys]
    return {
        "kind": kind, "storeys": storeys, "houses": len(own), "right": len(right), "off_m": _most([score.off_m for score in right]),
        "beside_m": _most([score.beside_m for score in right]), "lost": _most([score.lost for score in own]),
        "misplaced": _most([score.misplaced for score in right]), "seconds": sum(score.seconds for score in own) / len(own),
    }  # fmt: skip


def _share(values: Sequence[bool]) -> float | None:
    return sum(values) / len(values) if values else None


def _most(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) if known else None


def scored(house: House) -> HouseScore:
    """What is found in a house, leveled as capture does it, and how it is divided."""
    clock = time.process_time()
    pose = align(house.surface).pose
    parted = levels(house.surface.transformed(pose), StoreyConfig())
    pieces = [storey.reading.surface for storey in storeys_of(Reading(house.surface), [], pose, parted)]
    seconds = time.process_time() - clock
    areas = face_areas(house.surface.vertices, house.surface.faces)
    divided = sum(float(face_areas(piece.vertices, piece.faces).sum()) for piece in pieces if piece is not None)
    height = transform_points(house.surface.vertices[house.surface.faces].mean(axis=1), pose)[:, 2]
    is_off = (parted.storey_of(height) != house.storey) & (house.storey != NOBODYS)
    off = beside = None
    if len(parted.cuts) == len(house.middles):
        away = np.abs(np.array(parted.cuts) - parted.floors[0] - house.middles)
        off, beside = float(away.max(initial=0.0)), float(np.maximum(away - house.slabs / 2, 0.0).max(initial=0.0))
    return HouseScore(
        house.kind, len(house.middles) + 1, len(parted.floors), off, beside, abs(1.0 - divided / float(areas.sum())),
        float(areas[is_off].sum() / areas.sum()), seconds,
    )  # fmt: skip


def made_house(folder: Path, index: int, seed: int) -> House:
    """House `index` of a seed; hard rooms are scanned below a folder. The same arguments give the same house."""
    rng = np.random.default_rng([seed, index, 3])
    count = 1 + index % MOST_STOREYS
    is_hard = index % EVERY_HARD == EVERY_HARD - 1
    if count == 1 and not is_hard and index % 2:
        return _as_scanned("gallery", [_gallery((seed, index), rng)], [], rng)
    if is_hard:
        storeys = [_hard(folder / str(index), MOST_STOREYS * index + number, seed) for number in range(count)]
    else:
        storeys = [_seen(_dwelling((seed, index, number)), rng) for number in range(count)]
    heights = [float(np.percentile(storey.vertices[:, 2], 99.9)) for storey in storeys]
    return _as_scanned("hard rooms" if is_hard else "dwellings", storeys, heights, rng)


def _as_scanned(kind: str, storeys: Sequence[Surface], heights: Sequence[float], rng: np.random.Generator) -> House:
    """Storeys above one another in one scan, with stairs, drift and what nobody scanned. heights: Of their ceilings [m]."""
    slabs = rng.uniform(*SLABS_M, len(storeys) - 1)
    floors = np.concatenate([[0.0], np.cumsum(np.array(heights[:-1]) + slabs)]) if len(storeys) > 1 else np.zeros(1)
    parts, owners = [], []
    for number, (storey, floor) in enumerate(zip(storeys, floors, strict=True)):
        middle = storey.bounds.mean(axis=0)
        turn = yaw_pose(float(rng.integers(4)) * np.pi / 2 + float(rng.normal(0, DRIFT)), [0.0, 0.0, floor])
        turn[:3, 3] += rng.uniform(-DRIFT_M, DRIFT_M, 3) * (number > 0)
        turn[2, :2] = rng.normal(0, DRIFT / 2, 2)
        moved = storey.transformed(turn @ np.block([[np.eye(3), -np.array([[middle[0]], [middle[1]], [0.0]])], [np.zeros((1, 3)), 1.0]]))
        for below in (number - 1, number):  # the well of stairs, in the floor and in the ceiling
            if 0 <= below < len(storeys) - 1:
                moved = _without(moved, floors[below] + 0.3, floors[below + 1] + 0.1, heights[below])
        parts.append(moved)
        owners.append(np.full(len(moved.faces), number))
        if number:
            flight = _stairs(float(floors[number - 1]), float(floors[number]))
            parts.append(flight)
            owners.append(np.full(len(flight.faces), NOBODYS))
    whole, owner = union_of(parts), np.concatenate(owners)
    patch = np.unique(np.floor(2 * whole.vertices[whole.faces].mean(axis=1)).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    kept = rng.random(int(patch.max()) + 1)[patch] >= MISSING
    vertices = whole.vertices + rng.normal(0.0, NOISE_M, whole.vertices.shape)
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_to_z(np.array([*rng.uniform(-TILT, TILT, 2), 1.0]))
    scan = Surface(vertices, whole.faces[kept], whole.colors).transformed(yaw_pose(float(rng.uniform(0, 6.28)), [3.0, -2.0, 0.7]) @ tilt)
    return House(kind, scan, owner[kept].astype(np.int64), floors[1:] - slabs / 2, slabs)


WELL = (-1.5, 1.5, -0.5, 0.5)
"""Of the stairs in the middle of a house, seen from above [m]."""


def _without(surface: Surface, low: float, high: float, height: float) -> Surface:
    """A surface without what is level within the well of stairs: the ceiling and the floor that they pass."""
    centers, normals = surface.vertices[surface.faces].mean(axis=1), face_normals(surface.vertices, surface.faces)
    inside = (centers[:, 0] > WELL[0]) & (centers[:, 0] < WELL[1]) & (centers[:, 1] > WELL[2]) & (centers[:, 1] < WELL[3])
    passed = inside & (np.abs(normals[:, 2]) > 0.7) & (centers[:, 2] > low + height - 0.5) & (centers[:, 2] < high)
    return dataclasses.replace(surface, faces=surface.faces[~passed])


def _stairs(start: float, end: float) -> Surface:
    """A straight flight of treads in the well [m]."""
    count = round((end - start) / 0.18)
    deep = (WELL[1] - WELL[0]) / count
    corners = []
    for k in range(count):
        x, z = WELL[0] + k * deep, start + (k + 1) * (end - start) / count
        corners.append([(x, WELL[2], z), (x + deep, WELL[2], z), (x + deep, WELL[3], z), (x, WELL[3], z)])
    first = 4 * np.arange(count)[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int64)
    vertices = np.array(corners, dtype=np.float64).reshape(-1, 3)
    return Surface(vertices, faces, np.full((len(vertices), 3), 120, dtype=np.uint8))


def _dwelling(seed: tuple[int, ...]) -> Scenery:
    return scenery_of(dwelling(seed).furnished)


def _gallery(seed: tuple[int, ...], rng: np.random.Generator) -> Surface:
    """A dwelling whose walls are twice as high, with a gallery over a part of it that carries furniture of another one."""
    import trimesh

    home, other = _dwelling((*seed, 0)), _dwelling((*seed, 1))
    tall = []
    for part, number in zip(home.parts, home.object_of, strict=True):
        copy = part.copy()
        if home.objects[number].category in STRUCTURE:
            copy.apply_scale([1.0, 1.0, 2.05])
        tall.append(copy)
    low, high = np.array([part.bounds for part in tall]).min(axis=(0, 1)), np.array([part.bounds for part in tall]).max(axis=(0, 1))
    rise = float(home.room.height if home.room is not None else 2.5)
    end = high[1] - float(rng.uniform(*GALLERY)) * (high[1] - low[1])
    slab = trimesh.creation.box(bounds=[[low[0], end, rise - 0.2], [high[0], high[1], rise]])
    above = []
    for part, number in zip(other.parts, other.object_of, strict=True):
        copy = part.copy()
        copy.apply_translation([*(-other.parts[0].bounds.mean(axis=0)[:2] + [(low[0] + high[0]) / 2, (end + high[1]) / 2]), rise])
        bounds = copy.bounds
        if other.objects[number].category not in STRUCTURE and bounds[0, 1] > end and bounds[1, 1] < high[1]:
            above.append(copy)
    parts = [*tall, slab, *above]
    objects = np.concatenate([home.object_of, np.zeros(1 + len(above), dtype=np.int64)])
    return _seen(Scenery(parts, objects, home.objects, home.room), rng)


def _seen(scenery: Scenery, rng: np.random.Generator) -> Surface:
    """What a walk shows of a scene, in small triangles."""
    import trimesh

    scene = RayScene(scenery.parts)
    refined = []
    for part in scenery.parts:
        vertices, faces = trimesh.remesh.subdivide_to_size(np.asarray(part.vertices), np.asarray(part.faces), EDGE_M, max_iter=12)
        refined.append(trimesh.Trimesh(vertices, faces, process=False))
    whole = surface_of(refined)
    centers = whole.vertices[whole.faces].mean(axis=1)
    targets = Targets(centers, face_normals(whole.vertices, whole.faces), np.zeros(len(centers), np.int64), np.ones(len(centers)))
    config = dataclasses.replace(HARD, max_range_m=6.0)
    eyes = standpoints(scene, scenery, config, rng)
    shown = np.zeros(len(centers), dtype=np.bool_)
    for eye in rng.permutation(eyes)[:STOPS]:
        shown[looks(scene, targets, eye, config)[0]] = True
    return dataclasses.replace(whole, faces=whole.faces[shown])


def _hard(folder: Path, index: int, seed: int) -> Surface:
    """A hard room as its scan has it, in the world frame. index: Odd numbers are scanned without frames, which are not read here."""
    truth = make_scan(folder, 2 * index + 1, seed)
    mesh = folder / truth.scan / f"{truth.scan}_vh_clean_2.ply"
    return read_ply(mesh, mesh.name).surface.transformed(matrix(truth.alignment))
