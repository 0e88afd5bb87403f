"""The walk from a model: the run that trained it, what it learned from, the models that it goes back to, and its figures."""

from __future__ import annotations

from schemas.parsing import json_value
from schemas.record import arrow_to_rows
from schemas.training import LearnedModel, ModelEvaluation
from warehouse.lineage.walk import Walk, picked

MOST_PARENTS = 100
"""Models that one goes back to: each began with the weights of the next."""


def walk_model(walk: Walk, model: LearnedModel) -> str:
    """Walk a model, and those that it began with; the id of its node."""
    root = model_node(walk, model)
    walk.line(0, "", root)
    node, row = root, model
    for depth in range(1, MOST_PARENTS):
        _follow_dataset(walk, node, row, depth)
        if row.parent_id is None:
            break
        parents = walk.reader.rows_by_key(LearnedModel, [row.parent_id])
        if not parents:  # it ships inside the package, or was another lake's
            walk.leads(depth, node, walk.node("model", row.parent_id, {"origin": "elsewhere"}), "began with")
            break
        parent = model_node(walk, parents[0])
        walk.leads(depth, node, parent, "began with")
        node, row = parent, parents[0]
    return root


def model_node(walk: Walk, model: LearnedModel) -> str:
    """The node of a model, with its figures."""
    figures = arrow_to_rows(walk.reader.matching("model_evaluations", {"model_id": [model.model_id]}), ModelEvaluation)
    facts = {
        **picked(model, "kind", "origin", "architecture", "parameter_count", "seed", "device", "license", "is_fallback", "is_withdrawn",
                 "notes", "weights_blob"),
        "config": json_value(model.config),
        "figures": [f"{row.metric} {row.value:.4g} on {row.dataset}, {row.split}" for row in figures],
    }  # fmt: skip
    node = walk.node("model", model.model_id, facts, walk.run(model.training_id, "training"))
    walk.check_blobs(node, (model.weights_blob,))
    return node


def _follow_dataset(walk: Walk, node: str, model: LearnedModel, depth: int) -> None:
    """What a model learned from, by its name and its content."""
    facts = picked(model, "dataset", "snapshot_id", "release", "dataset_fingerprint", "examples")
    walk.leads(depth, node, walk.node("dataset", f"{model.dataset_fingerprint[:12]}", facts), "learned from")
