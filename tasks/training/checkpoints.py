"""Checkpoints: the state of a fit as bytes, by key and step, in a cache that keeps each whole or not at all."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, MutableMapping
from typing import Any

from schemas.parsing import json_value

KEPT = 2
"""The newest ones: should the last not be whole, the one before it is."""


def forget(checkpoints: MutableMapping[str, bytes], key: str) -> None:
    """Remove the checkpoints of a key, once what came of it is kept elsewhere."""
    for name in names_of(checkpoints, key):
        with contextlib.suppress(KeyError):
            del checkpoints[name]


def names_of(checkpoints: Mapping[str, bytes], key: str) -> list[str]:
    """Checkpoints of a key, the newest first."""
    return sorted((name for name in checkpoints if name.rpartition("-")[0] == key and name.endswith(".pt")), reverse=True)


def keep(checkpoints: MutableMapping[str, bytes], key: str, step: int, state: bytes) -> None:
    """Keep a checkpoint, and the newest ones before it."""
    checkpoints[f"{key}-{step:09d}.pt"] = state
    for name in names_of(checkpoints, key)[KEPT:]:
        with contextlib.suppress(KeyError):
            del checkpoints[name]


def newest(checkpoints: Mapping[str, bytes], key: str, mark: str) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The newest checkpoint of a key that is whole and was made under the same settings: its facts and its tensors."""
    import torch

    for name in names_of(checkpoints, key):
        try:
            read = torch.load(io.BytesIO(checkpoints[name]), map_location="cpu", weights_only=True)
            facts = json_value(read.pop("facts"))
        except Exception:  # torch says in many ways that a file is not whole, and another is as good
            continue
        if facts.get("mark") == mark:
            return facts, read
    return None
