"""Scores by torch: of architectures and frozen encoders that inference without torch does not have."""

from __future__ import annotations

import dataclasses
from collections.abc import MutableMapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.selection.model.batches import joined, tensors
from tasks.selection.model.config import SelectionModel
from tasks.selection.model.features import Contender, Scanned, features_of
from tasks.selection.model.frozen import seen_by_frozen, widths_of
from tasks.selection.model.shapes import check_shapes
from tasks.weights import from_safetensors


@dataclasses.dataclass(frozen=True)
class TorchScorer:
    """A model in torch, on one thread: the same scores on every worker. memory: Of frozen encoders' vectors."""

    config: SelectionModel
    network: Any
    memory: MutableMapping[str, bytes] = dataclasses.field(default_factory=dict)

    def score(self, scanned: Scanned, contenders: Sequence[Contender]) -> NDArray[np.float64]:
        """Scores, shape (k,)."""
        import torch

        seen = seen_by_frozen(scanned, self.config, self.memory)
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with torch.no_grad():
                made = self.network(tensors(joined([features_of(seen, contenders, self.config)])))
        finally:
            torch.set_num_threads(before)
        return made["match" if self.config.decides == "match" else "scores"][0].double().numpy()


def torch_scorer(weights: bytes, config: SelectionModel, file: str) -> TorchScorer:
    """The scorer of a model's weights.

    Raises:
        InputError: torch is not installed, or weights do not fit.
    """
    check_torch(config, file)
    from tasks.selection.model.networks.selector import Selector

    image, text = widths_of(config)
    check_shapes(from_safetensors(weights, file), torch_shapes(config, image, text), file)
    network = Selector(config, image_width=image, text_width=text).eval()
    begin_with(network, weights, file)
    return TorchScorer(config, network)


def check_torch(config: SelectionModel, file: str) -> None:
    """Raise `InputError` where torch, which a config needs, is not installed."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        problem = f"an architecture {config.architecture.kind}, or a frozen encoder, needs torch"
        raise InputError(file, "", problem, "pip install 'metascenes[train]', or take a model of the architecture small")


def torch_shapes(config: SelectionModel, image_width: int = 0, text_width: int = 0) -> dict[str, tuple[int, ...]]:
    """Shapes of the network's weights by name; of networks of any size, since none is allocated."""
    import torch

    from tasks.selection.model.networks.selector import Selector

    with torch.device("meta"):
        network = Selector(config, image_width=image_width, text_width=text_width)
    return {name: tuple(values.shape) for name, values in network.state_dict().items()}


def begin_with(module: Any, weights: bytes, file: str = "weights") -> None:
    """Give a network all of its weights.

    Raises:
        InputError: some are missing, too many or of another shape.
    """
    import torch

    given, wanted = from_safetensors(weights, file), module.state_dict()
    for name in sorted({*wanted, *given}):
        if name not in given or name not in wanted or tuple(wanted[name].shape) != given[name].shape:
            raise InputError(file, name, "does not fit the model's config", "take weights and config of one model")
    module.load_state_dict({name: torch.from_numpy(np.array(values)).to(wanted[name].dtype) for name, values in given.items()})
