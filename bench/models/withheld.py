"""Rooms that are scanned whole, as people walk, and whose files do not name what is small: what capture finds of it; and what it adds where
everything is named."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance
from tasks import capture
from tasks.capture.scan import Scan
from tasks.capture.small_objects import additions
from tasks.capture.small_objects.additions import SmallObjectsConfig, Unsought
from tasks.capture.small_objects.classical import PROVIDER, ClassicalConfig, Found, found_objects
from tasks.capture.small_objects.lifting import DepthView
from tasks.capture.small_objects.supports import SupportSlab, support_kind
from tasks.furniture.rooms import furnish
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import inverse, matrix, transform_points
from tasks.scanner import ScannerConfig, ScanTruth, TrueObject, scan_scene
from tasks.stage import Context, Outcome

Array = NDArray[np.float64]

Finder = Callable[[Sequence[DepthView], Sequence[SupportSlab], ClassicalConfig], Found]
"""Who finds what stands on a support's boards in frames, as `found_objects` does."""

ROOM_TYPES = ("office", "living room", "bedroom", "kitchen")

OBJECTS = 25
"""Of a room, large and small."""

NEAR_M = 0.02
"""Points are those of an object from whose points they are no farther [m]: the mesh of a scan has one every 2 cm."""

LEAST_SHARE = 0.5
"""Of an object's points at those of what is found, times the share the other way round: it is that one."""


@dataclasses.dataclass(frozen=True)
class WithheldFigures:
    """What rooms came to. withheld: Small objects that the annotation had. back: Those of them that are found again. added: What is found
    then. beside: What is found beside a whole annotation; unnamed: of these, true objects that were seen too little to be annotated;
    doubled: those that are annotated. seconds, without: Of a processor, for a scan with and without looking for small objects."""

    rooms: int
    withheld: int
    back: int
    added: int
    beside: int
    unnamed: int
    doubled: int
    seconds: float
    without: float


def withheld_figures(rooms: int, first_seed: int, finder: Finder = found_objects) -> WithheldFigures:
    """What capture finds in generated rooms. finder: Stands in the place of the classical member's search on a support."""
    with mock.patch.object(additions, "found_objects", finder):
        figures = [_room(first_seed, number) for number in range(rooms)]
    return WithheldFigures(rooms, *(sum(each) for each in zip(*figures, strict=True)))


def _room(seed: int, number: int) -> tuple[float, ...]:
    rng = np.random.default_rng([seed, 11, number])
    with tempfile.TemporaryDirectory(prefix="withheld-") as name:
        folder = Path(name)
        furnished = furnish(ROOM_TYPES[number % len(ROOM_TYPES)], rng, OBJECTS)
        truth = scan_scene(furnished, folder, "scene", ScannerConfig(), rng)
        (scan,), _ = capture.find_scans(folder / "scene", "auto")
        plain, without = _captured(scan, seed, capture.CaptureConfig(small_objects=SmallObjectsConfig(provider=Unsought())))
        whole, seconds = _captured(scan, seed, capture.CaptureConfig())
        small = _small(truth)
        annotation = next((folder / "scene").glob("*aggregation.json"))
        document = json.loads(annotation.read_text())
        document["segGroups"] = [group for group in document["segGroups"] if group["objectId"] not in small]
        annotation.write_text(json.dumps(document))
        bare, _ = _captured(scan, seed, capture.CaptureConfig())
    clouds = _clouds(plain)
    true = [clouds[row.instance_id] for row in plain.rows["instances"] if row.source_id in {str(each) for each in small}]
    of_bare = _clouds(bare)
    added = [of_bare[row.instance_id] for row in _found(bare)]
    beside = [_owner(row, _clouds(whole)[row.instance_id], truth) for row in _found(whole)]
    unnamed = sum(owner is not None and owner.object_id is None for owner in beside)
    doubled = sum(owner is not None and owner.object_id is not None for owner in beside)
    return len(true), _matched(true, added), len(added), len(beside), unnamed, doubled, seconds, without


def _captured(scan: Scan, seed: int, config: capture.CaptureConfig) -> tuple[Outcome, float]:
    start = time.process_time()
    outcome = capture.run(scan=scan, context=Context(scan.scene_id, "capture", seed, {}), config=config)
    return outcome, time.process_time() - start


def _small(truth: ScanTruth) -> set[int]:
    """Numbers of annotated objects that stand on what carries things."""
    categories = {obj.name: obj.category for obj in truth.objects}
    return {obj.object_id for obj in truth.objects if obj.object_id is not None and support_kind(categories.get(obj.parent, ""))}


def _found(outcome: Outcome) -> list[Instance]:
    return [row for row in outcome.rows["instances"] if row.found_by == PROVIDER]


def _clouds(outcome: Outcome) -> Mapping[str, Array]:
    """Points of each instance, world frame [m], shapes (n, 3)."""
    return {row.instance_id: read_points(outcome.blobs[row.points_blob])[0] for row in outcome.rows["instances"]}


def _matched(true: Sequence[Array], seen: Sequence[Array]) -> int:
    """How many true objects are found, each by one cloud at most."""
    from scipy.optimize import linear_sum_assignment

    if not true or not seen:
        return 0
    shares = np.array([[_share(a, b) * _share(b, a) for b in seen] for a in true])
    rows, columns = linear_sum_assignment(np.where(shares >= LEAST_SHARE, shares, 0.0), maximize=True)
    return int((shares[rows, columns] >= LEAST_SHARE).sum())


def _share(points: Array, cloud: Array) -> float:
    from scipy.spatial import cKDTree

    return float(np.isfinite(cKDTree(cloud).query(points, distance_upper_bound=1.5 * NEAR_M)[0]).mean())


def _owner(row: Instance, points: Array, truth: ScanTruth) -> TrueObject | None:
    """The true object in whose box most of an instance's points lie, of what stands on others."""
    categories = {obj.name: obj.category for obj in truth.objects}
    standing = [obj for obj in truth.objects if support_kind(categories.get(obj.parent, ""))]
    shares = []
    for obj in standing:
        local = transform_points(points, inverse(matrix(obj.pose)))
        half = np.array(obj.extents) / 2 + NEAR_M
        shares.append(float((np.abs(local - [0, 0, obj.extents[2] / 2]) <= half).all(axis=1).mean()))
    best = int(np.argmax(shares)) if shares else -1
    return standing[best] if shares and shares[best] >= LEAST_SHARE else None
