"""Scans by others in the table of hard rooms: the AWS small house, scanned virtually, and the frames of a synthetic living room.

What nobody states of them is NaN in their figures, and blank in the table.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.dwellings.judgement import BATCH, COLLIDER_M, FAR_M, FIGURES, is_same, mean, offset, pipeline_seconds
from bench.dwellings.replicas import BenchReplica
from bench.realdata import HOUSE, HOUSE_VOXEL_M, LIVING_ROOM, MODELS
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.containers import GLB_MAGIC
from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import matrix
from tasks.scanner import ScannerConfig, ScanTruth, TrueObject, scan_scene

SHELL = ("floor", "wall", "ceiling")
"""Categories that are no objects."""


@dataclasses.dataclass(frozen=True)
class ScanByOthers:
    """A scan by others, by what the table calls it. needs: below the folder of real data. library: of models, there, too; None for none."""

    name: str
    title: str
    needs: Path
    library: Path | None = None

    def is_in(self, realdata: Path) -> bool:
        """Whether the folder of real data holds it."""
        return all((realdata / part).exists() for part in (self.needs, self.library) if part is not None)

    def digest(self, realdata: Path) -> str:
        """SHA-256 of its files, 64 hex digits."""
        text = hashlib.sha256()
        for part in (self.needs, self.library):
            place = realdata / part if part is not None else None
            for path in sorted([place] if place is not None and place.is_file() else place.rglob("*") if place is not None else []):
                if path.is_file():
                    text.update(str(path.relative_to(realdata)).encode())
                    text.update(hashlib.sha256(path.read_bytes()).digest())
        return text.hexdigest()


BY_OTHERS = (
    ScanByOthers("house", "AWS small house", HOUSE, MODELS),
    ScanByOthers("living_room", "synthetic living room", LIVING_ROOM),
)
"""The scans that are measured."""


def held_by(realdata: Path | None) -> tuple[list[ScanByOthers], list[str]]:
    """The scans that a folder holds, and a line for each that it does not.

    Raises:
        InputError: a folder is named that holds none.
    """
    if realdata is None:
        return [], [f"the {scan.title}: METASCENES_REALDATA or --realdata names the folder that holds {scan.needs}" for scan in BY_OTHERS]
    held = [scan for scan in BY_OTHERS if scan.is_in(realdata)]
    if not held:
        parts = " nor ".join(str(scan.needs) for scan in BY_OTHERS)
        raise InputError(str(realdata), "--realdata", f"holds neither {parts}", "name the folder that does, or leave the option out")
    return held, [f"the {scan.title}: {realdata} does not hold {_missing(scan, realdata)}" for scan in BY_OTHERS if scan not in held]


def _missing(scan: ScanByOthers, realdata: Path) -> str:
    return " and ".join(str(part) for part in (scan.needs, scan.library) if part is not None and not (realdata / part).exists())


def scan_of(scan: ScanByOthers, realdata: Path, folder: Path) -> tuple[Path, ScanTruth | None]:
    """Where the scan lies, and what is true of it: the house is scanned into a folder; frames are a scan, and nothing is known of them."""
    if scan.needs != HOUSE:
        return realdata / scan.needs, None
    parts = load_glb(read_file(realdata / HOUSE, HOUSE.name, BUDGET.scene_bytes, magic=GLB_MAGIC), HOUSE.name)
    folder.mkdir(parents=True)
    config = dataclasses.replace(ScannerConfig(), voxel_m=HOUSE_VOXEL_M)
    return folder, scan_scene(parts, folder, HOUSE.stem, config, np.random.default_rng(0))


def judged_by_others(scan: ScanByOthers, truth: ScanTruth | None, replica: BenchReplica, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Figures of a scan by others.

    Nobody says what of it is free: objects are that its replica does not fix, and what it left out of the annotation, which holds
    still nowhere. Where a truth says which objects there are, those that the annotation lacks are left out, too.
    """
    objects = {name: row for name, row in replica.instances.items() if not row.is_structure}
    true = [obj for obj in truth.objects if obj.category not in SHELL] if truth is not None else []
    lacking = sum(obj.object_id is None for obj in true)
    placed = {name: row for name, row in replica.placements.items() if name in objects}
    free = [name for name in objects if name not in placed or not replica.supports[name].is_fixed]
    verdicts = [replica.certificates.get(name) if name in placed else None for name in free]
    moved = [math.hypot(row.displacement_m or 0.0, row.lift_m or 0.0) for row in placed.values()]
    total = pipeline_seconds(seconds)
    fidelity = replica.fidelity
    figures = nothing_known(scan) | {
        "annotated": len(free),
        "annotated_1cm": mean([row is not None and bool(row.is_stable_1cm) for row in verdicts]),
        "annotated_5cm": mean([row is not None and bool(row.is_stable_5cm) for row in verdicts]),
        "annotated_nudged": mean([row is not None and bool(row.is_stable_nudged) for row in verdicts]),
        "placed": len(placed),
        "left_out": len(objects) - len(placed) + lacking,
        "object_f_5cm": (fidelity.object_f_5cm or 0.0) if fidelity else math.nan,
        "object_completeness_5cm": (fidelity.object_completeness_5cm or 0.0) if fidelity else math.nan,
        "unexplained_share": fidelity.unexplained_share if fidelity and fidelity.unexplained_share is not None else math.nan,
        "deep_pairs": replica.optimization.deep_pairs if replica.optimization else math.nan,
        "moved_15cm": sum(far > FAR_M[0] for far in moved),
        "moved_30cm": sum(far > FAR_M[1] for far in moved),
        "moved_share": mean([far > FAR_M[0] for far in moved]),
        "collider_far_share": mean([(row.collider_distance_m or 0.0) > COLLIDER_M for row in placed.values()]),
        "rooms_found": len(replica.rooms),
        "seconds": total,
        "seconds_per_25": BATCH * total / max(len(objects), 1),
        "stages": dict(seconds),
    }
    return figures | (_by_truth(true, truth, replica) if truth is not None else {})


def _by_truth(true: Sequence[TrueObject], truth: ScanTruth, replica: BenchReplica) -> dict[str, Any]:
    """What can be said where poses and categories are known."""
    source = {row.source_id: name for name, row in replica.instances.items()}
    names = [(obj, source.get(str(obj.object_id))) for obj in true if obj.object_id is not None]
    placed = [(obj, name) for obj, name in names if name is not None and name in replica.placements]
    to_world = replica.true_to_world(matrix(truth.alignment))
    off = [offset(obj, name, replica, to_world) for obj, name in placed]
    return {
        "objects": len(true),
        "off_15cm": sum(far > FAR_M[0] for far in off),
        "off_30cm": sum(far > FAR_M[1] for far in off),
        "categories_right": mean([is_same(replica.instances[name].category, obj.category) for obj, name in placed]),
    }


def nothing_known(
    scan: ScanByOthers, stage: str = "", error: str | None = None, seconds: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Figures of a scan of which nothing was measured, with the stage that failed, and its error."""
    known = {"room": scan.name, "title": scan.title, "has_frames": True, "stage": stage, "error": error, "stages": dict(seconds or {})}
    return {key: math.nan for key, _, _ in FIGURES} | {"seconds": pipeline_seconds(seconds or {})} | known
