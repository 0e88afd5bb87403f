"""Rooms furnished with models of a library, scanned virtually and captured: what is asked of retrieval, and the right answer."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.selection.data import CAPTURE
from bench.selection.rooms import LIGHT
from bench.shelves import ShelvedModel
from tasks.candidates.request import CandidateRequest
from tasks.capture import scenes as capture
from tasks.capture.formats import find_scans
from tasks.furniture.furnishing import Extents, Furnisher, Furnishing
from tasks.furniture.rooms import FurnishedRoom, furnish
from tasks.mounting import mounting
from tasks.scanner import scan_scene
from tasks.stage import Blobs, Context

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

MODELS_PER_ROOM = 10
"""With so many a room of 30 m2 is as full as people's rooms are."""

ROOM_OBJECTS = 45
"""Things that the empty room was planned for: two L-shaped sofas have to fit in."""

SMALL_M = 0.5
"""What is no longer than this stands on a table."""

AT_WALL = 0.5
"""Share of the larger things that stand with a side at a wall; which one is drawn, so that half of them are seen from behind."""


NUMBER = len("_000")
"""Signs behind a model's name in that of an object."""


class ModelFurnisher(Furnisher):
    """Places models of a library by their files' names, and what carries them by its category."""

    def __init__(self, polygon: Array, height: float, rng: np.random.Generator, models: dict[str, list[trimesh.Trimesh]]) -> None:
        super().__init__(polygon, height, rng)
        self._models = models

    def _model(self, category: str, size: Extents, pose: Array, parent: str) -> Furnishing:
        if category not in self._models:
            return super()._model(category, size, pose, parent)
        return Furnishing(f"{category}_{len(self.objects):03d}", category, self._models[category], [], pose, size, parent)


def query_rooms(entries: Sequence[ShelvedModel], seed: int) -> list[list[ShelvedModel]]:
    """All entries, `MODELS_PER_ROOM` to a room, by chance."""
    order = np.random.default_rng([seed, 1]).permutation(len(entries))
    return [[entries[int(k)] for k in order[at : at + MODELS_PER_ROOM]] for at in range(0, len(order), MODELS_PER_ROOM)]


def furnished(entries: Sequence[ShelvedModel], rng: np.random.Generator) -> FurnishedRoom:
    """A room with models of a library in it, each turned by a whole number of quarters in its box first."""
    empty = furnish("living room", rng, ROOM_OBJECTS)
    turned = {entry.stem: _turned(entry, rng) for entry in entries}
    furnisher = ModelFurnisher(empty.polygon, max(empty.height, 2.7), rng, {name: parts for name, (parts, _) in turned.items()})
    furnisher.objects += [obj for obj in empty.objects if obj.category == "door"]
    by_size = sorted(entries, key=lambda entry: -float(np.prod(turned[entry.stem][1])))
    tables = [entry for entry in entries if _is_small(entry)]
    if tables:
        furnisher.on_floor("dining table", (0.9, 1.6, 0.74))
    for entry in by_size:
        _place(furnisher, entry, turned[entry.stem][1])
    known = {entry.stem: entry.category for entry in entries}
    objects = [dataclasses.replace(obj, category=known.get(obj.category, obj.category)) for obj in furnisher.objects]
    return FurnishedRoom("living room", empty.polygon, empty.height, empty.structure, objects)


def _turned(entry: ShelvedModel, rng: np.random.Generator) -> tuple[list[trimesh.Trimesh], Extents]:
    """Parts of an entry at the canonical origin, its long side along y, one of both others in front; and its extents [m]."""
    from tasks.geometry.transforms import yaw_pose

    parts, (x, y, z) = entry.parts(), entry.extents
    quarters = int(x > y) + 2 * int(rng.integers(2))
    for part in parts:
        part.apply_transform(yaw_pose(0.5 * np.pi * quarters))
    return parts, ((y, x, z) if quarters % 2 else (x, y, z))


def _is_small(entry: ShelvedModel) -> bool:
    return max(entry.extents) < SMALL_M and mounting(entry.category).kind not in ("wall", "frame", "ceiling")


def _place(furnisher: ModelFurnisher, entry: ShelvedModel, size: Extents) -> None:
    """Put a model where its category belongs; where nothing is free, it is not in the room."""
    name, kind = entry.stem, mounting(entry.category).kind
    if kind == "ceiling":
        at = furnisher.polygon[:3].mean(axis=0)
        pose = np.eye(4)
        pose[:3, 3] = [*at, furnisher.height - size[2]]
        furnisher.put(name, size, pose, "ceiling")
    elif kind in ("wall", "frame") or entry.category in ("tv", "kitchen utensils"):
        if furnisher.on_wall(name, (0.9, 1.2) if size[2] < 1.6 else (0.0, 0.05), size) is None:
            furnisher.on_floor(name, size)
    elif _is_small(entry):
        anchor = next((obj for obj in furnisher.objects if obj.category == "dining table"), None)
        if anchor is None or furnisher.on_top(anchor, name, size) is None:
            furnisher.on_floor(name, size)
    elif furnisher.rng.random() >= AT_WALL or furnisher.against_wall(name, size) is None:
        furnisher.on_floor(name, size, 200)


def asked(entries: Sequence[ShelvedModel], seed: int, number: int) -> list[tuple[ShelvedModel, CandidateRequest]]:
    """What retrieval is asked for after a scan of one room, and the entries that were scanned. Those that the scan lost are left out."""
    rng = np.random.default_rng([seed, 2, number])
    room, by_stem = furnished(entries, rng), {entry.stem: entry for entry in entries}
    with tempfile.TemporaryDirectory(prefix="retrieval-", ignore_cleanup_errors=True) as folder:
        scan_name = f"scene{number:04d}_00"
        scanned = scan_scene(room, Path(folder), scan_name, LIGHT, rng)
        scan = find_scans(Path(folder) / scan_name, dataset="retrieval")[0][0]
        captured = capture.run(scan=scan, context=Context(scan.scene_id, "capture", seed, Blobs()), config=CAPTURE)
    models = {str(obj.object_id): by_stem.get(obj.name[:-NUMBER]) for obj in scanned.objects if obj.object_id is not None}
    blobs = Blobs()
    blobs.update(captured.blobs)
    context = Context(scan.scene_id, "candidates", seed, blobs)
    rows = captured.rows["instances"]
    return [
        (entry, CandidateRequest(row, None, context, None, rows))
        for row in rows
        if not row.is_structure and (entry := models.get(row.source_id)) is not None
    ]
