"""Objects that fail their certificate are let fall: they are put where the engine saw them come to rest, if that is near."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import rotation_vector
from tasks.optimization.certificates import CertificateConfig, Certified, certify
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import Default
from tasks.optimization.interior import Interior
from tasks.optimization.parting import APART_M
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.solids import ConvexParts, RigidBody
from tasks.optimization.support.resting import MOST_LAID_M, lost_supports
from tasks.stage import Spread, in_turn

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

MOST_ROUNDS = 3
"""Falls that are followed, one after the other: what lies now may have held something else."""

MOST_PARTINGS = 40
"""Shifts that may bring a fallen object out of what the engine's soft contacts let it sink into."""

BESIDE_M = 0.01
"""Objects whose pieces' boxes are no farther apart than this may lean on one another or push one another [m]: as far as what is stable
moves."""

SUNK_M = 0.001
"""Deeper than this no contact at rest is soft [m]: the engine has lost track."""


@dataclasses.dataclass(frozen=True)
class Fall:
    """What letting objects fall came to: poses [m], shape (n, 4, 4), the moves that lead there, in order, and certificates. concerned:
    Objects, by number, of which these are new."""

    poses: Array
    moves: tuple[tuple[str, Move], ...]
    certified: list[Certified]
    concerned: frozenset[int] = frozenset()


def let_fall(
    interior: Interior, poses: Array, certified: list[Certified], bodies: Sequence[RigidBody],
    allowed: Mapping[tuple[str, str], float], method: Default, config: CertificateConfig,
    spread: Spread = in_turn,
) -> Fall:  # fmt: skip
    """Objects that carry nothing and that MuJoCo sees move from `poses` [m], shape (n, 4, 4), put where they come to rest, and certified
    anew.

    What falls farther than `method.most_way_m` aside or down from where it was scanned, off its carrier, or
    over although it is too high to be laid down, keeps its place, and so does what does not stay where it comes to rest. Nothing else
    is moved, and nobody falls at the cost of what stood before. allowed: depths [m] to which pairs may be in each other, by their names.

    While falls are tried, what fell or moved before, what was or is beside that, and what it hits are certified anew; the rest sleeps,
    untouched, and keeps its certificates. Where they end, all is certified at once: an engine weighs all contacts together.
    """
    start = Fall(poses, (), certified)
    best, tried = start, start
    for _ in range(MOST_ROUNDS):
        falling = _falling(interior, tried, allowed, method)
        if not falling:
            break
        tried = _certified_after(interior, start, [*tried.moves, *falling], tried.concerned, bodies, config, spread)
        if _unstable(tried.certified) - _unstable(start.certified):
            break  # something that stood leaned on it
        best = tried
    is_whole = best.concerned == frozenset(range(len(bodies)))
    while best.moves:
        restless = {name for name, _ in best.moves} & _unstable(best.certified)
        if is_whole and not restless:
            break
        moves = [move for move in best.moves if move[0] not in restless]
        poses = _poses_after(interior, start, moves)
        if not moves or (restless and _is_met(interior, moves, poses, allowed, method.slop_m)):
            return start  # nothing stays where it fell, or something fell to where another one went back to
        made = certify(bodies, poses, interior.shell, config, spread)
        best = dataclasses.replace(best, poses=poses, moves=tuple(moves), certified=made)
        is_whole = True
    return best if _unstable(best.certified) < _unstable(start.certified) else start


def _unstable(certified: Sequence[Certified]) -> set[str]:
    """Names of what moves, left alone or after a nudge, by any engine."""
    return {row.name for row in certified if not (row.is_stable_1cm and row.is_stable_5cm) or row.is_stable_nudged is False}


def _is_met(
    interior: Interior, moves: Sequence[tuple[str, Move]], poses: Array, allowed: Mapping[tuple[str, str], float], slop: float
) -> bool:
    """Whether anything overlaps what moves led to `poses` [m], shape (n, 4, 4), by more than `slop` [m]. allowed: as for `let_fall`."""
    fell = {name for name, _ in moves}
    met = Colliders(interior.solids, interior.shell).penetrations(poses)
    return any(fell & {p.a, p.b} and p.depth_m > slop + allowed.get((p.a, p.b), 0.0) for p in met)


def _poses_after(interior: Interior, start: Fall, moves: Sequence[tuple[str, Move]]) -> Array:
    """Poses [m], shape (n, 4, 4), after moves from the start, as a replay of the trace has them."""
    parents = {name: carrier.parent_id for name, carrier in zip(interior.names, interior.carriers, strict=True)}
    moved = moved_poses(dict(zip(interior.names, start.poses, strict=True)), parents, moves)
    return np.array([moved[name] for name in interior.names])


def _certified_after(
    interior: Interior, start: Fall, moves: Sequence[tuple[str, Move]], concerned: Collection[int], bodies: Sequence[RigidBody],
    config: CertificateConfig, spread: Spread,
) -> Fall:  # fmt: skip
    """Poses after moves from the start, with new certificates of what these or former moves may concern."""
    poses, unstable = _poses_after(interior, start, moves), _unstable(start.certified)
    moved = {*unstable, *(name for name, _ in moves)}
    seeds = {*concerned, *(i for i, name in enumerate(interior.names) if name in moved)}
    if config.mujoco.sleep_m_s == 0.0:  # then nothing ever sleeps
        seeds = set(range(len(bodies)))
    beside = _beside(interior.solids, [body.is_fixed for body in bodies], (start.poses, poses))
    while True:
        awake = _linked(beside, seeds)
        asleep = [i for i, body in enumerate(bodies) if i not in awake and not body.is_fixed]
        made = certify(bodies, poses, interior.shell, config, spread, asleep)
        hit = {row.name for row in made if row.engine.startswith("mujoco") and (row.displacement_m or row.nudged_displacement_m)}
        seeds = awake | {i for i in asleep if interior.names[i] in hit}
        if seeds == awake:
            break
    sleeping = {interior.names[i] for i in asleep}
    rows = [former if row.name in sleeping else row for row, former in zip(made, start.certified, strict=True)]
    return Fall(poses, tuple(moves), rows, frozenset(range(len(bodies))) - frozenset(asleep))


def _beside(solids: Sequence[ConvexParts], fixed: Sequence[bool], states: Sequence[Array]) -> Booleans:
    """Which solids are beside one another, with pieces whose boxes are at most `BESIDE_M` apart, at any of some poses [m], shape (n, 4, 4)
    each; shape (n, n). What is fixed is beside nothing: it passes nothing on."""
    beside = np.zeros((len(solids), len(solids)), dtype=np.bool_)
    for poses in states:
        boxes = [
            np.array([(hull.vertices.min(axis=0), hull.vertices.max(axis=0)) for hull in solid.placed(pose)]).reshape(-1, 2, 3)
            for solid, pose in zip(solids, poses, strict=True)
        ]
        free = [i for i, box in enumerate(boxes) if len(box) and not fixed[i]]
        for at, i in enumerate(free):
            for j in free[at + 1 :]:
                low, high = np.maximum(boxes[i][:, None, 0], boxes[j][None, :, 0]), np.minimum(boxes[i][:, None, 1], boxes[j][None, :, 1])
                beside[i, j] |= bool((low <= high + BESIDE_M).all(axis=2).any())
    return beside | beside.T


def _linked(beside: Booleans, seeds: Collection[int]) -> set[int]:
    """Seeds and all that they reach from one to the next."""
    linked, waiting = set(seeds), list(seeds)
    while waiting:
        new = set(np.flatnonzero(beside[waiting.pop()]).tolist()) - linked
        linked |= new
        waiting += new
    return linked


def _falling(interior: Interior, state: Fall, allowed: Mapping[tuple[str, str], float], method: Default) -> list[tuple[str, Move]]:
    """Moves of what may fall to where MuJoCo saw it end, set as exported scenes are or else as it comes, one each."""
    colliders, before = Colliders(interior.solids, interior.shell), state.poses
    carrying, lost = set(interior.parent.tolist()), lost_supports(interior, before)
    ends = {  # by MuJoCo's own settings only where it stays by those of exported scenes
        row.name: row.fallen_pose for row in reversed(state.certified) if row.engine.startswith("mujoco") and row.fallen_pose is not None
    }
    falling: list[int] = []
    poses = before.copy()
    for i, name in enumerate(interior.names):
        is_free = i not in carrying and not interior.fixed[i] and not interior.covering[i]
        if name in ends and is_free and _is_near(interior, i, before[i], ends[name], method):
            poses[i] = ends[name]
            falling.append(i)
    while True:
        blocked = [i for i in falling if not _part(colliders, poses, i, allowed, method.slop_m)]
        blocked = blocked or [i for i in falling if interior.names[i] in lost_supports(interior, poses) - lost]
        if not blocked:
            break
        poses[blocked] = before[blocked]
        falling = [i for i in falling if i not in blocked]
    moves = []
    for i in falling:
        turn, way = rotation_vector(poses[i][:3, :3] @ before[i][:3, :3].T), (poses[i] - before[i])[:3, 3].tolist()
        moves.append((interior.names[i], (way[0], way[1], way[2], *turn)))
    return moves


def _is_near(interior: Interior, obj: int, before: Array, after: Array, method: Default) -> bool:
    """Whether a person would still say that an object is where it was scanned, `before` and `after` its fall, 4x4 [m]."""
    way = after[:3, 3] - interior.poses[obj][:3, 3]
    if float(np.hypot(way[0], way[1])) > method.most_way_m or abs(float(way[2])) > method.most_way_m:
        return False
    tilt = float(np.arctan2(np.linalg.norm(np.cross(before[:3, 2], after[:3, 2])), before[:3, 2] @ after[:3, 2]))
    height = float(np.ptp(np.concatenate([hull.vertices[:, 2] for hull in interior.solids[obj].placed(before)])))
    return height <= MOST_LAID_M or tilt <= method.most_tilt_radians


def _part(colliders: Colliders, poses: Array, obj: int, allowed: Mapping[tuple[str, str], float], slop: float) -> bool:
    """Shift an object out of what it sank into, at `poses` [m], shape (n, 4, 4), in place; whether that leaves no overlap above `slop`."""
    for _ in range(MOST_PARTINGS):
        mine = [p for p in colliders.penetrations(poses) if obj in (p.index_a, p.index_b)]
        mine = [p for p in mine if p.depth_m > slop + allowed.get((p.a, p.b), 0.0)]
        if not mine:
            return True
        deepest = max(mine, key=lambda p: p.depth_m)
        if deepest.depth_m > SUNK_M:
            return False
        sign = 1.0 if deepest.index_a == obj else -1.0
        poses[obj][:3, 3] += sign * (deepest.depth_m + APART_M) * np.array(deepest.direction)
    return False
