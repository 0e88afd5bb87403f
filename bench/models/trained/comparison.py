"""The network beside the classical member: the same frames, boards and rooms for both."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.goals import goal
from bench.models.lifting import lifting_figures
from bench.models.tabletops import SupportWord, Tabletop, tabletop
from bench.models.trained.fitting import TrainedConfig, fitted_network
from bench.models.trained.photographs import photographed_tables
from bench.models.trained.scoring import FrameScore, FrameTruth, harmonic, lead, precision_recall, score
from bench.models.trained.seeing import WIDTH, seen_masks, thinned
from bench.models.withheld import Finder, withheld_figures
from tasks.capture.small_objects.additions import board_of
from tasks.capture.small_objects.classical import ClassicalConfig, Found, found_in_masks, found_masks
from tasks.capture.small_objects.classical import found_objects as found_classically
from tasks.capture.small_objects.lifting import DepthView, FrameMasks
from tasks.capture.small_objects.naming import NamingConfig, name_by_size
from tasks.capture.small_objects.supports import SupportSlab, support_slabs

if TYPE_CHECKING:
    from bench.models.trained.networks.parting import PartingNet

CLASSICAL, TRAINED = "classical", "trained"

REAL, GENERATED = "real tables", "desks and shelves"
"""What frames show: tables that were photographed, and the virtual scanner's."""

LEARNED = 0.7
"""F1 of masks on generated desks and shelves that says that a training has come to something."""

VIEWS = 4
"""Frames of a desk or shelf whose masks are scored: all twelve show nearly the same."""

LEAST_PIXELS = 60
"""Of an object that has to be found in a frame."""

Masks = Callable[[DepthView, Sequence[SupportSlab]], FrameMasks]


def trained_report(
    scenes: int, rooms: int, seed: int, realdata: Path | None, checkpoints: MutableMapping[str, bytes],
    config: TrainedConfig | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Figures of the network, after its training, and of the classical member.

    scenes: Desks and shelves of each kind. rooms: That are scanned as people walk. realdata: Folder with real frames; None leaves them out.
    checkpoints: Where a training that was ended goes on from.

    Raises:
        InputError: torch is not installed, or a real frame cannot be read.
    """
    network, training = fitted_network(config or TrainedConfig(), checkpoints, lambda done, of, text: None)
    members = members_of(network)
    rows, leads = [], []
    for title, frames in frames_by_title(scenes, seed, realdata).items():
        scores = {name: scored(masks, frames) for name, masks in members.items()}
        for name, (own, seconds) in scores.items():
            rows.append({"frames of": title, "member": name, **figures_of(own), "seconds": seconds / max(len(own), 1)})
        first, second = scores[TRAINED][0], max((scores[name][0] for name in members if name != TRAINED), key=harmonic)
        lead_of, low, high = lead(first, second, seed)
        leads.append({"frames of": title, "lead": lead_of, "low": low, "high": high})
    lifting = [dataclasses.asdict(each) for each in lifted_rows(network, scenes, seed)]
    finders: dict[str, Finder] = {CLASSICAL: found_classically, TRAINED: partial(found_objects, network)}
    walked = [{"member": name, **dataclasses.asdict(withheld_figures(rooms, seed, finder))} for name, finder in finders.items() if rooms]
    learned = next((row["f1"] for row in rows if row["frames of"].startswith(GENERATED) and row["member"] == TRAINED), None)
    goals = [goal("network: F1 of masks on generated desks and shelves that stand apart", learned, ">=", LEARNED)]
    return {"training": training, "frames": rows, "leads": leads, "lifting": lifting, "rooms": walked, "goals": goals}


def members_of(network: PartingNet) -> Mapping[str, Masks]:
    """Who is held against each other; the classical member also at the resolution of the network, where it has more to go by than noise."""
    return {CLASSICAL: classical_masks, f"{CLASSICAL}, thinned": thinned_masks, TRAINED: partial(seen_masks, network)}


def classical_masks(view: DepthView, slabs: Sequence[SupportSlab]) -> FrameMasks:
    """Masks of the classical member, named by size."""
    config, naming = ClassicalConfig(), NamingConfig()
    seen, points = found_masks(view, slabs, config), view.points()
    clouds = [points[mask & (view.depth > 0)] for mask in seen.masks]
    words = [name_by_size(cloud, board_of(cloud, slabs).height, naming).category if len(cloud) > 3 else "" for cloud in clouds]
    return dataclasses.replace(seen, labels=tuple(words))


def thinned_masks(view: DepthView, slabs: Sequence[SupportSlab]) -> FrameMasks:
    """The same of every second pixel of large frames."""
    every = max(1, round(view.depth.shape[1] / WIDTH))
    seen = classical_masks(thinned(view, every), slabs)
    large = np.repeat(np.repeat(seen.masks, every, axis=1), every, axis=2)[:, : view.depth.shape[0], : view.depth.shape[1]]
    return dataclasses.replace(seen, masks=large & (view.depth > 0))


def found_objects(
    network: PartingNet, views: Sequence[DepthView], slabs: Sequence[SupportSlab], config: ClassicalConfig
) -> Found:  # fmt: skip
    """What views agree on by the network's masks, as the classical member's are agreed on."""
    seen = [seen_masks(network, view, slabs) for view in views]
    return found_in_masks(views, [dataclasses.replace(each, labels=("",) * len(each.labels)) for each in seen], slabs, config)


@dataclasses.dataclass(frozen=True)
class ScoredFrame:
    """A frame with the boards in it, and what is true of it."""

    view: DepthView
    slabs: tuple[SupportSlab, ...]
    truth: FrameTruth


def frames_by_title(scenes: int, seed: int, realdata: Path | None) -> dict[str, list[ScoredFrame]]:
    """Frames that masks are scored in."""
    made: dict[str, list[ScoredFrame]] = {}
    for touching, title in ((False, "apart"), (True, "touching")):
        tops = [tabletop(word, touching, seed + number, VIEWS) for word in _words() for number in range(scenes)]
        made[f"{GENERATED}, {title}"] = [frame for number, top in enumerate(tops) for frame in _frames(top, str(number))]
    if realdata is not None:
        made[REAL] = [ScoredFrame(table.view, (table.slab,), table.truth) for table in photographed_tables(realdata)]
    return made


def _words() -> tuple[SupportWord, ...]:
    return ("desk", "bookshelf")


def _frames(top: Tabletop, group: str) -> list[ScoredFrame]:
    frames = []
    for number, view in enumerate(top.views):
        masks, own = top.masks(number)
        counted = masks.sum(axis=(1, 2)) >= LEAST_PIXELS
        truth = FrameTruth(masks, tuple(top.words[index] for index in own), counted, view.depth > 0, group)
        frames.append(ScoredFrame(view, _slabs(top), truth))
    return frames


def scored(masks: Masks, frames: Sequence[ScoredFrame]) -> tuple[list[FrameScore], float]:
    """Scores of frames, and seconds of a processor that masks took."""
    scores, seconds = [], 0.0
    for frame in frames:
        start = time.process_time()
        seen = masks(frame.view, frame.slabs)
        seconds += time.process_time() - start
        scores.append(score(frame.truth, seen))
    return scores, seconds


def figures_of(scores: Sequence[FrameScore]) -> dict[str, Any]:
    """Shares at both overlaps, and of matched pairs those of one word."""
    precision, recall = precision_recall(scores)
    matched = sum(each.matched for each in scores)
    return {
        "frames": len(scores), "objects": sum(each.true for each in scores), "masks": sum(each.seen for each in scores),
        "precision": precision, "recall": recall, "f1": harmonic(scores), "f1_exact": harmonic(scores, exact=True),
        "named": sum(each.named for each in scores) / max(matched, 1),
    }  # fmt: skip


def lifted_rows(network: PartingNet, scenes: int, seed: int) -> list[Any]:
    """Instances of desks and shelves that views agree on, by both."""
    rows = []
    for word in _words():
        for touching in (False, True):
            tops = [tabletop(word, touching, seed + number) for number in range(scenes)]
            for method, finder in ((CLASSICAL, _lifted_classically), (TRAINED, partial(_lifted, network))):
                rows.append(lifting_figures(word, touching, method, tops, [finder] * len(tops)))  # type: ignore[arg-type]
    return rows


def _slabs(top: Tabletop) -> tuple[SupportSlab, ...]:
    return support_slabs(top.word, top.box_pose, top.box_size, top.support_points)


def _lifted(network: PartingNet, top: Tabletop) -> Found:
    return found_objects(network, top.views, _slabs(top), ClassicalConfig())


def _lifted_classically(top: Tabletop) -> Found:
    return found_classically(top.views, _slabs(top), ClassicalConfig())
