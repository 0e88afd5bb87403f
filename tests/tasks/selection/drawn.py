"""A small selection model whose weights were drawn."""

from __future__ import annotations

import json

import numpy as np

from tasks.models import Model, model_id_of
from tasks.selection.model.config import OwnImage, OwnText, SelectionModel, Small
from tasks.selection.model.shapes import shapes_of
from tasks.settings import plain
from tasks.weights import to_safetensors

SMALL = Small(points=48, groups=8, group_size=6, dim=24, depth=2, heads=4, first_widths=(8, 16), second_widths=(16, 24), position_width=8,
              embedding=20, head_width=16)  # fmt: skip
CONFIG = SelectionModel(
    SMALL, image=OwnImage(widths=(4, 6, 8)), text=OwnText(buckets=64, width=8), residual_points=16, residual_widths=(8, 12)
)


def drawn_model(seed: int = 0) -> Model:
    """A model whose weights were drawn."""
    rng = np.random.default_rng(seed)
    arrays = {}
    for name, shape in sorted(shapes_of(CONFIG).items()):
        values = rng.normal(0, 0.3, shape)
        arrays[name] = np.asarray(0.5 + np.abs(values) if name.endswith("running_var") else values, dtype="<f2")
    weights = to_safetensors(arrays)
    config = json.dumps({"model": plain(CONFIG)})
    return Model(model_id_of(weights, config), "selection", "small", config, weights)
