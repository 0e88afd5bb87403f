"""Weights of SPOC's `siglip_base_3`, by the names in its checkpoints, read into a policy of the published size.

| there | here |
|---|---|
| `visual_encoder.visual_compressor.{0,2}`, convolutions one pixel wide | `eyes.{0,2}` |
| `visual_encoder.visual_adapter.{0,1}` | `adapter.{0,1}` |
| `visual_encoder.visual_sensor_token_raw_navigation_camera` | `camera` |
| `visual_encoder.text_adapter.{0,1}` | `goal.adapter.{0,1}` |
| `visual_encoder.fusion_token` | `fusion` |
| `visual_encoder.fusion_xformer.layers` | `encoder.layers` |
| `decoder.layers` | `decoder.layers` |
| `last_actions_embed.weight`: 20 actions, start, filled up | `last.weight`: four of them, start, untold |
| `action_classifier` | `head`: four of 20 |
| `visual_encoder.{image_encoder,text_encoder}`, frozen | left out: a folder that transformers wrote has them |
| `visual_encoder.visual_sensor_token_raw_manipulation_camera`, `time_encoder`, `an_object_is_in_hand` | left out: there is none here |

Of their actions moving ahead, turning right, turning left and being done come first, second, third and fifth, as their list of actions has
them; theirs moves 0.2 m. A head of four actions is taken to have ours, in our order. Names are those that their code gives; no file of
theirs was opened here. Before all names Lightning puts `model.`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from tasks.policy.actions import FORWARD, LEFT, RIGHT, STOP
from tasks.policy.model.config import OwnEyes, OwnGoal, PolicyModel
from tasks.policy.model.shapes import Shape, shapes_of

Arrays = Mapping[str, NDArray[Any]]

PREFIXES = ("model.", "module.", "")
"""Before all names, of what wrote the file."""

ENCODER = "visual_encoder."
CAMERA = f"{ENCODER}visual_sensor_token_raw_navigation_camera"

LEFT_OUT = (
    f"{ENCODER}image_encoder.", f"{ENCODER}text_encoder.", f"{ENCODER}visual_sensor_token_", "time_encoder.", "object_in_hand_embed.",
)  # fmt: skip
"""First parts of names that have no place here."""

THEIR_ACTIONS = 20
THEIR_PLACES = {FORWARD: 0, RIGHT: 1, LEFT: 2, STOP: 4}
"""Places of our actions among theirs."""

SHOWN = 5


def their_names(names: Mapping[str, Shape]) -> dict[str, str]:
    """Names there by names here, of all weights but the states of goals."""
    begins = {
        "eyes.": f"{ENCODER}visual_compressor.",
        "adapter.": f"{ENCODER}visual_adapter.",
        "camera": CAMERA,
        "goal.adapter.": f"{ENCODER}text_adapter.",
        "fusion": f"{ENCODER}fusion_token",
        "encoder.": f"{ENCODER}fusion_xformer.",
        "decoder.": "decoder.",
        "last.": "last_actions_embed.",
        "head.": "action_classifier.",
    }
    made = {}
    for name in names:
        begin = next((begin for begin in begins if name.startswith(begin)), None)
        if begin is not None:
            made[name] = begins[begin] + name.removeprefix(begin)
    return made


def from_spoc(arrays: Arrays, config: PolicyModel, file: str) -> tuple[dict[str, NDArray[Any]], str]:
    """Weights of a checkpoint by the names here, and what is said of the rest.

    Raises:
        InputError: the policy is of another kind; or weights have names that nobody knows, are missing, or have another shape.
    """
    if config.blind or isinstance(config.eyes, OwnEyes) or isinstance(config.goal, OwnGoal):
        problem = "is not known how to be read into a policy with eyes or goals of its own"
        raise InputError(file, "foreign", problem, "train from scratch, or take the model `paper`")
    prefix = next(prefix for prefix in PREFIXES if any(name.startswith(prefix + ENCODER) for name in arrays) or not prefix)
    given = {name.removeprefix(prefix): array for name, array in arrays.items()}
    wanted = shapes_of(config, 1)
    names = their_names(wanted)
    known = {*names.values()}
    used = {name: array for name, array in given.items() if name in known or not name.startswith(LEFT_OUT)}
    for odd, problem in ((sorted({*used} - known), "are unknown"), (sorted(known - {*used}), "are missing")):
        if odd:
            shown = ", ".join(odd[:SHOWN]) + (f" and {len(odd) - SHOWN} more" if len(odd) > SHOWN else "")
            raise InputError(file, odd[0], f"{len(odd)} of its weights {problem}: {shown}", "name a checkpoint of SPOC's siglip_base_3")
    made = {}
    for here, there in names.items():
        array = used[there]
        if here.startswith("eyes.") and array.ndim == 4:
            array = array[..., 0, 0]
        if here.startswith(("last.", "head.")):
            array = _our_actions(array, has_ends=here.startswith("last."))
        if array.shape != wanted[here]:
            problem = f"has the shape {used[there].shape}; the config wants {wanted[here]}"
            raise InputError(file, there, problem, "take a config of its size")
        made[here] = array
    left = sorted({name.removeprefix(ENCODER).split(".")[0] for name in given if name not in known})
    return made, f"left out: {', '.join(left)}" if left else "all of them"


def _our_actions(array: NDArray[Any], *, has_ends: bool) -> NDArray[Any]:
    """Rows of our four actions, of an array that has rows of theirs; has_ends: with those of start and filled up behind them."""
    if len(array) != THEIR_ACTIONS + 2 * has_ends:
        return array
    rows = [THEIR_PLACES[action] for action in range(len(ACTIONS))]
    return np.asarray(array[rows + [THEIR_ACTIONS, THEIR_ACTIONS + 1] * has_ends])


def begin_with_foreign(module: Any, path: str) -> str:
    """Give a network the weights of a checkpoint; what came of it as a line.

    Raises:
        InputError: it cannot be read, or does not fit.
    """
    import torch

    from tasks.selection.model.foreign import checkpoint

    file = Path(path).name
    made, rest = from_spoc(checkpoint(Path(path)), module.config, file)
    state = module.state_dict()
    given = {name: torch.from_numpy(np.array(array)).to(state[name].dtype) for name, array in made.items()}
    module.load_state_dict({**state, **given})
    return f"{len(made)} weights from {file}; {rest}"
