"""Vertical placement, exact on convex pieces: an object is lowered or raised until it touches what carries it, and tipped
until it rests there."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.mounting import HOLDS_NOTHING
from tasks.optimization.interior import Interior
from tasks.optimization.shapes import Shapes, Stand, shapes_of, stand_of
from tasks.optimization.solids import mass_properties_of
from tasks.optimization.support.fastening import is_worktop
from tasks.optimization.support.laying import lay_down
from tasks.optimization.support.tipping import SUNK_M, compiled, kept_shape, put_back, tip, turn_along

Array = NDArray[np.float64]

NEAR_M = 0.05
"""How far a surface and its convex pieces may differ in height [m]: pieces stand out by up to 2 cm."""

SUNKEN_M = 0.03
"""An object whose carrier's top is farther off than this may rather stand beside it [m]."""

KEPT_M = 0.005
"""An object is still carried by what carried it when it stands this near above it [m]."""

DEEP_M = 0.002
"""A penetration deeper than this is one that a simulator answers with a jolt [m]."""

RIGHT_M = 0.01
"""An object this near to a surface stands right on it [m]."""

COVERING_M = 0.06
"""Height of the highest floor covering [m], with a centimetre for its place: objects that reach onto one are raised by it."""

FALL_M = 0.15
"""An object that would fall farther in the end [m] has lost what carried it, which is said instead of hidden."""

LEAST_BORNE = 0.5
"""What lies on several others shares half of the width of each with it, or of its own: what stands beside it shares an edge."""

ROUNDING_M = 1e-7
"""Lifts below this are none."""


def shift(shapes: Shapes, stand: Stand, group: Sequence[int], move: Sequence[float]) -> None:
    """Move bodies by dx, dy, dz [m]."""
    for body in group:
        stand.place[body] += move
        compiled()["bound"](shapes, stand, body)


def beside(interior: Interior, shapes: Shapes, stand: Stand, wedged: Collection[int] = ()) -> tuple[Interior, list[str]]:
    """The interior, in which what stands right on the carrier of its carrier is carried by that, beside the other; and
    which objects those are, a line each.

    A can that was scanned, or pushed, into a sculpture is found far below its top, but right on the cabinet below both.
    `wedged`: objects that were found to fit nowhere on or in their carrier, whatever their height says.
    """
    parents, carriers, notes = interior.parent.copy(), list(interior.carriers), []
    own = [c.lift - (carriers[p].lift if p >= 0 else 0.0) for c, p in zip(carriers, parents.tolist(), strict=True)]
    for i, carrier in enumerate(carriers):
        parent = int(parents[i])
        if parent < 0:
            continue
        is_in = carrier.relation == "inside" and interior.objects[parent].category not in HOLDS_NOTHING and _is_amid(stand, i, parent)
        if (abs(carrier.gap) < SUNKEN_M or is_in) and i not in wedged:
            continue
        below = int(parents[parent])
        gap = float(stand.low[i, 2])
        if below >= 0:
            among = np.zeros(len(stand.low), dtype=np.bool_)
            among[below] = True
            gap, _ = compiled()["least_gap"](shapes, stand, i, among, RIGHT_M)
        if abs(gap) > RIGHT_M:
            continue
        parents[i], own[i] = below, -float(gap)
        name = interior.names[below] if below >= 0 else None
        relation = carriers[parent].relation if below >= 0 else "floor"
        carriers[i] = dataclasses.replace(carrier, relation=relation, parent_id=name, gap=float(gap))
        notes.append(f"{interior.names[i]}: it stands beside {interior.names[parent]}, on {name or 'the floor'}")
    for i, parent in enumerate(parents.tolist()):  # carriers come first, so theirs is known
        carriers[i] = dataclasses.replace(carriers[i], lift=own[i] + (carriers[parent].lift if parent >= 0 else 0.0))
    return dataclasses.replace(interior, parent=parents, carriers=tuple(carriers)), notes


def _is_amid(stand: Stand, obj: int, carrier: int) -> bool:
    """Whether an object lies wholly within the box of its carrier in plan: in a shelf, not beside a sculpture."""
    low, high = stand.low[:, :2], stand.high[:, :2]
    way_out = np.minimum(high[obj] - low[carrier], high[carrier] - low[obj]).min()
    return bool(way_out > (high[obj] - low[obj]).min())


def put_to_rest(interior: Interior, shapes: Shapes, stand: Stand) -> list[tuple[int, float]]:
    """Lower or raise every object onto its own carrier, or the floor. Returns (object, dz [m]), carriers first.

    The surfaces say which part of the carrier is meant (a board of a shelf); its pieces say where exactly.
    """
    lifts = []
    groups = interior.groups()
    for i, carrier in enumerate(interior.carriers):
        parent = int(interior.parent[i])
        if carrier.relation == "floor":
            dz = -float(stand.low[i, 2])
        elif parent >= 0:
            dz = carrier.lift - interior.carriers[parent].lift
            shift(shapes, stand, groups[i], (0.0, 0.0, dz))
            gap, _ = compiled()["least_gap"](shapes, stand, i, bearing(interior, shapes, stand, i), NEAR_M)
            shift(shapes, stand, groups[i], (0.0, 0.0, -dz))
            dz -= gap if abs(gap) <= NEAR_M else 0.0
            if is_held(interior, i):
                dz = min(dz, float(interior.poses[i][2, 3] - stand.place[i, 2]))
        elif carrier.relation == "wall":  # a curtain that reaches the floor
            dz = max(-float(stand.low[i, 2]), 0.0)
        else:
            continue
        if abs(dz) > ROUNDING_M:
            shift(shapes, stand, groups[i], (0.0, 0.0, dz))
            lifts.append((i, dz))
    return lifts


def onto_cloths(interior: Interior, shapes: Shapes, stand: Stand) -> list[tuple[int, float]]:
    """Raise what stands on the floor, or on furniture, and reaches onto a rug or cloth. Returns (object, dz [m])."""
    lifts, groups = [], interior.groups()
    cloths = np.zeros(len(stand.low), dtype=np.bool_)
    cloths[: len(interior.objects)] = interior.covering
    for i, carrier in enumerate(interior.carriers):
        if carrier.relation not in ("floor", "on", "inside") or interior.covering[i] or is_held(interior, i):
            continue
        lower = cloths.copy()
        lower[groups[i]] = False
        dz = -float(compiled()["cloth_gap"](shapes, stand, i, lower, COVERING_M))
        if ROUNDING_M < dz < COVERING_M:
            shift(shapes, stand, groups[i], (0.0, 0.0, dz))
            lifts.append((i, dz))
    return lifts


def is_held(interior: Interior, obj: int) -> bool:
    """Whether an object is a worktop that its wall holds: what is built in below may be in it, and does not raise it."""
    parent, carrier = int(interior.parent[obj]), interior.carriers[obj]
    is_fast = bool(interior.fixed[obj] and parent >= 0 and interior.fixed[parent] and carrier.against is not None)
    return is_fast and is_worktop(interior.objects[obj], carrier)


def bearing(interior: Interior, shapes: Shapes, stand: Stand, obj: int) -> NDArray[np.bool_]:
    """Which bodies a carried object lies on, shape (n,): its carrier, and what stands on the floor beside that, as high as that: a
    worktop lies on all the cabinets below it."""
    parent = int(interior.parent[obj])
    among = np.zeros(len(stand.low), dtype=np.bool_)
    among[parent] = True
    if interior.carriers[obj].relation != "on" or interior.carriers[parent].relation != "floor" or interior.covering[parent]:
        return among
    wide = stand.high[obj, :2] - stand.low[obj, :2]
    if not (stand.low[obj, :2] < stand.low[parent, :2]).any() and not (stand.high[obj, :2] > stand.high[parent, :2]).any():
        return among
    for other, carrier in enumerate(interior.carriers):
        if other in (obj, parent) or carrier.relation != "floor" or interior.covering[other]:
            continue
        shared = np.minimum(stand.high[obj, :2], stand.high[other, :2]) - np.maximum(stand.low[obj, :2], stand.low[other, :2])
        if (shared < LEAST_BORNE * np.minimum(wide, stand.high[other, :2] - stand.low[other, :2])).any():
            continue
        alone = np.zeros(len(stand.low), dtype=np.bool_)
        alone[other] = True
        among[other] = abs(float(compiled()["least_gap"](shapes, stand, obj, alone, NEAR_M)[0])) <= NEAR_M
    return among


MOST_LAID_M = 0.6
"""Higher objects are not laid down [m]: they are furniture, which was not meant to lie, and are named where they would fall."""


@dataclasses.dataclass(frozen=True)
class Settling:
    """What was done to let objects down.

    moves: (object, shift (3,) [m], rotation (3, 3) about its origin), in order. laid: places in `moves` of those that laid an
    object down. hanging: objects that would fall too far, with how far [m]. toppling: objects that cannot stand as they are.
    """

    moves: list[tuple[int, Array, Array]]
    laid: set[int]
    hanging: dict[int, float]
    toppling: list[int]


def let_down(interior: Interior, shapes: Shapes, stand: Stand, most_tilt: float, nudge: float = 0.0, rounds: int = 3) -> Settling:
    """Lower or raise every standing object until it touches anything, lowest first, tip what leans over its contacts, and lay down what
    carries nothing and a nudge [m/s] would throw over, up to so many rounds.

    What would fall too far, or tip by more than `most_tilt` [rad] and is too high to be laid down, stays as it is.
    """
    done = Settling([], set(), {}, [])
    groups = interior.groups()
    n, bodies = len(interior.objects), len(stand.low)
    covering = np.zeros(bodies, dtype=np.bool_)
    covering[:n] = interior.covering
    standing = [i for i, carrier in enumerate(interior.carriers) if carrier.relation in ("floor", "on", "inside")]
    for i in sorted(standing, key=lambda i: (_depth(interior, i), not covering[i], float(stand.low[i, 2]), i)):
        is_other = np.ones(bodies, dtype=np.bool_)
        is_other[groups[i]] = False
        solid, _ = compiled()["least_gap"](shapes, stand, i, is_other & ~covering, SUNK_M)
        cloth = compiled()["cloth_gap"](shapes, stand, i, is_other & covering, COVERING_M)
        gap = min(solid, cloth, float(stand.low[i, 2]))
        if gap > FALL_M:
            done.hanging[i] = gap
            continue
        if gap < 0.0 and is_held(interior, i):
            continue
        if abs(gap) > ROUNDING_M:
            held = [(int(j), _held_up(shapes, stand, groups[j], is_other, gap)) for j in np.flatnonzero(interior.parent == i)]
            shift(shapes, stand, groups[i], (0.0, 0.0, -gap))
            done.moves.append((i, np.array([0.0, 0.0, -gap]), np.eye(3)))
            for j, height in held:
                if height > ROUNDING_M:
                    shift(shapes, stand, groups[j], (0.0, 0.0, height))
                    done.moves.append((j, np.array([0.0, 0.0, height]), np.eye(3)))
        if interior.fixed[i] or covering[i]:
            continue
        origin = stand.place[i].copy()
        before = [(body, *kept_shape(shapes, body), stand.place[body].copy()) for body in groups[i]]
        tipped = tip(shapes, stand, i, center_as_turned(interior, shapes, i), is_other, most_tilt)
        if tipped is None:
            done.toppling.append(i)
        elif np.abs(tipped.rotation - np.eye(3)).max() > 1e-6 or np.abs(tipped.shift).max() > ROUNDING_M:
            for body in groups[i][1:]:
                turn_along(shapes, stand, body, tipped, origin)
            if max((compiled()["deepest"](shapes, stand, body, is_other, DEEP_M) for body in groups[i][1:]), default=0.0) > DEEP_M:
                for body, vertices, normals, place in before:  # what it carries would be in something else
                    put_back(shapes, stand, body, vertices, normals, place)
                done.toppling.append(i)
            else:
                done.moves.append((i, tipped.shift, tipped.rotation))
        if nudge > 0.0 and len(groups[i]) == 1 and float(stand.high[i, 2] - stand.low[i, 2]) <= MOST_LAID_M:
            laid = lay_down(shapes, stand, i, center_as_turned(interior, shapes, i), is_other, nudge)
            if laid is not None:
                done.laid.add(len(done.moves))
                if tipped is None:
                    done.toppling.remove(i)
                done.moves.append((i, laid.shift, laid.rotation))
    if done.laid and rounds > 1:  # what leaned on something that lies now has nothing to lean on
        again = let_down(interior, shapes, stand, most_tilt, nudge, rounds - 1)
        lying = done.laid | {len(done.moves) + at for at in again.laid}
        return Settling([*done.moves, *again.moves], lying, again.hanging, again.toppling)
    return done


def _held_up(shapes: Shapes, stand: Stand, group: Sequence[int], is_other: NDArray[np.bool_], way: float) -> float:
    """How much of its carrier's way down a group stays behind [m], because some of it comes to stand on others first."""
    free = min(float(compiled()["least_gap"](shapes, stand, body, is_other, SUNK_M)[0]) for body in group)
    return max(way - max(free, 0.0), 0.0)


def center_of_mass(interior: Interior, obj: int) -> Array:
    """Center of mass of an object from its origin, along the world's axes as proposed [m], shape (3,)."""
    return np.asarray(interior.poses[obj][:3, :3] @ mass_properties_of(interior.solids[obj]).center)


def center_as_turned(interior: Interior, shapes: Shapes, obj: int) -> Array:
    """The same in the frame of the object's vertices, which tipping may have turned since [m], shape (3,)."""
    first, last = shapes.first_piece[obj], shapes.first_piece[obj + 1]
    turned = shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]]
    proposed = np.concatenate([hull.vertices for hull in interior.solids[obj].hulls]) @ interior.poses[obj][:3, :3].T
    center = center_of_mass(interior, obj)
    if np.allclose(turned, proposed, rtol=0.0, atol=1e-12):
        return center
    return np.asarray(center @ np.linalg.lstsq(proposed, turned, rcond=None)[0])


def lost_supports(interior: Interior, poses: Array) -> set[str]:
    """Objects that stand on what carried them, or on the floor, no more at `poses` [m], shape (n, 4, 4). A rug may lie between."""
    shapes = shapes_of(interior.solids, poses)
    stand = stand_of(shapes, poses[:, :3, 3])
    lost = set()
    for i, (name, carrier) in enumerate(zip(interior.names, interior.carriers, strict=True)):
        if carrier.relation in ("floor", "on", "inside") and not is_held(interior, i):
            gap, to_cloth = gap_to_carrier(interior, shapes, stand, i)
            if gap > KEPT_M and not (gap <= COVERING_M and to_cloth <= KEPT_M):
                lost.add(name)
    return lost


def gap_to_carrier(interior: Interior, shapes: Shapes, stand: Stand, obj: int) -> tuple[float, float]:
    """Height of an object over its own carrier, or the floor, where it stands, and over rugs and cloths [m]; infinite where
    it is not over any."""
    parent = int(interior.parent[obj])
    among, cloths = np.zeros((2, len(stand.low)), dtype=np.bool_)
    cloths[: len(interior.objects)] = interior.covering
    gap = float(stand.low[obj, 2])
    if parent >= 0:
        among[parent] = True
        gap, _ = compiled()["least_gap"](shapes, stand, obj, among, SUNK_M)
    to_cloth, _ = compiled()["least_gap"](shapes, stand, obj, cloths, SUNK_M)
    return float(gap), float(to_cloth)


def _depth(interior: Interior, obj: int) -> int:
    """How many objects are below an object, one on the other."""
    depth, above = 0, int(interior.parent[obj])
    while above >= 0:
        depth, above = depth + 1, int(interior.parent[above])
    return depth
