"""What networks that see take of a device, at published shape with weights drawn at random, and how far two devices are from one another.

Without a graphics card nothing is run at published shape: what is left is the processor in single precision against itself in double.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.goals import goal
from bench.models.drawn_networks import NETWORKS, SIDES, Shape, drawn_network, letter_tokenizer, weights_bytes, word_tokenizer
from schemas.errors import InputError
from tasks.capture.small_objects.detectors import Detections, Detector, GroundingDino, Owlv2, RfDetr
from tasks.capture.small_objects.detectors.grounding_dino import GroundingDinoDetector
from tasks.capture.small_objects.detectors.owlv2 import Owlv2Detector
from tasks.capture.small_objects.detectors.rf_detr import RfDetrDetector
from tasks.capture.small_objects.segmenters import Segmenter, Segments
from tasks.capture.small_objects.segmenters.sam import SamSegmenter
from tasks.capture.small_objects.segmenters.sam2 import Sam2Segmenter
from tasks.vision.devices import CARD, NetworkPlacement, check_installed, device_of
from tasks.vision.pixels import Image

NAMES = ("red mug", "book", "coffee table", "pen")
"""What detectors are asked for."""

BOXES = 15
"""Of a picture, that segmenters are asked for: as many as things on a full desk."""

BOX_PX, SCORE, MASK_SHARE = 0.5, 1e-3, 1e-3
"""By how much two devices may differ: corners of boxes [px], scores, and share of the pixels of masks. Half a pixel moves no mask at the
resolution of depth."""

SIZE, SMALL = (968, 1296), (60, 90)
"""Height and width of ScanNet's color images [px], and of those that tiny networks look at."""

PICTURES = 8
"""That are looked at, at published shape."""


@dataclasses.dataclass(frozen=True)
class DeviceFigures:
    """Of a provider. weights_mb: At published shape, in single precision. device, against: What was compared. boxes_px, scores,
    masks: Largest differences of the two, as `BOX_PX` and so on. pictures_per_second, peak_mb: At published shape on a graphics card,
    memory with all activations; None where there is no card."""

    provider: str
    weights_mb: float
    device: str
    against: str
    boxes_px: float
    scores: float
    masks: float
    pictures_per_second: float | None = None
    peak_mb: float | None = None


def measured(card: str | None) -> list[DeviceFigures]:
    """Figures of every provider. card: The graphics card; None where there is none."""
    return [_figures(name, card) for name in NETWORKS]


def card_there() -> str | None:
    """The first graphics card; None where there is none.

    Raises:
        InputError: packages are not installed.
    """
    check_installed("bench models")
    device = device_of("auto", "bench models")
    return device if device.startswith(CARD) else None


def device_report() -> dict[str, Any]:
    """Rows, goals, and what there is to compute on."""
    card = card_there()
    figures = measured(card)
    goals = []
    for field, limit, text in (
        ("boxes_px", BOX_PX, "largest difference of boxes [px]"), ("scores", SCORE, "of scores"), ("masks", MASK_SHARE, "of masks, share"),
    ):  # fmt: skip
        goals.append(goal(f"two devices: {text}", round(max(getattr(row, field) for row in figures), 7), "<=", limit))
    return {"rows": [dataclasses.asdict(row) for row in figures], "goals": goals, "card": card_name(card)}


def card_name(card: str | None) -> str:
    """A graphics card, as its maker calls it; '' where there is none."""
    if card is None:
        return ""
    import torch

    return str(torch.cuda.get_device_name(card))


def _figures(name: str, card: str | None) -> DeviceFigures:
    """One provider's."""
    with tempfile.TemporaryDirectory(prefix="metascenes-") as place:
        folder = Path(place)
        pictures = [drawn_picture(SMALL, i) for i in range(3)]
        plain = _answers(provider_of(name, "tiny", folder), pictures)
        other = provider_of(name, "tiny", folder)
        if card is None:
            other.network.double()
            against = "cpu, double precision"
        else:
            other.network.to(card)
            against = card
        boxes, scores, masks = differences(plain, _answers(other, pictures))
        figures = DeviceFigures(name, weights_bytes(name) / 2**20, "cpu", against, boxes, scores, masks)
        if card is None:
            return figures
        rate, peak = _speed(provider_of(name, "published", folder), card)
        return dataclasses.replace(figures, pictures_per_second=rate, peak_mb=peak)


def provider_of(name: str, shape: Shape, folder: Path) -> Any:
    """A provider with a network of weights drawn at random, on the processor. folder: Where files of its tokenizer may lie."""
    network = drawn_network(name, shape)
    placement = NetworkPlacement("cpu", "", 0)
    sides: dict[str, Any] = {"shortest_px": 64, "longest_px": 96} if shape == "tiny" else {}
    everything: dict[str, Any] = {"threshold": 0.0, "same_box": 1.0}
    made: dict[str, Callable[[], Segmenter | Detector]] = {
        "sam2": lambda: Sam2Segmenter(network, placement, 4),
        "sam": lambda: SamSegmenter(network, placement, 4),
        "grounding_dino": lambda: GroundingDinoDetector(
            network, word_tokenizer(folder), placement, GroundingDino(text_threshold=0.0, **sides, **everything)
        ),
        "owlv2": lambda: Owlv2Detector(network, letter_tokenizer(folder), placement, Owlv2(**everything)),
        "rf_detr": lambda: RfDetrDetector(network, placement, RfDetr(side_px=SIDES[shape], skipped=(), **everything)),
    }
    return made[name]()


def drawn_picture(size: tuple[int, int], seed: int) -> Image:
    """A picture of noise, shape (h, w, 3)."""
    return np.random.default_rng([seed, 11]).integers(0, 256, (*size, 3), dtype=np.uint8)


def drawn_boxes(size: tuple[int, int], seed: int) -> NDArray[np.float64]:
    """Boxes x0, y0, x1, y1 in a picture [px], shape (`BOXES`, 4)."""
    rng = np.random.default_rng([seed, 12])
    low = rng.uniform(0, 0.6, (BOXES, 2))
    return np.concatenate([low, low + rng.uniform(0.1, 0.4, (BOXES, 2))], axis=1) * np.array([size[1], size[0]] * 2)


def _answers(provider: Any, pictures: list[Image]) -> list[Detections | Segments]:
    """What a provider says of pictures."""
    if isinstance(provider, Sam2Segmenter | SamSegmenter):
        return list(provider.segment(pictures, [drawn_boxes(picture.shape[:2], i) for i, picture in enumerate(pictures)]))
    return list(provider.detect(pictures, NAMES))


def differences(first: list[Detections | Segments], second: list[Detections | Segments]) -> tuple[float, float, float]:
    """Largest differences of the answers of two devices to the same pictures: of boxes [px], of scores, and the share of mask pixels.
    Infinite where one sees more things than the other, or calls one by another name."""
    boxes = scores = masks = 0.0
    for a, b in zip(first, second, strict=True):
        if len(a.scores) != len(b.scores):
            return (np.inf, np.inf, np.inf)
        scores = max(scores, float(np.abs(a.scores - b.scores).max(initial=0)))
        if isinstance(a, Detections) and isinstance(b, Detections):
            boxes = max(boxes, float(np.abs(a.boxes - b.boxes).max(initial=0)) if a.labels == b.labels else np.inf)
        if a.masks is not None and b.masks is not None and a.masks.size:
            masks = max(masks, float((a.masks != b.masks).mean()))
    return boxes, scores, masks


def _speed(provider: Any, card: str) -> tuple[float, float]:
    """Pictures a second of published shape, and the most memory that they took [MB]."""
    import torch

    provider.network.to(card)
    pictures = [drawn_picture(SIZE, i) for i in range(PICTURES)]
    _answers(provider, pictures[:1])  # the first call chooses algorithms, and loads them
    torch.cuda.synchronize(card)
    torch.cuda.reset_peak_memory_stats(card)
    started = time.perf_counter()
    _answers(provider, pictures)
    torch.cuda.synchronize(card)
    return PICTURES / (time.perf_counter() - started), torch.cuda.max_memory_allocated(card) / 2**20


def lacking() -> str | None:
    """Why devices cannot be compared; None where they can."""
    try:
        check_installed("bench models")
    except InputError as error:
        return f"{error.field} {error.problem}"
    return None
