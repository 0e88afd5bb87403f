"""Weights of ATISS that others trained, by the names in their checkpoints.

| there | here |
|---|---|
| `fc_class`, `fc` | `class_in`, `object_in` |
| `empty_token_embedding`, through `fc` | `query` |
| `transformer_encoder.layers.i.attention.{query,key,value,out}_projection` | `encoder.layers.i.self_attn` |
| `transformer_encoder.layers.i.{linear1,linear2,norm1,norm2}` | the same below `encoder.layers.i` |
| `hidden2output.class_layer`, `hidden2output.fc_class` | `class_out`, `class_told` |
| `hidden2output.{centroid_layer,size_layer}_{x,y,z}`, `hidden2output.angle_layer` | `heads.{translation,size}.{0,1,2}`, `heads.angle.0` |
| `feature_extractor`, `fc_room_f`, `start_token_embedding`, `transformer_encoder.norm` | left out: not in this network |

There +Y is up and the front is +Z: its z, x, y are x, y, z here. Categories are taken to be in the same order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.model.config import Atiss
from tasks.synthesis.model.foreign.names import AXES, Arrays, check_names, turned

LEFT_OUT = ("feature_extractor.", "fc_room_f.", "start_token_embedding", "transformer_encoder.norm.")


def their_names(config: Atiss) -> dict[str, str]:
    """Names there by names here, of weights that are the same in both but for the order of parts."""
    names = {"class_in.weight": "fc_class.weight", "class_told.weight": "hidden2output.fc_class.weight"}
    for kind in ("weight", "bias"):
        names |= {f"object_in.{kind}": f"fc.{kind}", f"class_out.{kind}": f"hidden2output.class_layer.{kind}"}
        for layer in range(config.layers):
            here, there = f"encoder.layers.{layer}", f"transformer_encoder.layers.{layer}"
            names |= {f"{here}.{part}.{kind}": f"{there}.{part}.{kind}" for part in ("linear1", "linear2", "norm1", "norm2")}
            names[f"{here}.self_attn.out_proj.{kind}"] = f"{there}.attention.out_projection.{kind}"
        for place in (0, 2, 4):
            names[f"heads.angle.0.{place}.{kind}"] = f"hidden2output.angle_layer.{place}.{kind}"
            for part, word in (("translation", "centroid"), ("size", "size")):
                for axis, letter in enumerate(AXES):
                    names[f"heads.{part}.{axis}.{place}.{kind}"] = f"hidden2output.{word}_layer_{letter}.{place}.{kind}"
    return names


def from_atiss(arrays: Arrays, config: Atiss, file: str) -> dict[str, NDArray[Any]]:
    """Weights of a checkpoint by the names here, in the frame here.

    Raises:
        InputError: some have names that nobody knows, or are missing.
    """
    used = {name: array for name, array in arrays.items() if not name.startswith(LEFT_OUT)}
    attention = [
        (layer, kind, [f"transformer_encoder.layers.{layer}.attention.{part}_projection.{kind}" for part in ("query", "key", "value")])
        for layer in range(config.layers)
        for kind in ("weight", "bias")
    ]
    names = their_names(config)
    known = {*names.values(), "empty_token_embedding", *(name for *_, parts in attention for name in parts)}
    check_names(used, known, file, "ATISS")
    made = {here: used[there] for here, there in names.items()}
    for layer, kind, parts in attention:
        made[f"encoder.layers.{layer}.self_attn.in_proj_{kind}"] = np.concatenate([used[name] for name in parts])
    made["query"] = used["empty_token_embedding"].reshape(-1) @ used["fc.weight"].T + used["fc.bias"]
    # what is read of objects: category, middle, size and angle, each number as waves
    made["object_in.weight"] = _turned(used["fc.weight"], config.embedding, (1, 4))
    for part, axes in (("angle", 1), ("size", 3)):
        for axis in range(axes):
            name = f"heads.{part}.{axis}.0.weight"
            made[name] = _turned(made[name], config.embedding, (1,), config.width)
    return made


def _turned(weight: NDArray[Any], part: int, triples: tuple[int, ...], skipped: int = 0) -> NDArray[Any]:
    """Weights (o, i) whose columns are parts of one width, after some that are skipped, with three numbers of a triple in our order."""
    columns = np.arange(weight.shape[1] - skipped).reshape(-1, part)
    for first in triples:
        turned(columns, first)
    return weight[:, np.concatenate([np.arange(skipped), skipped + columns.reshape(-1)])]
