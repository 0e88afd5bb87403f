"""Who names better what a scan shows, by its points alone: the rules of sizes that capture has, or the encoder of a model."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from schemas.capture import Instance
from schemas.errors import InputError
from tasks.alignment import AlignmentConfig, instance_frame
from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.naming import RULED, guessed
from tasks.furniture import canonical_category
from tasks.geometry.meshes import surface_of_glb
from tasks.geometry.triangles import vertex_normals
from tasks.models import Model
from tasks.selection.metrics.bootstrap import interval
from tasks.selection.model.batches import NAME_TOKENS
from tasks.selection.model.inference import Scorer, load
from tasks.selection.model.sight import config_from, scanned
from tasks.stage import Context
from warehouse.lake import Lake

SHOWN = 12
"""Categories that the confusion matrix shows, the most frequent first."""


@dataclasses.dataclass(frozen=True)
class Naming:
    """An instance of a held-out room: what it is, and what it is called."""

    room_id: str
    category: str
    is_learned: bool
    by_rules: str
    by_model: str


def namings_of(lake: Lake, truths: Sequence[Mapping[str, Any]], model: Model, seed: int) -> list[Naming]:
    """What the instances of held-out rooms are called; those whose surface was not kept are left out. The model chooses among all
    categories of the rooms that it learned from.

    Raises:
        InputError: the model is none of the architecture small.
        ValueError: it was not trained to name scans.
    """
    scorer = load(model.weights, config_from(model.config), f"model {model.model_id[:12]}")
    if not isinstance(scorer, Scorer):
        raise InputError(f"model {model.model_id[:12]}", "architecture", "is none that names scans", "name one of the architecture small")
    learned = sorted({known["category"] for truth in truths if truth["split"] == "train" for known in truth["instances"].values()})
    reader, named = lake.snapshot(), []
    for truth in (row for row in truths if row["split"] == "test"):
        context = Context(truth["scene_id"], "selection", seed, lake.blobs)
        for row in reader.rows(Instance, truth["scene_id"]):
            known = truth["instances"].get(row.instance_id)
            if known is None or row.mesh_blob is None:
                continue
            surface = surface_of_glb(lake.blobs[row.mesh_blob], row.mesh_blob)
            by_rules = guessed(surface.vertices, vertex_normals(surface.vertices, surface.faces), vertex_areas(surface))
            _, target, points, colors = instance_frame(row, context, AlignmentConfig())
            seen = scanned(points, colors, target.size, "", None, None, scorer.config)
            by_model = learned[int(np.argmax(scorer.named(seen.cloud, seen.extents, learned, NAME_TOKENS)))]
            named.append(Naming(truth["room_id"], known["category"], known["category"] in learned, by_rules, by_model))
    return named


def naming_report(namings: Sequence[Naming], seed: int) -> dict[str, Any]:
    """Shares of right names with intervals of 95 % over rooms, and whom the model takes for whom.

    `ruled`: of the categories that the rules name alone; `learned`: of those that the model was trained on.
    """
    groups = {
        "all": list(namings),
        "learned": [row for row in namings if row.is_learned],
        "ruled": [row for row in namings if usual(row.category) in {usual(name) for name in RULED}],
    }
    shares = {
        group: {
            who: dataclasses.asdict(interval([float(is_right(row, who)) for row in rows], [row.room_id for row in rows], seed))
            for who in ("by_rules", "by_model")
        }
        for group, rows in groups.items()
    }
    frequent = [name for name, _ in Counter(row.category for row in groups["learned"]).most_common(SHOWN)]
    confusion = {
        name: dict(
            sorted(Counter(row.by_model for row in groups["learned"] if row.category == name).items(), key=lambda at: (-at[1], at[0]))
        )
        for name in frequent
    }
    return {"shares": shares, "confusion": confusion}


def is_right(row: Naming, who: str) -> bool:
    """Whether an instance is called what it is, by whichever word."""
    return usual(getattr(row, who)) == usual(row.category)


def usual(category: str) -> str:
    """The word that stands for all words for a thing."""
    return canonical_category(category) or category
