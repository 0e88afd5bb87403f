"""Simulated annotators: the rule that they rank by, its noise and mistakes, and answers that say what they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.annotation.batch import read_answers
from tasks.annotation.simulation import TOOL, AnnotatorRule, ShownModel, answer, dissimilarity, lab_of, order
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.transforms import transform_points, yaw_pose


def surface(category: str = "chair", seed: int = 0, color: tuple[int, int, int] = (120, 80, 40), size: float = 1.0) -> Surface:
    extents = (0.5 * size, 0.46 * size, 0.88 * size)
    return surface_of(generate(category, extents, np.random.default_rng(seed), color=color).parts)


def shown(of: Surface, seed: int, category: str = "chair", is_scan: bool = False) -> ShownModel:
    return ShownModel.of(category, of, np.random.default_rng(seed), is_scan)


RULE = AnnotatorRule()


def test_two_samples_of_one_model_hardly_differ_and_what_people_see_does_in_the_order_that_they_see_it() -> None:
    own = shown(surface(), 1)
    same = dissimilarity(own, shown(surface(), 2), RULE)
    painted = dissimilarity(own, shown(surface(color=(128, 88, 46)), 2), RULE)
    blue = dissimilarity(own, shown(surface(color=(40, 60, 190)), 2), RULE)
    lamp = dissimilarity(own, shown(surface("floor lamp"), 2, "floor lamp"), RULE)
    crop = dissimilarity(own, shown(surface(), 2, is_scan=True), RULE)
    assert same.chamfer_m < 0.006
    assert same.color < 3
    assert same.category == 0
    assert same.total < painted.total < blue.total < lamp.total
    assert crop.total == pytest.approx(same.total + RULE.scan_penalty)
    assert lamp.category > 0.4


def test_where_a_model_stands_and_which_way_it_faces_changes_nothing_but_a_size_beyond_the_limit_does() -> None:
    own, same = shown(surface(), 1), dissimilarity(shown(surface(), 1), shown(surface(), 2), RULE)
    chair = surface()
    for quarter in range(4):
        moved = dataclasses.replace(chair, vertices=transform_points(chair.vertices, yaw_pose(quarter * np.pi / 2, [3.0, -1.0, 0.7])))
        assert dissimilarity(own, shown(moved, 2), RULE).total == pytest.approx(same.total, abs=0.15)
    little = dissimilarity(own, shown(surface(size=1.05), 2), RULE)
    large = dissimilarity(own, shown(surface(size=1.6), 2), RULE)
    assert little.chamfer_m < 0.006 < 0.03 < large.chamfer_m


def test_colors_are_those_of_the_norm() -> None:
    known = lab_of(np.array([[255, 255, 255], [0, 0, 0], [255, 0, 0], [0, 0, 255]], dtype=np.uint8))
    expected = np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20], [32.30, 79.19, -107.86]])
    assert np.abs(known - expected).max() < 0.1


def test_without_noise_the_order_is_that_of_the_rule_and_with_it_the_odds_are_logistic() -> None:
    still = dataclasses.replace(RULE, noise=0.0, mistakes=0.0)
    totals = [0.4, 0.1, 2.0, 0.3]
    assert order(totals, still, np.random.default_rng(0)) == ([1, 3, 0, 2], False)
    loud = dataclasses.replace(RULE, noise=0.5, mistakes=0.0)
    rng = np.random.default_rng(7)
    first = np.mean([order([0.0, 0.4], loud, rng)[0][0] == 0 for _ in range(4000)])
    assert first == pytest.approx(1 / (1 + np.exp(-0.4 / 0.5)), abs=0.025)


def test_mistakes_come_at_the_stated_rate_and_are_by_chance_alone() -> None:
    rule, rng = dataclasses.replace(RULE, noise=0.0, mistakes=0.2), np.random.default_rng(3)
    drawn = [order([0.0, 5.0, 5.0, 5.0, 5.0], rule, rng) for _ in range(4000)]
    assert np.mean([mistaken for _, mistaken in drawn]) == pytest.approx(0.2, abs=0.02)
    assert np.mean([ranked[0] == 0 for ranked, mistaken in drawn if mistaken]) == pytest.approx(0.2, abs=0.05)
    assert all(ranked[0] == 0 for ranked, mistaken in drawn if not mistaken)


def test_the_same_seed_gives_the_same_order() -> None:
    assert order([0.3, 0.2, 0.1], RULE, np.random.default_rng(5)) == order([0.3, 0.2, 0.1], RULE, np.random.default_rng(5))


def test_an_answer_is_one_of_the_published_schema_and_says_that_a_program_gave_it() -> None:
    batch = read_answers({"batch_id": "b", "annotations": [answer("rooms/a", "0003", "simulated-1", [4, 1, 9], 7)]}, "b")
    row = batch.annotations[0]
    assert row.is_simulated
    assert row.tool == TOOL
    assert (row.choice, row.ranking) == (4, (4, 1, 9))
    assert row.seconds is None
