"""Generated rooms whose scans are lined up: which room is of which kind and split, and whose model each scanned instance shows.

Rooms are those of `tasks.furniture.rooms`; every eighth is a hard dwelling. Things that carry nothing are exchanged now and then for
another category of about their size, so that most of what the generator can draw is met. A fifth of its categories is never in a training
room: what the recipes put there is exchanged.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture import CATEGORIES, generate, typical_extents
from tasks.furniture.dwellings import Dwelling, DwellingSettings, dwelling
from tasks.furniture.furnishing import Furnishing
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.geometry.transforms import inverse, matrix
from tasks.mounting import mounting
from tasks.navigation import NavigationConfig, split_of
from tasks.scanner import ScannerConfig, scan_scene
from tasks.scanner.dwellings import HARD, HardScanSettings, scan_dwelling

if TYPE_CHECKING:
    import trimesh

    from schemas.capture import Instance, Scene

Array = NDArray[np.float64]

DATASET = "selection"
"""Before every scene's name."""

OBJECTS = 25
"""Things that an easy room is asked for."""

HARD_EVERY = 8
"""Every eighth room is a dwelling, scanned badly."""

HARD_OBJECTS = DwellingSettings(fewest=40, most=48)
"""Dwellings of the least size: a larger one costs as much as it has objects."""

HELD_OUT_SHARE = 0.2
"""Of the generator's categories, that no training room has."""

EXCHANGED = 0.35
"""Of the things that carry nothing, that become another category."""

STRETCH = 1.6
"""Largest ratio, along any side, of a category's usual size to the box that it is drawn into instead of another."""

LIGHT = ScannerConfig(
    depth_width=160,  # with 320 x 240 of color: crops stay as sharp, depth costs a quarter
    depth_height=120,
    looks_wanted=1.0,  # a hurried walk: a third of the frames, and twice the noise
    least_looks=1.0,  # so what one frame saw counts
    least_gain=0.04,  # and the walk ends sooner
    standpoint_spacing_m=0.8,  # long steps
    voxel_m=0.022,  # a sixth fewer vertices; small things keep theirs
)
"""How easy rooms are scanned: what a scan costs follows from its frames and vertices."""

MOST_OFF_M = 0.04
"""Scanned points that lie farther from the model than this, in the mean, are of something else: careless annotation."""

LEAST_SHARE = 0.8
"""Of an instance's vertices that are of one object; with fewer it shows several."""


@dataclasses.dataclass(frozen=True)
class TrueModel:
    """The model that an instance shows. parts: in its own frame [m]; pose: to the world of the capture, 4x4 [m]; extents [m]."""

    name: str
    category: str
    parts: list[trimesh.Trimesh]
    pose: Array
    extents: tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class ScannedRoom:
    """A room that was scanned into a folder. models: by number of the instance in the scan's annotation; to_true: scan frame to the world
    of the models' poses, 4x4 [m]."""

    models: dict[str, Furnishing]
    to_true: Array

    def true_models(self, scene: Scene, instances: list[Instance]) -> dict[str, TrueModel]:
        """The models that captured instances show, by instance; those of which nobody can tell, and parts of the building, are left out."""
        moved = matrix(scene.alignment) @ inverse(self.to_true)
        return {
            row.instance_id: TrueModel(model.name, model.category, model.parts, moved @ model.pose, model.extents)
            for row in instances
            if not row.is_structure and (model := self.models.get(row.source_id)) is not None
        }


def room_name(index: int) -> str:
    """What the scan of a room is called."""
    return f"scene{index:04d}_00"


def split_of_room(index: int) -> str:
    """`train` or `test`, by the rule of the project."""
    return split_of(f"{DATASET}/{room_name(index)}", NavigationConfig().test_share)


def held_out(seed: int) -> frozenset[str]:
    """Categories that are in test rooms only."""
    names = np.random.default_rng([seed, 1]).permutation(np.array(CATEGORIES))
    return frozenset(str(name) for name in names[: round(HELD_OUT_SHARE * len(CATEGORIES))])


def allowed(index: int, seed: int) -> tuple[str, ...]:
    """Categories that a room, and what is offered in it, may have."""
    kept = held_out(seed) if split_of_room(index) == "train" else frozenset()
    return tuple(name for name in CATEGORIES if name not in kept)


def is_hard(index: int) -> bool:
    """Whether a room is a dwelling, scanned badly."""
    return index % HARD_EVERY == HARD_EVERY - 1


@dataclasses.dataclass(frozen=True)
class MadeRoom:
    """A room before it is scanned. home: the dwelling that it is, if it is one. rng: the generator, as furnishing left it."""

    furnished: FurnishedRoom
    home: Dwelling | None
    rng: np.random.Generator


def made_room(index: int, seed: int) -> MadeRoom:
    """Room `index` of a seed."""
    rng = np.random.default_rng([seed, 2, index])
    home = dwelling((seed, 3, index), HARD_OBJECTS) if is_hard(index) else None
    if home is not None:
        room = home.furnished
    else:
        clutter = float(rng.uniform(0.0, 0.4))
        room = furnish(ROOM_TYPES[index % len(ROOM_TYPES)], rng, OBJECTS, clutter)
    room = dataclasses.replace(room, objects=exchanged(room.objects, allowed(index, seed), held_out(seed), rng))
    return MadeRoom(room, dataclasses.replace(home, furnished=room) if home is not None else None, rng)


def scan_room(index: int, seed: int, folder: Path) -> ScannedRoom:
    """Room `index` of a seed, scanned into `<folder>/<name>`; the same arguments write the same bytes."""
    made = made_room(index, seed)
    by_name = {obj.name: obj for obj in made.furnished.objects}
    if made.home is None:
        scanned = scan_scene(made.furnished, folder, room_name(index), LIGHT, made.rng)
        models = {str(row.object_id): by_name[row.name] for row in scanned.objects if row.object_id is not None and row.name in by_name}
        return ScannedRoom(models, matrix(scanned.alignment))
    config = dataclasses.replace(HARD, depth_width=LIGHT.depth_width, depth_height=LIGHT.depth_height)
    truth = scan_dwelling(made.home, folder, room_name(index), HardScanSettings(scanner=config, frames="exported"), made.rng)
    models = {}
    for instance in truth.instances:
        name, share = instance.objects[0] if instance.objects else ("", 0.0)
        if name in by_name and share >= LEAST_SHARE and not (instance.is_merged or instance.is_split):
            models[str(instance.object_id)] = by_name[name]
    return ScannedRoom(models, matrix(truth.alignment))


def exchanged(objects: list[Furnishing], categories: tuple[str, ...], rare: frozenset[str], rng: np.random.Generator) -> list[Furnishing]:
    """Objects of a room, of `categories` alone: others are exchanged for one of these of about their size, or left out with all that they
    carry where there is none. Of what carries nothing, `EXCHANGED` are, too: half of them, where that can be, for a `rare` category."""
    carriers = {obj.parent for obj in objects}
    gone: set[str] = set()
    kept = []
    for obj in objects:
        if obj.parent in gone:
            gone.add(obj.name)
            continue
        must = obj.category not in categories
        may = obj.name not in carriers and mounting(obj.category).kind != "let_in"
        if must or (may and rng.random() < EXCHANGED):
            fitting = alike(obj.category, obj.extents, categories)
            if obj.name in carriers:
                fitting = [name for name in fitting if mounting(name).is_flat_topped]
            few = [name for name in fitting if name in rare]
            chosen = few if few and rng.random() < 0.5 else fitting
            if chosen:
                name = chosen[int(rng.integers(len(chosen)))]
                model = generate(name, obj.extents, rng)
                obj = dataclasses.replace(obj, category=name, parts=model.parts, pieces=model.pieces)
            elif must:
                gone.add(obj.name)
                continue
        kept.append(obj)
    return kept


def alike(category: str, extents: tuple[float, float, float], categories: tuple[str, ...]) -> list[str]:
    """Other categories that are carried in the same way and usually about as large along each side [m]."""
    kind = mounting(category).kind
    kinds = {"stands", "either"} if kind in ("stands", "either") else {kind}
    ratio = {name: np.abs(np.log(np.array(typical_extents(name)) / np.array(extents))).max() for name in categories if name != category}
    return sorted(name for name, far in ratio.items() if far <= np.log(STRETCH) and mounting(name).kind in kinds)
