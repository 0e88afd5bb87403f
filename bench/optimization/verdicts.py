"""Verdicts: what is right and wrong with the states of a scene, before and after each method of optimization."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.optimization.depths import TOLERANCE_M, disagreeing
from bench.optimization.measures import FLOOR, OFF_WALL_M, OUTSIDE_M, TOUCH_M, Measures, Posed
from bench.optimization.reports import reported_losses, reported_outside
from bench.rooms import BenchScene, Carried
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks import optimization
from tasks.geometry.mass import mass_properties
from tasks.geometry.meshes import asset_surface, load_glb
from tasks.geometry.pieces import Pieces, asset_pieces, pieces, read_pieces
from tasks.geometry.transforms import matrix
from tasks.optimization import OptimizationConfig
from tasks.optimization.certificates import certify
from tasks.optimization.contacts import Colliders
from tasks.optimization.solids import ConvexParts, RigidBody, shell_solids
from tasks.optimization.support.supports import PlacedAsset, find_carriers
from tasks.stage import Caches, Context, Outcome

Array = NDArray[np.float64]

DEEP_M = 0.002
"""Pairs that penetrate deeper than this count."""

DRAWN, INPUT = "drawn", "input"
"""States before any optimization: as the generator furnished it, and disturbed."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What is wrong with one state of one scene; objects by instance id, sorted.

    deep, allowed: pairs deeper than `DEEP_M`, and their depth [m]; allowed ones are of fixed objects with the room, no deeper
    than in the input: a door is in its wall.
    free: objects that may move. unplaced: instances for which the stage placed nothing. fixed_wrongly: fixed, though they
    were not drawn as fixed; None where nobody knows how they were drawn. unstable_1cm, unstable_5cm: free objects that
    moved farther in MuJoCo's certificate, displacement [m] and tilt [rad]. unstable_nudged: those that moved farther than
    1 cm or tilted by more than 5 degrees after a nudge. laid_down: objects that the optimization laid down, as a nudge would
    throw them over; fallen: that it put where they come to rest. displaced: horizontal distance from the input of every
    object [m]. floating: free objects above nothing
    nearer than 1 cm, and the gap [m]. outside: free objects and how far they reach over the floor's edge [m];
    outside_silently: those of which the optimization does not say so.
    lost_reported, lost_silently: objects that what carried them carries no more; the optimization says that very object, or
    does not. carried: objects whose carrier was looked at. misjudged: objects for which the optimization took something else
    as carrier than what carried them when they were drawn; None where nobody knows. disagreeing: pairs whose depth in the
    rows differs by more than 0.1 mm from what the optimization's own colliders find at these poses (all pairs), or from the
    depth by every axis (a sample of `depths_checked` pairs), and the difference [m].
    """

    scene_id: str
    state: str
    objects: int
    free: tuple[str, ...]
    unplaced: tuple[str, ...]
    fixed_wrongly: tuple[str, ...] | None
    deep: tuple[tuple[str, str, float], ...]
    allowed: tuple[tuple[str, str, float], ...]
    unstable_1cm: tuple[tuple[str, float, float], ...]
    unstable_5cm: tuple[tuple[str, float, float], ...]
    unstable_nudged: tuple[tuple[str, float, float], ...]
    laid_down: tuple[str, ...]
    fallen: tuple[str, ...]
    displaced: tuple[tuple[str, float], ...]
    floating: tuple[tuple[str, float], ...]
    outside: tuple[tuple[str, float], ...]
    outside_silently: tuple[str, ...]
    carried: int
    lost_reported: tuple[str, ...]
    lost_silently: tuple[str, ...]
    misjudged: tuple[str, ...] | None
    disagreeing: tuple[tuple[str, str, float], ...]
    depths_checked: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class SceneVerdicts:
    """Verdicts of a scene's states, in order; how many objects were disturbed; seconds until all convex pieces were there."""

    scene_id: str
    categories: Mapping[str, str]
    verdicts: tuple[Verdict, ...]
    disturbances: int
    piece_seconds: float


def config_of(method: str) -> OptimizationConfig:
    """The config of a method, everything else as it is by default."""
    names = {"paper": optimization.Paper, "released": optimization.Released, "default": optimization.Default}
    return OptimizationConfig(method=names[method]())


def context_of(scene: BenchScene, seed: int, caches: Caches) -> Context:
    """What the stage may know beside the rows."""
    return Context(scene.scene_id, "optimization", seed, scene.blobs, caches)


def optimized(scene: BenchScene, config: OptimizationConfig, context: Context) -> Outcome:
    """The stage's rows for a scene."""
    stage = optimization.STAGE
    return stage.run(**{table: scene.rows[table] for table in (*stage.reads, *stage.history)}, context=context, config=config)


def judge(scene: BenchScene, methods: Sequence[str], seed: int, caches: Caches) -> SceneVerdicts:
    """Every method on a scene, and the states before, measured in the same way."""
    config, context = OptimizationConfig(), context_of(scene, seed, caches)
    clock = time.perf_counter()
    known = _pieces(scene, config, context)
    piece_seconds = time.perf_counter() - clock
    outcomes: dict[str, tuple[Outcome, float]] = {}
    for method in methods:
        clock = time.perf_counter()
        outcome = optimized(scene, config_of(method), context)
        outcomes[method] = outcome, time.perf_counter() - clock
    instances = {row.instance_id: row for row in scene.rows["instances"]}
    to_place = {name for name, row in instances.items() if not row.is_structure}
    categories = {name: row.category for name, row in instances.items()}
    placements = {row.instance_id: row for row in outcomes[methods[-1]][0].rows["placements"]}
    proposed = {name: matrix(row.proposed_pose) for name, row in placements.items()}
    solids = {
        name: ConvexParts(name, tuple(hull.transformed(np.eye(4), row.scale) for hull in known[row.asset_id].hulls))
        for name, row in placements.items()
    }  # fmt: skip
    room = scene.rows["shells"][0] if scene.rows["shells"] else None
    polygon = np.array(room.floor_polygon, dtype=np.float64).reshape(-1, 2) if room else np.zeros((0, 2))
    shell = list(shell_solids(room)) if room else []
    colliders = Colliders(list(solids.values()), shell)
    depths = {(p.a, p.b): p.depth_m for p in colliders.penetrations(np.array([proposed[name] for name in solids]))}
    last = outcomes[methods[-1]][0]
    fixed = {row.instance_id for row in last.rows["supports"] if row.is_fixed}
    carried = scene.carried if scene.carried is not None else _carried_as_proposed(scene, placements, config, context)
    used = {name: (row.asset_id, row.scale) for name, row in placements.items()}
    rebuilt = _Rebuilt(scene, used, solids, config, {asset for asset, made in known.items() if made.method == "cut"}, {})

    def laboratory_with(own: Mapping[str, ConvexParts]) -> _Laboratory:
        """The laboratory with colliders of placements, by name, in place of their assets'."""
        used_solids = {name: own.get(name, solid) for name, solid in solids.items()}
        measures = Measures(list(used_solids.values()), categories, polygon, room.height_m if room else np.inf)
        met = Colliders(list(used_solids.values()), shell) if own else colliders
        remade = dataclasses.replace(rebuilt, solids=used_solids, own=frozenset(own))
        return _Laboratory(scene, used_solids, categories, measures, met, shell, carried, proposed, config, to_place, depths, remade)

    laboratory = laboratory_with({})
    verdicts = []
    if scene.drawn_poses is not None:
        poses = {name: scene.drawn_poses[name] for name in solids}
        verdicts.append(laboratory.verdict(DRAWN, poses, fixed, None, 0.0))
    verdicts.append(laboratory.verdict(INPUT, proposed, fixed, None, 0.0))
    for method, (outcome, seconds) in outcomes.items():
        poses = {row.instance_id: matrix(row.optimized_pose) for row in outcome.rows["placements"]}
        own = {row.instance_id for row in outcome.rows["supports"] if row.is_fixed}
        blobs = {row.instance_id: row.collider_blob for row in outcome.rows["placements"] if row.collider_blob is not None}
        cut = {name: ConvexParts(name, read_pieces(outcome.blobs[blob], blob)) for name, blob in blobs.items()}
        verdicts.append((laboratory_with(cut) if cut else laboratory).verdict(method, poses, own, outcome, seconds))
    return SceneVerdicts(scene.scene_id, categories, tuple(verdicts), len(scene.disturbances), piece_seconds)


def _carried_as_proposed(
    scene: BenchScene, placements: Mapping[str, Placement], config: OptimizationConfig, context: Context
) -> dict[str, Carried]:
    """What carries each object at its proposed pose, by the geometry of its surface there: for scans, which nobody drew.

    The stage may find others while it works; those are in its own rows, which are not asked here.
    """
    assets = {row.asset_id: row for row in scene.rows["assets"]}
    categories = {row.instance_id: row.category for row in scene.rows["instances"]}
    placed = []
    for name, row in sorted(placements.items()):
        asset = assets[row.asset_id]
        surface = asset_surface(asset.mesh_blob, context.blobs, f"{asset.name}.glb", context.caches["tasks.geometry.meshes"])
        world = surface.transformed(matrix(row.proposed_pose), np.array(row.scale))
        placed.append(PlacedAsset.of(name, categories[name], world, asset.is_watertight))
    room = scene.rows["shells"][0] if scene.rows["shells"] else None
    return {name: Carried(c.relation, c.parent_id) for name, c in find_carriers(placed, room, config.supports).items()}


def _pieces(scene: BenchScene, config: OptimizationConfig, context: Context) -> dict[str, Pieces]:
    """Convex pieces by asset, as the stage has them; from here on they are remembered. Assets that cannot be read have
    none: the stage places nothing for them, which is counted."""
    pieces = {}

    def parts(blob: str) -> Callable[[], Sequence[Any]]:
        return lambda: load_glb(context.blobs[blob])

    for asset in scene.rows["assets"]:
        known = parts(asset.pieces_blob) if asset.pieces_blob else None
        with contextlib.suppress(InputError, KeyError, ValueError):
            pieces[asset.asset_id] = asset_pieces(
                asset.asset_id, parts(asset.mesh_blob), known, config.pieces, context.caches["tasks.geometry.pieces"]
            )
    return pieces


@dataclasses.dataclass(frozen=True)
class _Rebuilt:
    """Convex pieces made anew from the GLBs, past every memory: asset and scale of each object, and the pieces that the
    other measures use. decomposed: assets whose meshes were cut. made: by asset, filled at need. own: objects whose pieces are theirs
    alone."""

    scene: BenchScene
    used: Mapping[str, tuple[str, tuple[float, ...]]]
    solids: Mapping[str, ConvexParts]
    config: OptimizationConfig
    decomposed: set[str]
    made: dict[str, Pieces | None]
    own: frozenset[str] = frozenset()

    def vertices(self, name: str) -> list[Array]:
        """Vertices of an object's pieces in its own frame [m], shape (n, 3) each."""
        asset_id, scale = self.used[name]
        if name in self.own:
            return [hull.vertices for hull in self.solids[name].hulls]
        if asset_id not in self.made:
            asset = next(row for row in self.scene.rows["assets"] if row.asset_id == asset_id)
            blobs, config = self.scene.blobs, self.config.pieces
            known = load_glb(blobs[asset.pieces_blob]) if asset.pieces_blob else None
            parts = load_glb(blobs[asset.mesh_blob])
            # cutting takes seconds, and is none of what is checked here
            self.made[asset_id] = None if asset_id in self.decomposed else pieces(parts, known, config)
        made = self.made[asset_id]
        if made is None:
            return [hull.vertices for hull in self.solids[name].hulls]
        return [hull.vertices * np.array(scale) for hull in made.hulls]


@dataclasses.dataclass(frozen=True)
class _Laboratory:
    """All that is needed to judge the states of one scene."""

    scene: BenchScene
    solids: Mapping[str, ConvexParts]
    categories: Mapping[str, str]
    measures: Measures
    colliders: Colliders
    shell: Sequence[ConvexParts]
    was_carried: Mapping[str, Carried]
    proposed: Mapping[str, Array]
    config: OptimizationConfig
    to_place: set[str]
    proposed_depths: Mapping[tuple[str, str], float]
    rebuilt: _Rebuilt

    def verdict(self, state: str, poses: Mapping[str, Array], fixed: set[str], outcome: Outcome | None, seconds: float) -> Verdict:
        """The verdict on one state: poses by name, which objects are fixed, and the stage's rows where it made the state."""
        free = tuple(name for name in self.solids if name not in fixed)
        pairs = [(p.a, p.b, p.depth_m) for p in self.colliders.penetrations(np.array([poses[name] for name in self.solids]))]
        room = {wall.name for wall in self.shell} | {FLOOR}
        deep = [pair for pair in pairs if pair[2] > DEEP_M]
        allowed = [p for p in deep if p[0] in fixed and p[1] in room and p[2] <= self.proposed_depths.get(p[:2], 0.0) + DEEP_M]
        moved_1cm, moved_5cm, moved_nudged = self._unstable(poses, fixed, outcome)
        posed = self.measures.at(poses)
        carriers = {name: posed.carriers(name) for name in self.solids}
        lost = self._lost(posed, carriers)
        reported = reported_losses(outcome, self.was_carried) if outcome is not None else set()
        said_outside = reported_outside(outcome) if outcome is not None else set()
        disagreeing, checked = self._disagreeing(pairs, poses, outcome) if outcome is not None else ((), 0)
        drawn_fixed = {name for name, c in self.was_carried.items() if c.relation in ("wall", "ceiling") or c.is_fitted}
        reaches = [(name, posed.reach_outside(name)) for name in free]
        outside = tuple((name, reach) for name, reach in reaches if reach > OUTSIDE_M)
        return Verdict(
            scene_id=self.scene.scene_id,
            state=state,
            objects=len(self.solids),
            free=free,
            unplaced=tuple(sorted(self.to_place - set(poses))) if outcome is not None else (),
            fixed_wrongly=tuple(sorted(fixed - drawn_fixed)) if self.scene.carried is not None else None,
            deep=tuple(pair for pair in deep if pair not in allowed),
            allowed=tuple(allowed),
            unstable_1cm=moved_1cm,
            unstable_5cm=moved_5cm,
            unstable_nudged=moved_nudged,
            laid_down=_moved_so(outcome, "laid_down"),
            fallen=_moved_so(outcome, "fallen"),
            displaced=tuple((name, float(np.hypot(*(poses[name] - self.proposed[name])[:2, 3]))) for name in self.solids),
            floating=tuple((name, carriers[name][1]) for name in free if carriers[name][1] > TOUCH_M),
            outside=outside,
            outside_silently=tuple(name for name, _ in outside if name not in said_outside),
            carried=len(self.was_carried),
            lost_reported=tuple(name for name in lost if name in reported),
            lost_silently=tuple(name for name in lost if name not in reported),
            misjudged=self._misjudged(outcome) if outcome is not None else None,
            disagreeing=disagreeing,
            depths_checked=checked,
            seconds=seconds,
        )

    def _unstable(
        self, poses: Mapping[str, Array], fixed: set[str], outcome: Outcome | None
    ) -> tuple[tuple[tuple[str, float, float], ...], ...]:
        """Free objects that do not stay within 1 cm, within 5 cm (and 5 degrees each), and after nudges: by the stage's own certificates
        of MuJoCo as it is shipped, where it made the state, else by one made here."""
        if outcome is not None:
            certificates = [(r.instance_id, r) for r in outcome.rows["certificates"]]
        else:
            bodies = [self._body(name, name in fixed) for name in self.solids]
            stacked = np.array([poses[name] for name in self.solids])
            certificates = [(c.name, c) for c in certify(bodies, stacked, self.shell, self.config.certificate)]
        free = [(name, c) for name, c in sorted(certificates, key=lambda f: f[0]) if name not in fixed and c.engine == "mujoco"]
        moved = [(name, _far(c.displacement_m), _far(c.tilt_radians), c) for name, c in free]
        missing = tuple((name, np.inf, np.inf) for name in self.solids if name not in fixed and name not in {n for n, _ in certificates})
        near = tuple((name, far, tilt) for name, far, tilt, c in moved if not c.is_stable_1cm) + missing
        far_off = tuple((name, far, tilt) for name, far, tilt, c in moved if not c.is_stable_5cm) + missing
        nudged = [(name, _far(c.nudged_displacement_m), _far(c.nudged_tilt_radians)) for name, c in free if c.is_stable_nudged is False]
        return near, far_off, (*nudged, *missing)

    def _body(self, name: str, is_fixed: bool) -> RigidBody:
        """A solid with the mass and friction of its caption."""
        solid, bodies = self.solids[name], self.config.bodies
        for caption in self.scene.rows["captions"]:
            if caption.instance_id == name:
                return RigidBody(solid, caption.mass_kg, caption.friction, caption.materials, is_fixed)
        return RigidBody(solid, max(bodies.density_kg_m3 * mass_properties(solid.hulls).volume, 0.001), bodies.friction, (), is_fixed)

    def _lost(self, posed: Posed, carriers: Mapping[str, tuple[set[str], float]]) -> list[str]:
        """Objects that are not carried any more by what carried them: measured at their poses, whatever the stage says."""
        lost = []
        for name, was in sorted(self.was_carried.items()):
            if name not in self.solids or self._is_let_in(name):
                continue
            if was.relation == "wall":
                held = posed.off_wall(name) <= OFF_WALL_M
            elif was.relation == "ceiling":
                held = posed.below_ceiling(name) <= OFF_WALL_M
            else:
                held = was.relation == "none" or (was.parent_id or FLOOR) in carriers[name][0]
            if not held:
                lost.append(name)
        return lost

    def _is_let_in(self, name: str) -> bool:
        from tasks.mounting import mounting

        return mounting(self.categories[name]).kind == "let_in"

    def _disagreeing(
        self, pairs: Sequence[tuple[str, str, float]], poses: Mapping[str, Array], outcome: Outcome
    ) -> tuple[tuple[tuple[str, str, float], ...], int]:
        """Pairs of which the rows of `contacts` say another depth than is measured here, the difference [m], and how many
        pairs of objects were measured by every axis."""
        rows = {(r.instance_a, r.body_b): r.penetration_m for r in outcome.rows["contacts"] if r.phase == "optimized"}
        walls = {wall.name: [hull.vertices for hull in wall.hulls] for wall in self.shell}
        disputed, checked = disagreeing(
            rows, list(self.solids.values()), self.shell, poses, lambda name: walls[name] if name in walls else self.rebuilt.vertices(name)
        )
        here = {(a, b) if b not in self.solids else (min(a, b), max(a, b)): depth for a, b, depth in pairs}
        wrong = {(a, b): difference for a, b, difference in disputed}
        for pair in {*here, *rows}:
            difference = abs(here.get(pair, 0.0) - rows.get(pair, 0.0))
            if difference > TOLERANCE_M:
                wrong.setdefault(pair, difference)
        return tuple((a, b, wrong[a, b]) for a, b in sorted(wrong)), checked

    def _misjudged(self, outcome: Outcome) -> tuple[str, ...] | None:
        """Objects for which the stage took another carrier than the one that they had when they were drawn."""
        if self.scene.carried is None:
            return None
        rugs = {name for name, category in self.categories.items() if "rug" in category}
        wrong = []
        for row in outcome.rows["supports"]:
            was = self.scene.carried[row.instance_id]
            parent = None if row.parent_id in rugs else row.parent_id
            hangs, hung = row.relation in ("wall", "ceiling"), was.relation in ("wall", "ceiling")
            if hangs != hung or (not hung and parent != was.parent_id):
                wrong.append(row.instance_id)
        return tuple(wrong)


def _moved_so(outcome: Outcome | None, how: str) -> tuple[str, ...]:
    """Objects that the optimization moved by steps of an outcome, by instance."""
    return tuple(sorted({row.instance_id for row in outcome.rows["optimization_steps"] if row.outcome == how})) if outcome else ()


def _far(value: float | None) -> float:
    """How far an object went; without an end where the engine could not simulate it."""
    return np.inf if value is None else value
