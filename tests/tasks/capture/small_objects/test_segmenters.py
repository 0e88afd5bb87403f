"""Masks by SAM and SAM 2 of random weights: as the library's own processors have them, whatever the batch and the device's precision."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.small_objects.segmenters import Sam, Sam2, Segments, segmenter_in

pytestmark = pytest.mark.whole

PICTURES = [np.random.default_rng(i).integers(0, 256, (h, w, 3), dtype=np.uint8) for i, (h, w) in enumerate([(60, 90), (75, 50), (64, 64)])]
BOXES = [np.array([[3.0, 4, 40, 50], [20, 20, 80, 55]]), np.zeros((0, 4)), np.array([[i, i, 20 + 2 * i, 30.0 + i] for i in range(20)])]


def segmented(kind: type[Sam] | type[Sam2], networks: Path, **more: Any) -> tuple[Any, list[Segments]]:
    segmenter: Any = segmenter_in(kind(weights=str(networks / kind.kind), device="cpu", **more))
    return segmenter, segmenter.segment(PICTURES, BOXES)


@pytest.mark.parametrize("kind", [Sam, Sam2])
def test_every_box_has_a_mask_whatever_the_batch(kind: type[Sam] | type[Sam2], networks: Path) -> None:
    segmenter, found = segmented(kind, networks)
    assert [segments.masks.shape for segments in found] == [(2, 60, 90), (0, 75, 50), (20, 64, 64)]
    assert all(((segments.scores >= 0) & (segments.scores <= 1)).all() for segments in found)
    assert any(0 < mask.mean() < 1 for segments in found for mask in segments.masks)
    assert (segmenter.placement.device, segmenter.placement.weights_bytes > 100_000) == ("cpu", True)
    _, one = segmented(kind, networks, batch=1)
    for segments, again in zip(found, one, strict=True):
        assert (segments.masks != again.masks).sum() <= 0.001 * segments.masks.size
        assert np.allclose(segments.scores, again.scores, atol=1e-5)
    _, same = segmented(kind, networks)
    assert [each.masks.tobytes() for each in same] == [each.masks.tobytes() for each in found]


@pytest.mark.parametrize("kind", [Sam, Sam2])
def test_double_precision_changes_hardly_a_pixel(kind: type[Sam] | type[Sam2], networks: Path) -> None:
    from tasks.capture.small_objects.segmenters.sam import sam_in
    from tasks.capture.small_objects.segmenters.sam2 import sam2_in

    _, found = segmented(kind, networks)
    settings: Any = kind(weights=str(networks / kind.kind), device="cpu")
    exact: Any = sam_in(settings) if kind is Sam else sam2_in(settings)
    exact.network.double()
    for segments, precise in zip(found, exact.segment(PICTURES, BOXES), strict=True):
        assert np.abs(segments.scores - precise.scores).max(initial=0) < 1e-4
        assert (segments.masks != precise.masks).sum() <= 0.001 * segments.masks.size


def test_sam_is_as_its_processor_has_it(networks: Path) -> None:
    """Its own preparation and its own way back, which need no torchvision."""
    import torch
    from transformers import SamModel, SamProcessor
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    segmenter, found = segmented(Sam, networks)
    square = {"height": 128, "width": 128}
    processor: Any = SamProcessor(SamImageProcessorPil(size={"longest_edge": 128}, pad_size=square))
    network: Any = SamModel.from_pretrained(str(networks / "sam")).eval()
    for place in (0, 2):
        inputs = processor(images=PICTURES[place], input_boxes=[BOXES[place].tolist()], return_tensors="pt")
        assert np.abs(segmenter.pixels(PICTURES[place]) - inputs["pixel_values"][0].numpy()).max() < 1e-5
        with torch.no_grad():
            out = network(pixel_values=inputs["pixel_values"], input_boxes=inputs["input_boxes"].float(), multimask_output=False)
        (masks,) = processor.image_processor.post_process_masks(
            out.pred_masks, inputs["original_sizes"], inputs["reshaped_input_sizes"], pad_size=square
        )
        assert (masks[:, 0].numpy() == found[place].masks).mean() > 0.999
        assert np.allclose(np.clip(out.iou_scores[0, :, 0].numpy(), 0, 1), found[place].scores, atol=1e-5)


def test_sam2_takes_boxes_as_its_processor_does_and_pictures_by_the_published_constants(networks: Path) -> None:
    """Its picture processor wants torchvision; sizes, means and deviations are the library's defaults for it."""
    import torch
    from transformers import Sam2Model, Sam2Processor

    segmenter, found = segmented(Sam2, networks)
    theirs = Sam2Processor._normalize_coordinates(None, 128, torch.from_numpy(BOXES[0]), (60, 90), is_bounding_box=True)  # type: ignore[arg-type]
    assert np.allclose(segmenter.scaled(BOXES[0], 60, 90), theirs.numpy())
    tensor = torch.from_numpy(PICTURES[0].transpose(2, 0, 1).astype(np.float32))[None]
    shares = torch.nn.functional.interpolate(tensor, (128, 128), mode="bilinear", antialias=True) / 255
    pixels = (shares - torch.tensor([0.485, 0.456, 0.406])[:, None, None]) / torch.tensor([0.229, 0.224, 0.225])[:, None, None]
    assert np.abs(segmenter.pixels(PICTURES[0]) - pixels[0].numpy()).max() <= 1 / 255 / 0.224 + 1e-4
    network: Any = Sam2Model.from_pretrained(str(networks / "sam2")).eval()
    with torch.no_grad():
        out = network(
            pixel_values=torch.from_numpy(segmenter.pixels(PICTURES[0]))[None], input_boxes=theirs[None].float(), multimask_output=False
        )
        masks = torch.nn.functional.interpolate(out.pred_masks[0], (60, 90), mode="bilinear", align_corners=False)[:, 0] > 0
    assert (masks.numpy() == found[0].masks).mean() > 0.999


def test_weights_of_another_kind_are_refused(networks: Path) -> None:
    with pytest.raises(InputError, match="holds no Sam2Model"):
        segmenter_in(Sam2(weights=str(networks / "owlv2"), device="cpu"))
