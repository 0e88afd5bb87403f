"""Arrangements of rooms in dwellings: fitted kitchens, sofas round a table, tables on rugs, corner desks, full shelves, platforms."""

from __future__ import annotations

import numpy as np

from tasks.furniture import generate
from tasks.furniture.drafting import Extents
from tasks.furniture.dwellings.corners import corner_desk, corner_sofa, flat_rug, platform
from tasks.furniture.dwellings.kitchens import UNIT_M, kitchen
from tasks.furniture.dwellings.placing import RoomFurnisher
from tasks.furniture.dwellings.plans import FloorPlan
from tasks.furniture.furnishing import GAP_M, Furnishing
from tasks.furniture.rooms import RECIPES, place_step, small_size
from tasks.geometry.transforms import yaw_pose

SHELF_THINGS: tuple[str, ...] = (
    "book", "book stack", "vase", "box", "candle", "jar", "can", "mug", "bowl", "bottle", "sculpture", "stuffed animal", "tissue box",
    "camera", "cup", "speaker",
)  # fmt: skip
"""What open shelves are full of."""

CARRIERS: tuple[str, ...] = (
    "desk", "table", "coffee table", "side table", "nightstand", "dresser", "cabinet", "bookshelf", "shelf", "tv stand", "kitchen counter",
    "platform",
)  # fmt: skip

LEFT_OUT: tuple[str, ...] = (
    "rug",
    "window",
    "curtain",
    "kitchen counter",
    "range hood",
    "oven",
    "refrigerator",
    "kitchen cabinet",
    "desk lamp",
)
"""Steps of the easy rooms' recipes that dwellings do otherwise."""

LYING_M: Extents = (0.4, 0.42, 0.13)
"""A pillow that lies: one that is leaned upright falls over."""

ONCE: tuple[str, ...] = ("sofa", "table", "coffee table", "tv stand", "tv", "microwave", "kettle", "toaster", "ceiling lamp")
"""What a room has one of."""

RUG_M = 0.008
"""Thickness of a rug."""


def furnish_room(furnisher: RoomFurnisher, plan: FloorPlan, index: int, count: int) -> None:
    """Fill a room with about `count` objects, what its openings hold included."""
    kind, rng = furnisher.room.kind, furnisher.rng
    started = {"living room": _sofas, "kitchen": _kitchen, "bedroom": _raised_corner, "office": _desks, "dining room": _dining}[kind]
    started(furnisher, plan, index)
    if kind != "bedroom" and rng.random() < 0.35:
        _raised_corner(furnisher, plan, index)
    _curtains(furnisher, plan, index)
    for how, category, at in RECIPES[kind]:
        if len(furnisher.objects) >= count:
            return
        if category == "pillow":
            for anchor in furnisher.all_of(at):
                if furnisher.on_top(anchor, category, LYING_M) is not None:
                    break
        elif category not in LEFT_OUT and not (category in ONCE and furnisher.all_of(category)):
            place_step(furnisher, how, category, at)
    if rng.random() < 0.7:
        _full_shelf(furnisher, count)
    fill(furnisher, count)


def fill(furnisher: RoomFurnisher, count: int) -> None:
    """Small things on whatever carries, until there are `count` objects or no place is left."""
    rng = furnisher.rng
    for _ in range(8 * count):
        carriers = [obj for obj in furnisher.objects if obj.category in CARRIERS and obj.name not in furnisher.fitted]
        if len(furnisher.objects) >= count or not carriers:
            return
        category = SHELF_THINGS[int(rng.integers(len(SHELF_THINGS)))]
        _put_small(furnisher, carriers[int(rng.integers(len(carriers)))], category)


def _put_small(furnisher: RoomFurnisher, carrier: Furnishing, category: str) -> Furnishing | None:
    size = small_size(category, furnisher.rng)
    if category == "book stack":
        size = 0.19, float(furnisher.rng.uniform(0.2, 0.45)), 0.25
    return furnisher.on_top(carrier, category, size, tries=8)


def _sofas(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    """An L- or U-shaped sofa on a rug with a table in its bend, a stand with a screen."""
    rng = furnisher.rng
    rug_size = (float(rng.uniform(2.5, 2.9)), float(rng.uniform(2.9, 3.4)), RUG_M)
    for attempt in range(6):
        arms = 2 if rng.random() < 0.35 and attempt < 3 else 1
        width, reach = (3.0, 1.75) if arms == 2 else (float(rng.uniform(2.1, 2.7)), float(rng.uniform(1.5, 1.9)))
        shape = corner_sofa(rng, arms, width, reach, int(rng.choice([-1, 1])))
        if attempt % 2 == 0:  # on a rug with all its feet
            order = rng.permutation(len(furnisher.walls))
            for wall in (int(k) for k in order):
                free = furnisher.walls[wall].length - rug_size[1] - 0.1
                if free < 0:
                    continue
                at = float(rng.uniform(0, 1)) * free + 0.5 * rug_size[1] + 0.05
                rug = furnisher.lay_rug(flat_rug(rng, rug_size), rug_size, furnisher.at_wall(wall, at, rug_size[0], 0.0, 0.03))
                if rug is None:
                    continue
                back = -0.5 * rug_size[0] + 0.5 * reach + 0.02
                sofa = furnisher.shaped("sofa", shape, rug.pose @ yaw_pose(0.0, [back, 0.0, 0.0]))
                if sofa is not None:
                    _in_bend(furnisher, sofa, shape.bend)
                    _opposite(furnisher, sofa)
                    return
                furnisher.objects.remove(rug)
        sofa = furnisher.corner(shape, "sofa", 0.02)
        if sofa is not None:
            _in_bend(furnisher, sofa, shape.bend)
            _opposite(furnisher, sofa)
            return


def _in_bend(furnisher: RoomFurnisher, sofa: Furnishing, bend: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """A low table between the seats, near enough to reach a cup, pillows on the seats, things on the table."""
    (x0, x1), (y0, y1) = bend
    rng = furnisher.rng
    clear = (x1 - x0 - 0.3, y1 - y0 - (0.6 if y0 > -0.5 * sofa.extents[1] and y1 < 0.5 * sofa.extents[1] else 0.4))
    wanted = rng.uniform([0.55, 0.8, 0.36], [0.75, 1.1, 0.44])
    size: Extents = (min(float(wanted[0]), clear[0]), min(float(wanted[1]), clear[1]), float(wanted[2]))
    if min(size) < 0.3:
        return
    local = yaw_pose(0.0, [x0 + 0.3 + 0.5 * size[0], 0.5 * (y0 + y1), 0.0])
    table = furnisher.on_floor_at("coffee table", size, sofa.pose @ local)
    for _ in range(2):
        furnisher.on_top(sofa, "pillow", LYING_M)
    if table is not None:
        for category in ("bowl", "remote control", "mug", "book"):
            furnisher.on_top(table, category, small_size(category, rng))


def _opposite(furnisher: RoomFurnisher, sofa: Furnishing) -> None:
    stand = place_step(furnisher, "wall", "tv stand", "")
    if stand is not None:
        place_step(furnisher, "on", "tv", "tv stand")


def _kitchen(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    """A fitted kitchen along the longest wall that is free of doors, then the things that stand on it."""
    rng = furnisher.rng
    runs = _runs(furnisher, plan, index)
    if not runs:
        return
    length, wall, start, has_window = max(runs, key=lambda run: run[0] - 0.4 * run[3])
    placed: dict[str, list[Furnishing]] = {}
    for unit in kitchen(length, furnisher.height, has_window, rng):
        category = unit.model.category
        pose = furnisher.at_wall(wall, start + unit.at, unit.extents[0], unit.low, unit.off)
        below = placed.get(unit.carrier)
        parent = below[-1].name if below else unit.carrier
        if category in ("sink", "stove"):
            here: Furnishing | None = furnisher.let_in(category, unit.model, unit.extents, pose, parent)
        else:
            here = furnisher.modelled(category, unit.model, unit.extents, pose, parent, unit.is_fitted)
        if here is not None:
            placed.setdefault(category, []).append(here)
    for worktop in placed.get("kitchen counter", []):
        for category in ("microwave", "kettle", "toaster", "coffee maker", "bottle", "kitchen utensils", "jar", "cutting board"):
            if rng.random() < 0.75:
                furnisher.on_top(worktop, category)
    for hob in placed.get("stove", []):
        furnisher.on_top(hob, "pot" if rng.random() < 0.6 else "kettle")
    _table_on_rug(furnisher, "table", 3)


def _runs(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> list[tuple[float, int, float, bool]]:
    """Where a run of units can stand: length [m], wall, where it begins along it [m], and whether a window is above."""
    runs = []
    for wall, face in enumerate(furnisher.walls):
        openings = plan.openings_of(index, wall)
        start = 0.03
        while start + 3 * UNIT_M < face.length:
            length = min(4.3, face.length - 0.03 - start)
            while length >= 3 * UNIT_M:
                pose = furnisher.at_wall(wall, start + 0.5 * length, 0.64, 0.0, 0.004)
                if furnisher.is_free(pose, (0.64, length, 0.94)):
                    above = any(o.kind == "window" and o.span[0] < start + length and o.span[1] > start for o in openings)
                    runs.append((length, wall, start, above))
                    break
                length -= 0.15
            start += 0.15
    return runs


def _dining(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    _table_on_rug(furnisher, "table", 6)


def _table_on_rug(furnisher: RoomFurnisher, category: str, seats: int) -> None:
    """A table with chairs pushed under it, all of them on one rug where there is room for one."""
    rng = furnisher.rng
    for _ in range(12):
        if rng.random() < 0.75:
            size = (float(rng.uniform(2.0, 2.3)), float(rng.uniform(2.4, 2.8)), RUG_M)
            low, high = furnisher.polygon.min(axis=0), furnisher.polygon.max(axis=0)
            pose = yaw_pose(furnisher.walls[0].yaw + float(rng.choice([0.0, np.pi / 2])), [*rng.uniform(low, high), 0.0])
            rug = furnisher.lay_rug(flat_rug(rng, size), size, pose)
            if rug is None:
                continue
            table = furnisher.on_floor_at(category, (0.8, 1.3, 0.74), rug.pose)
        else:
            table = furnisher.centered(category)
        if table is not None:
            for _ in range(seats):
                furnisher.seat_at(table, "chair")
            for category_on in ("plate", "plate", "cup", "bowl"):
                furnisher.on_top(table, category_on)
            return


def _desks(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    """A desk with a return, a chair in its bend, and what one works with."""
    rng = furnisher.rng
    for _ in range(4):
        side = int(rng.choice([-1, 1]))
        shape = corner_desk(rng, float(rng.uniform(1.5, 1.8)), float(rng.uniform(1.35, 1.6)), side)
        desk = furnisher.corner(shape, "desk", GAP_M)
        if desk is None:
            continue
        (x0, _), (y0, y1) = shape.bend
        for tuck in (0.25, 0.1, 0.0):
            local = yaw_pose(np.pi, [x0 + 0.32 - tuck, 0.5 * (y0 + y1), 0.0])
            if furnisher.on_floor_at("office chair", None, desk.pose @ local, tucked=desk) is not None:
                break
        for category in ("monitor", "keyboard", "mouse", "laptop", "mug", "book stack", "printer", "desk organizer"):
            furnisher.on_top(desk, category, (0.19, 0.3, 0.25) if category == "book stack" else None)
        return


def _raised_corner(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    """A platform in a corner with a step before it, and something that stands on it."""
    rng = furnisher.rng
    if rng.random() < 0.25:
        return
    tall = float(rng.uniform(0.14, 0.32))
    size = (float(rng.uniform(1.3, 1.7)), float(rng.uniform(1.4, 2.0)), tall)
    for wall in (int(k) for k in rng.permutation(len(furnisher.walls))):
        face = furnisher.walls[wall]
        if face.length < size[1] + 0.1:
            continue
        near = 0.5 * size[1] + 0.013
        poses = [furnisher.at_wall(wall, at, size[0], 0.0, 0.013) for at in (near, face.length - near, 0.5 * face.length)]
        free = [pose for pose in poses if furnisher.is_free(pose @ yaw_pose(0.0, [0.18, 0.0, 0.0]), (size[0] + 0.36, size[1], tall))]
        if not free:
            continue
        pose = free[0]
        base = furnisher.modelled("platform", platform(rng, size), size, pose, "floor", True)
        if base is None:
            continue
        if tall > 0.2:
            step = (0.3, 0.8, 0.5 * tall)
            before = pose @ yaw_pose(0.0, [0.5 * (size[0] + step[0]) + 0.002, 0.0, 0.0])
            furnisher.modelled("stairs", platform(rng, step, "stairs"), step, before, "floor", True)
        furnisher.on_top(base, "armchair")
        furnisher.on_top(base, "floor lamp")
        furnisher.on_top(base, "plant")
        return


def _curtains(furnisher: RoomFurnisher, plan: FloorPlan, index: int) -> None:
    """Curtains over windows: one at either side, or one across; a few windows have none."""
    rng = furnisher.rng
    for opening in (o for o in plan.openings_of(index) if o.kind == "window"):
        how = float(rng.random())
        if how < 0.2:
            continue
        top = min(opening.high + 0.12, furnisher.height - 0.03)
        low = 0.04 if rng.random() < 0.6 else max(opening.low - 0.15, 0.04)
        width = opening.width + 0.3 if how > 0.8 else max(0.34, 0.3 * opening.width)
        middles = [opening.at] if how > 0.8 else [opening.span[0] - 0.14 + 0.5 * width, opening.span[1] + 0.14 - 0.5 * width]
        design = int(rng.integers(2**63))
        for at in middles:
            size = (0.1, width, top - low)
            pose = furnisher.at_wall(opening.wall, at, size[0], low, 0.012)
            model = generate("curtain", size, np.random.default_rng(design))
            furnisher.modelled("curtain", model, size, pose, "wall", True)


def _full_shelf(furnisher: RoomFurnisher, count: int) -> None:
    """An open shelf, and as many small things in it as go in."""
    shelves: list[Furnishing] = [*furnisher.all_of("bookshelf"), *furnisher.all_of("shelf")]
    shelf = shelves[0] if shelves else furnisher.against_wall("shelf")
    for _ in range(30):
        if shelf is None or len(furnisher.objects) >= count:
            return
        _put_small(furnisher, shelf, SHELF_THINGS[int(furnisher.rng.integers(len(SHELF_THINGS)))])
