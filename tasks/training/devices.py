"""Where networks are fitted: devices, precision and several processes, which Lightning Fabric owns; threads and seeds of torch."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError

if TYPE_CHECKING:
    from tasks.training.fitting import FittingConfig


def check_installed() -> None:
    """Refuse to train where the packages for it are not there.

    Raises:
        InputError: one line that says how they get there.
    """
    from importlib.util import find_spec

    gone = [name for name in ("torch", "lightning_fabric") if find_spec(name) is None]
    if gone:
        raise InputError("train", gone[0], "is not installed", "pip install 'metascenes[train]', or `make train` in a checkout")


def seed_of(seed: int, *words: object) -> int:
    """A seed of 63 bits made of a seed and words."""
    text = "\x1f".join(map(str, (seed, *words)))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1


@contextlib.contextmanager
def seeded(seed: int, *words: object) -> Iterator[None]:
    """What is drawn from torch's own generators inside, such as initial weights, follows from seed and words; they go on as before."""
    import torch

    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed_of(seed, *words))
        yield


def fabric_for(config: FittingConfig) -> Any:
    """What owns devices and precision, for as many processes as whoever started us says that there are.

    Raises:
        InputError: a graphics card is asked for, and there is none.
    """
    import torch
    from lightning_fabric import Fabric

    device = ("cuda" if torch.cuda.is_available() else "cpu") if config.device == "auto" else config.device
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("training", "device", "torch sees no CUDA device", "set device=cpu, or auto")
    world, local = processes(), int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    precision = {"32": "32-true", "bf16-mixed": "bf16-mixed"}[config.precision]
    return Fabric(
        accelerator=device, devices=local if world > 1 else 1, num_nodes=max(world // local, 1), precision=precision,  # type: ignore[arg-type]
        strategy="ddp" if world > 1 else "auto",
    )  # fmt: skip


def processes() -> int:
    """How many processes are at one training: as `torchrun` and `fabric run` say in the environment; else 1."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def rank() -> int:
    """Which of them this is, from 0; the first keeps what comes of it."""
    return int(os.environ.get("RANK", "0"))


@contextlib.contextmanager
def quiet_torch(config: FittingConfig) -> Iterator[None]:
    """Torch with the threads of a config and deterministic algorithms, and as it was afterwards; it warns of nothing.

    On a graphics card an operation that has no deterministic algorithm is let through: there, resumed weights may differ in last bits.
    """
    import torch
    from torch.utils import deterministic

    before = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS is deterministic with it alone
    torch.set_num_threads(config.threads)
    torch.use_deterministic_algorithms(True, warn_only=config.device != "cpu" and torch.cuda.is_available())
    fills = deterministic.fill_uninitialized_memory  # type: ignore[attr-defined]
    deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]  # a tenth of a step: nothing here reads what it has not written
    try:
        with seeded(0, "fitting"):
            yield
    finally:
        deterministic.fill_uninitialized_memory = fills  # type: ignore[attr-defined]
        torch.set_num_threads(before[0])
        torch.use_deterministic_algorithms(before[1], warn_only=before[2])
