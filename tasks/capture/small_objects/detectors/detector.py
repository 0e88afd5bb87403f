"""What a detector is: it has boxes, names and scores for what it finds in pictures, and masks where it draws them itself."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.settings import Config, Count, Share
from tasks.vision.devices import NetworkPlacement, NetworkSettings
from tasks.vision.pixels import Image

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

WHERE = "capture.small_objects.provider.detector"
"""The settings, as errors name them."""

LEAST_SIDE_PX = 2.0
"""Of a box: smaller ones have no pixel of their own."""


@dataclasses.dataclass(frozen=True)
class Detections:
    """What somebody found in a picture, the surest first. boxes: x0, y0, x1, y1 [px], shape (n, 4). labels: A name for each. scores:
    How sure each is, 0 to 1, shape (n,). masks: Shape (n, h, w); None where the detector draws none."""

    boxes: Array
    labels: tuple[str, ...]
    scores: Array
    masks: Bools | None = None

    def __post_init__(self) -> None:
        counts = {len(self.boxes), len(self.labels), len(self.scores)} | ({len(self.masks)} if self.masks is not None else set())
        if len(counts) > 1 or self.boxes.shape[1:] != (4,):
            raise ValueError(f"boxes of shape {self.boxes.shape}, {len(self.labels)} labels and {len(self.scores)} scores must be as many")

    def at(self, places: Sequence[int] | NDArray[np.int64]) -> Detections:
        """Those at some places."""
        chosen = np.asarray(places, dtype=np.int64)
        masks = None if self.masks is None else self.masks[chosen]
        return Detections(self.boxes[chosen], tuple(self.labels[i] for i in chosen), self.scores[chosen], masks)


class Detector(Protocol):
    """Boxes for names. name: As rows have it. is_open: Whether it finds what it is asked for; else it has names of its own. draws_masks:
    Whether its answers have masks; else a segmenter draws them. placement: Where its network is; None where that is its own affair."""

    name: str
    is_open: bool
    draws_masks: bool

    @property
    def placement(self) -> NetworkPlacement | None:
        """Where its network is."""

    def detect(self, pictures: Sequence[Image], names: Sequence[str]) -> list[Detections]:
        """What is in pictures, shapes (h, w, 3), of those names."""


@dataclasses.dataclass(frozen=True)
class DetectionSelection(Config):
    """What of an answer counts."""

    most: Count = 100  # boxes of a picture, the surest: fifteen things on a desk, under several names
    same_box: Share = 0.8  # overlap of two boxes from which on the less sure one is left out; as in the demo of Grounded-SAM


@dataclasses.dataclass(frozen=True)
class DetectorNetwork(NetworkSettings, DetectionSelection):
    """A network that detects, and what of its answer counts."""


@dataclasses.dataclass(frozen=True)
class OpenVocabulary(DetectorNetwork):
    """A network that finds what it is asked for."""

    names_per_call: Count = 20  # of more, a phrase gets less of the network's attention (specs A.2)


def selected(answer: Detections, settings: DetectionSelection, height: int, width: int) -> Detections:
    """Detections within a picture of that size, without boxes of nothing and without doubles, the surest first."""
    boxes = np.clip(answer.boxes, 0, [width, height, width, height])
    return dataclasses.replace(answer, boxes=boxes).at(surest(boxes, answer.scores, settings))


def surest(boxes: Array, scores: Array, settings: DetectionSelection) -> list[int]:
    """Places of the boxes that are something, the surest first, without those that a surer one covers as well."""
    sides = boxes[:, 2:] - boxes[:, :2]
    order = np.lexsort((np.arange(len(boxes)), -scores))
    kept: list[int] = []
    for i in order[(sides[order] >= LEAST_SIDE_PX).all(axis=1)].tolist():
        if len(kept) == settings.most:
            break
        if all(box_overlap(boxes[i], boxes[j]) <= settings.same_box for j in kept):
            kept.append(i)
    return kept


def box_overlap(first: Array, second: Array) -> float:
    """Intersection over union of two boxes x0, y0, x1, y1."""
    shared = np.prod(np.clip(np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2]), 0, None))
    both = np.prod(first[2:] - first[:2]) + np.prod(second[2:] - second[:2])
    return float(shared / max(both - shared, 1e-12))


def corners(boxes: Any) -> Array:
    """Boxes as centers and sides, shape (n, 4), as corners x0, y0, x1, y1."""
    values = boxes.double().cpu().numpy()
    return np.concatenate([values[:, :2] - 0.5 * values[:, 2:], values[:, :2] + 0.5 * values[:, 2:]], axis=1)


def phrases(names: Iterable[str]) -> dict[str, str]:
    """Names by the phrases that networks are asked for: small letters, digits, blanks and hyphens; no phrase twice."""
    asked: dict[str, str] = {}
    for name in names:
        phrase = " ".join(re.sub(r"[^a-z0-9 -]+", " ", name.lower()).split()).strip(" -")
        if phrase:
            asked.setdefault(phrase, name)
    return asked


def joined_answers(
    pictures: Sequence[Image], names: Sequence[str], settings: OpenVocabulary, ask: Callable[[Sequence[Image], list[str]], list[Detections]]
) -> list[Detections]:
    """What a network finds in pictures, which is asked for some phrases at a time, and shown a batch of pictures of one size."""
    asked = phrases(names)
    answers: list[list[Detections]] = [[] for _ in pictures]
    by_size: dict[tuple[int, ...], list[int]] = {}
    for i, picture in enumerate(pictures):
        by_size.setdefault(picture.shape, []).append(i)
    for same in by_size.values():
        for start in range(0, len(same), settings.batch):
            part = same[start : start + settings.batch]
            for first in range(0, len(asked), settings.names_per_call):
                some = list(asked)[first : first + settings.names_per_call]
                for i, answer in zip(part, ask([pictures[i] for i in part], some), strict=True):
                    answers[i].append(dataclasses.replace(answer, labels=tuple(asked[phrase] for phrase in answer.labels)))
    return [selected(together(own), settings, *picture.shape[:2]) for own, picture in zip(answers, pictures, strict=True)]


def together(answers: Sequence[Detections]) -> Detections:
    """Several answers about one picture, none with masks, as one."""
    if not answers:
        return Detections(np.zeros((0, 4)), (), np.zeros(0))
    labels = tuple(label for answer in answers for label in answer.labels)
    return Detections(np.concatenate([a.boxes for a in answers]), labels, np.concatenate([a.scores for a in answers]))


def too_long(field: str, text: str, most: int) -> InputError:
    """That what a network is asked for is longer than it reads."""
    return InputError(WHERE, field, f"has more than {most} tokens of the network in {text[:60]!r}", "ask for fewer names at a time")
