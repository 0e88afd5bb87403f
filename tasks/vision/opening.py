"""Networks of others out of folders that transformers wrote: whole, as safetensors alone, and computed so that workers agree.

Nothing in such a file can run, and nothing is fetched: who wants a network names a folder.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from tasks.weights import files_digest


def folder_digest(folder: str, where: str) -> str:
    """Hash of the weights and configs of a folder, 64 hex digits: who looked. where: The settings, as errors name them.

    Raises:
        InputError: none is named, or it holds no safetensors file.
    """
    if not folder:
        raise InputError(where, "weights", "names no folder", "give one that transformers wrote, as safetensors")
    files = sorted(path for path in Path(folder).glob("*") if path.suffix in (".safetensors", ".json", ".txt"))
    if not any(path.suffix == ".safetensors" for path in files):
        raise InputError(folder, "", "holds no *.safetensors", "name a folder that transformers wrote: save_pretrained(folder)")
    return files_digest(Path(folder), files)


def model_in(kind: Any, folder: Path) -> Any:
    """A model of a class, whole: weights that are missing would be drawn at random."""
    model, loaded = kind.from_pretrained(str(folder), local_files_only=True, use_safetensors=True, output_loading_info=True)
    if loaded["missing_keys"]:
        gone = sorted(loaded["missing_keys"])
        raise ValueError(f"lacks {len(gone)} of its weights, {gone[0]} first")
    return model.float().eval()


@contextlib.contextmanager
def opening(folder: Path, kind: str) -> Iterator[None]:
    """Name the folder of whatever goes wrong while a model is opened.

    Raises:
        InputError: in its place.
    """
    try:
        yield
    except Exception as error:  # the readers of weights and tokenizers raise classes of their own
        problem = f"holds no {kind}: {next(iter(str(error).strip().splitlines()), repr(error))}"
        raise InputError(str(folder), "", problem, "name a folder that it was saved to") from error


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Sums in one order: the same vectors on every worker."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
