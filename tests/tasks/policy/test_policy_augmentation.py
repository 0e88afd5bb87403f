"""Pictures in training: changed by what was drawn, all of a walk alike."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.policy.augmentation import PictureAugmentation, PictureChange, drawn, looked

SAME = PictureChange(np.eye(3), 1.0, (0.0, 0.0, 1.0, 1.0), 0.0, 8)
NOTHING = PictureAugmentation(0, 0, 0, 0, 1.0, 0, 0, 0)
RNG = np.random.default_rng(0)
PICTURES = RNG.integers(0, 256, (3, 24, 32, 3), dtype=np.uint8)


def test_nothing_changes_nothing() -> None:
    assert np.array_equal(looked(PICTURES, SAME), PICTURES)
    look = drawn(NOTHING, np.random.default_rng(0))
    assert np.allclose(look.matrix, np.eye(3))
    assert np.abs(looked(PICTURES, look).astype(int) - PICTURES).max() <= 1


def test_a_walk_is_changed_alike_and_as_drawn() -> None:
    for seed in range(20):
        look = drawn(PictureAugmentation(), np.random.default_rng(seed))
        again = drawn(PictureAugmentation(), np.random.default_rng(seed))
        assert np.array_equal(look.matrix, again.matrix)
        top, left, height, width = look.box
        assert 0.9 <= height == width <= 1.0
        assert min(top, left) >= 0.0
        assert max(top, left) + height <= 1.0 + 1e-12
        same = np.repeat(PICTURES[:1], 3, axis=0)
        made = looked(same, look)
        assert np.array_equal(made[0], made[2])


def test_colors_are_brighter_greyer_and_turned() -> None:
    grey = np.full((1, 8, 8, 3), 100, dtype=np.uint8)
    hue = drawn(dataclasses.replace(NOTHING, hue=0.5, saturation=1.0), np.random.default_rng(3))
    assert np.abs(looked(grey, hue).astype(int) - 100).max() <= 1, "grey has no hue"
    assert looked(grey, dataclasses.replace(SAME, matrix=1.5 * np.eye(3)))[0, 0, 0].tolist() == [150] * 3
    half = np.concatenate([np.full((1, 8, 8, 3), 40, np.uint8), np.full((1, 8, 8, 3), 160, np.uint8)])
    flat = looked(half, dataclasses.replace(SAME, contrast=0.5))
    assert [int(part.max()) for part in flat] == [70, 130]


def test_crops_are_enlarged_between_pixels() -> None:
    ramp = np.broadcast_to((np.arange(32) * 8).astype(np.uint8)[None, None, :, None], (1, 24, 32, 3)).copy()
    made = looked(ramp, dataclasses.replace(SAME, box=(0.25, 0.25, 0.5, 0.5)))[0, 0, :, 0].astype(float)
    expected = 8 * ((0.25 + (np.arange(32) + 0.5) / 32 * 0.5) * 32 - 0.5)
    assert np.abs(made - expected).max() <= 1.0


def test_blurred_sharpened_and_posterized() -> None:
    blurred = looked(PICTURES, dataclasses.replace(SAME, sharpness=-1.0)).astype(float)
    window = PICTURES[1, 4:7, 9:12, 2].astype(float)
    assert blurred[1, 5, 10, 2] == pytest.approx(window.mean(), abs=1.0)
    sharp = looked(PICTURES, dataclasses.replace(SAME, sharpness=1.0)).astype(float)
    assert blurred.std() < PICTURES.std() < sharp.std()
    assert set(np.unique(looked(PICTURES, dataclasses.replace(SAME, bits=2)))) <= {0, 64, 128, 192}
