"""Optimization: the asset of every instance, at rest on what carries it, moved until nothing collides, and certified."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.optimization import APPLIED, OptimizationStep
from schemas.selection import Selection
from tasks.geometry.meshes import read_points
from tasks.geometry.pieces import PieceConfig
from tasks.mounting import LEANS
from tasks.optimization import default, paper, released
from tasks.optimization.bodies import BodyConfig, bodies_of
from tasks.optimization.certificates import CertificateConfig, Certified, certificate_rows, certify
from tasks.optimization.clearance import keep_clear
from tasks.optimization.colliders.distances import collider_distances
from tasks.optimization.colliders.seams import CLEAR_M, SEAM_M, Seams, cut_at_seams, with_stored_colliders
from tasks.optimization.colliders.shoring import with_plates
from tasks.optimization.contacts import Colliders, Penetration
from tasks.optimization.coverings import cut_at_walls
from tasks.optimization.default import Default, poses_at_rest, tipping_at_rest, walls_of
from tasks.optimization.falling import let_fall
from tasks.optimization.footing import NOTE as FOOTING_NOTE
from tasks.optimization.footing import on_their_feet
from tasks.optimization.interior import Interior, cut_proposed, furnish
from tasks.optimization.losses import MOST_LOSS, fidelity_losses
from tasks.optimization.misfits import fit_together
from tasks.optimization.paper import Paper
from tasks.optimization.parting import part_slight
from tasks.optimization.proposals import propose
from tasks.optimization.released import Released
from tasks.optimization.rows import allowed_depths, contact_rows, optimization_row, placement_rows, remains_of, set_down, support_rows
from tasks.optimization.search.collisions import MOVES, OUTCOMES
from tasks.optimization.search.trace import Move, Resolution, moved_poses, replayed_poses, step_rows, with_falls, with_shifts
from tasks.optimization.solids import RigidBody
from tasks.optimization.support.leaning import lean_of_points
from tasks.optimization.support.resting import DEEP_M, lost_supports
from tasks.optimization.support.supports import SupportConfig
from tasks.settings import ByKind, Config, NonNegative
from tasks.stage import Blobs, Context, Outcome, Stage

__all__ = ["MOVES", "OUTCOMES", "STAGE", "Default", "OptimizationConfig", "Paper", "Released", "SupportConfig", "replayed_poses", "run"]

Method = Annotated[Paper | Released | Default, ByKind()]
"""How collisions are resolved: a union of frozen configs, matched by type."""


@dataclasses.dataclass(frozen=True)
class OptimizationConfig(Config):
    """How assets are put to rest and apart."""

    method: Method = dataclasses.field(default_factory=Default)  # no pair of the benchmark stays deeper than 2 mm
    misfit_m: NonNegative = 0.02  # deeper, and another asset that fits its object as well is taken, if it leaves the other its place
    supports: SupportConfig = dataclasses.field(default_factory=SupportConfig)
    pieces: PieceConfig = dataclasses.field(default_factory=PieceConfig)
    bodies: BodyConfig = dataclasses.field(default_factory=BodyConfig)
    certificate: CertificateConfig = dataclasses.field(default_factory=CertificateConfig)


def run(
    *,
    instances: Sequence[Instance],
    captions: Sequence[Caption],
    selections: Sequence[Selection],
    shells: Sequence[Shell],
    assets: Sequence[Asset],
    annotations: Sequence[Annotation],
    context: Context,
    config: OptimizationConfig,
) -> Outcome:
    """Placements of a scene, what carries each, what touches before and after, every step between, and certificates.

    Each instance's asset is the winning annotation's, else the selection's first that leaves its neighbors their place. It is
    put to rest on what carries it, within reach of where it was scanned; then collisions are resolved; then another engine
    says what stays, and small things that do not are put where it saw them come to rest. Instances for which nothing can be
    placed, orphaned annotations and what could not be put right are said.
    """
    known = {asset.asset_id: asset for asset in assets}
    proposals, notes = propose(instances, selections, annotations, known)
    proposed, (points, pointless) = proposals, _scanned(instances, context.blobs)
    room = shells[0] if shells else None
    cut_proposed(proposals, known, context.blobs, config.pieces, context.caches, context.spread)
    is_default = isinstance(config.method, Default)
    leans = {name: lean_of_points(scanned, np.ones(len(scanned))) for name, scanned in points.items()}
    placed = (known, context.blobs, room, config.supports, config.pieces, context.caches, is_default, leans)
    deepest = config.misfit_m if is_default else np.inf  # the other methods move what they were given
    notable: dict[str, tuple[str, str]] = {}
    blobs = Blobs()
    usable = list(selections)
    if isinstance(config.method, Default):
        alone = (known, context.blobs, None, config.supports, config.pieces, context.caches)
        tilt = config.method.most_tilt_radians
        proposals, fallen = on_their_feet(proposals, selections, known, lambda some: furnish(some, *alone), tilt)
        usable = [row for row in selections if row.asset_id not in fallen.get(row.instance_id, ())]
        proposals, cut = cut_at_walls(proposals, known, room)
        reasons = dict.fromkeys(fallen, FOOTING_NOTE) | cut
        notable = {
            p.instance.instance_id: (p.asset_id, reasons[p.instance.instance_id]) for p in proposals if p.instance.instance_id in reasons
        }
    fitting = fit_together(proposals, usable, known, deepest, config.supports.reach_m, lambda some: furnish(some, *placed))
    interior = fitting.interior
    notes += fitting.left_out
    cut_shares: Mapping[str, float] = {}
    if not isinstance(config.method, Default):
        resolved = _resolved(interior, config, context)
    else:
        resolved, cut_shares = _beside_each_other(interior, points, config.method, config, context, blobs)
    resolution, interior, poses, before, after, steps = resolved
    scene_id, word = context.scene_id, config.method.kind
    bodies, unknown = bodies_of(interior, captions, config.bodies)
    certified, allowed = certify(bodies, poses, interior.shell, config.certificate, context.spread), allowed_depths(interior, before)
    if isinstance(config.method, Default):
        shored = _shored(interior, poses, bodies, certified, after, allowed, config, context, blobs)
        interior, bodies, certified, after = shored
    if isinstance(config.method, Default) and config.method.lets_fall:
        fall = let_fall(interior, poses, certified, bodies, allowed, config.method, config.certificate, context.spread)
        poses, certified = fall.poses, fall.certified
        if fall.moves:
            after = Colliders(interior.solids, interior.shell).penetrations(poses)
            left = sum(p.depth_m for p in after if p.depth_m > config.method.slop_m + allowed.get((p.a, p.b), 0.0))
            resolution = with_falls(resolution, fall.moves, min(resolution.final, left))
            steps = step_rows(scene_id, resolution.start, resolution.steps)
    final = {p.instance.instance_id: p.asset_id for p in interior.proposals}
    changed = [f"{name}: {text}" for name, (asset_id, text) in notable.items() if final.get(name) == asset_id]
    losses = fidelity_losses(points, proposed, interior.proposals, poses, known, context.blobs, context.caches)
    distances = collider_distances(interior, poses, known, context.blobs, context.caches)
    lost = lost_supports(interior, poses)
    remains = remains_of(interior, poses, after, resolution, lost, allowed, certified)
    whole = fitting.interior  # as it was proposed, before colliders were cut
    met = Colliders(whole.solids, whole.shell).penetrations(whole.poses)
    contacts = contact_rows(scene_id, whole, whole.poses, met, "proposed", allowed_depths(whole, met))
    contacts += contact_rows(scene_id, interior, poses, after, "optimized", allowed)
    undone = [*notes, *resolution.notes]
    unknown += pointless if isinstance(config.method, Default) else []
    notes = [*undone, *fitting.notes, *changed, *unknown, *resolution.noted, *set_down(interior, config.supports)]
    notes += [f"{name}: {text}" for name, text in remains.items()]
    notes += [f"{name}: it covers its scan less well by {loss:.2f} of its F-score" for name, loss in losses.items() if loss > MOST_LOSS]
    return Outcome(
        placements=placement_rows(scene_id, interior, poses, certified, word, remains, cut_shares, distances, losses),
        supports=support_rows(scene_id, interior, lost, dict(zip(whole.names, whole.carriers, strict=True))),
        contacts=contacts,
        optimization_steps=steps,
        optimizations=[optimization_row(scene_id, interior, resolution, contacts, word, remains, undone)],
        certificates=certificate_rows(scene_id, certified),
        blobs=blobs,
        degradations=notes,
    )


class _Resolved(NamedTuple):
    """What a method made of an interior: its steps as rows, poses in the end, shape (n, 4, 4), penetrations before and after."""

    resolution: Resolution
    interior: Interior
    poses: NDArray[np.float64]
    before: list[Penetration]
    after: list[Penetration]
    steps: list[OptimizationStep]


def _scanned(instances: Sequence[Instance], blobs: Mapping[str, bytes]) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Scanned points of instances in the world frame, shape (n, 3) [m], by instance, and whose points cannot be read, a line each."""
    points: dict[str, NDArray[np.float64]] = {}
    notes = []
    for row in sorted(instances, key=lambda each: each.instance_id):
        if row.is_structure:
            continue
        try:
            points[row.instance_id] = read_points(blobs[row.points_blob], row.points_blob)[0]
        except (InputError, KeyError) as error:
            why = f"blob {error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
            notes.append(f"{row.instance_id}: its neighbors keep the space that they share with it: its points cannot be read: {why}")
    return points, notes


def _beside_each_other(
    interior: Interior, points: Mapping[str, NDArray[np.float64]], method: Default,
    config: OptimizationConfig, context: Context, blobs: Blobs,
) -> tuple[_Resolved, Mapping[str, float]]:  # fmt: skip
    """The interior resolved with colliders that end at seams, and the shares of them that were cut away, by instance: only where objects
    are deep in each other, else wherever they are, and if that does not help, what is stuck is put anywhere.

    points: as for `cut_at_seams`.
    """
    supports = config.supports
    tries: list[tuple[_Resolved, Seams]] = []
    for deepest in (SEAM_M, DEEP_M):
        seams = cut_at_seams(interior, points, walls_of(interior), lambda some: poses_at_rest(some, supports), deepest)
        steady = _steadied(seams.interior, method, supports)
        stored = dataclasses.replace(seams, interior=with_stored_colliders(steady, blobs))
        tries.append((_resolved(stored.interior, config, context), stored))
        if not _stuck(tries[-1][0]):
            break
    resolved, seams = min(tries, key=lambda each: _stuck_depth(each[0]))
    if names := {name for pair in _stuck(resolved) for name in (pair.a, pair.b)}:
        resolved = min(resolved, _resolved(seams.interior, config, context, names), key=_stuck_depth)
    return resolved, seams.shares


def _steadied(interior: Interior, method: Default, supports: SupportConfig) -> Interior:
    """The interior with plates under what would tip where it comes to rest, but for what may lean."""
    wanted = [
        i for i in tipping_at_rest(interior, method, supports) if interior.objects[i].category not in LEANS and not interior.fixed[i]
    ]  # fmt: skip
    return with_plates(interior, poses_at_rest(interior, supports), wanted, CLEAR_M)[0] if wanted else interior


def _shored(
    interior: Interior, poses: NDArray[np.float64], bodies: list[RigidBody], certified: list[Certified], after: list[Penetration],
    allowed: Mapping[tuple[str, str], float], config: OptimizationConfig, context: Context, blobs: Blobs,
) -> tuple[Interior, list[RigidBody], list[Certified], list[Penetration]]:  # fmt: skip
    """The interior at `poses`, shape (n, 4, 4) [m], its bodies, certificates and penetrations, with plates under objects that do not stay,
    if more of them stay then and no pair gets deep. allowed: depths to which pairs may be in each other [m]."""
    restless = {row.name for row in certified if not (row.is_stable_1cm and row.is_stable_5cm)}
    standing = [carrier.relation in ("floor", "on", "inside") for carrier in interior.carriers]
    wanted = [i for i, name in enumerate(interior.names) if name in restless and standing[i] and not interior.fixed[i]]
    changed, plated = with_plates(interior, poses, wanted, CLEAR_M)
    if not plated:
        return interior, bodies, certified, after
    changed = with_stored_colliders(changed, blobs)
    heavier = [dataclasses.replace(body, solid=solid) for body, solid in zip(bodies, changed.solids, strict=True)]
    met = Colliders(changed.solids, changed.shell).penetrations(poses)
    if len(_deep(met, allowed)) > len(_deep(after, allowed)):
        return interior, bodies, certified, after
    later = certify(heavier, poses, interior.shell, config.certificate, context.spread)
    still = {row.name for row in later if not (row.is_stable_1cm and row.is_stable_5cm)}
    return (changed, heavier, later, met) if len(still) < len(restless) else (interior, bodies, certified, after)


def _stuck_depth(resolved: _Resolved) -> float:
    """Sum of the depths at which objects are still in others [m]."""
    return round(sum(p.depth_m for p in _stuck(resolved)), 6)


def _stuck(resolved: _Resolved) -> list[Penetration]:
    """Penetrations that are still deep in the end."""
    return _deep(resolved.after, allowed_depths(resolved.interior, resolved.before))


def _deep(penetrations: Sequence[Penetration], allowed: Mapping[tuple[str, str], float]) -> list[Penetration]:
    """Penetrations deeper than `DEEP_M` beyond what is allowed [m]."""
    return [p for p in penetrations if p.depth_m > DEEP_M + allowed.get((p.a, p.b), 0.0)]


def _resolved(interior: Interior, config: OptimizationConfig, context: Context, anywhere: Collection[str] = ()) -> _Resolved:
    match config.method:
        case Paper() as method:
            resolution = paper.resolve(interior, method, context.rng)
        case Released() as method:
            resolution = released.resolve(interior, method, config.supports, context.rng)
        case Default() as method:
            resolution = default.resolve(interior, method, config.supports, context.rng, context.spread, anywhere=anywhere)
    interior = resolution.interior or interior
    moves = [(step.name, step.move) for step in resolution.steps if step.outcome in APPLIED]
    poses = _moved(interior, moves)
    colliders = Colliders(interior.solids, interior.shell)
    before, after = colliders.penetrations(interior.poses), colliders.penetrations(poses)
    if isinstance(config.method, Default):
        parted = part_slight(interior, poses, after, allowed_depths(interior, before), config.method.slop_m)
        for shifts in (parted, keep_clear(interior, _moved(interior, [*moves, *parted]), config.method.slop_m)):
            if shifts:
                resolution, moves = with_shifts(resolution, shifts), [*moves, *shifts]
                poses = _moved(interior, moves)
                after = colliders.penetrations(poses)
    steps = step_rows(context.scene_id, resolution.start, resolution.steps)
    return _Resolved(resolution, interior, poses, before, after, steps)


def _moved(interior: Interior, moves: Sequence[tuple[str, Move]]) -> NDArray[np.float64]:
    """Poses [m], shape (n, 4, 4), after moves from where things were proposed."""
    parents = {name: carrier.parent_id for name, carrier in zip(interior.names, interior.carriers, strict=True)}
    moved = moved_poses(dict(zip(interior.names, interior.poses, strict=True)), parents, moves)
    return np.array([moved[name] for name in interior.names]).reshape(-1, 4, 4)


STAGE = Stage(
    name="optimization",
    reads=("instances", "captions", "selections", "shells", "assets"),
    writes=("placements", "supports", "contacts", "optimization_steps", "optimizations", "certificates"),
    config=OptimizationConfig,
    run=run,
    history=("annotations",),
)
