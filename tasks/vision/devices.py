"""Where a network runs: the processor or a graphics card, with whose weights, and how much memory these take."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from schemas.errors import InputError
from tasks.selection.methods import encoders
from tasks.settings import Config, Count

Device = Annotated[str, Field(pattern=r"^(auto|cpu|cuda(:\d{1,3})?)$")]
"""Of settings: cpu, cuda, cuda:1, or auto for the first graphics card where there is one."""

CARD = "cuda"
"""How devices are called that are no processor."""


@dataclasses.dataclass(frozen=True)
class NetworkSettings(Config):
    """Weights in a folder, and where the network runs that has them."""

    weights: str = ""  # folder that transformers wrote, as safetensors; nothing is fetched
    device: Device = "auto"  # the first graphics card where there is one; cuda:1 is the second
    batch: Count = 4  # pictures at a time: activations of the largest of these networks stay below 16 GB


@dataclasses.dataclass(frozen=True)
class NetworkPlacement:
    """A network in memory. device: cpu, cuda:0, cuda:1. weights: Hash of its folder, 64 hex digits. weights_bytes: What its weights take
    there; activations come on top, by the picture."""

    device: str
    weights: str
    weights_bytes: int

    @property
    def version(self) -> str:
        """Of the weights, as rows have it."""
        return self.weights[:12]


def device_of(device: str, where: str) -> str:
    """The device that is meant: cpu, cuda:0, cuda:1. where: The settings, as errors name them.

    Raises:
        InputError: packages are not installed, or there is no such device.
    """
    check_installed(where)
    import torch

    cards = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if device == "auto":
        return f"{CARD}:0" if cards else "cpu"
    if not device.startswith(CARD):
        return device
    number = int(device.partition(":")[2] or 0)
    if number >= cards:
        there = f"cards 0 to {cards - 1}" if cards else "no CUDA device"
        raise InputError(where, "device", f"is {device}, and torch sees {there}", "set device=cpu, or auto")
    return f"{CARD}:{number}"


def check_installed(where: str) -> None:
    """Refuse to look where the packages for it are not there.

    Raises:
        InputError: one line that says how they get there.
    """
    gone = [name for name in ("torch", "transformers") if find_spec(name) is None]
    if gone:
        raise InputError(where, gone[0], "is not installed", "pip install 'metascenes[encoders]'")


@contextlib.contextmanager
def looking() -> Iterator[None]:
    """Around what a network computes: sums in one order, and on a graphics card in whole single precision, so that every worker and device
    sees the same, give or take what `docs/models.md` states."""
    import torch

    with torch.inference_mode(), encoders._one_thread(), torch.backends.cudnn.flags(deterministic=True, benchmark=False, allow_tf32=False):
        yield


def opened(
    settings: NetworkSettings, name: str, where: str, more: Callable[[Path], Any] = lambda folder: None
) -> tuple[Any, Any, NetworkPlacement]:
    """A network out of its folder, ready to look; what `more` reads of the folder beside it, such as a tokenizer; and where it is.

    name: Class of transformers.

    Raises:
        InputError: packages are not installed, no folder is named, there is no such device, or the folder holds no such network, whole.
    """
    device = device_of(settings.device, where)
    digest = encoders.weights_digest(settings.weights, where)
    import transformers

    folder = Path(settings.weights)
    with encoders._opening(folder, name):
        network = encoders._model_in(getattr(transformers, name), folder).to(device)
        beside = more(folder)
    size = sum(tensor.numel() * tensor.element_size() for tensor in (*network.parameters(), *network.buffers()))
    return network, beside, NetworkPlacement(device, digest, size)
