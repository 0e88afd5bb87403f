"""What is right and wrong with a replica of a dwelling, by what is true: every free object counts, also what was left out."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.dwellings.openings import SEEN, open_shares, silhouettes
from bench.dwellings.replicas import BenchReplica, FirstHits
from schemas.capture import Room
from tasks.furniture import canonical_category
from tasks.furniture.dwellings import Dwelling
from tasks.geometry.transforms import matrix
from tasks.mounting import mounting
from tasks.scanner import TrueObject
from tasks.scanner.truth import DwellingObject, DwellingTruth

Array = NDArray[np.float64]

FAR_M = (0.15, 0.3)
"""Objects that moved, or are off, by more than these are counted [m]."""

COLLIDER_M = 0.03
"""Colliders farther from the visual surface than this [m] are counted, seams apart."""

BATCH = 25
"""Seconds are told for so many objects."""

FIGURES: tuple[tuple[str, str, str], ...] = (
    ("objects", "objects in truth", "count"),
    ("free", "of these free", "count"),
    ("annotated_share", "free objects that the scan's annotation has", "percent"),
    ("stable_1cm", "free objects stable at 1 cm", "percent"),
    ("stable_5cm", "free objects stable at 5 cm", "percent"),
    ("stable_nudged", "free objects stable after nudges", "percent"),
    ("annotated_1cm", "of those that the annotation has, stable at 1 cm", "percent"),
    ("annotated_5cm", "of those that the annotation has, stable at 5 cm", "percent"),
    ("annotated_nudged", "of those that the annotation has, after nudges", "percent"),
    ("unseen_objects", "free objects that the scan does not show at all", "count"),
    ("anchored", "free objects that were fixed (without failed rooms)", "count"),
    ("anchored_share", "share of the annotated free objects that were fixed", "percent"),
    ("rugs", "rugs and mats", "count"),
    ("rugs_5cm", "of them placed, and fixed or stable at 5 cm", "percent"),
    ("left_out", "free objects left out", "count"),
    ("fitted_left_out", "fitted objects left out", "count"),
    ("object_f_5cm", "F-score over objects at 5 cm, mean of rooms", "score"),
    ("object_completeness_5cm", "completeness of objects at 5 cm, mean of rooms", "score"),
    ("unexplained_share", "surface of objects that no asset explains", "percent"),
    ("deep_pairs", "pairs deeper than 2 mm (without failed rooms)", "count"),
    ("moved_15cm", "objects moved by more than 15 cm from the scan (of a failed room all)", "count"),
    ("moved_30cm", "by more than 30 cm", "count"),
    ("moved_share", "share of the placed objects that moved by more than 15 cm", "percent"),
    ("collider_far_share", "share whose collider is more than 3 cm from what is seen", "percent"),
    ("off_15cm", "objects more than 15 cm off the truth (of a failed room all)", "count"),
    ("off_30cm", "more than 30 cm", "count"),
    ("openings", "doors and windows to be seen", "count"),
    ("silhouette", "of their silhouette seen, mean", "percent"),
    ("openings_seen", "of them seen to 80 %", "percent"),
    ("ways", "openings without a door", "count"),
    ("ways_open", "of them open to 80 %", "percent"),
    ("categories_right", "categories right of the objects placed", "percent"),
    ("true_rooms", "rooms of the dwellings", "count"),
    ("rooms_found", "rooms found", "count"),
    ("rooms_right", "rooms right: floors share 80 % of what they cover", "percent"),
    ("unseen", "surface that the scan lacks", "percent"),
    ("regions_per_object", "regions per object where labels are left out", "score"),
    ("optimization_cpu_per_25", "CPU seconds of the optimization per 25 objects", "seconds"),
    ("seconds_per_25", "seconds per 25 objects", "seconds"),
)
"""Key of a figure, what a person reads, and its unit."""

SHOWN = 0.03
"""An object of which the scan has less of the surface is not in it: no pipeline can place it."""

RIGHT = 0.8
"""A room whose floor has so much in common with the true one's, of what either covers, is that room."""

SHARES: Mapping[str, str] = {
    "annotated_share": "free", "stable_1cm": "free", "stable_5cm": "free", "stable_nudged": "free", "silhouette": "openings",
    "openings_seen": "openings", "categories_right": "placed", "rooms_right": "true_rooms", "unseen": "rooms", "seconds_per_25": "objects",
    "object_f_5cm": "rooms", "unexplained_share": "rooms",
    "moved_share": "placed",
    "collider_far_share": "placed", "object_completeness_5cm": "rooms", "anchored_share": "annotated", "ways_open": "ways",
    "regions_per_object": "rooms", "optimization_cpu_per_25": "objects",
    "rugs_5cm": "rugs", "annotated_1cm": "annotated", "annotated_5cm": "annotated", "annotated_nudged": "annotated",
}  # fmt: skip
"""Figures that are means over rooms, and what each room counts by."""


def judged(
    index: int,
    has_frames: bool,
    home: Dwelling,
    truth: DwellingTruth,
    replica: BenchReplica,
    seconds: Mapping[str, float],
    cpu: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Figures of a room. seconds, cpu: by stage; regions of the scan without its labels are added by the caller."""
    source = {row.source_id: name for name, row in replica.instances.items()}
    best = standing_for(truth)
    names = {name: source[str(object_id)] for name, (object_id, _) in standing_for(truth, source).items()}
    placed = {name: instance for name, instance in names.items() if instance in replica.placements}
    free = [obj for obj in truth.objects if obj.is_free]
    verdicts = [_verdict(placed.get(obj.name), replica) for obj in free]
    moved_to = replica.true_to_world(matrix(truth.alignment))
    rugs = [obj for obj in truth.objects if is_rug(obj)]
    lying = [_lies(placed.get(obj.name), replica) for obj in rugs]
    off = [offset(obj, placed[obj.name], replica, moved_to) for obj in truth.objects if obj.name in placed]
    # how far the optimization took an object from where the scan shows it
    rows = [replica.placements[name] for name in placed.values()]
    moved = [math.hypot(row.displacement_m or 0.0, row.lift_m or 0.0) for row in rows]
    stands_for = parts_of(truth, source)
    drawn = FirstHits([(name.partition("|")[0], mesh) for name, mesh in home.furnished.named_parts()])
    hits = FirstHits(replica.parts)
    shares, ways = silhouettes(truth, drawn, hits, stands_for, moved_to), open_shares(truth, drawn, hits, moved_to)
    fixed = [name for name in (obj.name for obj in free) if name in placed and replica.supports[placed[name]].is_fixed]
    in_annotation = [verdict for obj, verdict in zip(free, verdicts, strict=True) if obj.name in best]
    right = [is_same(replica.instances[placed[obj.name]].category, obj.category) for obj in truth.objects if obj.name in placed]
    total = pipeline_seconds(seconds)
    fidelity = replica.fidelity
    return {
        "room": f"room_{index:04d}",
        "has_frames": has_frames,
        "stage": "",
        "error": None,
        "rooms": 1,
        "objects": len(truth.objects),
        "free": len(free),
        "placed": len(placed),
        "annotated_share": mean([obj.name in best for obj in free]),
        "stable_1cm": mean([v[0] for v in verdicts]),
        "stable_5cm": mean([v[1] for v in verdicts]),
        "stable_nudged": mean([v[2] for v in verdicts]),
        "annotated": len(in_annotation),
        "annotated_1cm": mean([v[0] for v in in_annotation]),
        "annotated_5cm": mean([v[1] for v in in_annotation]),
        "annotated_nudged": mean([v[2] for v in in_annotation]),
        "unseen_objects": sum(obj.observed < SHOWN for obj in free),
        "anchored": len(fixed),
        "anchored_share": len(fixed) / len(in_annotation) if in_annotation else math.nan,
        "rugs": len(rugs),
        "rugs_5cm": mean(lying),
        "left_out": sum(obj.name not in placed for obj in free),
        "fitted_left_out": sum(obj.name not in placed for obj in truth.objects if not obj.is_free),
        "deep_pairs": replica.optimization.deep_pairs if replica.optimization else math.nan,
        "object_f_5cm": (fidelity.object_f_5cm or 0.0) if fidelity else math.nan,
        "object_completeness_5cm": (fidelity.object_completeness_5cm or 0.0) if fidelity else math.nan,
        "unexplained_share": fidelity.unexplained_share if fidelity and fidelity.unexplained_share is not None else math.nan,
        "moved_15cm": sum(far > FAR_M[0] for far in moved),
        "moved_30cm": sum(far > FAR_M[1] for far in moved),
        "moved_share": mean([far > FAR_M[0] for far in moved]),
        "collider_far_share": mean([(row.collider_distance_m or 0.0) > COLLIDER_M for row in rows]),
        "off_15cm": sum(far > FAR_M[0] for far in off),
        "off_30cm": sum(far > FAR_M[1] for far in off),
        "openings": len(shares),
        "silhouette": mean(shares),
        "openings_seen": mean([share >= SEEN for share in shares]),
        "ways": len(ways),
        "ways_open": mean([share >= SEEN for share in ways]),
        "categories_right": mean(right),
        "true_rooms": len(truth.rooms),
        "rooms_found": len(replica.rooms),
        "rooms_right": mean([share >= RIGHT for share in shared_floors(truth, replica.rooms, moved_to)]),
        "unseen": truth.unseen,
        "regions_per_object": math.nan,
        "optimization_cpu_per_25": BATCH * cpu["optimization"] / max(len(truth.objects), 1) if cpu else math.nan,
        "seconds": total,
        "seconds_per_25": BATCH * total / max(len(truth.objects), 1),
        "stages": dict(seconds),
    }


def standing_for(truth: DwellingTruth, captured: Container[str] | None = None) -> dict[str, tuple[int, float]]:
    """The instance that stands for each true object: of those that hold more of it than of anything else, the one with the most; only
    those `captured`, by their ids in the scan, which may be named as another part of the object."""
    best: dict[str, tuple[int, float]] = {}
    for instance in truth.instances:
        if not instance.objects or (captured is not None and str(instance.object_id) not in captured):
            continue
        name, share = instance.objects[0]
        weight = share * instance.segment_count
        if name not in best or weight > best[name][1]:
            best[name] = (instance.object_id, weight)
    return best


def parts_of(truth: DwellingTruth, captured: Mapping[str, str]) -> dict[str, set[str]]:
    """Instances that are annotated as a true object, alone or with others, by its name; also those that capture set apart of such an
    annotation, which is `21.1` beside `21`. captured: instances by their ids in the scan."""
    parts: dict[str, set[str]] = {}
    for instance in truth.instances:
        own = {name for object_id, name in captured.items() if object_id.partition(".")[0] == str(instance.object_id)}
        for held, share in instance.objects:
            if own and share > 0.3:
                parts.setdefault(held, set()).update(own)
    return parts


def _verdict(instance: str | None, replica: BenchReplica) -> tuple[bool, bool, bool]:
    """Whether a free object holds still at 1 cm, at 5 cm, and after nudges; left out or fixed it does not."""
    row = replica.certificates.get(instance) if instance is not None else None
    if instance is None or row is None or replica.supports[instance].is_fixed or row.is_fixed:
        return False, False, False
    return bool(row.is_stable_1cm), bool(row.is_stable_5cm), bool(row.is_stable_nudged)


def _lies(instance: str | None, replica: BenchReplica) -> bool:
    """True if a rug is placed, and fixed or stable at 5 cm."""
    row = replica.certificates.get(instance) if instance is not None else None
    return bool(row is not None and (row.is_fixed or row.is_stable_5cm))


def is_rug(obj: DwellingObject) -> bool:
    """True if an object lies flat to be stood upon: it counts as fastened, and as free only where the truth says so."""
    return mounting(obj.category).kind == "covering"


def offset(obj: DwellingObject | TrueObject, instance: str, replica: BenchReplica, moved: Array) -> float:
    """Distance of the middle of a placed asset's box from that of the true object [m]."""
    row = replica.placements[instance]
    asset = replica.assets[row.asset_id]
    own = matrix(row.optimized_pose) @ [0.0, 0.0, 0.5 * asset.extents[2] * row.scale[2], 1.0]
    true = moved @ matrix(obj.pose) @ [0.0, 0.0, 0.5 * obj.extents[2], 1.0]
    return float(np.linalg.norm(own[:3] - true[:3]))


def shared_floors(truth: DwellingTruth, rooms: Sequence[Room], moved: Array) -> list[float]:
    """Of each true room the largest share that its floor and a found one's have in common of what either covers. moved: from the frame
    of the truth to the replica's world, 4x4 [m]."""
    import shapely

    own_floors = [shapely.Polygon(room.floor_polygon) for room in rooms]
    shares = []
    for room in truth.rooms:
        corners = np.column_stack([np.array(room.polygon), np.zeros(len(room.polygon))])
        floor = shapely.Polygon((corners @ moved[:3, :3].T + moved[:3, 3])[:, :2])
        shares.append(max((float(floor.intersection(own).area / floor.union(own).area) for own in own_floors), default=0.0))
    return shares


def is_same(category: str, true: str) -> bool:
    """Whether two categories are one, by the generator's names."""
    return (canonical_category(category) or category) == (canonical_category(true) or true)


def lost_room(
    index: int, has_frames: bool, home: Dwelling, stage: str, error: str, truth: DwellingTruth | None = None,
    seconds: Mapping[str, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Figures of a room that failed: nothing of it holds still, nothing is seen, everything is left out, and counts as moved and off
    by more than any distance. Deep pairs, objects that were fixed, categories and seconds nobody knows: NaN, so that sums are those
    of the other rooms."""
    free = sum(obj.name not in home.fitted for obj in home.objects)
    openings = sum(o.instance is not None for o in home.openings)
    ways = sum(o.opening.kind == "passage" for o in home.openings)
    total = pipeline_seconds(seconds or {})
    held = len([obj for obj in truth.objects if obj.is_free and obj.name in standing_for(truth)]) if truth else free
    unseen = len([obj for obj in truth.objects if obj.is_free and obj.observed < SHOWN]) if truth else 0
    rugs = len([obj for obj in truth.objects if is_rug(obj)]) if truth else 0
    return {
        "room": f"room_{index:04d}", "has_frames": has_frames, "stage": stage, "error": error, "rooms": 1, "objects": len(home.objects),
        "free": free, "placed": 0, "annotated_share": math.nan, "stable_1cm": 0.0, "stable_5cm": 0.0, "stable_nudged": 0.0,
        "anchored": math.nan, "annotated": held, "annotated_1cm": 0.0, "annotated_5cm": 0.0, "annotated_nudged": 0.0,
        "unseen_objects": unseen, "rugs": rugs, "rugs_5cm": 0.0 if rugs else math.nan, "left_out": free,
        "fitted_left_out": len(home.objects) - free, "deep_pairs": math.nan,
        "object_f_5cm": 0.0, "object_completeness_5cm": 0.0, "unexplained_share": 1.0, "anchored_share": math.nan, "moved_share": math.nan,
        "collider_far_share": math.nan,
        "moved_15cm": len(home.objects), "moved_30cm": len(home.objects), "off_15cm": len(home.objects), "off_30cm": len(home.objects),
        "openings": openings, "silhouette": 0.0, "openings_seen": 0.0, "ways": ways, "ways_open": 0.0, "categories_right": math.nan,
        "true_rooms": len(home.plan.rooms), "rooms_found": math.nan, "rooms_right": 0.0,
        "unseen": truth.unseen if truth else math.nan, "regions_per_object": math.nan,
        "optimization_cpu_per_25": math.nan, "seconds": total, "seconds_per_25": math.nan, "stages": dict(seconds or {}),
    }  # fmt: skip


def summed(rooms: Sequence[Mapping[str, Any]]) -> dict[str, float | int]:
    """Figures of several rooms: counts added, shares over all that they are shares of. What is NaN of a room does not count;
    what is NaN of all stays NaN."""
    totals: dict[str, float | int] = {"rooms": len(rooms), "failed": sum(room["error"] is not None for room in rooms)}
    for key, _, _ in FIGURES:
        if key in SHARES:
            known = [(float(room[key]), float(room[SHARES[key]])) for room in rooms if not math.isnan(room[key])]
            weight = sum(w for _, w in known)
            totals[key] = sum(v * w for v, w in known) / weight if weight else math.nan
        else:
            counts = [int(room[key]) for room in rooms if not math.isnan(room[key])]
            totals[key] = sum(counts) if counts else math.nan
    return totals


def pipeline_seconds(seconds: Mapping[str, float]) -> float:
    """Seconds of all stages but the one that measures."""
    return sum(taken for stage, taken in seconds.items() if stage != "fidelity")


def mean(values: Sequence[float | bool]) -> float:
    """Mean, NaN of none."""
    return float(np.mean(values)) if len(values) else math.nan
