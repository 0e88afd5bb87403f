"""Methods on rooms that were held out: what each chooses, and how far that is from the model that was scanned.

Rooms are measured one by one and remembered in a folder, each with the scorers that it was measured by: more scorers add to it.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.selection.lineups import OF_SCANNED
from flows.run.fingerprints import ModuleCaches, code_fingerprint, digest
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from schemas.files import write_whole
from schemas.selection import Selection, SelectionOutcome
from tasks.geometry.meshes import Surface, surface_of_glb
from tasks.models import Model
from tasks.selection import SelectionConfig, scored
from tasks.selection.evidence import gather
from tasks.selection.metrics.outcomes import KnownInstance, outcome_of
from tasks.selection.metrics.surfaces import Agreement, agreement, samples_of
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

SAMPLES = 2048
"""Of each surface: half of what the paper's figures take, since there are ten candidates for each of thousands of instances."""


@dataclasses.dataclass(frozen=True)
class MeasuredMethod:
    """A method with its settings. name: in tables; seed: that its model was trained with; model: None where it learns nothing."""

    name: str
    config: Any
    seed: int = 0
    model: Model | None = None

    @property
    def key(self) -> str:
        """What its scores of a room follow from, but for the room."""
        return digest(self.name, repr(self.config), str(self.seed), self.model.model_id if self.model else "")


@dataclasses.dataclass(frozen=True)
class TrueSurface:
    """The scanned model of an instance: its surface in its own frame, and its pose in the world, 4x4 [m]."""

    surface: Surface
    pose: Any


def known_instances(
    truth: Mapping[str, Any], surfaces: Mapping[str, TrueSurface], reader: Reader, lake: Lake, count: int = SAMPLES
) -> dict[str, KnownInstance]:
    """What is known of a room's instances, by instance: with how each candidate, as selection placed it, agrees with the true model."""
    assets = {
        row.asset_id: row for row in reader.rows_by_key(Asset, {s["asset_id"] for i in truth["instances"].values() for s in i["slots"]})
    }
    placed = {(row.instance_id, row.slot): row for row in reader.rows(Selection, truth["scene_id"])}
    known = {}
    for instance_id, instance in sorted(truth["instances"].items()):
        totals = {slot: held["total"] for slot, held in enumerate(instance["slots"], start=1)}
        own = {slot for slot, held in enumerate(instance["slots"], start=1) if held["kind"] in OF_SCANNED}
        rest = {slot: total for slot, total in totals.items() if slot not in own}
        agreements: dict[int, Agreement] = {}
        if instance_id in surfaces:
            true = surfaces[instance_id]
            rng = np.random.default_rng([truth["index"], int(instance_id)])
            shape = samples_of(true.surface, true.pose, np.ones(3), rng, count)
            for slot in totals:
                row = placed.get((instance_id, slot))
                if row is not None:
                    asset = assets[row.asset_id]
                    other = samples_of(surface_of_glb(lake.blobs[asset.mesh_blob], asset.mesh_blob), row.pose, row.scale, rng, count)
                    agreements[slot] = agreement(shape, other)
        known[instance_id] = KnownInstance(
            scene_id=truth["scene_id"], room_id=truth["room_id"], instance_id=instance_id, category=instance["category"],
            split=truth["split"], is_held_out_category=instance["is_held_out"],
            assets={slot: held["asset_id"] for slot, held in enumerate(instance["slots"], start=1)},
            true=nearest(totals), true_without_own=nearest(rest), own=own, agreements=agreements,
        )  # fmt: skip
    return known


def source_digest(*modules: str) -> str:
    """Hash of modules of this folder as they are written; fingerprints of code follow none of the benchmarks'."""
    return digest(*(Path(__file__).with_name(f"{module}.py").read_text() for module in modules))


def nearest(totals: Mapping[int, float]) -> set[int]:
    """Slots that differ least by the rule of the simulated annotators, without noise."""
    least = min(totals.values(), default=np.inf)
    return {slot for slot, total in totals.items() if total <= least + 1e-9}


def measured_room(
    lake: Lake, reader: Reader, truth: Mapping[str, Any], surfaces: Mapping[str, TrueSurface], scorers: Sequence[MeasuredMethod],
    dataset: str, folder: Path | None, seed: int,
) -> list[SelectionOutcome]:  # fmt: skip
    """Outcomes of every scorer for every instance of a room: remembered ones, and those that are new."""
    path = folder / f"{truth['scene_id'].replace('/', '-')}.json" if folder is not None else None
    mark = digest(code_fingerprint("tasks.selection"), source_digest("measures"), json.dumps(truth, sort_keys=True))
    held = remembered(path, mark)
    wanted = [scorer for scorer in scorers if scorer.key not in held]
    if wanted:
        held |= _measured(lake, reader, truth, surfaces, wanted, dataset, seed)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps({"mark": mark, "outcomes": held}).encode())
    return [SelectionOutcome(**row) for scorer in scorers for row in held[scorer.key]]


def remembered(path: Path | None, mark: str) -> dict[str, list[dict[str, Any]]]:
    """Outcomes that a file holds under a mark, by scorer; none where there is none, it cannot be read, or is of other code or data."""
    try:
        document = json.loads(path.read_bytes()) if path is not None else {}
    except (OSError, ValueError):
        return {}
    return dict(document["outcomes"]) if isinstance(document, dict) and document.get("mark") == mark else {}


def _measured(
    lake: Lake, reader: Reader, truth: Mapping[str, Any], surfaces: Mapping[str, TrueSurface], scorers: Sequence[MeasuredMethod],
    dataset: str, seed: int,
) -> dict[str, list[dict[str, Any]]]:  # fmt: skip
    """Rows of outcomes as plain values, by scorer."""
    scene = truth["scene_id"]
    known = known_instances(truth, surfaces, reader, lake)
    context = Context(scene, "selection", seed, lake.blobs, caches=ModuleCaches())
    candidates = [row for row in reader.rows(Candidate, scene) if row.instance_id in known]
    assets = reader.rows_by_key(Asset, {row.asset_id for row in candidates if row.asset_id is not None})
    instances = [row for row in reader.rows(Instance, scene) if row.is_structure or row.instance_id in known]
    rows: dict[str, list[dict[str, Any]]] = {scorer.key: [] for scorer in scorers}
    gathered = gather(
        instances, candidates, assets, context, SelectionConfig(), [], captions=reader.rows(Caption, scene),
        frames=reader.rows(Frame, scene), masks=reader.rows(Mask, scene),
    )  # fmt: skip
    for query, evidence in gathered:
        slots = [each.candidate.slot for each in evidence]
        for scorer in scorers:
            if scorer.model is not None:  # point clouds of assets are made once for all models, and kept
                scored(query, evidence, scorer.config, scorer.model)
            clock = time.perf_counter()
            scores, _, _, lacks = scored(query, evidence, scorer.config, scorer.model)
            took = time.perf_counter() - clock
            row = outcome_of(
                known[query.instance.instance_id], scores, slots, method=scorer.name, dataset=dataset, training_id="bench-selection",
                seed=scorer.seed, model_id=scorer.model.model_id if scorer.model else None, is_fallback=lacks is not None,
                seconds=took,
            )  # fmt: skip
            rows[scorer.key].append(dataclasses.asdict(row))
    return rows


def check_committed(reader: Reader, truths: Sequence[Mapping[str, Any]]) -> None:
    """See that the lake has every room whose truth is told.

    Raises:
        InputError: it lacks one.
    """
    from schemas.capture import Scene

    lacking = sorted({truth["scene_id"] for truth in truths} - {row.scene_id for row in reader.rows(Scene)})
    if lacking:
        raise InputError("lake", "scenes", f"lacks {lacking[0]}, whose truth is told", "remove its file from the folder `truth`")
