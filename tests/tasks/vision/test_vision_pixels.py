"""Pictures as networks take them: against torch, and against the processors of transformers that need no torchvision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tasks.capture.small_objects.detectors.owlv2 import in_square
from tasks.vision.pixels import IMAGENET_MEAN, IMAGENET_STD, fitted_size, normalized, sampled, shrunk_to, smoothed_to

SIDES = st.integers(2, 90)


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@given(SIDES, SIDES)
def test_a_picture_of_one_color_stays_so_at_any_size(height: int, width: int) -> None:
    plain = np.full((37, 21, 3), 93, np.uint8)
    assert (shrunk_to(plain, height, width) == 93).all()
    shares = plain.astype(np.float32) / 255
    assert np.allclose(sampled(shares, height, width), 93 / 255, atol=1e-6)
    assert sampled(shares, height, width).shape == (height, width, 3)
    values = normalized(plain, IMAGENET_MEAN, IMAGENET_STD)
    assert np.allclose(values, ((93 / 255 - np.array(IMAGENET_MEAN)) / IMAGENET_STD)[:, None, None], atol=1e-6)


def test_at_its_own_size_a_picture_is_itself() -> None:
    own = picture(31, 44)
    assert shrunk_to(own, 31, 44) is own
    assert np.array_equal(sampled(own.astype(np.float32), 31, 44), own)
    square = own[:31, :31].astype(np.float32) / 255
    assert np.allclose(smoothed_to(square, 31), square, atol=1e-6)


@given(st.integers(10, 2000), st.integers(10, 2000))
@example(480, 640)
@example(968, 1296)
@example(100, 1900)
def test_sides_fit_and_keep_their_ratio(height: int, width: int) -> None:
    high, wide = fitted_size(height, width, 800, 1333)
    assert max(high, wide) <= 1334
    assert min(high, wide) == 800 or max(high, wide) >= 1332 or (high, wide) == (height, width)
    assert abs(high / height - wide / width) <= 1.01 / min(height, width)


@pytest.mark.whole
@settings(max_examples=20)
@given(SIDES, SIDES, SIDES, SIDES, st.integers(0, 99))
def test_sizes_change_as_torch_has_it(height: int, width: int, high: int, wide: int, seed: int) -> None:
    """What torchvision does with tensors is `interpolate`: with smoothing for SAM 2, which rounds to grays, and without for RF-DETR."""
    torch = pytest.importorskip("torch")
    own = picture(height, width, seed)
    tensor = torch.from_numpy(own.transpose(2, 0, 1).astype(np.float32))[None]
    smooth = torch.nn.functional.interpolate(tensor, (high, wide), mode="bilinear", antialias=True)[0].numpy().transpose(1, 2, 0)
    assert np.abs(shrunk_to(own, high, wide) - smooth).max() <= 1.0 + 1e-3, "a whole step, but for single precision"
    plain = torch.nn.functional.interpolate(tensor, (high, wide), mode="bilinear", antialias=False)[0].numpy().transpose(1, 2, 0)
    assert np.abs(sampled(own.astype(np.float32), high, wide) - plain).max() < 0.01  # grays


@pytest.mark.whole
@pytest.mark.parametrize(("height", "width"), [(60, 90), (91, 47), (64, 64), (30, 200)])
def test_pictures_are_those_of_the_processors_of_transformers(height: int, width: int) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("transformers")
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil
    from transformers.models.owlv2.image_processing_pil_owlv2 import Owlv2ImageProcessorPil

    own = picture(height, width)
    theirs = GroundingDinoImageProcessorPil(size={"shortest_edge": 80, "longest_edge": 133})(own, return_tensors="np")["pixel_values"][0]
    assert theirs.shape[1:] == fitted_size(height, width, 80, 133)
    assert np.abs(normalized(shrunk_to(own, *theirs.shape[1:]), IMAGENET_MEAN, IMAGENET_STD) - theirs).max() < 1e-5
    theirs = Owlv2ImageProcessorPil(size={"height": 64, "width": 64})(own, return_tensors="np")["pixel_values"][0]
    assert np.abs(in_square(own, 64) - theirs).max() < 1e-4
