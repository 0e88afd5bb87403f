"""What stands on a support, found by networks: stand-ins that blur the truth, and tiny ones of random weights behind a real server."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.models.lifting import matched_pairs, overlaps
from bench.models.standins import TrueBoxes, TrueMasks, found_by_standins, frame_of
from bench.models.tabletops import Tabletop, tabletop
from schemas.errors import InputError
from tasks.calls.ledger import Recollection
from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.detectors import Detections, GroundingDino, RfDetr
from tasks.capture.small_objects.items import AskedItems, ListedItems
from tasks.capture.small_objects.items.pictures import box_of
from tasks.capture.small_objects.learned import LearnedConfig, LearnedFound, SeeingNetworks, check, networks_of, objects_on
from tasks.capture.small_objects.segmenters import Sam2
from tasks.capture.small_objects.support_views import (
    CarryingInstance,
    SupportView,
    best_views,
    slab_window,
    support_box,
    support_pixels,
    support_view,
)
from tasks.capture.small_objects.supports import support_slabs
from tasks.stage import Context
from tests.tasks.calls.servers import Server, refuses, says, server

__all__ = ["server"]


@pytest.fixture(scope="module")
def desk() -> Tabletop:
    return tabletop("desk", False, 1)


def support_of(scene: Tabletop) -> CarryingInstance:
    slabs = support_slabs(scene.word, scene.box_pose, scene.box_size, scene.support_points)
    return CarryingInstance("0003", scene.word, slabs, scene.support_points)


def doubled(frame: FrameSource) -> FrameSource:
    """The same frame with a color image of twice the resolution."""
    fx, fy, cx, cy = frame.intrinsics
    return dataclasses.replace(
        frame, width=2 * frame.width, height=2 * frame.height, intrinsics=(2 * fx, 2 * fy, 2 * cx + 0.5, 2 * cy + 0.5),
        color=lambda: np.repeat(np.repeat(frame.color(), 2, axis=0), 2, axis=1),
    )  # fmt: skip


def context(ledger: Recollection | None = None) -> Context:
    return Context("demo/a", "capture", 0, {}, ledger=ledger or Recollection())


@pytest.mark.whole
def test_blurred_boxes_and_masks_give_the_true_objects_with_their_names(desk: Tabletop) -> None:
    found = found_by_standins(desk, np.random.default_rng(7))
    pairs = matched_pairs(overlaps(desk, [obj.points for obj in found.objects]))
    counted = set(desk.counted)
    assert sum(obj in counted for obj, _ in pairs) >= 0.9 * len(counted)
    assert len(found.objects) <= 1.15 * len(counted)
    assert all(found.objects[i].category == desk.words[obj] for obj, i in pairs)
    assert {(obj.found_by, obj.support_id) for obj in found.objects} == {("true_boxes+true_masks", "0000")}
    assert all(0 < obj.probability <= 1 for obj in found.objects)
    frames = {view.frame_id: view for view in desk.views}
    for obj in found.objects:
        assert len(obj.masks) >= 2
        assert all(mask.shape == frames[name].depth.shape and mask.any() for name, mask in obj.masks.items())
    again = found_by_standins(desk, np.random.default_rng(7))
    assert [obj.points.tobytes() for obj in again.objects] == [obj.points.tobytes() for obj in found.objects]


def test_nothing_beside_the_support_and_no_board_is_an_object(desk: Tabletop) -> None:
    """A detector that boxes the desk, its wall and floor, and whole frames."""

    class Everything(TrueBoxes):
        def detect(self, pictures: Sequence[Any], names: Sequence[str]) -> list[Detections]:
            found = []
            for picture in pictures:
                height, width = picture.shape[:2]
                owner = self.scene.owner[self.frames[np.ascontiguousarray(picture).tobytes()]]
                boxes = [(0, 0, width, height), box_of(owner == -1), box_of(owner == -2)]
                found.append(Detections(np.array(boxes, dtype=float), ("mug", "book", "pen"), np.full(3, 0.9)))
            return found

    rng = np.random.default_rng(0)
    networks = SeeingNetworks(Everything(desk, rng), TrueMasks(desk, rng))
    config = LearnedConfig(items=ListedItems(names=("mug", "book", "pen")), look="frame")
    found = objects_on(support_of(desk), [frame_of(view) for view in desk.views], np.eye(4), networks, context(), config)
    assert found.objects == ()


def test_a_closed_set_is_asked_for_nothing_and_an_open_one_not_for_the_support(desk: Tabletop) -> None:
    asked: list[tuple[str, ...]] = []

    class Listening(TrueBoxes):
        def detect(self, pictures: Sequence[Any], names: Sequence[str]) -> list[Detections]:
            asked.append(tuple(names))
            return [Detections(np.zeros((0, 4)), (), np.zeros(0)) for _ in pictures]

    rng = np.random.default_rng(0)
    detector = Listening(desk, rng)
    frames = [frame_of(view) for view in desk.views]
    config = LearnedConfig(items=ListedItems(names=("mug", "Desks", "book")), look="frame")
    found = objects_on(support_of(desk), frames, np.eye(4), SeeingNetworks(detector, TrueMasks(desk, rng)), context(), config)
    assert set(asked) == {("mug", "book")} == {found.names}
    detector.is_open = False
    asked.clear()
    assert objects_on(support_of(desk), frames, np.eye(4), SeeingNetworks(detector, TrueMasks(desk, rng)), context(), config).names == ()
    assert set(asked) == {()}


def test_color_of_twice_the_resolution_gives_the_same_masks(desk: Tabletop) -> None:
    """Boxes of the color image, masks of the depth image: both cameras look from one center."""
    support = support_of(desk)
    frame = frame_of(desk.views[0])
    plain, fine = (support_view(each, desk.views[0], support) for each in (frame, doubled(frame)))
    assert np.allclose(2 * support_box(plain, support) + 0.5, support_box(fine, support), atol=1.01)
    low, high = slab_window(plain), slab_window(fine)
    assert np.abs(2 * np.array(low) - np.array(high)).max() <= 2
    rows, columns = np.nonzero(plain.allowed)
    assert low[0] <= columns.min() <= columns.max() < low[2]
    assert low[1] <= rows.min() <= rows.max() < low[3]
    coarse, detailed = support_pixels(plain, support), support_pixels(fine, support)
    assert (detailed[::2, ::2] == coarse).mean() > 0.98


def test_the_support_is_where_its_own_pixels_are(desk: Tabletop) -> None:
    support = support_of(desk)
    for view, owner in zip(desk.views, desk.owner, strict=True):
        seen = support_view(frame_of(view), view, support)
        top = (owner == -1) & seen.board
        mask = support_pixels(seen, support)
        assert mask[top].mean() > 0.9
        assert mask[owner == -2].mean() < 0.25
        ((x0, y0, x1, y1),) = support_box(seen, support)
        rows, columns = np.nonzero(owner == -1)
        assert x0 - 3 <= np.percentile(columns, 5) < np.percentile(columns, 95) <= x1 + 3
        assert y0 - 3 <= np.percentile(rows, 5) < np.percentile(rows, 95) <= y1 + 3


def test_the_best_views_show_most_of_the_support_away_from_the_border(desk: Tabletop) -> None:
    support = support_of(desk)
    views = [support_view(frame_of(view), view, support) for view in desk.views]
    blind = dataclasses.replace(desk.views[0], depth=np.zeros_like(desk.views[0].depth))
    views.append(support_view(frame_of(blind), blind, support))
    best = best_views(views, 3)
    assert len(best) == 3
    assert [views[i].score for i in best] == sorted((view.score for view in views), reverse=True)[:3]
    assert views[-1].score == 0
    assert len(views) - 1 not in best_views(views, 99)
    assert support_box(views[-1], support).shape == (0, 4)
    assert not support_pixels(views[-1], support).any()


def told(desk: Tabletop, networks: SeeingNetworks, config: LearnedConfig, ledger: Recollection | None = None) -> LearnedFound:
    frames = [doubled(frame_of(view)) for view in desk.views[:4]]
    return objects_on(support_of(desk), frames, np.eye(4), networks, context(ledger), config)


def tiny(folder: Path, **more: Any) -> LearnedConfig:
    """Settings with tiny networks by which nearly everything counts."""
    detector = GroundingDino(
        weights=str(folder / "grounding_dino"), threshold=0.3, text_threshold=0.0, shortest_px=64, longest_px=96, device="cpu"
    )
    segmenter = Sam2(weights=str(folder / "sam2"), device="cpu")
    return LearnedConfig(**{"detector": detector, "segmenter": segmenter, "least_fit": 0.0, "inside_share": 0.0, **more})


@pytest.mark.whole
def test_a_server_and_networks_in_folders_make_the_same_rows_every_time(desk: Tabletop, networks: Path, server: Server) -> None:
    items = [{"item": "mug", "color": "red", "count": 1}, {"item": "Books", "color": None, "count": 2}]
    server.answers = [says(json.dumps({"items": items}))]
    config = tiny(networks, items=AskedItems(url=server.url, model="seer-1", pause_seconds=0.0, attempts=1))
    opened = networks_of(config)
    ledger = Recollection()
    first = told(desk, opened, config, ledger)
    assert (first.names, first.problems) == (("mug", "book"), ())
    assert set(first.call_ids) == set(ledger.calls)
    assert len(first.call_ids) == len(server.requests) == 2, "two views show the support"
    assert sum(len(frame.masks) for frame in first.lifted.frames) > 0
    assert {label for frame in first.lifted.frames for label in frame.labels} <= {"mug", "book"}
    assert {obj.found_by for obj in first.objects} <= {"grounding_dino+sam2"}
    server.answers = [refuses(500)]
    again = told(desk, opened, config, ledger)
    assert len(server.requests) == 2, "what the ledger has is not asked again"
    assert [frame.masks.tobytes() for frame in again.lifted.frames] == [frame.masks.tobytes() for frame in first.lifted.frames]
    assert [obj.points.tobytes() for obj in again.objects] == [obj.points.tobytes() for obj in first.objects]
    assert opened.version == "+".join(each.placement.weights[:12] for each in (opened.detector, opened.segmenter))  # type: ignore[union-attr]
    nobody = told(desk, opened, config)
    assert (nobody.objects, nobody.names, len(nobody.problems)) == ((), (), 1)


@pytest.mark.whole
def test_a_closed_set_with_masks_of_its_own_needs_no_segmenter(desk: Tabletop, networks: Path) -> None:
    config = tiny(networks, detector=RfDetr(weights=str(networks / "rf_detr"), threshold=0.0, side_px=64, device="cpu"), segmenter=Sam2())
    opened = networks_of(config)
    assert opened.segmenter is None
    found = told(desk, opened, config)
    assert {obj.found_by for obj in found.objects} <= {"rf_detr"}
    assert {label for frame in found.lifted.frames for label in frame.labels} <= {"cup", "book", "mouse"}
    assert found.names == ()


@pytest.mark.whole
def test_settings_that_name_nothing_are_refused_before_anything_is_begun(networks: Path) -> None:
    pytest.importorskip("torch")
    with pytest.raises(InputError, match=r"capture\.small_objects\.provider\.detector: weights: names no folder"):
        check(LearnedConfig())
    with pytest.raises(InputError, match=r"capture\.small_objects\.provider\.segmenter: weights: names no folder"):
        check(tiny(networks, segmenter=Sam2()))
    with pytest.raises(InputError, match=r"capture\.small_objects\.provider\.items: model: names no model"):
        check(tiny(networks, items=AskedItems()))
    check(tiny(networks))


def test_frames_without_depth_or_far_from_the_support_show_nothing(desk: Tabletop) -> None:
    rng = np.random.default_rng(0)
    networks = SeeingNetworks(TrueBoxes(desk, rng), TrueMasks(desk, rng))
    blind = [dataclasses.replace(frame_of(view), depth=None) for view in desk.views]
    assert objects_on(support_of(desk), blind, np.eye(4), networks, context(), LearnedConfig()).objects == ()
    away = np.eye(4)
    away[0, 3] = 50.0
    frames = [frame_of(view) for view in desk.views]
    assert objects_on(support_of(desk), frames, away, networks, context(), LearnedConfig()).objects == ()


def test_a_view_is_one_of_a_support(desk: Tabletop) -> None:
    view: SupportView = support_view(frame_of(desk.views[0]), desk.views[0], support_of(desk))
    inside = np.zeros(view.allowed.shape, dtype=bool)
    world = desk.views[0].points()
    for slab in support_of(desk).slabs:
        inside |= slab.holds(world) & (desk.views[0].depth > 0)
    assert np.array_equal(view.allowed, inside)
    assert not (view.board & ~view.allowed).any()
    objects = desk.owner[0] >= 0
    assert view.allowed[objects].mean() > 0.95
    assert view.board[objects].mean() < 0.3
