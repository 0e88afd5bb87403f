"""Training examples out of the rows of a dataset: what annotators chose and ranked, with what they chose from."""

from __future__ import annotations

import contextlib
import dataclasses
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Protocol, TypeVar

import numpy as np

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.lineage.licenses import of_asset, stated
from schemas.navigation import Split
from schemas.selection import Selection
from tasks.alignment import instance_frame
from tasks.geometry.transforms import inverse, matrix
from tasks.navigation import split_of
from tasks.selection import SelectionConfig
from tasks.selection.model.config import SelectionModel
from tasks.selection.model.examples import AlignedCandidate, Example
from tasks.selection.model.sight import evidence, scanned, surface_cloud
from tasks.selection.scoring import is_own_geometry
from tasks.stage import Context
from tasks.views.crops import decoded

R = TypeVar("R")
Key = tuple[str, str]
"""Scene and instance."""

READS = ("annotations", "assets", "candidates", "captions", "instances", "scenes", "selections", "splits")

MEMORY = "tasks.selection.model.sight"
"""Of point clouds; use and training share it."""

STAGE_CONFIG = SelectionConfig()
"""What instances stand by, and whose assets are the scan itself, as the stage has it by default."""


class Rows(Protocol):
    """A dataset; see `tasks.training.dataset.Dataset`."""

    def rows(self, record: type[R]) -> Iterator[R]:
        """Rows of a record type."""
        ...


@dataclasses.dataclass(frozen=True)
class Collected:
    """What a dataset has to learn from.

    train, test: Examples by the split of their room. clouds: Packed clouds by asset. license: Of assets and scans, each once. simulated:
    Examples on which only programs answered. left_out: Objects that somebody chose for and that cannot be used, by reason.
    """

    train: list[Example]
    test: list[Example]
    clouds: dict[str, bytes]
    license: str
    simulated: int
    left_out: Mapping[str, int]


def answers_of(dataset: Rows) -> tuple[dict[Key, list[tuple[str, ...]]], set[Key]]:
    """Rankings of assets, best first, by instance, and the instances for which only programs answered.

    Of an annotator's revisions in a batch the last counts; where people answered, programs do not; 'none of them' is no ranking.
    """
    newest: dict[tuple[str, ...], Annotation] = {}
    for row in dataset.rows(Annotation):
        key = (row.scene_id, row.instance_id, row.batch_id, row.annotator)
        if key not in newest or newest[key].revision < row.revision:
            newest[key] = row
    people: dict[Key, list[tuple[str, ...]]] = defaultdict(list)
    programs: dict[Key, list[tuple[str, ...]]] = defaultdict(list)
    for _, row in sorted(newest.items()):
        if row.is_withdrawn:
            continue
        answered = (programs if row.is_simulated else people)[row.scene_id, row.instance_id]
        if row.choice is not None:
            answered.append((row.choice, *(asset for asset in row.ranking if asset != row.choice)))
    every = {key: orders for key, orders in {**programs, **people}.items() if orders}
    return every, set(every) - set(people)


def collected(dataset: Rows, context: Context, config: SelectionModel, test_share: float) -> Collected:
    """The examples of a dataset, in the order of scenes and instances.

    `test_share`: of the rooms, where the dataset has no row of a room in `splits`.

    Raises:
        InputError: nobody chose anything in it.
    """
    answers, simulated = answers_of(dataset)
    if not answers:
        raise InputError(
            "train selection", "annotations", "has no choice that counts", "annotate and accept a batch, or simulate annotators"
        )
    scenes = {scene.scene_id: scene for scene in dataset.rows(Scene)}
    rooms = {scene_id: scene.room_id for scene_id, scene in scenes.items()}
    scans = {scene_id: scene.license for scene_id, scene in scenes.items()}
    splits = {row.room_id: row.split for row in dataset.rows(Split)}
    captions = {key: row.sentence for row in dataset.rows(Caption) if (key := (row.scene_id, row.instance_id)) in answers}
    slots: dict[Key, dict[int, Candidate]] = defaultdict(dict)
    for candidate in dataset.rows(Candidate):
        if (key := (candidate.scene_id, candidate.instance_id)) in answers and candidate.asset_id is not None:
            slots[key][candidate.slot] = candidate
    poses: dict[Key, dict[int, Selection]] = defaultdict(dict)
    for selection in dataset.rows(Selection):
        if (key := (selection.scene_id, selection.instance_id)) in answers:
            poses[key][selection.slot] = selection
    wanted = {row.asset_id for rows in poses.values() for row in rows.values()}
    assets = {asset.asset_id: asset for asset in dataset.rows(Asset) if asset.asset_id in wanted}
    clouds = asset_clouds(assets, context, config)
    licenses = {stated(license_) for license_ in scans.values()}
    licenses |= {of_asset(assets[asset_id].license, assets[asset_id].source, scans) for asset_id in clouds}
    made: dict[str, list[Example]] = {"train": [], "test": []}
    left_out: dict[str, int] = defaultdict(int)
    of_programs = 0
    for number, instance in enumerate(row for row in dataset.rows(Instance) if (row.scene_id, row.instance_id) in answers):
        key = (instance.scene_id, instance.instance_id)
        context_rows = (slots[key], poses[key], assets, captions.get(key))
        example = _example(instance, rooms.get(instance.scene_id, instance.scene_id), answers[key], context_rows, clouds, context, config)
        if isinstance(example, str):
            left_out[example] += 1
            continue
        split = splits.get(example.room_id) or split_of(example.room_id, test_share)
        made[split].append(example)
        of_programs += key in simulated
        context.report(number + 1, len(answers), "examples")
    if not made["train"]:
        raise InputError("train selection", "annotations", "has no choice in a training room", "annotate rooms of the split 'train', too")
    return Collected(made["train"], made["test"], clouds, ", ".join(sorted(licenses)), of_programs, dict(left_out))


def asset_clouds(assets: Mapping[str, Asset], context: Context, config: SelectionModel) -> dict[str, bytes]:
    """Packed clouds of assets; without those that cannot be read."""
    clouds: dict[str, bytes] = {}
    for number, (asset_id, asset) in enumerate(sorted(assets.items())):
        with contextlib.suppress(InputError, ValueError, KeyError):
            clouds[asset_id] = surface_cloud(asset.mesh_blob, context.blobs, config, context.caches[MEMORY])
        context.report(number + 1, len(assets), "point clouds")
    return clouds


def _example(
    instance: Instance, room_id: str, rankings: list[tuple[str, ...]],
    rows: tuple[dict[int, Candidate], dict[int, Selection], Mapping[str, Asset], str | None],
    clouds: Mapping[str, bytes], context: Context, config: SelectionModel,
) -> Example | str:  # fmt: skip
    """The example of an instance, or why there is none."""
    slots, poses, assets, caption = rows
    usable = [slot for slot in sorted(poses) if slot in slots and poses[slot].asset_id in clouds]
    places: dict[str, int] = {}
    for place, slot in enumerate(usable):
        places.setdefault(poses[slot].asset_id, place)
    # of a ranking whose first choice is gone nothing is known about the rest
    kept = tuple(tuple(places[asset] for asset in order if asset in places) for order in rankings if order[0] in places)
    if len(usable) < 2:
        return "fewer than two candidates"
    if not kept:
        return "the chosen asset is no candidate any more"
    try:
        frame, target, points, colors = instance_frame(
            instance, context, STAGE_CONFIG.alignment, STAGE_CONFIG.floor_snap_m, STAGE_CONFIG.beside_m
        )
        image = None if instance.view_blob is None else decoded(context.blobs[instance.view_blob], instance.view_blob)
    except (InputError, KeyError):
        return "its points or its view cannot be read"
    seen = scanned(points, colors, target.size, instance.category, caption, image, config)
    back = inverse(frame)
    candidates = []
    for slot in usable:
        row, asset = poses[slot], assets[poses[slot].asset_id]
        values = evidence(
            coverage=row.coverage, box_iou=row.box_iou, color=row.color_similarity, foreign=row.foreign_share, chamfer_m=row.chamfer_m,
            diagonal_m=target.diagonal, scale=row.scale, category=instance.category, asset=asset,
            is_own=is_own_geometry(asset, slots[slot].provider, STAGE_CONFIG.score),
        )  # fmt: skip
        pose, extents = back @ matrix(row.pose), np.array(asset.extents, dtype=np.float32)
        candidates.append(AlignedCandidate(row.asset_id, extents, pose, np.array(row.scale), values))
    return Example(instance.scene_id, room_id, instance.instance_id, seen, tuple(candidates), kept)
