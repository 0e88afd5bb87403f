"""What is asked for: a large object in a kind of room, or one of a scene; held against what there is before anything is drawn."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Room, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.optimization import Placement, Support
from schemas.selection import Selection
from tasks import micro_scenes
from tasks.furniture import typical_extents
from tasks.furniture.tops import typical_size
from tasks.furniture.tops.sizes import LARGE
from tasks.micro_scenes.categories import read_categories
from tasks.settings import nearest
from tasks.stage import Context
from tasks.synthesis.layout import UNKNOWN_ROOM, Large
from tasks.synthesis.scenes.bases import large_box
from tasks.synthesis.scenes.drawn import BaseScene
from tasks.synthesis.scenes.words import large_of, words_of
from warehouse.lake import Lake
from warehouse.tables.history import fingerprints, states
from warehouse.tables.snapshot import Reader

ROOM_TYPES = ("bedroom", "office", "living room", "kitchen", "dining room", "bathroom", UNKNOWN_ROOM)
"""Kinds of rooms that can be asked for."""

LEAST_M, MOST_M = 0.2, 5.0
"""Extents of a large object that can be asked for [m]."""

_OWN_SIZE = (0.92, 1.08)
"""Range of the factor of a category's usual extents where it has no range of its own."""

_READ = ("capture", "captions", "candidates", "selection", "optimization", "micro_scenes")
"""Stages whose rows a base brings."""


@dataclasses.dataclass(frozen=True)
class SceneRequest:
    """What is asked for: `large` in a room of `room_type`, of extents `size` [m], depth, width, height, by chance where none are given; or
    `instance`, `<scene>/<id>`, a large object of the lake that is furnished anew."""

    large: str = ""
    room_type: str = UNKNOWN_ROOM
    size: tuple[float, float, float] | None = None
    instance: str = ""


@dataclasses.dataclass(frozen=True)
class AskedScene:
    """A request that can be met. word: The large object's own word. size: None for by chance. content: What of a base counts."""

    word: str
    category: str
    room_type: str
    size: tuple[float, float, float] | None
    base: BaseScene | None
    content: tuple[str, ...]

    def large(self, seed: int, number: int) -> Large:
        """The large object of a layout."""
        return Large(self.category, self.size or usual_size(self.word, seed, number), self.room_type)

    @property
    def facts(self) -> dict[str, Any]:
        """As JSON values, for rows that say what was asked for."""
        of = {"instance": f"{self.base.scene.scene_id}/{self.base.instance_id}"} if self.base is not None else {"large": self.word}
        return {**of, "category": self.category, "room_type": self.room_type, "size": list(self.size) if self.size is not None else None}


def usual_size(word: str, seed: int, number: int) -> tuple[float, float, float]:
    """Extents of a large object of a word by chance [m]: depth, width, height; the same for a seed and a number."""
    rng = np.random.default_rng([abs(seed), int(seed < 0), number])
    if word in LARGE:
        return typical_size(word, rng)
    x, y, z = (float(value) for value in np.array(typical_extents(word)) * rng.uniform(*_OWN_SIZE, 3))
    return x, y, z


def asked(lake: Lake, request: SceneRequest) -> AskedScene:
    """A request, held against the table of categories, the kinds of rooms, and the lake.

    Raises:
        InputError: it names what there is not, with what it may have meant.
    """
    if request.instance:
        return _of_instance(lake, request.instance)
    table = read_categories()
    category = large_of(request.large, table)
    if category is None:
        names = sorted(name for name in table.names if table.is_large(name))
        raise InputError("--large", request.large, "is no large object", nearest(request.large.replace(" ", "_"), names, "there are"))
    room_type = _room_type(request.room_type)
    if request.size is not None and not all(LEAST_M <= value <= MOST_M for value in request.size):
        sides = " x ".join(f"{value:g}" for value in request.size)
        raise InputError("--size", sides, "is no size of furniture", f"give depth, width and height of {LEAST_M:g} to {MOST_M:g} m")
    word = " ".join(request.large.lower().replace("_", " ").replace("-", " ").split())
    if word.replace(" ", "_") == category and category.replace("_", " ") not in LARGE:
        word = next((known for known in words_of(category) if known in LARGE), word)
    return AskedScene(word, category, room_type, request.size, None, ())


def _room_type(text: str) -> str:
    word = " ".join(text.lower().replace("_", " ").replace("-", " ").split())
    if word not in ROOM_TYPES:
        raise InputError("--room-type", text, "is no kind of room", nearest(word, ROOM_TYPES, "there are"))
    return word


def _of_instance(lake: Lake, text: str) -> AskedScene:
    """The large object of a scene, with all of the scene's rows as the newest snapshot has them."""
    scene_id, _, instance_id = text.rpartition("/")
    reader = lake.snapshot()
    scenes = reader.rows(Scene, scene_id) if scene_id.count("/") == 1 else []
    if not scenes:
        raise InputError("--instance", text, "is in no scene of the lake", 'give <scene>/<id>; see `metascenes sql "FROM micro_scenes"`')
    instances = list(reader.rows(Instance, scene_id))
    instance = next((row for row in instances if row.instance_id == instance_id), None)
    table = read_categories()
    if instance is None or instance.is_structure or large_of(instance.category, table) is None:
        known = [f"{row.instance_id} {row.category}" for row in instances if not row.is_structure and large_of(row.category, table)]
        problem = "is no instance of its scene" if instance is None else f"is no large object, but a {instance.category}"
        raise InputError("--instance", text, problem, f"its large objects are {', '.join(known[:10]) or 'none'}")
    shells, rooms = list(reader.rows(Shell, scene_id)), list(reader.rows(Room, scene_id))
    placements = list(reader.rows(Placement, scene_id))
    if not shells or not placements:
        raise InputError("--instance", text, "nothing is placed in its scene", "run the optimization of its scene first")
    shown = {(row.instance_id, row.asset_id) for row in placements}
    assets = list(reader.rows_by_key(Asset, sorted({row.asset_id for row in placements})))
    base = BaseScene(
        scene=scenes[0], shell=shells[0], rooms=tuple(rooms), surfaces=tuple(reader.rows(RoomSurface, scene_id)),
        instances=tuple(instances),
        captions=tuple(reader.rows(Caption, scene_id)),
        candidates=tuple(row for row in reader.rows(Candidate, scene_id) if (row.instance_id, row.asset_id) in shown),
        selections=tuple(row for row in reader.rows(Selection, scene_id) if (row.instance_id, row.asset_id) in shown),
        placements=tuple(placements), supports=tuple(reader.rows(Support, scene_id)),
        assets=tuple(assets), instance_id=instance_id, belonging=frozenset(),
    )  # fmt: skip
    box = large_box(base)
    x, y, z = (float(value) for value in box.size)
    if min(x, y) < LEAST_M or max(x, y, z) > MOST_M:  # a board on a wall may be as thin as it likes
        sides = " x ".join(f"{value:.2f}" for value in (x, y, z))
        raise InputError("--instance", text, f"is {sides} m, no size of furniture", f"name one of {LEAST_M:g} to {MOST_M:g} m")
    content = content_of(reader, scene_id)
    if any(part.startswith("micro_scenes=") for part in content):
        larges, objects = list(reader.rows(MicroScene, scene_id)), list(reader.rows(MicroSceneObject, scene_id))
    else:
        larges, objects = _extracted(base)
    base, room_type = _with_belonging(base, larges, objects)
    return AskedScene(instance.category, table.merged(instance.category), room_type, (x, y, z), base, content)


def content_of(reader: Reader, scene_id: str) -> tuple[str, ...]:
    """Fingerprints of the runs that wrote the rows of a base, as `<stage>=<fingerprint>`: of the stages that are read alone, in a snapshot.

    What is staged does not count: rows are read from the snapshot. A run of another stage changes nothing here.
    """
    prints = fingerprints(states(reader.matching("stage_runs", {"scene_id": [scene_id]})))
    return tuple(f"{stage}={print_}" for (_, stage), print_ in sorted(prints.items()) if stage in _READ)


def _extracted(base: BaseScene) -> tuple[list[MicroScene], list[MicroSceneObject]]:
    """The micro-scenes of a base that nobody has looked for yet."""
    context = Context(scene_id=base.scene.scene_id, stage="micro_scenes", seed=0, blobs={})
    matches = micro_scenes.run(
        scenes=[base.scene], shells=[base.shell], rooms=base.rooms, instances=base.instances, supports=base.supports,
        placements=base.placements, assets=base.assets, context=context, config=micro_scenes.MicroScenesConfig(),
    ).rows  # fmt: skip
    return matches["micro_scenes"], matches["micro_scene_objects"]


def _with_belonging(base: BaseScene, larges: Sequence[MicroScene], objects: Sequence[MicroSceneObject]) -> tuple[BaseScene, str]:
    """A base with the small objects that belong to its large one, and the kind of room that it stands in."""
    names = frozenset(row.instance_id for row in objects if row.large_id == base.instance_id)
    room_type = next((row.room_type for row in larges if row.instance_id == base.instance_id), "")
    return dataclasses.replace(base, belonging=names), room_type or _room_of(base.rooms, base)


def _room_of(rooms: Sequence[Room], base: BaseScene) -> str:
    index = next(row.room_index for row in base.instances if row.instance_id == base.instance_id)
    return next((room.room_type for room in rooms if room.room_index == index or len(rooms) == 1), base.shell.room_type)
