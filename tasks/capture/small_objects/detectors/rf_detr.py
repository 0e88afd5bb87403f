"""RF-DETR (Robinson et al., 2025): boxes and masks of classes that it was trained on, in the place of the paper's YOLOv8 (specs A.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from tasks.capture.small_objects.detectors.detector import WHERE, Detections, DetectorNetwork, corners, surest
from tasks.selection.methods import encoders
from tasks.settings import Count, Share, Texts
from tasks.vision.devices import NetworkPlacement, looking, opened
from tasks.vision.pixels import Image, normalized, sampled

FURNITURE = (
    "person", "cat", "dog", "bicycle", "motorcycle", "car", "bus", "train", "truck", "boat", "airplane", "chair", "couch", "bed",
    "dining table", "toilet", "bench", "refrigerator",
)  # fmt: skip
"""Of COCO's classes, those that stand on nothing, and who does not stay."""


@dataclasses.dataclass(frozen=True)
class RfDetr(DetectorNetwork):
    """Boxes and masks by RF-DETR. Weights are Apache-2.0: Roboflow/rf-detr-seg-nano to -xlarge, of the 80 classes of COCO."""

    kind: ClassVar[str] = "rf_detr"
    threshold: Share = 0.5  # of a detection; as published
    side_px: Count = 432  # of the square that pictures are brought to; published: nano 312, small 384, medium 432, large 504, xlarge 624
    skipped: Texts = FURNITURE  # classes that are no small objects
    version: str = "1"  # goes up when the same weights would give other masks


class RfDetrDetector:
    """RF-DETR out of a folder. Whatever it is asked for, it finds what it knows."""

    name = RfDetr.kind
    is_open = False
    draws_masks = True

    def __init__(self, network: Any, placement: NetworkPlacement, settings: RfDetr) -> None:
        self.network, self.placement, self.settings = network, placement, settings

    def detect(self, pictures: Sequence[Image], names: Sequence[str] = ()) -> list[Detections]:
        """What is in pictures, shapes (h, w, 3), of the network's own classes."""
        import torch

        made: list[Detections] = []
        side = self.settings.side_px
        with looking():
            for start in range(0, len(pictures), self.settings.batch):
                part = pictures[start : start + self.settings.batch]
                pixels = torch.from_numpy(np.stack([in_side(picture, side) for picture in part]))
                out = self.network(pixel_values=pixels.to(device=self.network.device, dtype=self.network.dtype))
                answers = zip(out.logits, out.pred_boxes, out.pred_masks, part, strict=True)
                made += [self._found(*answer) for answer in answers]
        return made

    def _found(self, logits: Any, boxes: Any, masks: Any, picture: Image) -> Detections:
        """What is in one picture. logits: Shape (queries, classes). boxes: Centers and sides, as shares. masks: Logits, shape (queries,
        h, w)."""
        from torch.nn.functional import interpolate

        height, width = picture.shape[:2]
        sure = logits.sigmoid().double().cpu().numpy()
        labels = [str(self.network.config.id2label.get(i, "")) for i in range(sure.shape[1])]
        sure[:, [label == "" or label in self.settings.skipped for label in labels]] = 0.0
        scores, best = sure.max(axis=1), sure.argmax(axis=1)
        drawn = np.clip(corners(boxes) * [width, height, width, height], 0, [width, height, width, height])
        places = [i for i in surest(drawn, scores, self.settings) if scores[i] > self.settings.threshold]
        whole = np.zeros((0, height, width), dtype=bool)
        if places:
            whole = (interpolate(masks[places][:, None], (height, width), mode="bilinear", align_corners=False)[:, 0] > 0).cpu().numpy()
        return Detections(drawn[places].reshape(-1, 4), tuple(labels[best[i]] for i in places), scores[places], whole)


def in_side(picture: Image, side: int) -> Any:
    """A picture as the network takes it, shape (3, side, side): squeezed, and not smoothed before it."""
    return normalized(sampled(picture.astype(np.float32) * np.float32(1 / 255), side, side), encoders.IMAGENET_MEAN, encoders.IMAGENET_STD)


def rf_detr_in(settings: RfDetr) -> RfDetrDetector:
    """RF-DETR out of the folder that settings name.

    Raises:
        InputError: it is not there, or holds none that draws masks.
    """
    network, _, placement = opened(settings, "RfDetrForInstanceSegmentation", WHERE)
    return RfDetrDetector(network, placement, settings)
