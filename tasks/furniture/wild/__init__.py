"""Wild rooms: one room each that fails as real scans do, with furniture that no candidate provider has a template of.

A U-shaped sofa under cushions and throws with a table in its bend, a wall of shelves with a TV in it, a heap of cloth, patterned
curtains, a piano and a guitar, chairs tucked in, things on every surface. Other furniture is of the withheld half of the generator's
templates (`tasks.furniture.halves`), and of models by others where a folder of them is given. A room is a pure function of its seed
and these models.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np

from tasks.furniture import generate
from tasks.furniture.drafting import Extents
from tasks.furniture.dwellings import HUNG, Dwelling, TrueOpening, fill_openings, part_objects
from tasks.furniture.dwellings.corners import flat_rug
from tasks.furniture.dwellings.placing import RoomFurnisher
from tasks.furniture.dwellings.plans import FloorPlan, Opening
from tasks.furniture.dwellings.shells import shell
from tasks.furniture.furnishing import GAP_M, Furnishing, Wall
from tasks.furniture.halves import Half, TemplateWithheld
from tasks.furniture.rooms import FurnishedRoom, place_step, small_size
from tasks.furniture.wild.bodies import dish_rack, draped_sofa, glass_shelf, guitar, leaning, loose_cushion, piano, screen, wall_shelf
from tasks.furniture.wild.foreign import AT_WALLS, MAX_FLOOR_M, ON_TOPS, ForeignFile, foreign_files, foreign_model
from tasks.furniture.wild.plans import halls, shelved_wall, wild_plan
from tasks.furniture.wild.sheets import SizedModel, curtain, heap
from tasks.geometry.transforms import yaw_pose

__all__ = ["ForeignFile", "foreign_files", "wild_room"]

CLUTTER: tuple[str, ...] = (
    "box", "bottle", "bowl", "cup", "mug", "plate", "vase", "plant", "book", "book stack", "stuffed animal", "tissue box", "speaker",
    "camera", "sculpture", "tray", "wine glass", "pot", "pan", "shoe", "keyboard", "laptop", "basket",
)  # fmt: skip
"""What lies on every surface, as far as the withheld half has it."""

SHELVED: tuple[str, ...] = ("vase", "book stack", "speaker", "stuffed animal", "sculpture", "plant", "plate", "box")
"""What stands on glass shelves: large enough for a scan to show it."""

SMALL_M: dict[str, Extents] = {
    "book stack": (0.18, 0.3, 0.24), "speaker": (0.18, 0.16, 0.26), "plant": (0.2, 0.2, 0.3), "box": (0.18, 0.26, 0.16),
    "stuffed animal": (0.18, 0.22, 0.28), "sculpture": (0.16, 0.18, 0.3), "vase": (0.16, 0.16, 0.3),
}  # fmt: skip
"""Extents of what stands on glass shelves [m]."""

ABOUT: tuple[str, ...] = ("backpack", "bag", "shoe", "ball", "suitcase", "storage bin", "basket", "stool", "trash can", "ottoman", "fan")
"""What stands about on the floor."""

WALLED: tuple[str, ...] = ("cabinet", "dresser", "desk", "shelf", "file cabinet", "tv stand", "armchair", "floor lamp")
"""What stands at walls next to the furniture that every wild room has."""

CARRIERS: tuple[str, ...] = (
    "coffee table", "table", "cabinet", "dresser", "desk", "tv stand", "file cabinet", "nightstand", "piano", "shelf", "kitchen cabinet",
)  # fmt: skip

FOREIGN = 5
"""Models by others in a room."""

LEAN = (0.13, 0.18)
"""Angles at which things lean at a wall [rad]: with less they tip forward, with much more friction of 0.6 does not hold them."""

HEAP_M = ((1.15, 1.35), (1.35, 1.55), (0.24, 0.4))
"""Sides and height of a heap of cloth."""


class WildFurnisher(RoomFurnisher):
    """Places objects of the withheld half of the templates, and bodies that are drawn already."""

    half: Half = "withheld"

    def standing(self, category: str, sized: SizedModel, pose: np.ndarray, parent: str = "floor") -> Furnishing | None:
        """A body at a pose, if nothing is in its way."""
        return self.modelled(category, sized.model, sized.extents, pose, parent, False)

    def somewhere(self, category: str, sized: SizedModel, tries: int = 60) -> Furnishing | None:
        """A body anywhere on the floor, turned by chance."""
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        for _ in range(tries):
            x, y = self.rng.uniform(low, high)
            placed = self.standing(category, sized, yaw_pose(float(self.rng.uniform(-np.pi, np.pi)), [x, y, 0.0]))
            if placed is not None:
                return placed
        return None

    def along_walls(self, category: str, sized: SizedModel, gap: float = GAP_M, tries: int = 40) -> Furnishing | None:
        """A body with its back at some wall."""
        for _ in range(tries):
            number = int(self.rng.integers(len(self.walls)))
            wall, half = self.walls[number], 0.5 * sized.extents[1] + 0.03
            if wall.length > 2 * half:
                at = float(self.rng.uniform(half, wall.length - half))
                placed = self.standing(category, sized, self.at_wall(number, at, sized.extents[0], 0.0, gap))
                if placed is not None:
                    return placed
        return None

    def within(self, carrier: Furnishing, category: str, sized: SizedModel, local: np.ndarray) -> Furnishing | None:
        """A body inside of another object, at a pose in its frame; nothing else may be there."""
        pose = carrier.pose @ local
        center = pose.copy()
        center[2, 3] += 0.5 * sized.extents[2]
        blocks = [(center, sized.extents)]
        return self._settle(category, sized.extents, pose, carrier.name, blocks, sized.model, inside=carrier)

    def drawn(self, category: str, size: Extents | None) -> SizedModel:
        """A model of the withheld half. size: extents [m]; usual ones if None."""
        extents = size or self._sizes(category)
        return SizedModel(generate(category, extents, self.rng, half=self.half), extents)


@cache
def is_drawn(category: str) -> bool:
    """True if the withheld half has a template of a category."""
    try:
        generate(category, None, np.random.default_rng(0), half="withheld")
    except TemplateWithheld:
        return False
    return True


def wild_room(seed: int | tuple[int, ...], foreign: Sequence[ForeignFile] = ()) -> Dwelling:
    """The wild room of a seed: 40 to 65 objects in one room. foreign: models by others, of which some furnish it."""
    rng = np.random.default_rng(seed)
    plan = wild_plan(rng)
    furnisher = WildFurnisher(plan.rooms[0], plan.height, rng, "room0_")
    openings: list[TrueOpening] = fill_openings(furnisher, plan, 0)
    _shelf(furnisher, plan)
    _sofa(furnisher)
    _dining(furnisher)
    _heap(furnisher)
    _music(furnisher)
    _rug(furnisher)
    _curtains(furnisher, plan)
    _foreign(furnisher, foreign)
    _glass(furnisher)
    for category in (WALLED[int(k)] for k in rng.permutation(len(WALLED))[:3]):
        if is_drawn(category):
            furnisher.against_wall(category)
    for category in ("picture", "mirror"):
        if is_drawn(category):
            place_step(furnisher, "hang", category, "")
    _rack(furnisher)
    for category in (ABOUT[int(k)] for k in rng.permutation(len(ABOUT))[:4]):
        if is_drawn(category):
            furnisher.on_floor(category)
    _clutter(furnisher, len(furnisher.objects) + int(rng.integers(8, 15)))
    _clear_windows(furnisher, plan)
    part_objects(furnisher)
    fitted = frozenset(obj.name for obj in furnisher.objects if obj.name in furnisher.fitted or obj.parent in HUNG or obj.category == "rug")
    structure = [*shell(plan, [], rng), *halls(plan)]
    furnished = FurnishedRoom("living room", plan.rooms[0].polygon, plan.height, structure, furnisher.objects)
    return Dwelling(plan, furnished, dict.fromkeys((obj.name for obj in furnisher.objects), 0), fitted, tuple(openings), ())


def _shelf(furnisher: WildFurnisher, plan: FloorPlan) -> None:
    """Shelves over most of a wall, with a TV and other things in what books leave open."""
    rng, number = furnisher.rng, shelved_wall(plan)
    wall = furnisher.walls[number]
    width, tall = min(wall.length - 0.1, float(rng.uniform(3.6, 4.2))), min(plan.height - 0.06, float(rng.uniform(2.35, 2.6)))
    shelf = wall_shelf(rng, width, tall)
    at = float(rng.uniform(0.5 * width + 0.04, wall.length - 0.5 * width - 0.04))
    model = shelf.sized
    placed = furnisher.modelled(
        "bookshelf", model.model, model.extents, furnisher.at_wall(number, at, model.extents[0], 0.0, GAP_M), "floor", True
    )
    if placed is None:
        return
    (y0, y1), (z0, z1) = shelf.screen
    tv = screen(rng, min(y1 - y0 - 0.06, (z1 - z0 - 0.08) / 0.58))
    furnisher.within(placed, "tv", tv, yaw_pose(0.0, [0.0, 0.5 * (y0 + y1), z0 + 0.001]))
    kinds = [category for category in CLUTTER if is_drawn(category)]
    for k in rng.permutation(len(shelf.openings))[:7]:
        (y0, y1), (z0, z1) = shelf.openings[int(k)]
        category = kinds[int(rng.integers(len(kinds)))]
        body = furnisher.drawn(category, small_size(category, rng))
        if body.extents[0] < model.extents[0] and body.extents[1] < y1 - y0 - 0.02 and body.extents[2] < z1 - z0 - 0.02:
            furnisher.within(placed, category, body, yaw_pose(0.0, [0.0, 0.5 * (y0 + y1), z0 + 0.0005]))


def _sofa(furnisher: WildFurnisher) -> None:
    """A U-shaped sofa in the room with a table inside its bend."""
    rng = furnisher.rng
    low, high = furnisher.polygon.min(axis=0), furnisher.polygon.max(axis=0)
    shape = draped_sofa(rng, float(rng.uniform(2.6, 3.0)), float(rng.uniform(2.2, 2.6)))
    for _ in range(200):
        x, y = rng.uniform(low, high)
        turn = furnisher.walls[0].yaw + 0.5 * np.pi * int(rng.integers(4)) + float(rng.normal(0.0, 0.06))
        sofa = furnisher.shaped("sofa", shape, yaw_pose(turn, [x, y, 0.0]))
        if sofa is None:
            continue
        (x0, _), (y0, y1) = shape.bend
        size: Extents = (float(rng.uniform(0.75, 1.0)), min(y1 - y0 - 0.1, float(rng.uniform(0.6, 0.85))), float(rng.uniform(0.36, 0.44)))
        local = yaw_pose(0.0, [x0 + float(rng.uniform(0.06, 0.12)) + 0.5 * size[0], 0.5 * (y0 + y1), 0.0])
        furnisher.on_floor_at("coffee table", size, sofa.pose @ local)
        _cushions(furnisher, sofa)
        return


def _cushions(furnisher: WildFurnisher, sofa: Furnishing) -> None:
    """Loose cushions that lean on a sofa's backs."""
    rng = furnisher.rng
    x, y = (0.5 * side for side in sofa.extents[:2])
    spots = [(-x, float(at), 0.0) for at in rng.uniform(-y + 0.7, y - 0.7, 3)]
    spots += [(float(at), side * y, -0.5 * np.pi * side) for side in (-1, 1) for at in rng.uniform(-x + 1.2, x - 0.6, 1)]
    for at_x, at_y, turn in spots:
        sized = loose_cushion(rng)
        out = 0.22 + 0.5 * sized.extents[0]
        local = yaw_pose(turn, [at_x + out * np.cos(turn), at_y + out * np.sin(turn), 0.0])
        reach = np.abs(local[:2, :2]) @ np.array(sized.extents[:2])
        level = furnisher._rest(sofa, (float(local[0, 3]), float(local[1, 3])), 0.8 * reach, 0.4 * sofa.extents[2], 0.5)
        if level is not None:
            local[2, 3] = level
            furnisher.within(sofa, "cushion", sized, local)


def _heap(furnisher: WildFurnisher) -> None:
    rng = furnisher.rng
    for shrink in (1.0, 0.85, 0.7):
        length, width, tall = (float(rng.uniform(*span)) for span in HEAP_M)
        if furnisher.somewhere("clothes", heap(rng, shrink * length, shrink * width, tall), 120) is not None:
            return


def _music(furnisher: WildFurnisher) -> None:
    """A piano with a bench before it, and a guitar that leans at a wall."""
    rng = furnisher.rng
    placed = furnisher.along_walls("piano", piano(rng))
    if placed is not None:
        size: Extents = (0.34, 0.62, 0.48)
        furnisher.on_floor_at("bench", size, placed.pose @ yaw_pose(0.0, [0.5 * placed.extents[0] + 0.1, 0.0, 0.0]), tucked=placed)
    for _ in range(int(rng.integers(1, 3))):
        furnisher.along_walls("guitar", guitar(rng, float(rng.uniform(*LEAN))), gap=0.001)
    for _ in range(int(rng.integers(3, 6))):
        category, sized = leaning(rng, float(rng.uniform(*LEAN)))
        furnisher.along_walls(category, sized, gap=0.001)


def _glass(furnisher: WildFurnisher) -> None:
    """Glass shelves at walls, with things on them that seem to hang in the air."""
    rng = furnisher.rng
    for _ in range(2):
        for _ in range(30):
            number = int(rng.integers(len(furnisher.walls)))
            wall, width = furnisher.walls[number], float(rng.uniform(0.8, 1.2))
            if wall.length < width + 0.2:
                continue
            at = float(rng.uniform(0.5 * width + 0.05, wall.length - 0.5 * width - 0.05))
            sized = glass_shelf(rng, width)
            pose = furnisher.at_wall(number, at, sized.extents[0], float(rng.uniform(1.15, 1.5)), 0.001)
            shelf = furnisher.modelled("shelf", sized.model, sized.extents, pose, "wall", True)
            if shelf is None:
                continue
            for _ in range(4):
                kinds = [category for category in SHELVED if is_drawn(category)]
                category = kinds[int(rng.integers(len(kinds)))]
                furnisher.on_top(shelf, category, SMALL_M.get(category))
            break


def _dining(furnisher: WildFurnisher) -> None:
    """A table with chairs tucked in as far as its legs allow."""
    rng = furnisher.rng
    low, high = furnisher.polygon.min(axis=0), furnisher.polygon.max(axis=0)
    for _ in range(200):
        pose = yaw_pose(furnisher.walls[0].yaw + float(rng.choice([0.0, 0.5 * np.pi])), [*rng.uniform(low, high), 0.0])
        size: Extents = (float(rng.uniform(0.75, 0.85)), float(rng.uniform(1.25, 1.45)), 0.74)
        if not furnisher.is_free(pose, (size[0] + 0.5, size[1] + 0.3, size[2])):
            continue
        table = furnisher.on_floor_at("table", size, pose)
        if table is not None:
            for _ in range(4):
                furnisher.seat_at(table, "chair")
            return


def _rug(furnisher: WildFurnisher) -> None:
    """A rug where the floor is free."""
    rng = furnisher.rng
    low, high = furnisher.polygon.min(axis=0), furnisher.polygon.max(axis=0)
    size: Extents = (float(rng.uniform(0.9, 1.2)), float(rng.uniform(1.3, 1.7)), 0.008)
    for _ in range(60):
        pose = yaw_pose(furnisher.walls[0].yaw + float(rng.normal(0.0, 0.1)), [*rng.uniform(low, high), 0.0])
        if furnisher.lay_rug(flat_rug(rng, size), size, pose) is not None:
            return


def _curtains(furnisher: WildFurnisher, plan: FloorPlan) -> None:
    """Patterned curtains at both sides of windows, from near the ceiling to near the floor."""
    rng = furnisher.rng
    for opening in (o for o in plan.openings_of(0) if o.kind == "window"):
        tall = min(opening.high + 0.14, furnisher.height - 0.03) - 0.04
        state = int(rng.integers(2**63))
        for end in opening.span:
            width = float(rng.uniform(0.5, 0.7))
            sized = curtain(np.random.default_rng(state), width, tall)
            wall = furnisher.walls[opening.wall]
            at = float(np.clip(end, 0.5 * width + 0.03, wall.length - 0.5 * width - 0.03))
            pose = furnisher.at_wall(opening.wall, at, sized.extents[0], 0.04, 0.012)
            furnisher.modelled("curtain", sized.model, sized.extents, pose, "wall", True)


def _clear_windows(furnisher: WildFurnisher, plan: FloorPlan) -> None:
    """Take down what hangs before a window: it is thinner than the space before a pane that stays clear."""
    for opening in (o for o in plan.openings_of(0) if o.kind == "window"):
        wall = furnisher.walls[opening.wall]

        def is_before(obj: Furnishing, wall: Wall = wall, opening: Opening = opening) -> bool:
            offset = obj.pose[:2, 3] - wall.start
            reach = 0.5 * (obj.extents[1] + opening.width)
            is_level = obj.pose[2, 3] < opening.high and obj.pose[2, 3] + obj.extents[2] > opening.low
            return bool(abs(offset @ wall.along - opening.at) < reach and offset @ wall.inward < 0.2 and is_level)

        furnisher.objects = [obj for obj in furnisher.objects if obj.category not in ("picture", "mirror") or not is_before(obj)]


def _foreign(furnisher: WildFurnisher, files: Sequence[ForeignFile]) -> None:
    """Some models by others, where they belong."""
    rng = furnisher.rng
    for k in rng.permutation(len(files))[: 2 * FOREIGN]:
        if sum("foreign" in obj.name for obj in furnisher.objects) >= FOREIGN:
            return
        file = files[int(k)]
        body = foreign_model(file)
        if max(body.extents[:2]) > MAX_FLOOR_M or body.extents[2] > furnisher.height - 0.05:
            continue
        if file.category in AT_WALLS:
            placed = furnisher.along_walls(file.category, body)
        elif file.category in ON_TOPS:
            placed = _on_some_top(furnisher, file.category, body)
        else:
            placed = furnisher.somewhere(file.category, body)
        if placed is not None:
            furnisher.objects[-1] = dataclasses.replace(placed, name=f"{placed.name}_foreign")


def _on_some_top(furnisher: WildFurnisher, category: str, body: SizedModel) -> Furnishing | None:
    """A body on the top of some furniture with a flat one, where there is place."""
    carriers = [obj for obj in furnisher.objects if obj.category in CARRIERS and min(obj.extents[:2]) > min(body.extents[:2]) + 0.04]
    for k in furnisher.rng.permutation(len(carriers)):
        carrier = carriers[int(k)]
        for _ in range(12):
            free = 0.5 * (np.array(carrier.extents[:2]) - np.array(body.extents[:2])) - 0.01
            if (free < 0).any():
                break
            x, y = furnisher.rng.uniform(-free, free)
            if carrier.category == "piano":
                x = -free[0]
            level = furnisher._rest(carrier, (x, y), np.array(body.extents[:2]), carrier.extents[2], 0.6)
            if level is None or level > carrier.extents[2] + 0.005:
                continue
            placed = furnisher.within(carrier, category, body, yaw_pose(0.0, [x, y, level]))
            if placed is not None:
                return placed
    return None


def _rack(furnisher: WildFurnisher) -> None:
    _on_some_top(furnisher, "dish rack", dish_rack(furnisher.rng))


def _clutter(furnisher: WildFurnisher, count: int) -> None:
    """Small things on every surface, in turn, until there are `count` objects."""
    rng = furnisher.rng
    carriers = [obj for obj in furnisher.objects if obj.category in CARRIERS]
    kinds = [category for category in CLUTTER if is_drawn(category)]
    for turn in range(12 * max(len(carriers), 1)):
        if len(furnisher.objects) >= count or not carriers:
            return
        category = kinds[int(rng.integers(len(kinds)))]
        size = small_size(category, rng) if category != "book stack" else (0.19, 0.3, 0.25)
        furnisher.on_top(carriers[turn % len(carriers)], category, size, tries=8)
