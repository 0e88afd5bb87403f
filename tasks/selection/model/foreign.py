"""Weights that others trained: Point-BERT, ULIP-2 and Uni3D by the names in their checkpoints. Nothing in a file can run."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.files import read_file
from tasks.weights import MOST_BYTES, from_safetensors

LEAST_MATCHED = 0.95
"""Share of the encoder's weights that a checkpoint must have."""

SHOWN_KEYS = 5
PREFIXES = ("module.", "_orig_mod.", "")
OUTER = ("state_dict", "model", "base_model", "module")
"""Tables in which checkpoints keep their weights, beside epochs and optimizers."""


@dataclasses.dataclass(frozen=True)
class Matched:
    """What of a checkpoint fits a network. weights: By the network's names. missing: Names of the encoder that it lacks. surplus: Names of
    its own that the network lacks. wrong: Names of another shape."""

    file: str
    weights: dict[str, NDArray[Any]]
    missing: tuple[str, ...]
    surplus: tuple[str, ...]
    wrong: tuple[str, ...]

    @property
    def note(self) -> str:
        """One line of it."""
        parts = [f"{len(self.weights)} weights from {self.file}"]
        for name in ("missing", "surplus", "wrong"):
            keys = getattr(self, name)
            if keys:
                label = "of another shape" if name == "wrong" else name
                parts.append(f"{len(keys)} {label}: {', '.join(keys[:SHOWN_KEYS])}{', ...' if len(keys) > SHOWN_KEYS else ''}")
        return "; ".join(parts)


def checkpoint(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of a checkpoint by name, of a safetensors file or one that torch wrote, read as weights alone.

    Raises:
        InputError: it cannot be read, or holds what is no weight.
    """
    data = read_file(path, path.name, MOST_BYTES)
    if path.suffix == ".safetensors":
        return from_safetensors(data, path.name)
    import torch

    try:
        read = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch says in many ways that a file is none, or would run code
        problem = "is no checkpoint that can be read as weights alone; nothing else is read, since it could run code"
        raise InputError(path.name, "", problem, "convert it to safetensors where you trust it") from error
    for name in OUTER:
        if isinstance(read, Mapping) and isinstance(read.get(name), Mapping):
            read = read[name]
    if not isinstance(read, Mapping):
        raise InputError(path.name, "", "holds no table of weights", "name a file of a state dict")
    return {str(name): value.float().numpy() if value.is_floating_point() else value.numpy() for name, value in read.items()
            if isinstance(value, torch.Tensor)}  # fmt: skip


def matched(arrays: Mapping[str, NDArray[Any]], wanted: Mapping[str, tuple[int, ...]], file: str) -> Matched:
    """Weights of a checkpoint that fit a network, by the network's names.

    Of `wanted`, shapes by name, those of the encoder of points and its projection must be there: at least 95 %, by count. A checkpoint of
    the encoder alone may leave out `point_encoder.` before its names.

    Raises:
        InputError: fewer are.
    """
    best = max((renamed(arrays, prefix) for prefix in PREFIXES), key=lambda names: len(names.keys() & wanted.keys()))
    encoder = {name for name in wanted if name.startswith("point_encoder.") or name == "pc_projection"}
    fitting = {name: best[name] for name in wanted if name in best and best[name].shape == wanted[name]}
    wrong = tuple(sorted(name for name in wanted if name in best and best[name].shape != wanted[name]))
    made = Matched(file, fitting, tuple(sorted(encoder - best.keys())), tuple(sorted(best.keys() - wanted.keys())), wrong)
    share = len(encoder & fitting.keys()) / max(len(encoder), 1)
    if share < LEAST_MATCHED:
        keys = [*made.missing, *made.wrong][:SHOWN_KEYS]
        problem = f"has {share:.0%} of the encoder's weights; not {', '.join(keys)}"
        raise InputError(file, keys[0] if keys else "", problem, "name a checkpoint of this architecture, or train from scratch")
    return made


def renamed(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """Arrays whose names begin with a prefix, without it, by the names that networks here have."""
    names = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
    if not any(name.startswith("point_encoder.") for name in names):
        names = {name if name in ("pc_projection", "logit_scale") else f"point_encoder.{name}": values for name, values in names.items()}
    return names


def begin_with_foreign(module: Any, path: str) -> str:
    """Give a network's encoder the weights of a checkpoint; what came of it as a line.

    Raises:
        InputError: it cannot be read, or fits too little.
    """
    import torch

    wanted = {name: tuple(values.shape) for name, values in module.state_dict().items()}
    made = matched(checkpoint(Path(path)), wanted, Path(path).name)
    state = module.state_dict()
    given = {name: torch.from_numpy(np.array(values)).to(state[name].dtype) for name, values in made.weights.items()}
    module.load_state_dict({**state, **given})
    return made.note
