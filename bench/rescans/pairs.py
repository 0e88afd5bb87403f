"""How well changes between rescans are found: generated rooms, changed by a rule that the stage does not know, scanned twice."""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench.selection.rooms import LIGHT
from schemas.capture import Instance, Scene
from schemas.rescans import Rescan, RescanObject
from tasks.capture import CaptureConfig, find_scans
from tasks.capture import run as capture
from tasks.furniture.furnishing import Furnishing, pieces_meet
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.geometry.transforms import inverse, matrix, yaw_of, yaw_pose
from tasks.mounting import mounting
from tasks.rescans import RescansConfig, run
from tasks.scanner import ScanTruth, scan_scene
from tasks.stage import Blobs, Context

CHANGED = ("moved", "added", "removed")
KEPT = {"moved": 2, "added": 2, "removed": 2}
"""Changes of each kind in a room."""

LEAST_M = 0.3
"""Of a move [m]: what people would say was moved."""

DOORS = frozenset({"door", "window"})


@dataclasses.dataclass(frozen=True)
class ScannedAgain:
    """A scan that was captured, and what is true of it: numbers of its objects by name, and its frame to the generator's, 4x4 [m]."""

    scene: Scene
    instances: Sequence[Instance]
    blobs: Mapping[str, bytes]
    names: Mapping[str, str]
    truth: ScanTruth


@dataclasses.dataclass(frozen=True)
class RescannedPair:
    """Two scans of a room, and what is true of each object that was changed, by its name."""

    earlier: ScannedAgain
    later: ScannedAgain
    changes: Mapping[str, str]


def changed(room: FurnishedRoom, rng: np.random.Generator) -> tuple[FurnishedRoom, FurnishedRoom, dict[str, str]]:
    """A room before and after changes: what carries nothing and is not part of the house is moved on the floor, taken away or brought."""
    carriers = {obj.parent for obj in room.objects}
    free = [obj for obj in room.objects if obj.name not in carriers and mounting(obj.category).kind not in ("ceiling", "frame")]
    free = [obj for obj in free if obj.category not in DOORS]
    order = [free[index] for index in rng.permutation(len(free))]
    changes: dict[str, str] = {}
    moved: dict[str, Furnishing] = {}
    for obj in order:
        if sum(kind == "moved" for kind in changes.values()) == KEPT["moved"]:
            break
        if obj.parent == "floor" and obj.category != "rug" and (place := _elsewhere(room, obj, rng)) is not None:
            changes[obj.name], moved[obj.name] = "moved", place
    for kind in ("added", "removed"):
        for obj in [obj for obj in order if obj.name not in changes][: KEPT[kind]]:
            changes[obj.name] = kind
    before = [obj for obj in room.objects if changes.get(obj.name) != "added"]
    after = [moved.get(obj.name, obj) for obj in room.objects if changes.get(obj.name) != "removed"]
    return dataclasses.replace(room, objects=before), dataclasses.replace(room, objects=after), changes


def _elsewhere(room: FurnishedRoom, obj: Furnishing, rng: np.random.Generator) -> Furnishing | None:
    """An object somewhere else on the floor where it meets nothing; None where no place was found."""
    from shapely.geometry import MultiPoint, Polygon

    floor = Polygon(room.polygon).buffer(-0.02)
    low, high = room.polygon.min(axis=0), room.polygon.max(axis=0)
    for _ in range(60):
        pose = yaw_pose(float(rng.uniform(-np.pi, np.pi)), [*rng.uniform(low, high), obj.pose[2, 3]])
        there = dataclasses.replace(obj, pose=pose)
        plan = MultiPoint(np.concatenate([part.vertices[:, :2] for part in there.world_parts()])).convex_hull
        if np.linalg.norm(pose[:2, 3] - obj.pose[:2, 3]) < LEAST_M or not floor.contains(plan):
            continue
        if not any(pieces_meet(there, other) for other in room.objects if other.name != obj.name and other.category != "rug"):
            return there
    return None


def scanned(room: FurnishedRoom, folder: Path, scan: str, rng: np.random.Generator) -> ScannedAgain:
    """A room, scanned in a frame of its own and captured."""
    truth = scan_scene(room, folder, scan, dataclasses.replace(LIGHT, axis_alignment=False), rng)
    scan_found = find_scans(folder / scan)[0][0]
    outcome = capture(scan=scan_found, context=Context(scan_found.scene_id, "capture", 0, Blobs()), config=CaptureConfig())
    names = {str(obj.object_id): obj.name for obj in truth.objects if obj.object_id is not None}
    return ScannedAgain(outcome.rows["scenes"][0], outcome.rows["instances"], outcome.blobs, names, truth)


def generated_pair(index: int, seed: int) -> RescannedPair:
    """Two scans of generated room number `index`."""
    rng = np.random.default_rng([seed, 22, index])
    room = furnish(ROOM_TYPES[index % len(ROOM_TYPES)], rng, object_count=20, clutter=0.2)
    before, after, changes = changed(room, rng)
    with tempfile.TemporaryDirectory(prefix="rescans-", ignore_cleanup_errors=True) as folder:
        scans = [scanned(each, Path(folder), f"scene{index:04d}_0{number}", rng) for number, each in enumerate((before, after))]
    return RescannedPair(scans[0], scans[1], changes)


@dataclasses.dataclass(frozen=True)
class PairFigures:
    """Of one pair. right, missed, false: Changes by kind; unnamed: changed objects that one of the scans does not name.

    turn_degrees, shift_m: Of the pose against the true one, over the floor. far_m: Largest error of a move's distance.
    """

    pair: str
    outcome: str
    turn_degrees: float
    shift_m: float
    right: Mapping[str, int]
    missed: Mapping[str, int]
    false: Mapping[str, int]
    unnamed: int
    unchanged: int
    not_seen: int
    far_m: float
    seconds: float
    notes: tuple[str, ...] = ()


def held(earlier: ScannedAgain, later: ScannedAgain) -> tuple[Rescan, list[RescanObject], float]:
    """What the stage says of two scans, and how long it took [s]."""
    blobs = Blobs()
    for each in (earlier, later):
        blobs.update(each.blobs)
    scenes = [later.scene, earlier.scene]
    context, clock = Context(later.scene.scene_id, "rescans", 0, blobs), time.perf_counter()
    names, instances = [scene.scene_id for scene in scenes], [*later.instances, *earlier.instances]
    outcome = run(rescanned_rooms=names, scenes=scenes, instances=instances, context=context, config=RescansConfig())
    return outcome.rows["rescans"][0], outcome.rows["rescan_objects"], time.perf_counter() - clock


def figures(pair: RescannedPair) -> PairFigures:
    """What was found of the changes of a pair."""
    row, objects, seconds = held(pair.earlier, pair.later)
    numbers = [{each.instance_id: scan.names.get(each.source_id, "") for each in scan.instances} for scan in (pair.earlier, pair.later)]
    known = [set(names.values()) for names in numbers]
    expected = {
        name: kind for name, kind in pair.changes.items()
        if (kind == "added" or name in known[0]) and (kind == "removed" or name in known[1])
    }  # fmt: skip
    right, false, far, notes = Counter[str](), Counter[str](), 0.0, []
    left = dict(expected)
    for each in objects:
        if each.change not in CHANGED:
            continue
        old, new = numbers[0].get(each.reference_instance_id or "", ""), numbers[1].get(each.instance_id or "", "")
        name = old or new
        is_one = each.change != "moved" or old == new
        if is_one and left.get(name) == each.change:
            right[left.pop(name)] += 1
            if each.change == "moved" and each.distance_m is not None:
                far = max(far, abs(each.distance_m - _distance(pair, name)))
        else:
            false[each.change] += 1
            notes.append(f"false {each.change}: {old or '-'} > {new or '-'} ({each.category}, {each.distance_m}, {each.turn_radians})")
    notes += [f"missed {kind}: {name}" for name, kind in left.items()]
    states = Counter(each.change for each in objects)
    turn, shift = _off(row, pair)
    return PairFigures(
        row.scene_id, row.outcome, turn, shift, dict(right), dict(Counter(left.values())), dict(false), len(pair.changes) - len(expected),
        states["unchanged"], states["not_seen"] + states["unnamed"], far, seconds, tuple(notes),
    )  # fmt: skip


def _distance(pair: RescannedPair, name: str) -> float:
    """How far an object's box was moved."""
    places = []
    for each in (pair.earlier, pair.later):
        obj = next(obj for obj in each.truth.objects if obj.name == name)
        places.append(matrix(obj.pose)[:3, 3])
    return float(np.linalg.norm(places[1] - places[0]))


def _off(row: Rescan, pair: RescannedPair) -> tuple[float, float]:
    """Turn [degrees] and shift in the middle of the room [m] by which a pose is off."""
    if row.pose is None:
        return float("nan"), float("nan")
    to_world = []
    for each in (pair.earlier, pair.later):  # captured frame to the generator's
        to_world.append(matrix(each.truth.alignment) @ inverse(matrix(each.scene.alignment)))
    off = to_world[0] @ matrix(row.pose) @ inverse(to_world[1])
    middle = np.array([*np.mean(pair.earlier.truth.polygon, axis=0), 0.0, 1.0])
    return float(abs(np.degrees(yaw_of(off)))), float(np.linalg.norm((off @ middle - middle)[:2]))


def main() -> None:
    """Print a JSON line for each pair, then the sums, and what was said of pairs of different rooms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sums = {"right": Counter[str](), "missed": Counter[str](), "false": Counter[str]()}
    earlier: list[ScannedAgain] = []
    for index in range(options.pairs):
        pair = generated_pair(index, options.seed)
        earlier.append(pair.earlier)
        measured = figures(pair)
        print(json.dumps(dataclasses.asdict(measured)), flush=True)
        for key, counter in sums.items():
            counter.update(getattr(measured, key))
    other_rooms = [(a, b) for i, a in enumerate(earlier) for b in earlier[:i]]
    refused = [held(a, b)[0].outcome == "refused" for a, b in other_rooms]
    print(json.dumps({key: dict(counter) for key, counter in sums.items()} | {"other_rooms": len(other_rooms), "refused": sum(refused)}))


if __name__ == "__main__":
    main()
