"""Foreign encoders of pictures and texts: CLIP and DINOv2 with weights in a folder that transformers wrote.

Weights are safetensors alone, so that nothing in them can run, and nothing is fetched: who wants a method of these names a folder.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.weights import files_digest

Vectors = NDArray[np.float32]
Images = NDArray[np.uint8]

CLIP_MEAN, CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
"""Of the pictures that CLIP was trained on, as published; the authors' release took ImageNet's (specs C.3, defect 3)."""

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of the pictures that DINOv2 was trained on, as published."""

BATCH = 16
"""Pictures at a time: their activations in the largest CLIP stay below a gigabyte."""


class ClipEncoder:
    """CLIP: vectors of length 1 for pictures and texts, whose products say how well they go together."""

    def __init__(self, folder: Path) -> None:
        check_installed()
        from transformers import CLIPModel, CLIPTokenizer

        with _opening(folder, "CLIPModel"):
            self._model = _model_in(CLIPModel, folder)
            self._tokenizer: Any = CLIPTokenizer.from_pretrained(str(folder), local_files_only=True)
        self.side = int(self._model.config.vision_config.image_size)
        self.scale = float(np.exp(float(self._model.logit_scale.detach())))

    def images(self, pictures: Images) -> Vectors:
        """Vectors of pictures, shape (n, side, side, 3) to (n, d)."""
        import torch

        vectors = []
        with torch.no_grad(), _one_thread():
            for pixels in _batches(pictures, CLIP_MEAN, CLIP_STD):
                vectors.append(self._model.visual_projection(self._model.vision_model(pixel_values=pixels).pooler_output).numpy())
        return _unit(np.concatenate(vectors))

    def texts(self, texts: Sequence[str]) -> Vectors:
        """Vectors of texts, shape (n, d); what is longer than the model reads is cut."""
        import torch

        longest = int(self._model.config.text_config.max_position_embeddings)
        with torch.no_grad(), _one_thread():
            tokens = self._tokenizer(list(texts), padding=True, truncation=True, max_length=longest, return_tensors="pt")
            read = self._model.text_model(input_ids=tokens["input_ids"], attention_mask=tokens["attention_mask"])
            return _unit(self._model.text_projection(read.pooler_output).numpy())


class DinoEncoder:
    """DINOv2: a vector for every patch of a picture."""

    side = 224
    """Pixels of a picture; as its weights were published for."""

    def __init__(self, folder: Path) -> None:
        check_installed()
        from transformers import Dinov2Model

        with _opening(folder, "Dinov2Model"):
            self._model = _model_in(Dinov2Model, folder)
        self.patch = int(self._model.config.patch_size)

    def patches(self, pictures: Images) -> Vectors:
        """Vectors of length 1 of the patches of pictures, shape (n, h, h, 3) to (n, p, d). h: `side`, or another multiple of `patch`."""
        import torch

        vectors = []
        with torch.no_grad(), _one_thread():
            for pixels in _batches(pictures, IMAGENET_MEAN, IMAGENET_STD):
                vectors.append(self._model(pixel_values=pixels).last_hidden_state[:, 1:].numpy())  # the first token stands for the picture
        return _unit(np.concatenate(vectors))


def check_installed() -> None:
    """Refuse to encode where the packages for it are not there.

    Raises:
        InputError: one line that says how they get there.
    """
    gone = [name for name in ("torch", "transformers") if find_spec(name) is None]
    if gone:
        raise InputError("selection", gone[0], "is not installed", "pip install 'metascenes[encoders]'")


def clip_in(folder: str) -> ClipEncoder:
    """The CLIP of a folder, opened once in a process.

    Raises:
        InputError: none is named, it is not there, or holds no such model as safetensors, or packages are not installed.
    """
    return _clip(folder, weights_digest(folder))


def dino_in(folder: str) -> DinoEncoder:
    """The DINOv2 of a folder, opened once in a process. Raises as `clip_in`."""
    return _dino(folder, weights_digest(folder))


def weights_digest(folder: str, where: str = "selection.provider") -> str:
    """Hash of the weights and configs of a folder, 64 hex digits: who scored. where: The settings, as errors name them.

    Raises:
        InputError: none is named, or it holds no safetensors file.
    """
    if not folder:
        raise InputError(where, "weights", "names no folder", "give one that transformers wrote, as safetensors")
    files = sorted(path for path in Path(folder).glob("*") if path.suffix in (".safetensors", ".json", ".txt"))
    if not any(path.suffix == ".safetensors" for path in files):
        raise InputError(folder, "", "holds no *.safetensors", "name a folder that transformers wrote: save_pretrained(folder)")
    return files_digest(Path(folder), files)


def remembered(cache: MutableMapping[str, bytes], key: str, make: Callable[[], NDArray[Any]], half: bool = False) -> Vectors:
    """Vectors by a key that names all that they follow from: out of the cache, or made and put there. Shape (n, ...), float32.

    With `half` they are kept in half precision, and are the same whether they were there or not.
    """
    kind = "<f2" if half else "<f4"
    if key not in cache:
        made = np.ascontiguousarray(make(), dtype=kind)
        cache[key] = np.array([made.ndim, *made.shape], dtype="<i8").tobytes() + made.tobytes()
    data = cache[key]
    count = int(np.frombuffer(data, dtype="<i8", count=1)[0])
    shape = np.frombuffer(data, dtype="<i8", count=count, offset=8)
    return np.frombuffer(data, dtype=kind, offset=8 * (count + 1)).reshape(shape).astype(np.float32)


@lru_cache(maxsize=2)
def _clip(folder: str, digest: str) -> ClipEncoder:
    return ClipEncoder(Path(folder))


@lru_cache(maxsize=2)
def _dino(folder: str, digest: str) -> DinoEncoder:
    return DinoEncoder(Path(folder))


def _model_in(kind: Any, folder: Path) -> Any:
    """A model of a class, whole: weights that are missing would be drawn at random."""
    model, loaded = kind.from_pretrained(str(folder), local_files_only=True, use_safetensors=True, output_loading_info=True)
    if loaded["missing_keys"]:
        gone = sorted(loaded["missing_keys"])
        raise ValueError(f"lacks {len(gone)} of its weights, {gone[0]} first")
    return model.float().eval()


@contextlib.contextmanager
def _opening(folder: Path, kind: str) -> Iterator[None]:
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
def _one_thread() -> Iterator[None]:
    """Sums in one order: the same vectors on every worker."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _batches(pictures: Images, mean: tuple[float, ...], std: tuple[float, ...]) -> Iterator[Any]:
    """Pictures, shape (n, h, w, 3), as tensors of a few each, (b, 3, h, w), with the mean and deviation that a network is used to."""
    import torch

    for start in range(0, len(pictures), BATCH):
        values = (pictures[start : start + BATCH].astype(np.float32) / 255.0 - np.array(mean, np.float32)) / np.array(std, np.float32)
        yield torch.from_numpy(np.ascontiguousarray(values.transpose(0, 3, 1, 2)))


def _unit(vectors: NDArray[Any]) -> Vectors:
    values = np.asarray(vectors, dtype=np.float32)
    return values / np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), 1e-9)
