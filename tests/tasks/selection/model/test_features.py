"""What a model sees: clouds changed at random, texts as tokens, numbers of candidates, and hits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.selection.model.augmentation import about, augmented, cropped, drawn_motion, moved, thinned
from tasks.selection.model.clouds import ColoredCloud, packed, unpacked
from tasks.selection.model.config import AugmentationConfig
from tasks.selection.model.features import EVIDENCE, features_of, residuals_of, square_crop
from tasks.selection.model.figures import hits
from tasks.selection.model.words import tokens_of
from tests.tasks.selection.model.shapes import toy
from tests.tasks.selection.model.test_inference import FULL

STILL = AugmentationConfig(dropout=0.0, scale_least=1.0, scale_most=1.0, shift=0.0, tilt_radians=0.0, turn=False, crop=1.0)


def cloud(count: int, seed: int = 0) -> ColoredCloud:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    return ColoredCloud(rng.normal(size=(count, 3)).astype(np.float32), rng.integers(0, 255, (count, 3), dtype=np.uint8), normals)


def test_a_turn_is_about_up_and_keeps_shapes() -> None:
    before = cloud(50)
    motion = drawn_motion(dataclasses.replace(STILL, turn=True), 1.0, np.random.default_rng(1))
    after = moved(before, motion, np.zeros(3))
    assert np.allclose(after.points[:, 2], before.points[:, 2], atol=1e-6)
    assert np.allclose(np.linalg.norm(after.points, axis=1), np.linalg.norm(before.points, axis=1), atol=1e-5)
    assert not np.allclose(after.points, before.points, atol=0.01)
    assert np.allclose((after.points * after.normals).sum(axis=1), (before.points * before.normals).sum(axis=1), atol=1e-5)
    lying = drawn_motion(dataclasses.replace(STILL, turn=True, axis="y"), 1.0, np.random.default_rng(1))
    assert np.allclose(moved(before, lying, np.zeros(3)).points[:, 1], before.points[:, 1], atol=1e-6)


@pytest.mark.parametrize("axis", range(3))
def test_turns_are_rotations(axis: int) -> None:
    matrix = about(axis, 0.7)
    assert np.allclose(matrix @ matrix.T, np.eye(3))
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    following = np.eye(3)[(axis + 1) % 3]
    assert (matrix @ following)[(axis + 2) % 3] > 0  # right-handed


def test_points_left_out_keep_their_order_and_a_share() -> None:
    whole = cloud(1000)
    kept = thinned(whole, 0.6, np.random.default_rng(0))
    assert 400 <= len(kept.points) < 1000
    places = [int(np.flatnonzero((whole.points == point).all(axis=1))[0]) for point in kept.points]
    assert places == sorted(set(places))


def test_what_stands_in_one_frame_moves_as_one() -> None:
    examples, clouds = toy(1, 0, points=64)
    contenders = examples[0].contenders(clouds)
    config = dataclasses.replace(STILL, turn=True, shift=0.1, tilt_radians=0.05, scale_least=0.8, scale_most=0.8)
    view = augmented(examples[0].scanned, contenders, FULL, config, np.random.default_rng(3))
    plain = [each.placed() for each in contenders]
    for before, after in zip(plain, view.clouds, strict=True):
        gaps = np.linalg.norm(before.points[:20, None] - examples[0].scanned.cloud.points[None, :20], axis=2)
        assert np.allclose(np.linalg.norm(after.points[:20, None] - view.scan.points[None, :20], axis=2), 0.8 * gaps, atol=1e-4)
    apart = augmented(examples[0].scanned, contenders, dataclasses.replace(FULL, frame="canonical"), config, np.random.default_rng(3))
    first = np.linalg.norm(apart.clouds[0].points[0] - apart.clouds[1].points[0])
    assert not np.isclose(first, 0.8 * np.linalg.norm(contenders[0].cloud.points[0] - contenders[1].cloud.points[0]), atol=1e-3)


def test_nothing_changed_gives_plain_features_but_for_the_order_of_distances() -> None:
    examples, clouds = toy(1, 4, points=64)
    contenders = examples[0].contenders(clouds)
    plain = features_of(examples[0].scanned, contenders, FULL)
    view = augmented(examples[0].scanned, contenders, FULL, STILL, np.random.default_rng(0))
    same = features_of(examples[0].scanned, contenders, FULL, view)
    assert all(np.allclose(plain[name], same[name], atol=1e-5) for name in plain if name != "residuals")
    again = augmented(examples[0].scanned, contenders, FULL, STILL, np.random.default_rng(0))
    assert np.array_equal(features_of(examples[0].scanned, contenders, FULL, again)["residuals"], same["residuals"])


def test_distances_point_by_point_are_those_to_the_nearest() -> None:
    scan, surface = cloud(40, 1), cloud(60, 2)
    made = residuals_of(scan, [surface], np.array([2.0, 2.0, 2.0]), 40)
    radius, middle = np.sqrt(3.0), np.array([0, 0, 1.0])
    apart = np.linalg.norm(scan.points[:, None] - surface.points[None], axis=2) / radius
    assert made.shape == (1, 80, 17)
    assert np.allclose(made[0, :40, 0:3], (scan.points - middle) / radius, atol=1e-5)
    near = apart.min(axis=1) < 0.5
    assert np.allclose(made[0, :40, 6][near], 5 * apart.min(axis=1)[near], atol=1e-4)
    back = apart.min(axis=0)[:40]
    assert np.allclose(made[0, 40:, 6][back < 0.5], 5 * back[back < 0.5], atol=1e-4)
    assert made[0, :40, 15].max() == 0.0
    assert made[0, 40:, 15].min() == 1.0


def test_packed_clouds_come_back_to_half_precision() -> None:
    whole = cloud(33)
    again = unpacked(packed(whole))
    assert len(packed(whole)) == 33 * 15
    assert np.array_equal(again.colors, whole.colors)
    assert np.abs(again.points - whole.points).max() < 2e-3
    assert packed(again) == packed(whole)


def test_words_that_are_written_alike_share_tokens() -> None:
    chairs, chair, lamp = (set(tokens_of(word, 4096, 32)[tokens_of(word, 4096, 32) > 0]) for word in ("chairs", "Chair", "lamp"))
    assert len(chair & chairs) >= 3
    assert not chair & lamp
    assert tokens_of("chair", 4096, 32).tolist() == tokens_of("CHAIR!", 4096, 32).tolist()
    assert tokens_of("", 8, 4).tolist() == [0] * 4
    assert tokens_of("a bcd", 1 << 20, 4)[0] == 1 + __import__("zlib").crc32(b"<a>") % (1 << 20)


def test_evidence_stands_by_its_names() -> None:
    from tasks.selection.model.sight import evidence
    from tests.tasks.selection.generated import generated_room

    asset = generated_room(count=4).assets[0]
    values = evidence(
        coverage=0.1, box_iou=0.2, color=0.3, foreign=None, chamfer_m=0.0, diagonal_m=1.0, scale=(1.0, 2.0, 0.5),
        category=asset.category.upper(), asset=asset, is_own=True,
    )  # fmt: skip
    named = dict(zip(EVIDENCE, values.tolist(), strict=True))
    assert named["coverage"] == pytest.approx(0.1)
    assert (named["foreign_share"], named["looked"], named["closeness"], named["category"], named["own"]) == (0, 0, 1, 1, 1)
    assert (named["stretch_x"], named["stretch_y"]) == (0, pytest.approx(np.log(2)))
    assert named["oval"] == 1.0
    assert named["unscaled"] == pytest.approx(np.exp(-20 * 2 * np.log(2) / 3))


def test_hits_count_equal_scores_against_the_choice() -> None:
    examples, _ = toy(1, 0, points=16)
    example = dataclasses.replace(examples[0], rankings=((2,), (3,), (3,)))
    assert example.choice == 3
    scores = np.arange(10.0)
    assert hits([example], [scores], 6).tolist() == [0.0]
    assert hits([example], [scores], 7).tolist() == [1.0]
    assert hits([example], [np.zeros(10)], 5).tolist() == [0.0]
    own = [dataclasses.replace(c, evidence=c.evidence + (i > 4) * (np.array(EVIDENCE) == "own")) for i, c in enumerate(example.candidates)]
    marked = dataclasses.replace(example, candidates=tuple(own))
    assert hits([marked], [scores], 2, without_own=True).tolist() == [1.0]
    assert np.isnan(hits([dataclasses.replace(marked, rankings=((7,),))], [scores], 2, without_own=True)).all()


def test_a_crop_is_whole_in_its_square_and_windows_lie_inside() -> None:
    image = np.full((10, 20, 3), 7, dtype=np.uint8)
    square = square_crop(image, 20)
    assert (square[5:15] == 7).all()
    assert (square[:5] == 255).all()
    assert np.array_equal(square_crop(square, 20), square)
    window = cropped(np.arange(600, dtype=np.uint8).reshape(10, 20, 3), 0.5, np.random.default_rng(0))
    assert 0.4 * 200 < window.shape[0] * window.shape[1] <= 200
