"""Training examples out of the rows of a dataset: what annotators chose and ranked, with what they chose from."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Protocol, TypeVar

import numpy as np

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.navigation import Split
from schemas.selection import Selection
from tasks.geometry.transforms import inverse, matrix
from tasks.navigation import split_of
from tasks.selection import ScoreConfig, is_own_geometry
from tasks.selection.alignment import AlignmentConfig, sample_asset
from tasks.selection.model.config import SelectionModel
from tasks.selection.model.examples import Aligned, Example, packed, unpacked
from tasks.selection.model.features import Scanned
from tasks.selection.model.sight import asset_cloud, asset_points, evidence, scan_cloud, scan_points, standing, view_of
from tasks.stage import Context

R = TypeVar("R")
Key = tuple[str, str]
"""Scene and instance."""

READS = ("annotations", "assets", "candidates", "captions", "instances", "scenes", "selections", "splits")


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
        if row.choice is not None and not row.is_withdrawn:
            order = (row.choice, *(asset for asset in row.ranking if asset != row.choice))
            (programs if row.is_simulated else people)[row.scene_id, row.instance_id].append(order)
    return {**programs, **people}, set(programs) - set(people)


def collected(dataset: Rows, context: Context, config: SelectionModel, test_share: float) -> Collected:
    """The examples of a dataset, in the order of scenes and instances.

    `test_share`: of the rooms, where the dataset has no row of a room in `splits`.

    Raises:
        InputError: nobody chose anything in it.
    """
    answers, simulated = answers_of(dataset)
    if not answers:
        raise InputError("train selection", "annotations", "has no choice that counts", "annotate and accept a batch, or simulate annotators")
    rooms, licenses = {}, set()
    for scene in dataset.rows(Scene):
        rooms[scene.scene_id] = scene.room_id
        licenses.add(scene.license or "unknown")
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
    licenses |= {assets[asset_id].license for asset_id in clouds}
    made: dict[str, list[Example]] = {"train": [], "test": []}
    left_out: dict[str, int] = defaultdict(int)
    for number, instance in enumerate(row for row in dataset.rows(Instance) if (row.scene_id, row.instance_id) in answers):
        key = (instance.scene_id, instance.instance_id)
        context_rows = (slots[key], poses[key], assets, captions.get(key))
        example = _example(instance, rooms.get(instance.scene_id, instance.scene_id), answers[key], context_rows, clouds, context, config)
        if isinstance(example, str):
            left_out[example] += 1
            continue
        split = splits.get(example.room_id) or split_of(example.room_id, test_share)
        made[split].append(example)
        context.report(number + 1, len(answers), "examples")
    if not made["train"]:
        raise InputError("train selection", "annotations", "has no choice in a training room", "annotate rooms of the split 'train', too")
    return Collected(made["train"], made["test"], clouds, ", ".join(sorted(licenses)), len(simulated), dict(left_out))


def asset_clouds(assets: Mapping[str, Asset], context: Context, config: SelectionModel) -> dict[str, bytes]:
    """Packed clouds of assets, made once for each content; without those that cannot be read."""
    memory, count = context.caches[__name__], asset_points(config)
    clouds: dict[str, bytes] = {}
    for number, (asset_id, asset) in enumerate(sorted(assets.items())):
        key = f"asset {asset.mesh_blob} {count}"
        data = memory.get(key)
        if data is None:
            rng = np.random.default_rng(list(hashlib.sha256(key.encode()).digest()))
            try:
                sample = sample_asset(asset, context.blobs[asset.mesh_blob], AlignmentConfig(samples=2 * count), rng)
            except (InputError, ValueError, KeyError):
                continue
            data = packed(asset_cloud(sample.points, sample.normals, sample.colors, config))
            memory[key] = data
        clouds[asset_id] = data
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
        stands = standing(instance, context.blobs)
        image = view_of(instance, context.blobs, config)
    except (InputError, KeyError):
        return "its points or its view cannot be read"
    diagonal, back = float(np.linalg.norm(stands.extents)), inverse(stands.frame)
    key = " ".join(map(str, ("scan", instance.points_blob, instance.box_pose, instance.box_size, instance.hidden_m, scan_points(config))))
    memory = context.caches[__name__]
    points = memory.get(key)
    if points is None:
        points = memory[key] = packed(scan_cloud(stands.points, stands.colors, config))
    candidates = []
    for slot in usable:
        row, asset = poses[slot], assets[poses[slot].asset_id]
        values = evidence(
            coverage=row.coverage, box_iou=row.box_iou, color=row.color_similarity, foreign=row.foreign_share, chamfer_m=row.chamfer_m,
            diagonal_m=diagonal, scale=row.scale, category=instance.category, asset=asset,
            is_own=is_own_geometry(asset, slots[slot].provider, ScoreConfig()),
        )  # fmt: skip
        pose, extents = back @ matrix(row.pose), np.array(asset.extents, dtype=np.float32)
        candidates.append(Aligned(row.asset_id, extents, pose, np.array(row.scale), values))
    seen = Scanned(unpacked(points), stands.extents.astype(np.float32), instance.category, caption, image)
    return Example(instance.scene_id, room_id, instance.instance_id, seen, tuple(candidates), kept)
