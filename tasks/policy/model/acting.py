"""Policies in torch, which act where eyes are frozen ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tasks.policy.inference.network import Indices
from tasks.policy.model.config import PolicyModel, SiglipEyes
from tasks.policy.model.frozen import is_frozen, vision_in
from tasks.policy.model.networks.policy import PolicyNet
from tasks.policy.model.shapes import VOCABULARY, check_fit
from tasks.selection.methods import encoders
from tasks.synthesis.inference.layers import Values
from tasks.weights import from_safetensors


class TorchPolicy:
    """A `tasks.policy.inference.actor.Network` in torch, on the device of its module."""

    def __init__(self, module: PolicyNet) -> None:
        self.module, self.config = module.eval(), module.config

    def told(self, goals: Indices) -> Values:
        """Tokens (n, g, w) of goals (n,)."""
        with torch.no_grad():
            return self.module.told(self._given(goals)).cpu().numpy()

    def seen(self, pictures: NDArray[np.uint8], told: Values) -> Values:
        """Vectors (n, w) of pictures (n, h, w, 3)."""
        looked: Any = pictures
        if is_frozen(self.config):
            eyes = self.config.eyes
            assert isinstance(eyes, SiglipEyes)
            looked = vision_in(eyes).tokens(pictures, (eyes.grid[0], eyes.grid[1])).astype(np.float16)
        with torch.no_grad(), encoders._one_thread():
            return self.module.seen(self._given(looked), self._given(told)).cpu().numpy()

    def decided(self, seen: Values, last: Indices, times: Indices, told: Values) -> Values:
        """Logits (n, t, a) of steps."""
        with torch.no_grad(), encoders._one_thread():
            return self.module.decided(*(self._given(part) for part in (seen, last, times, told))).cpu().numpy()

    def _given(self, array: NDArray[Any]) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.module.fusion.device)


def torch_network(arrays: Mapping[str, NDArray[Any]], config: PolicyModel, goals: int) -> TorchPolicy:
    """What acts by a model's arrays, in torch.

    Raises:
        InputError: frozen eyes are not where the config says, or packages are not installed.
    """
    if is_frozen(config):
        assert isinstance(config.eyes, SiglipEyes)
        vision_in(config.eyes)
    module = PolicyNet(config, goals)
    begin_with(module, arrays)
    return TorchPolicy(module)


def begin_with(module: PolicyNet, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Give a network all of its weights, which fit it."""
    state = module.state_dict()
    module.load_state_dict(
        {name: torch.from_numpy(np.array(array)).to(state[name].dtype) for name, array in arrays.items() if name != VOCABULARY}
    )


def opened(weights: bytes, config: PolicyModel, file: str = "weights") -> PolicyNet:
    """The network of a model's weights, in evaluation. Raises `InputError` as `check_fit`."""
    arrays = from_safetensors(weights, file)
    module = PolicyNet(config, len(check_fit(arrays, config, file)))
    begin_with(module, arrays)
    return module.eval()
