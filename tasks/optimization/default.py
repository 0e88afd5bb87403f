"""The default method: simulated annealing on convex pieces, between exact vertical placements."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tasks.geometry.transforms import translation
from tasks.mounting import mounting
from tasks.optimization.interior import Interior
from tasks.optimization.rows import TOPPLES
from tasks.optimization.search.annealing import AnnealingSchedule
from tasks.optimization.search.arrangement import FIXED, HANGING, OVERHEAD, STANDING, Arrangement, compiled
from tasks.optimization.search.chains import Chain, anneal
from tasks.optimization.search.collisions import plan_ring
from tasks.optimization.search.trace import Move, Resolution, SearchStep
from tasks.optimization.shapes import Shapes, Stand, shapes_of, stand_of
from tasks.optimization.solids import ConvexParts, shell_solids
from tasks.optimization.support.balance import draw_back
from tasks.optimization.support.boundary import outside_share, way_in
from tasks.optimization.support.relocation import last_resort, moves_of, vertices_of
from tasks.optimization.support.resting import DEEP_M, beside, is_held, let_down, onto_cloths, put_to_rest, shift
from tasks.optimization.support.supports import PlacedAsset, SupportConfig, support_map
from tasks.optimization.support.walls import wall_faces, wall_snap
from tasks.settings import Config, Count, NonNegative, Positive, Share

WALL_M = 1.0
"""Thickness that walls get while objects are moved [m]: what was scanned through one is pushed back, not out behind it."""

MAP_CELL_M = 0.02
"""Cells in which it is known where a carried object may stand: a fifth of a mug."""

MAP_REACH = 30
"""Cells that a carried object may stray on its carrier: 60 cm, most of a desk's depth."""

OUTSIDE_SHARE = 0.02
"""An object of which less lies outside of the floor, seen from above, only touches a wall that was estimated."""

HUNG_M = 0.05
"""Objects that hang farther off their wall, or in it [m], stay where they were scanned: the wall is less sure than their points."""

PULLED_M = 0.05
"""Objects that reach farther through a wall [m] are not pulled in: their colliders end at the wall."""

LEAN_RADIANS = 0.1
"""Objects that tip by more, 6 degrees, do not stand as they were scanned."""

MOSTLY_OUTSIDE = 0.5
"""Of an object's plan: what lies farther outside than this is pulled in all the same."""

LEVER = 0.25
"""What a turn by one radian counts as displacement, in longest sides: the mean way of a box's corners."""


@dataclasses.dataclass(frozen=True)
class Default(Config):
    """Simulated annealing on convex pieces: Metropolis acceptance, several chains, adaptive moves along x, y, z and yaw.

    The loss is the sum of the penetration depths of all pairs of pieces of different objects, and of objects and walls.
    What an object carries moves along; a carried object stays on its carrier, a hanging one at its wall. A chain ends when
    nothing overlaps; then objects are brought back towards their places as far as nothing overlaps again.
    """

    kind: ClassVar[str] = "default"
    chains: Count = 4  # the best of four moves objects a third less far than one alone, in crowded rooms
    max_moves: Count = 15_000  # of a chain; a solvable room of 40 objects takes some hundreds to thousands
    max_kept: Count = 20_000  # moves that a chain may keep: the length of its trace
    slop_m: NonNegative = 0.000005  # what rests on something touches it by rounding; 0.2 mm is what PhysX throws apart in its first step
    step_m: Positive = 0.02  # the spread of moves at first: the size of a usual overlap
    turn_radians: Positive = 0.05  # the spread of turns at first: 3 degrees move a chair's corner by 2 cm
    least_step_m: Positive = 0.001  # below a millimetre nothing is won
    most_step_m: Positive = 0.2  # farther moves throw objects about
    turn_share: Share = 0.2  # of the moves are turns: shifting parts most pairs
    rise_share: Share = 0.15  # of the other moves of a carried object go up or down: a pillow climbs onto the one beside it
    most_rise_m: NonNegative = 0.1  # higher, and it stands on something else
    most_aside_m: NonNegative = 0.4  # along its wall: the width of a picture
    most_way_m: NonNegative = 0.15  # farther, and it is another room; only what is stuck otherwise goes so far, and it is named
    most_turn_radians: NonNegative = 0.35  # 20 degrees: more, and the object faces elsewhere than the scanned one
    most_tilt_radians: NonNegative = 0.45  # 26 degrees: what would tip farther was not meant to stand so
    nudge_m_s: NonNegative = 0.05  # what such a push would throw over is laid down; certificates nudge by as much; 0: it is left to balance
    lets_fall: bool = True  # what fails its certificate is put where it comes to rest, if that is near; the first engine has a part in it
    price: NonNegative = 0.05  # metres of depth that a metre of displacement costs: objects move no farther than they must
    temperature_m: Positive = 0.0003  # cold at first, so that easy rooms are solved without detours
    cooling: Annotated[float, Field(gt=0, lt=1)] = 0.8  # per sweep: seven sweeps down to the coldest
    coldest_m: Positive = 0.00005  # below it no worse state is taken any more
    warmer: Annotated[float, Field(ge=1)] = 2.0  # each time a cold chain is stuck, it starts again twice as warm
    sweep: Count = 60  # moves per object that may move, at each temperature

    def schedule(self) -> AnnealingSchedule:
        """The same for compiled code."""
        return AnnealingSchedule(
            slop=self.slop_m, step=self.step_m, turn=self.turn_radians, least_step=self.least_step_m, most_step=self.most_step_m,
            turn_share=self.turn_share, rise_share=self.rise_share, most_rise=self.most_rise_m, most_aside=self.most_aside_m,
            most_turn=self.most_turn_radians, most_way=self.most_way_m,
            price=self.price, temperature=self.temperature_m,
            cooling=self.cooling, coldest=self.coldest_m, warmer=self.warmer, sweep=self.sweep, adapts=True, returns=True,
        )  # fmt: skip


def resolve(
    interior: Interior, method: Default, supports: SupportConfig, rng: Callable[..., np.random.Generator],
    spread: Callable[[Any, Sequence[Any]], list[Any]], wedged: Collection[int] = (), anywhere: Collection[str] = (),
) -> Resolution:  # fmt: skip
    """Objects pulled into the room, hung on their walls, put to rest, moved apart, and let down onto what is below them; what is
    still in something else then is put elsewhere.

    `wedged`: objects that fit nowhere on or in what was taken for their carrier, as a first attempt has shown. anywhere: those that
    go farther than `most_way_m` where they are still in something else.
    """
    names = interior.names
    proposed = interior
    laid = _laid_out(interior, supports, wedged)
    interior, solids, shapes, stand, drawn, noted = laid.interior, laid.solids, laid.shapes, laid.stand, laid.drawn, laid.noted
    notes: list[str] = []
    room = arrangement_of(interior, solids, shapes, stand, supports, dict(drawn))
    generators = [rng("chain", number) for number in range(method.chains)]
    chain, tried = anneal(room, method.schedule(), method.max_moves, method.max_kept, generators, spread)
    trace = [SearchStep(names[i], move, chain.start, chain.start, outcome) for i, move, outcome in laid.steps]
    trace += _chain_steps(names, room, stand, chain)
    settling = let_down(interior, shapes, stand, method.most_tilt_radians, method.nudge_m_s)
    final = _loss(room, stand, DEEP_M) if chain.final == 0.0 else _loss(room, stand, method.slop_m)
    trace += [SearchStep(names[i], move, final, min(final, chain.final), outcome) for i, move, outcome in moves_of(settling)]
    stuck = _wedged(interior, shapes, stand) if final > 0.0 and not wedged else []
    if stuck:
        poses = np.concatenate([proposed.poses, np.tile(np.eye(4), (len(solids) - len(names), 1, 1))])
        untouched = shapes_of(solids, poses)  # letting objects down has turned some of the others
        if beside(proposed, untouched, stand_of(untouched, poses[:, :3, 3]), stuck)[1] != list(noted):
            other = resolve(proposed, method, supports, rng, spread, stuck, anywhere)
            if other.settled < final:
                return other
    settled = final
    loose = [i for i, name in enumerate(names) if name in anywhere]
    most = (method.most_tilt_radians, method.nudge_m_s, method.most_way_m)
    last = last_resort(interior, solids, room, stand, settling, method.slop_m, *most, loose)
    if last.moves:
        final = _loss(room, stand, DEEP_M if chain.final == 0.0 else method.slop_m)
        smallest = min(final, trace[-1].smallest if trace else chain.start)
        trace += [SearchStep(names[i], move, final, smallest, outcome) for i, move, outcome in last.moves]
    if final == 0.0:
        ended = "nothing_to_do" if chain.start == 0.0 and not last.moves else "zero_loss"
    else:
        ended = "out_of_moves" if tried > 0 else "no_move_helps"
        notes.append(f"penetrations of {final:.3g} m of {chain.start:.3g} m are left after {tried} moves")
    problems = {names[i]: f"it hangs {gap:.2f} m above anything" for i, gap in last.settling.hanging.items()}
    for i in last.settling.toppling:
        problems.setdefault(names[i], TOPPLES)
    for i, text in last.reasons.items():
        problems[names[i]] = "; ".join([text, *([problems[names[i]]] if names[i] in problems else [])])
    chains = method.chains if chain.start > 0 else 1
    pulled = [(names[i], math.hypot(dx, dy)) for i, (dx, dy, *_), outcome in laid.steps if outcome == "pulled_in"]
    far = [f"{name}: pulled in by {way:.2f} m: it lay outside of the room" for name, way in pulled if way > method.most_way_m]
    return Resolution(tuple(trace), chain.start, final, tried, chains, ended, tuple(notes), problems, interior, (*noted, *far), settled)


class _Laid(NamedTuple):
    """Objects in the room and at rest, before any is moved apart: what carries them, solids with the walls behind them, where they stand,
    shifts of those drawn back (dx, dy) [m] by number, what was noted, and the steps that led there."""

    interior: Interior
    solids: tuple[ConvexParts, ...]
    shapes: Shapes
    stand: Stand
    drawn: list[tuple[int, tuple[float, float]]]
    noted: tuple[str, ...]
    steps: list[tuple[int, Move, str]]


def _laid_out(interior: Interior, supports: SupportConfig, wedged: Collection[int] = (), most_m: float = np.inf) -> _Laid:
    walls = walls_of(interior)
    solids = (*interior.solids, *walls)
    poses = np.concatenate([interior.poses, np.tile(np.eye(4), (len(walls), 1, 1))])
    shapes = shapes_of(solids, poses)
    stand = stand_of(shapes, poses[:, :3, 3])
    interior, noted = beside(interior, shapes, stand, wedged)
    steps: list[tuple[int, Move, str]] = []
    steps += [(i, (*way, 0.0, 0.0, 0.0, 0.0), outcome) for i, way, outcome in _brought_in(interior, shapes, stand, supports, most_m)]
    steps += [(i, (0.0, 0.0, dz, 0.0, 0.0, 0.0), "rested") for i, dz in put_to_rest(interior, shapes, stand)]
    steps += [(i, (0.0, 0.0, dz, 0.0, 0.0, 0.0), "rested") for i, dz in onto_cloths(interior, shapes, stand)]
    drawn = draw_back(interior, shapes, stand)
    steps += [(i, (*way, 0.0, 0.0, 0.0, 0.0), "pulled_in") for i, way in drawn]
    return _Laid(interior, solids, shapes, stand, drawn, tuple(noted), steps)


def walls_of(interior: Interior) -> tuple[ConvexParts, ...]:
    """The room's walls as they keep objects in, and brackets at them, world frame [m]; none where no room is known."""
    return (*shell_solids(interior.room, WALL_M), *interior.brackets) if interior.room is not None else ()


def poses_at_rest(interior: Interior, supports: SupportConfig) -> NDArray[np.float64]:
    """Poses of objects in the room and at rest on what carries them, before any is moved apart, shape (n, 4, 4) [m]. What reaches through a
    wall by more than `PULLED_M` stays there."""
    poses = interior.poses.copy()
    poses[:, :3, 3] = _laid_out(interior, supports, most_m=PULLED_M).stand.place[: len(poses)]
    return poses


def tipping_at_rest(interior: Interior, method: Default, supports: SupportConfig) -> list[int]:
    """Objects, by number, that would not stay as they are where they come to rest: they would topple, be laid down, or tip by more than
    `LEAN_RADIANS`."""
    laid = _laid_out(interior, supports)
    settling = let_down(laid.interior, laid.shapes, laid.stand, method.most_tilt_radians, method.nudge_m_s, rounds=1)
    turned = {i for i, _, rotation in settling.moves if float(rotation[2, 2]) < math.cos(LEAN_RADIANS)}
    names = {laid.interior.names[i] for i in turned | set(settling.toppling)}
    return [i for i, name in enumerate(interior.names) if name in names]


def _wedged(interior: Interior, shapes: Shapes, stand: Stand) -> list[int]:
    """Objects that overlap their own carrier where they stand."""
    carried = [(i, int(parent)) for i, parent in enumerate(interior.parent) if parent >= 0 and not is_held(interior, i)]
    return [i for i, parent in carried if compiled()["pair_depth"](shapes, stand, i, parent, DEEP_M)[1] > 0.0]


def _loss(room: Arrangement, stand: Stand, slop: float) -> float:
    """Sum of the penetration depths of all counted pairs of pieces beyond `slop`, where the bodies stand [m]."""
    pairs = np.argwhere(np.triu(room.counted, 1)).tolist()
    return float(sum(compiled()["pair_depth"](room.shapes, stand, a, b, slop)[0] for a, b in pairs))


def arrangement_of(
    interior: Interior, solids: Sequence[ConvexParts], shapes: Shapes, stand: Stand, supports: SupportConfig,
    drawn: Mapping[int, tuple[float, float]] | None = None,
) -> Arrangement:  # fmt: skip
    """The room as the chains take it: objects at rest, and the walls after them. `drawn`: shifts (dx, dy) [m] that objects
    were given on their carriers."""
    n, bodies = len(interior.objects), len(solids)
    parent = np.full(bodies, -1, dtype=np.int64)
    parent[:n] = interior.parent
    groups = [*interior.groups(), *([i] for i in range(n, bodies))]
    first = np.concatenate([[0], np.cumsum([len(group) for group in groups])]).astype(np.int64)
    kind, along = np.zeros(bodies, dtype=np.int64), np.zeros((bodies, 2))
    directions = {face.name: face.along for face in wall_faces(interior.room)} if interior.room is not None else {}
    counted = ~np.eye(bodies, dtype=np.bool_)
    counted[n:, n:] = False
    maps: list[NDArray[np.bool_]] = []
    map_of, lever = np.full(bodies, -1, dtype=np.int64), np.zeros(bodies)
    for i, (obj, carrier) in enumerate(zip(interior.objects, interior.carriers, strict=True)):
        lever[i] = LEVER * float((obj.high - obj.low)[:2].max())
        kind[i] = {"wall": HANGING, "ceiling": OVERHEAD}.get(carrier.relation, STANDING)
        if kind[i] == HANGING:
            along[i] = directions.get(carrier.against, np.zeros(2)) if carrier.against else 0.0
        if interior.covering[i] or mounting(obj.category).kind == "let_in":
            kind[i] = FIXED
        if interior.covering[i]:
            counted[i], counted[:, i] = False, False
        if interior.fixed[i]:
            if kind[i] == STANDING:  # built in
                kind[i] = FIXED
            counted[i, :n][interior.fixed] = False  # neither moves
            for wall in range(n, bodies):  # let into a wall or set against it: the room's shell is only an estimate there
                if compiled()["pair_depth"](shapes, stand, i, wall, 0.0)[1] > 0.0:
                    counted[i, wall] = counted[wall, i] = False
        if parent[i] >= 0:
            map_of[i] = len(maps)
            carrying = interior.objects[parent[i]]
            if drawn and i in drawn:
                obj = _shifted(obj, *drawn[i])
            maps.append(support_map(obj, carrying, carrier.gap, MAP_CELL_M, MAP_REACH, supports))
    side = 2 * MAP_REACH + 1
    return Arrangement(
        shapes=shapes, pivots=stand.place.copy(), counted=counted, parent=parent, first_carried=first,
        carried=np.concatenate([*map(np.asarray, groups), []]).astype(np.int64), kind=kind, along=along, map_of=map_of,
        maps=np.array(maps, dtype=np.bool_).reshape(-1, side, side), cell=MAP_CELL_M, lever=lever,
    )  # fmt: skip


def _shifted(obj: PlacedAsset, dx: float, dy: float) -> PlacedAsset:
    """An object somewhere else [m]."""
    move = np.array([dx, dy, 0.0])
    surface = obj.surface.transformed(translation(move))
    return dataclasses.replace(obj, surface=surface, low=obj.low + move, high=obj.high + move)


def _brought_in(
    interior: Interior, shapes: Shapes, stand: Stand, supports: SupportConfig, most_m: float
) -> list[tuple[int, tuple[float, float], str]]:
    """What hangs is put onto its wall, and what stands outside of the room pulled in, the shortest way, if that is no longer than `most_m`
    [m] or most of it lies outside. Moves `stand`."""
    if interior.room is None or interior.ring is None:
        return []
    has_walls = bool(wall_faces(interior.room))
    moves = []
    groups = interior.groups()
    for i, (obj, carrier) in enumerate(zip(interior.objects, interior.carriers, strict=True)):
        outcome, way = "", None
        if carrier.relation == "wall":
            outcome, way = "hung", wall_snap(obj, interior.room, carrier, supports.wall_m)
            if way is not None and math.hypot(*way) > HUNG_M:
                way = None
        elif has_walls and interior.parent[i] < 0 and carrier.relation != "ceiling" and not interior.fixed[i]:
            ring = plan_ring(vertices_of(shapes, stand, i)[:, :2])
            share = outside_share(ring, interior.ring)
            if share > OUTSIDE_SHARE:
                outcome, way = "pulled_in", way_in(ring, interior.ring)
                if way is not None and math.hypot(*way) > most_m and share < MOSTLY_OUTSIDE:
                    way = None
        if way is not None and math.hypot(*way) > 1e-6:
            shift(shapes, stand, groups[i], (*way, 0.0))
            moves.append((i, way, outcome))
            stays: set[int] = set()
            for k in groups[i][1:] if outcome == "hung" else ():
                # a worktop lies at its wall whatever its cabinet does, and a sink with it
                if k not in stays and interior.fixed[k] and interior.carriers[k].against is not None:
                    back = (-way[0], -way[1])
                    shift(shapes, stand, groups[k], (*back, 0.0))
                    moves.append((k, back, outcome))
                    stays.update(groups[k])
    return moves


def _chain_steps(names: Sequence[str], room: Arrangement, stand: Stand, chain: Chain) -> list[SearchStep]:
    """The moves of a chain in the world frame; leaves the bodies in `stand` where they lead."""
    offset = np.zeros((len(room.parent), 4))
    steps = []
    columns = (chain.bodies.tolist(), chain.moves, chain.loss.tolist(), chain.smallest.tolist(), chain.numbers.tolist())
    for body, move, loss, smallest, number in zip(*columns, strict=True):
        # a carried object's own moves are along the axes of its carrier
        carrier = int(room.parent[body])
        c, s = stand.turn[carrier].tolist() if carrier >= 0 else (1.0, 0.0)
        dx, dy, dz, dyaw = move.tolist()
        offset[body] += move
        for other in room.carried[room.first_carried[body] : room.first_carried[body + 1]]:
            compiled()["compose"](room, stand, offset, other)
        steps.append(SearchStep(names[body], (c * dx - s * dy, s * dx + c * dy, dz, 0.0, 0.0, dyaw), loss, smallest, "kept", number))
    return steps
