"""Policies in torch, which act where eyes are frozen ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.policy.inference.network import Indices
from tasks.policy.model.config import PolicyModel, SiglipEyes
from tasks.policy.model.frozen import is_frozen, vision_in
from tasks.policy.model.shapes import VOCABULARY
from tasks.selection.methods import encoders
from tasks.synthesis.inference.layers import Values

if TYPE_CHECKING:
    from torch import Tensor

    from tasks.policy.model.networks.policy import PolicyNet


class TorchPolicy:
    """A `tasks.policy.inference.actor.Network` in torch, on the device of its module."""

    def __init__(self, module: PolicyNet) -> None:
        self.module, self.config = module.eval(), module.config

    def goal_tokens(self, goals: Indices) -> Values:
        """Tokens (n, g, w) of goals (n,)."""
        import torch

        with torch.no_grad(), encoders._one_thread():
            return self.module.goal_tokens(self._given(goals)).cpu().numpy()

    def seen(self, pictures: NDArray[np.uint8], goal_tokens: Values) -> Values:
        """Vectors (n, w) of pictures (n, h, w, c)."""
        import torch

        looked: Any = pictures
        if is_frozen(self.config):
            eyes = self.config.eyes
            assert isinstance(eyes, SiglipEyes)
            looked = vision_in(eyes).tokens(pictures, (eyes.grid[0], eyes.grid[1])).astype(np.float16)
        with torch.no_grad(), encoders._one_thread():
            return self.module.seen(self._given(looked), self._given(goal_tokens)).cpu().numpy()

    def decided(self, seen: Values, last: Indices, times: Indices, goal_tokens: Values) -> Values:
        """Logits (n, t, a) of steps."""
        import torch

        with torch.no_grad(), encoders._one_thread():
            return self.module.decided(*(self._given(part) for part in (seen, last, times, goal_tokens))).cpu().numpy()

    def _given(self, array: NDArray[Any]) -> Tensor:
        import torch

        return torch.from_numpy(np.ascontiguousarray(array)).to(self.module.fusion.device)


def torch_network(arrays: Mapping[str, NDArray[Any]], config: PolicyModel, goals: int) -> TorchPolicy:
    """What acts by a model's arrays, in torch.

    Raises:
        InputError: frozen eyes are not where the config says, or packages are not installed.
    """
    from tasks.policy.model.networks.policy import PolicyNet

    if is_frozen(config):
        assert isinstance(config.eyes, SiglipEyes)
        vision_in(config.eyes)
    module = PolicyNet(config, goals)
    begin_with(module, arrays)
    return TorchPolicy(module)


def begin_with(module: PolicyNet, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Give a network all of its weights, which fit it."""
    import torch

    state = module.state_dict()
    module.load_state_dict(
        {name: torch.from_numpy(np.array(array)).to(state[name].dtype) for name, array in arrays.items() if name != VOCABULARY}
    )
