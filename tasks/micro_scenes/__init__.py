"""Micro-scenes of a scene: each large object with what stands on, in or leans on it (supplementary B.2).

Of grain scene: what is computed follows from one scene's rows, so that it is replaced and withdrawn with them; how rooms are
split into train and test is said by the table splits.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from pydantic import model_validator

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene, Shell
from schemas.errors import InputError
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.optimization import Placement, Support
from tasks.furniture import canonical_category
from tasks.geometry.transforms import flat, matrix
from tasks.micro_scenes.belonging import Belonging, belongings
from tasks.micro_scenes.boxes import Array, StandingBox, standing_box
from tasks.micro_scenes.carrying import CarriedBy, CarryingConfig, carriers_of, leans_on, without_circles
from tasks.micro_scenes.categories import Categories, read_categories
from tasks.mounting import HOLDS_NOTHING, mounting
from tasks.settings import Config
from tasks.stage import Context, Outcome, Stage

__all__ = ["STAGE", "MicroScenesConfig", "run"]

UNKNOWN_ROOM, SEVERAL_ROOMS = "unknown", "dwelling"
"""Kinds of rooms that say nothing of what stands there."""

_HUNG = ("let_in", "wall", "ceiling")
"""Kinds of mounting of what never stands on anything, whatever its box touches."""


@dataclasses.dataclass(frozen=True)
class MicroScenesConfig(Config):
    """How micro-scenes are found.

    `categories_sha256` is filled in from the table of categories in use, the project's own or the user's, so that its content decides
    whether they are found again.
    """

    categories: str | None = None  # The project's own table; users bring one of the same layout for words of their own.
    categories_sha256: str = dataclasses.field(init=False)  # From the file.
    carrying: CarryingConfig = dataclasses.field(default_factory=CarryingConfig)  # Used where no support is known.

    @model_validator(mode="after")
    def _with_categories(self) -> Self:
        object.__setattr__(self, "categories_sha256", _categories(self).sha256)
        return self


def run(
    *,
    scenes: Sequence[Scene],
    shells: Sequence[Shell],
    rooms: Sequence[Room],
    instances: Sequence[Instance],
    supports: Sequence[Support],
    placements: Sequence[Placement],
    assets: Sequence[Asset],
    context: Context,
    config: MicroScenesConfig,
) -> Outcome:
    """Rows of `micro_scenes` and `micro_scene_objects` of one scene.

    Raises:
        InputError: the scene has no room or no row of its own, a placement names an instance or asset that is not there, objects carry
            each other in a circle, or the table of categories has changed since the run was planned.
    """
    if not scenes or not shells:
        raise InputError(context.scene_id, "shells" if scenes else "scenes", "has no row for this scene", "run the capture stage again")
    categories = _categories(config)
    if categories.sha256 != config.categories_sha256:
        raise InputError(config.categories or "categories.yaml", "content", "has changed since the run was planned", "start the run again")
    by_id = {instance.instance_id: instance for instance in instances}
    placed = {row.instance_id: row for row in sorted(placements, key=lambda row: row.instance_id)}
    boxes = _boxes(placed, by_id, assets)
    merged = {name: categories.merged(by_id[name].category) for name in boxes}
    carried = _carried(boxes, by_id, supports, config.carrying)
    carried |= _leaning(boxes, by_id, merged, categories, carried, supports, config.carrying)
    if not without_circles(carried):
        raise InputError(context.scene_id, "supports", "objects carry each other in a circle", "run the optimization stage again")
    belonging = belongings(carried, lambda name: categories.is_large(merged[name]), lambda name: categories.is_small(merged[name]))
    counts = Counter(small.large for small in belonging)
    kinds = {room.room_index: room.room_type for room in rooms}
    larges = [
        MicroScene(
            scene_id=context.scene_id,
            instance_id=name,
            room_id=scenes[0].room_id,
            room_index=by_id[name].room_index,
            room_type=_room_type(by_id[name].room_index, kinds, shells[0]),
            category=merged[name],
            word=by_id[name].category,
            asset_id=placed[name].asset_id,
            frame_pose=flat(boxes[name].pose),
            box_size=_numbers(boxes[name].size),
            object_count=count,
        )
        for name, count in sorted(counts.items())
    ]
    smalls = [_object(small, boxes, by_id, placed, merged, context) for small in belonging]
    return Outcome(micro_scenes=larges, micro_scene_objects=smalls)


def _categories(config: MicroScenesConfig) -> Categories:
    return read_categories(None if config.categories is None else Path(config.categories))


def _boxes(placed: Mapping[str, Placement], by_id: Mapping[str, Instance], assets: Sequence[Asset]) -> dict[str, StandingBox]:
    """The box of every placed object but structure, by instance."""
    extents = {asset.asset_id: asset.extents for asset in assets}
    boxes = {}
    for name, row in placed.items():
        field = f"placement {name}"
        if name not in by_id:
            raise InputError(row.scene_id, field, "its instance is not in instances", "run the capture stage again")
        if row.asset_id not in extents:
            raise InputError(row.scene_id, field, f"asset {row.asset_id} is not in assets", "run the candidates stage again")
        if not by_id[name].is_structure:
            boxes[name] = standing_box(name, extents[row.asset_id], row.scale, matrix(row.optimized_pose))
    return boxes


def _carried(
    boxes: Mapping[str, StandingBox], by_id: Mapping[str, Instance], supports: Sequence[Support], config: CarryingConfig
) -> dict[str, CarriedBy]:
    """What carries each object: as its support says, where it still holds, else by the boxes. What lies on a rug lies on the floor."""
    known = {row.instance_id: row for row in supports if row.is_kept and row.instance_id in boxes}
    standing = [box for name, box in boxes.items() if mounting(by_id[name].category).kind not in _HUNG]
    solid = {name for name in boxes if canonical_category(by_id[name].category) in HOLDS_NOTHING or by_id[name].category in HOLDS_NOTHING}
    carried = {name: carrier for name, carrier in carriers_of(standing, config, solid).items() if name not in known}
    for name, row in known.items():
        if row.parent_id in boxes and row.parent_id is not None:
            carried[name] = CarriedBy(row.parent_id, row.relation)
    rugs = {name for name in boxes if name not in carried and mounting(by_id[name].category).kind == "covering"}
    return {name: carrier for name, carrier in carried.items() if carrier.parent not in rugs}


def _leaning(
    boxes: Mapping[str, StandingBox], by_id: Mapping[str, Instance], merged: Mapping[str, str], categories: Categories,
    carried: Mapping[str, CarriedBy], supports: Sequence[Support], config: CarryingConfig,
) -> dict[str, CarriedBy]:  # fmt: skip
    """Small objects that stand on the floor and lean on the side of a large one that nothing carries either."""
    hung = {row.instance_id for row in supports if row.relation in ("wall", "ceiling")}
    against = {row.instance_id: row.against for row in supports if row.is_kept}
    free = [name for name in boxes if name not in carried and name not in hung]
    larges = [boxes[name] for name in free if categories.is_large(merged[name]) and boxes[name].tilt <= config.lean_radians]
    names = {box.name for box in larges}
    leaning = {}
    for name in free:
        if not categories.is_small(merged[name]) or mounting(by_id[name].category).kind in _HUNG:
            continue
        stated = against.get(name)
        parent = stated if stated in names and stated != name else leans_on(boxes[name], larges, config)
        if parent is not None:
            leaning[name] = CarriedBy(parent, "leans")
    return leaning


def _room_type(index: int | None, kinds: Mapping[int, str], shell: Shell) -> str:
    """Kind of the room of an index, else of the only room, else of the whole scene where that is one."""
    only = next(iter(kinds.values())) if len(kinds) == 1 else UNKNOWN_ROOM
    kind = kinds.get(index, only) if index is not None else only
    if kind == UNKNOWN_ROOM and shell.room_type != SEVERAL_ROOMS:
        kind = shell.room_type
    return kind


def _object(
    small: Belonging, boxes: Mapping[str, StandingBox], by_id: Mapping[str, Instance], placed: Mapping[str, Placement],
    merged: Mapping[str, str], context: Context,
) -> MicroSceneObject:  # fmt: skip
    box = boxes[small.name]
    center, yaw = box.within(boxes[small.large])
    return MicroSceneObject(
        scene_id=context.scene_id,
        large_id=small.large,
        instance_id=small.name,
        category=merged[small.name],
        word=by_id[small.name].category,
        asset_id=placed[small.name].asset_id,
        parent_id=small.carried.parent,
        relation=small.carried.relation,
        depth=small.depth,
        box_center=_numbers(center),
        box_size=_numbers(box.size),
        yaw_radians=yaw + 0.0,
        tilt_radians=box.tilt + 0.0,
    )


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(value) + 0.0 for value in values)


STAGE = Stage(
    name="micro_scenes",
    reads=("scenes", "shells", "rooms", "instances", "supports", "placements", "assets"),
    writes=("micro_scenes", "micro_scene_objects"),
    config=MicroScenesConfig,
    run=run,
)
