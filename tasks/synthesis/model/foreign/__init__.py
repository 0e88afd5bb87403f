"""Weights that others trained, by the names in their checkpoints, as a beginning of training; nothing in a file can run.

Of ATISS (`atiss`), and of DiffuScene and PhyScene, whose denoiser is one and the same (`denoiser`); each module has the table of names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from schemas.files import read_file
from tasks.synthesis.model.config import Atiss
from tasks.synthesis.model.foreign.atiss import from_atiss
from tasks.synthesis.model.foreign.denoiser import from_denoiser
from tasks.synthesis.model.foreign.names import Arrays, wrong_shape
from tasks.weights import MOST_BYTES, from_safetensors


def begin_with_foreign(module: Any, path: str) -> str:
    """Give a network of synthesis the weights of a checkpoint of the same model; what came of it as a line.

    Raises:
        InputError: the network is one that no checkpoint is known of, or the file cannot be read, or holds other weights.
    """
    import torch

    file, state = Path(path).name, module.state_dict()
    if isinstance(module.config, Atiss):
        made = from_atiss(_checkpoint(Path(path)), module.config, file)
        note = "what of it reads a floor plan is left out"
    else:
        shapes = {name: tuple(values.shape) for name, values in state.items()}
        made, note = from_denoiser(_checkpoint(Path(path)), module.config, shapes, file)
    for name, array in made.items():
        if state[name].shape != array.shape:
            raise wrong_shape(file, name, array.shape, tuple(state[name].shape))
        state[name] = torch.from_numpy(np.array(array)).to(state[name].dtype)
    module.load_state_dict(state)
    return f"{len(made)} weights from {file}; {note}"


def _checkpoint(path: Path) -> Arrays:
    """Arrays of a file of safetensors, or of one that torch wrote, read as weights alone."""
    if path.suffix == ".safetensors":
        return from_safetensors(read_file(path, path.name, MOST_BYTES), path.name)
    from tasks.selection.model.foreign import checkpoint

    return checkpoint(path)
