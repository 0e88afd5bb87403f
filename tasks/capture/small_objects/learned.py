"""Small objects by networks: a support is shown to a model that lists what is on it, a detector finds that, a segmenter has its masks,
and views agree on instances (supplementary; specs A.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.classical import Found
from tasks.capture.small_objects.consensus import ConsensusConfig, associate
from tasks.capture.small_objects.detectors import Detections, Detector, DetectorSettings, GroundingDino, detector_in
from tasks.capture.small_objects.items import AskedItems, ItemSettings, ListedItems, ToldItems, asked_items, listed_names, names_of
from tasks.capture.small_objects.items.asked import check as check_asked
from tasks.capture.small_objects.joining import FoundObject, found_object
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, LiftingConfig, at_depth, depth_view, lifted
from tasks.capture.small_objects.segmenters import Sam2, Segmenter, SegmenterSettings, segmenter_in
from tasks.capture.small_objects.support_views import (
    CarryingInstance,
    SupportView,
    best_views,
    slab_window,
    support_box,
    support_pixels,
    support_view,
)
from tasks.furniture import canonical_category
from tasks.geometry.windows import view_window
from tasks.settings import Config, Count, Share
from tasks.stage import Context
from tasks.vision.pixels import Image

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FRAMES_AT_ONCE = 8
"""Whose images and masks are in memory."""

_LEAST_BOARD = 60
"""Pixels of a board: fewer do not say whether a mask is the board."""


@dataclasses.dataclass(frozen=True)
class LearnedConfig(Config):
    """Who looks at a support, and what of it counts."""

    kind: ClassVar[str] = "learned"
    segmenter: SegmenterSettings = dataclasses.field(default_factory=Sam2)  # SAM, the paper's, is slower
    detector: DetectorSettings = dataclasses.field(default_factory=GroundingDino)  # knows what a model lists
    items: ItemSettings = dataclasses.field(default_factory=ListedItems)  # needs no endpoint
    support_mask: Literal["segmenter", "points"] = "segmenter"  # whose mask of the support a model is shown; else its instance's points
    item_views: Count = 2  # frames that show the support best, which a model is shown: a second one shows what the first one hides
    look: Literal["window", "frame"] = "window"  # around the support alone, things have more pixels; frames of one size go in batches
    least_pixels: Count = 200  # of depth where small objects can be: frames with fewer show none that can be lifted
    inside_share: Share = 0.5  # of a mask where small objects can be: the rest of what is more elsewhere is not on the support
    board_share: Share = 0.5  # of the board that a frame shows: what covers more is the board
    least_fit: Share = 0.5  # as the segmenter judges its mask: less is no outline of anything
    lifting: LiftingConfig = dataclasses.field(default_factory=LiftingConfig)  # see there
    consensus: ConsensusConfig = dataclasses.field(default_factory=ConsensusConfig)  # see there
    version: str = "1"  # goes up when the same masks would give other instances


@dataclasses.dataclass(frozen=True)
class SeeingNetworks:
    """Who looks. segmenter: None where nobody needs one: the detector draws
    masks itself, and no model is shown the support."""

    detector: Detector
    segmenter: Segmenter | None

    @property
    def version(self) -> str:
        """Hashes of the weights, as rows have them: the same weights see the same things."""
        return "+".join(each.placement.version for each in (self.detector, self.segmenter) if each is not None and each.placement)


@dataclasses.dataclass(frozen=True)
class LearnedFound:
    """What stands on a support. lifted: Frames with their masks, and instances that name them. objects: The same as objects to be added.
    names: What was looked for; none of a detector that has names of its own. call_ids: Of replies that said so. problems: What could
    not be asked or seen, one line each."""

    lifted: Found
    objects: tuple[FoundObject, ...]
    names: tuple[str, ...] = ()
    call_ids: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def check(config: LearnedConfig) -> None:
    """Raises InputError where the settings name networks, devices or endpoints that are not there."""
    networks_of(config)
    if isinstance(config.items, AskedItems):
        check_asked(config.items)


def networks_of(config: LearnedConfig) -> SeeingNetworks:
    """The networks that settings name, opened once in a process.

    Raises:
        InputError: packages, weights or devices are not there.
    """
    detector = detector_in(config.detector)
    shows_support = detector.is_open and isinstance(config.items, AskedItems) and config.support_mask == "segmenter"
    return SeeingNetworks(detector, segmenter_in(config.segmenter) if shows_support or not detector.draws_masks else None)


def objects_on(
    support: CarryingInstance,
    frames: Sequence[FrameSource],
    alignment: Array,
    networks: SeeingNetworks,
    context: Context,
    config: LearnedConfig,
) -> LearnedFound:
    """What stands on a support, found in posed frames with depth.

    alignment: Scan frame to world frame, 4x4 [m].

    Raises:
        InputError: an image cannot be read, the endpoint refuses, or a detector that is a program fails.
        EndpointAway: it does not answer, and that is left to the next run.
    """
    views = [support_view(frame, view, support) for frame in frames if (view := depth_view(frame, alignment)) is not None]
    views = [view for view in views if view.allowed.sum() >= config.least_pixels]
    items = ToldItems(())
    names: tuple[str, ...] = ()
    if networks.detector.is_open:
        if isinstance(config.items, AskedItems):
            items = asked_items(support.category, support.instance_id, _shown(support, views, networks, config), context, config.items)
            names = names_of(items.items)
        else:
            names = listed_names(support.category, config.items)
        own = canonical_category(support.category) or support.category
        names = tuple(name for name in names if (canonical_category(name) or name) != own)
    if not views or (networks.detector.is_open and not names):
        return LearnedFound(Found((), ()), (), names, items.call_ids, items.problems)
    masks = _masks(views, names, networks, config)
    lifts = lifted([view.view for view in views], masks, config.lifting, [view.allowed for view in views])
    instances = associate(lifts, config.consensus).instances
    who = found_by(networks)
    objects = tuple(found_object(each, lifts, each.label, each.score * each.label_share, who, support.instance_id) for each in instances)
    return LearnedFound(Found(tuple(lifts), instances), objects, names, items.call_ids, items.problems)


def found_by(networks: SeeingNetworks) -> str:
    """Who found an object, as rows name it: the detector, and the segmenter where that drew its mask."""
    if networks.detector.draws_masks or networks.segmenter is None:
        return networks.detector.name
    return f"{networks.detector.name}+{networks.segmenter.name}"


def _shown(
    support: CarryingInstance, views: Sequence[SupportView], networks: SeeingNetworks, config: LearnedConfig
) -> list[tuple[Image, Bools]]:
    """Pictures that show a support best, with its mask in each."""
    shown = []
    for index in best_views(views, config.item_views):
        picture = views[index].frame.color()
        mask = support_pixels(views[index], support)
        if config.support_mask == "segmenter" and networks.segmenter is not None:
            (drawn,) = networks.segmenter.segment([picture], [support_box(views[index], support)])
            if len(drawn.masks) and drawn.masks[0].any() and drawn.scores[0] >= config.least_fit:
                mask = drawn.masks[0]
        if mask.any():
            shown.append((picture, mask))
    return shown


def _masks(views: Sequence[SupportView], names: Sequence[str], networks: SeeingNetworks, config: LearnedConfig) -> list[FrameMasks]:
    """Masks of what is looked for, in every frame, at the resolution of its depth."""
    masks = []
    for start in range(0, len(views), FRAMES_AT_ONCE):
        part = views[start : start + FRAMES_AT_ONCE]
        windows = [_window(view, config) for view in part]
        pictures = [view.frame.color()[y0:y1, x0:x1] for view, (x0, y0, x1, y1) in zip(part, windows, strict=True)]
        answers, fits = _drawn(pictures, networks.detector.detect(pictures, names), networks)
        for view, window, detected, fit in zip(part, windows, answers, fits, strict=True):
            masks.append(_in_frame(view, window, detected, fit, config))
    return masks


def _window(view: SupportView, config: LearnedConfig) -> tuple[int, int, int, int]:
    """The part of a frame's color image that is looked at: x0, y0, x1, y1 [px], the ends exclusive."""
    if config.look == "frame":
        return 0, 0, view.frame.width, view.frame.height
    return view_window(slab_window(view), view.frame.width, view.frame.height)


def _drawn(pictures: Sequence[Image], answers: Sequence[Detections], networks: SeeingNetworks) -> tuple[list[Detections], list[Array]]:
    """Detections with masks, and how well each mask fits."""
    if networks.detector.draws_masks:
        return list(answers), [np.ones(len(detected.boxes)) for detected in answers]
    assert networks.segmenter is not None
    segments = networks.segmenter.segment(pictures, [detected.boxes for detected in answers])
    drawn = [dataclasses.replace(detected, masks=segment.masks) for detected, segment in zip(answers, segments, strict=True)]
    return drawn, [segment.scores for segment in segments]


def _in_frame(view: SupportView, window: tuple[int, int, int, int], detected: Detections, fit: Array, config: LearnedConfig) -> FrameMasks:
    """Masks of a frame at the resolution of its depth: those that lie where small objects can be, and are not the board.

    window: Part of the color image that the masks are of. fit: How well each mask fits, shape (n,).
    """
    assert detected.masks is not None
    x0, y0, x1, y1 = window
    depth: DepthView = view.view
    kept: list[int] = []
    masks: list[Bools] = []
    for place in range(len(detected.boxes)):
        if not fit[place] >= config.least_fit:  # nor what has no number
            continue
        whole = np.zeros((view.frame.height, view.frame.width), dtype=bool)
        whole[y0:y1, x0:x1] = detected.masks[place]
        mask = at_depth(whole, view.frame)
        measured, inside, board = (mask & (depth.depth > 0)).sum(), (mask & view.allowed).sum(), view.board.sum()
        is_board = board >= _LEAST_BOARD and (mask & view.board).sum() > config.board_share * board
        if inside and inside >= config.inside_share * measured and not is_board:
            kept.append(place)
            masks.append(mask)
    shape = (len(masks), *depth.depth.shape)
    return FrameMasks(np.array(masks, dtype=bool).reshape(shape), tuple(detected.labels[i] for i in kept), detected.scores[kept])
