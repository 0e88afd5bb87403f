"""Weights of ATISS that others trained, by the names in their checkpoints, as a beginning of training; nothing in a file can run.

| there | here |
|---|---|
| `fc_class`, `fc` | `class_in`, `object_in` |
| `empty_token_embedding`, through `fc` | `query` |
| `transformer_encoder.layers.i.attention.{query,key,value,out}_projection` | `encoder.layers.i.self_attn` |
| `transformer_encoder.layers.i.{linear1,linear2,norm1,norm2}` | the same below `encoder.layers.i` |
| `hidden2output.class_layer`, `hidden2output.fc_class` | `class_out`, `class_told` |
| `hidden2output.{centroid_layer,size_layer}_{x,y,z}`, `hidden2output.angle_layer` | `heads.{translation,size}.{0,1,2}`, `heads.angle.0` |
| `feature_extractor`, `fc_room_f`, `start_token_embedding`, `transformer_encoder.norm` | left out: not in this network |

There +Y is up and the front is +Z: its z, x, y are x, y, z here. Categories are taken to be in the same order. Of DiffuScene and PhyScene
the networks are not told in enough detail for a table of names.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.files import read_file
from tasks.synthesis.model.config import Atiss
from tasks.weights import MOST_BYTES, from_safetensors

AXES = ("z", "x", "y")
"""Their axis for each of ours."""

LEFT_OUT = ("feature_extractor.", "fc_room_f.", "start_token_embedding", "transformer_encoder.norm.")

SHOWN_NAMES = 5

Arrays = Mapping[str, NDArray[Any]]


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


def from_theirs(arrays: Arrays, config: Atiss, file: str) -> dict[str, NDArray[Any]]:
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
    for odd, problem in ((sorted(used.keys() - known), "are unknown"), (sorted(known - used.keys()), "are missing")):
        if odd:
            shown = ", ".join(odd[:SHOWN_NAMES]) + (f" and {len(odd) - SHOWN_NAMES} more" if len(odd) > SHOWN_NAMES else "")
            raise InputError(file, odd[0], f"{len(odd)} of its weights {problem}: {shown}", "name a checkpoint of ATISS of this size")
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
        columns[first : first + 3] = columns[[first + "xyz".index(letter) for letter in AXES]]
    return weight[:, np.concatenate([np.arange(skipped), skipped + columns.reshape(-1)])]


def begin_with_foreign(module: Any, path: str) -> str:
    """Give a network of ATISS the weights of a checkpoint; what came of it as a line.

    Raises:
        InputError: the network is another one, or the file cannot be read, or holds other weights.
    """
    import torch

    file = Path(path).name
    if not isinstance(module.config, Atiss):
        raise InputError(
            file, "foreign", f"is not known how to be read into {module.config.kind}", "train from scratch, or take atiss-paper"
        )
    made = from_theirs(_checkpoint(Path(path)), module.config, file)
    state = module.state_dict()
    for name, array in made.items():
        if state[name].shape != array.shape:
            raise InputError(
                file,
                name,
                f"has the shape {array.shape}; the config wants {tuple(state[name].shape)}",
                "take slots and classes of its size",
            )
        state[name] = torch.from_numpy(np.array(array)).to(state[name].dtype)
    module.load_state_dict(state)
    return f"{len(made)} weights from {file}; what of it reads a floor plan is left out"


def _checkpoint(path: Path) -> Arrays:
    """Arrays of a file of safetensors, or of one that torch wrote, read as weights alone."""
    if path.suffix == ".safetensors":
        return from_safetensors(read_file(path, path.name, MOST_BYTES), path.name)
    from tasks.selection.model.foreign import checkpoint

    return checkpoint(path)
