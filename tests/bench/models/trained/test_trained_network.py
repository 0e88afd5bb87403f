"""The network: its training, and masks by what it says."""

from __future__ import annotations

import dataclasses
import io
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from bench.machine import machine
from bench.models.lifting import lifting_figures
from bench.models.report import PARTS, TRAINED, USUAL
from bench.models.tables import print_models
from bench.models.tabletops import Tabletop, tabletop
from bench.models.trained import seeing
from bench.models.trained.comparison import classical_masks, found_objects, trained_report
from bench.models.trained.fitting import CROP, NO_DEPTH, TrainedConfig, fitted_network, training_crop
from bench.models.trained.grouping import PAIRS
from bench.models.trained.scenes import FIRST_SEED, training_frames
from bench.models.trained.seeing import WindowAnswer, seen_masks
from bench.models.trained.things import WORDS
from tasks.capture.small_objects.classical import ClassicalConfig, found_masks
from tasks.capture.small_objects.lifting import DepthView
from tasks.capture.small_objects.supports import support_slabs

TINY = TrainedConfig(scenes=1, views=1, crops=2, steps=2)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Tabletop:
    """A desk of which the network's place is taken by who knows the truth."""
    desk = tabletop("desk", False, 900, views=6)
    owners = {view.color.tobytes(): owner for view, owner in zip(desk.views, desk.owner, strict=True)}

    def answered(network: Any, view: DepthView, heights: Any, window: tuple[slice, slice]) -> WindowAnswer:
        owner = owners[view.color.tobytes()][window]
        pairs = [np.where((owner >= 0) & (owner == np.roll(owner, (-r, -c), (0, 1))), 6.0, -6.0) for r, c in PAIRS]
        categories = np.zeros((len(WORDS), *owner.shape), dtype=np.float32)
        for number, word in enumerate(desk.words):
            categories[WORDS.index(word), owner == number] = 1
        return WindowAnswer((owner >= 0).astype(np.float32), np.array(pairs, dtype=np.float32), categories)

    monkeypatch.setattr(seeing, "answered", answered)
    return desk


def test_what_is_true_is_seen_by_name(told: Tabletop) -> None:
    slabs = support_slabs(told.word, told.box_pose, told.box_size, told.support_points)
    for number, view in enumerate(told.views):
        found = seen_masks(None, view, slabs)  # type: ignore[arg-type]
        true, own = told.masks(number)
        assert not (found.masks & (view.depth <= 0)).any()
        assert (found.masks.sum(axis=0) <= 1).all()
        for mask, word in zip(found.masks, found.labels, strict=True):
            overlap = [(mask & other).sum() / mask.sum() for other in true]
            assert max(overlap) > 0.95
            assert told.words[own[int(np.argmax(overlap))]] == word


def test_views_agree_on_what_is_true(told: Tabletop) -> None:
    def finder(top: Tabletop) -> Any:
        slabs = support_slabs(top.word, top.box_pose, top.box_size, top.support_points)
        return found_objects(None, top.views, slabs, ClassicalConfig())  # type: ignore[arg-type]

    figures = lifting_figures("desk", False, "trained", [told], [finder])
    assert figures.objects >= 5
    assert figures.precision >= 0.9
    assert figures.recall >= 0.9


def test_large_frames_are_seen_in_every_second_pixel() -> None:
    desk = tabletop("desk", False, 900, views=1)
    slabs = support_slabs(desk.word, desk.box_pose, desk.box_size, desk.support_points)
    (view,) = desk.views
    fx, fy, cx, cy = view.intrinsics
    depth, color = (np.repeat(np.repeat(image, 2, axis=0), 2, axis=1) for image in (view.depth, view.color))
    large = dataclasses.replace(view, depth=depth, color=color, intrinsics=(2 * fx, 2 * fy, 2 * cx, 2 * cy))
    small = large.thinned(2)
    assert np.array_equal(small.depth, view.depth)
    assert small.intrinsics == view.intrinsics
    assert np.allclose(small.points(), large.points()[::2, ::2])
    expected = found_masks(view, slabs, ClassicalConfig()).masks & (view.depth > 0)
    assert np.array_equal(classical_masks(large, slabs).masks[:, ::2, ::2], expected)


def test_an_example_is_a_crop_whose_pixels_are_somebodys() -> None:
    (frame,) = training_frames(FIRST_SEED + 1, 1)
    for seed in range(8):
        made = training_crop(frame, np.random.default_rng(seed))
        again = training_crop(frame, np.random.default_rng(seed))
        assert all(np.array_equal(getattr(made, field.name), getattr(again, field.name)) for field in dataclasses.fields(made))
        assert made.owner.shape == made.above.shape == CROP
        assert ((made.owner == NO_DEPTH) == (made.seen[11] == 0)).all()
        assert not (made.above & (made.owner == NO_DEPTH)).any()
        named = made.category >= 0
        owner = made.owner[::4, ::4]
        assert (owner[named] >= 0).all()
        assert np.array_equal(made.category[named], frame.categories[owner[named]])
        assert np.isfinite(made.seen).all()


@pytest.mark.whole
@pytest.mark.slow
def test_a_training_is_the_same_bytes_also_after_a_kill_and_learns() -> None:
    torch = pytest.importorskip("torch")
    pytest.importorskip("lightning_fabric")
    first, figures = fitted_network(TINY, {}, lambda done, of, text: None)
    second, _ = fitted_network(TINY, {}, lambda done, of, text: None)
    assert all(torch.equal(a, b) for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True))
    assert figures["frames"] == 1
    kept: dict[str, bytes] = {}
    _, longer = fitted_network(dataclasses.replace(TINY, steps=30), kept, lambda done, of, text: None)
    assert longer["loss"] < figures["loss"]
    again, _ = fitted_network(dataclasses.replace(TINY, steps=30), kept, lambda done, of, text: None)
    whole, _ = fitted_network(dataclasses.replace(TINY, steps=30), {}, lambda done, of, text: None)
    assert all(torch.equal(a, b) for a, b in zip(again.state_dict().values(), whole.state_dict().values(), strict=True))


@pytest.mark.slow
@pytest.mark.whole
def test_an_untrained_network_is_asked_of_frames_of_any_size() -> None:
    pytest.importorskip("torch")
    pytest.importorskip("lightning_fabric")
    network, _ = fitted_network(TINY, {}, lambda done, of, text: None)
    desk = tabletop("desk", True, 901, views=1)
    slabs = support_slabs(desk.word, desk.box_pose, desk.box_size, desk.support_points)
    found = seen_masks(network, desk.views[0], slabs)
    assert found.masks.shape[1:] == desk.views[0].depth.shape
    assert len(found.labels) == len(found.masks)
    nowhere = dataclasses.replace(desk.views[0], pose=desk.views[0].pose @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert len(seen_masks(network, nowhere, slabs).masks) == 0


@pytest.mark.whole
@pytest.mark.slow
def test_both_members_see_the_same_frames_and_a_network_that_learned_nothing_misses_its_goal() -> None:
    pytest.importorskip("torch")
    pytest.importorskip("lightning_fabric")
    report = trained_report(1, 0, 902, None, {}, TINY)
    for title in {row["frames of"] for row in report["frames"]}:
        rows = [row for row in report["frames"] if row["frames of"] == title]
        assert [row["member"] for row in rows] == ["classical", "classical, thinned", "trained"]
        assert len({(row["frames"], row["objects"]) for row in rows}) == 1
        # frames of the generator are as wide as the network looks: nothing is thinned
        assert {**rows[0], "member": "", "seconds": 0} == {**rows[1], "member": "", "seconds": 0}
        assert rows[0]["f1"] > 0.6 > rows[2]["f1"]
    assert all(row["lead"] < 0 and row["high"] < 0 for row in report["leads"])
    assert [row["method"] for row in report["lifting"]] == ["classical", "trained"] * 4
    assert [row["met"] for row in report["goals"]] == [False]
    out = io.StringIO()
    print_models({"machine": machine(), "seed": 902, "parts": {TRAINED: report}, "goals": report["goals"]}, Console(file=out, width=200))
    for text in ("2 steps on 1 frames", "classical, thinned", "desks and shelves, touching", "MISSED"):
        assert text in out.getvalue()


def test_a_network_is_trained_only_where_that_is_asked_for() -> None:
    assert set(PARTS) - set(USUAL) == {TRAINED}
