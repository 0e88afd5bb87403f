"""Optimization: the asset of every instance, resting on what carries it, moved until as little as possible collides."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.capture import Instance, Room
from schemas.errors import InputError
from schemas.optimization import Contact, OptimizationStep, Placement, Support
from schemas.selection import Selection
from tasks.boxes import aabb_overlaps, aabb_penetrations
from tasks.meshes import load_glb, surface_of
from tasks.optimization.collisions import MOVES, OUTCOMES, Crowd, Trace, collision_loss, descend, outline, room_triangles, stacked
from tasks.optimization.descent import TOUCH_M
from tasks.optimization.proposals import Proposal, propose
from tasks.optimization.supports import Carrier, PlacedAsset, SupportConfig, allowed_shifts, descendants, find_carriers, is_floor_covering
from tasks.replica import floor_ring, interior_footprints
from tasks.stage import Context, Outcome, Stage
from tasks.transforms import flat, translation

__all__ = ["MOVES", "OUTCOMES", "STAGE", "OptimizationConfig", "Paper", "SupportConfig", "collision_loss", "replay", "run"]


@dataclasses.dataclass(frozen=True)
class Paper:
    """Algorithm 1 of the supplementary: one thing, one of four directions, 5 cm, kept when the loss falls.

    As printed: the loss is the volume in which the axis-aligned boxes of two assets overlap, summed over all pairs;
    a random thing is moved along x or y; a move out of the room is undone; a move that does not bring the loss below
    the smallest so far is undone; it ends at a loss of zero or after a number of steps.

    Where the text leaves room, or the result would float, our reading:

    - Walls, floor and ceiling take no part. What hangs on them counts in the loss but is not moved: off its wall it
      would hang in the air.
    - What stands on or in another thing does not collide with that thing: the box of a shelf holds its books. Nor does
      anything collide with a rug, which stays where it is.
    - What a thing carries moves along with it. A carried thing may move on its carrier, not off it.
    - A thing that reaches out of the room from the start (rooms are estimated) may move unless more of it gets outside.
    - The loop also ends once every possible move was tried since the last kept one. It changes nothing but the time.
    """

    step_m: float = 0.05  # as printed
    max_steps: int = 10_000  # the loop ends itself long before, when no move helps; 40 things need about 5000
    shift_reach: int = 12  # steps that a carried thing may stray on its carrier: 60 cm, most of a desk's depth

    def __post_init__(self) -> None:
        if not 0 < self.step_m < math.inf:
            raise ValueError(f"step_m: must be above 0, is {self.step_m:g}")
        for name in ("max_steps", "shift_reach"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: must be at least 0, is {getattr(self, name)}")


Method = Paper
"""How collisions are resolved: a union of frozen configs, matched by type."""


@dataclasses.dataclass(frozen=True)
class OptimizationConfig:
    """How assets are put to rest and apart."""

    method: Method = Paper()
    supports: SupportConfig = dataclasses.field(default_factory=SupportConfig)


def run(
    *,
    instances: Sequence[Instance],
    selections: Sequence[Selection],
    rooms: Sequence[Room],
    assets: Sequence[Asset],
    annotations: Sequence[Annotation],
    context: Context,
    config: OptimizationConfig,
) -> Outcome:
    """Placements of a scene, what carries each, which pairs touch before and after, and every step between.

    Each instance's asset is the winning annotation's, else the selection's first. It is put to rest on what carries
    it, within reach of where it was scanned; then collisions are resolved. Step 0 is the state at rest, before any
    move. Instances for which nothing can be placed, orphaned annotations and what collision is left are said.
    """
    known = {asset.asset_id: asset for asset in assets}
    proposals, said = propose(instances, selections, annotations, known)
    placed, kept, unreadable = _placed(proposals, known, context)
    room = rooms[0] if rooms else None
    carriers = find_carriers(placed, room, config.supports)
    said += unreadable + [f"{name}: nothing carries it; it is left hanging {c.gap:.2f} m above the floor" for name, c in carriers.items()
                          if c.relation == "none"]  # fmt: skip
    said += [f"{name}: nothing carried it; it was set down {c.gap:.2f} m onto the floor" for name, c in carriers.items()
             if c.relation == "floor" and c.gap > config.supports.reach_m]  # fmt: skip
    crowd, problem = _crowd(placed, carriers, room, config)
    said += [problem] if problem else []
    match config.method:
        case Paper(step_m=step, max_steps=max_steps):
            trace = descend(crowd, step, max_steps, context.rng("moves"))
            offsets, method = trace.moved * step, "paper"
    if trace.final > 0:
        why = "no single move lowers it" if trace.exhausted else f"{len(trace.loss)} steps were not enough"
        said.append(f"collision loss {trace.final:.3g} m3 of {trace.start:.3g} m3 is left: {why}")
    lifts = np.array([carriers[p.instance_id].lift for p in placed])
    scene_id = context.scene_id
    low, high = (np.array([getattr(p, side) for p in placed]).reshape(-1, 3) for side in ("low", "high"))
    moved = np.column_stack([offsets, lifts]) if len(placed) else np.zeros((0, 3))
    names = [p.instance_id for p in placed]
    return Outcome(
        placements=[_placement(p, m, scene_id, method) for p, m in zip(kept, moved, strict=True)],
        supports=[_support(scene_id, name, carriers[name]) for name in names],
        contacts=_contacts(scene_id, names, "proposed", low, high) + _contacts(scene_id, names, "optimized", low + moved, high + moved),
        optimization_steps=_steps(scene_id, names, trace, step),
        degradations=said,
    )


STAGE = Stage(
    name="optimization",
    reads=("instances", "selections", "rooms", "assets"),
    writes=("placements", "supports", "contacts", "optimization_steps"),
    config=OptimizationConfig,
    run=run,
    history=("annotations",),
)


def replay(
    placements: Sequence[Placement], supports: Sequence[Support], steps: Sequence[OptimizationStep]
) -> dict[str, NDArray[np.float64]]:
    """Optimized poses [m], 4x4 by instance id, from the proposed ones, the lifts and the kept moves; what a thing
    carries moves along."""
    below = descendants({row.instance_id: row.parent_id for row in supports})
    offsets = {row.instance_id: np.array([0.0, 0.0, row.lift_m]) for row in placements}
    for row in sorted(steps, key=lambda s: s.step):
        if row.outcome == "kept" and row.instance_id is not None:
            for name in (row.instance_id, *below[row.instance_id]):
                offsets[name] += [row.dx_m, row.dy_m, 0.0]
    return {row.instance_id: translation(offsets[row.instance_id]) @ np.reshape(row.proposed_pose, (4, 4)) for row in placements}


def _placed(
    proposals: Sequence[Proposal], assets: Mapping[str, Asset], context: Context
) -> tuple[list[PlacedAsset], list[Proposal], list[str]]:
    """Surfaces of the proposed assets in the world frame, the proposals that they belong to, and what cannot be read."""
    placed: list[PlacedAsset] = []
    kept: list[Proposal] = []
    unreadable: list[str] = []
    for proposal in proposals:
        blob = assets[proposal.asset_id].mesh_blob
        try:
            surface = surface_of(load_glb(context.blobs[blob], blob)).transformed(proposal.pose, proposal.scale)
        except (InputError, KeyError) as error:
            unreadable.append(
                f"{proposal.instance.instance_id}: nothing stands for it: asset {proposal.asset_id[:12]} cannot be read: {error}"
            )
            continue
        instance, watertight = proposal.instance, assets[proposal.asset_id].is_watertight
        placed.append(PlacedAsset.of(instance.instance_id, instance.category, surface, watertight))
        kept.append(proposal)
    return placed, kept, unreadable


def _crowd(
    placed: Sequence[PlacedAsset], carriers: Mapping[str, Carrier], room: Room | None, config: OptimizationConfig
) -> tuple[Crowd, str | None]:
    """The boxes at rest, which pairs of them count, and what limits their moves; and what is wrong with the room."""
    n, reach = len(placed), config.method.shift_reach
    index = {p.instance_id: i for i, p in enumerate(placed)}
    below = descendants({name: c.parent_id for name, c in carriers.items()})
    carries = np.eye(n, dtype=np.bool_)
    for name, others in below.items():
        carries[index[name], [index[o] for o in others]] = True
    covering = np.array([is_floor_covering(p, config.supports) for p in placed], dtype=np.bool_)
    counted = ~(carries | carries.T | covering[:, None] | covering[None])
    carrier = np.full(n, -1, dtype=np.int64)
    shifts = np.zeros((n, 2 * reach + 1, 2 * reach + 1), dtype=np.bool_)
    for i, thing in enumerate(placed):
        parent = carriers[thing.instance_id].parent_id
        if parent is not None:
            carrier[i] = index[parent]
            gap = carriers[thing.instance_id].gap
            shifts[i] = allowed_shifts(thing, placed[carrier[i]], gap, config.method.step_m, reach, config.supports)
    lifts = np.array([[0.0, 0.0, carriers[p.instance_id].lift] for p in placed]).reshape(-1, 3)
    outlines, corners = stacked([outline(p.surface.vertices[np.unique(p.surface.faces), :2]) for p in placed])
    floor, problem = np.zeros((0, 3, 2)), "no room is known: nothing keeps the assets inside it"
    if room is not None:
        try:
            floor, problem = room_triangles(floor_ring(room), interior_footprints(room)), ""
        except InputError as error:
            problem = f"nothing keeps the assets inside the room: {error}"
    crowd = Crowd(
        low=np.array([p.low for p in placed]).reshape(-1, 3) + lifts,
        high=np.array([p.high for p in placed]).reshape(-1, 3) + lifts,
        counted=counted,
        movable=np.array([carriers[p.instance_id].relation not in ("wall", "ceiling") for p in placed], dtype=np.bool_) & ~covering,
        carries=carries,
        outlines=outlines,
        corners=corners,
        room=floor,
        carrier=carrier,
        shifts=shifts,
    )
    return crowd, problem or None


def _placement(proposal: Proposal, moved: NDArray[np.float64], scene_id: str, method: str) -> Placement:
    """The row of a proposal that was moved by `moved` [m], shape (3,)."""
    return Placement(
        scene_id=scene_id,
        instance_id=proposal.instance.instance_id,
        asset_id=proposal.asset_id,
        origin=proposal.origin,
        annotator=proposal.annotator,
        annotation_match=proposal.annotation_match,
        scale=tuple(float(v) for v in proposal.scale),
        proposed_pose=flat(proposal.pose),
        optimized_pose=flat(translation(moved) @ proposal.pose),
        settled_pose=None,
        displacement_m=float(np.hypot(moved[0], moved[1])),
        lift_m=float(moved[2]) + 0.0,
        method=method,
        remains=None,
    )


def _support(scene_id: str, name: str, carrier: Carrier) -> Support:
    return Support(
        scene_id=scene_id,
        instance_id=name,
        relation=carrier.relation,
        parent_id=carrier.parent_id,
        against=None,
        gap_m=carrier.gap + 0.0,
        is_fixed=carrier.relation in ("wall", "ceiling"),
        is_kept=True,
    )


def _contacts(scene_id: str, names: Sequence[str], phase: str, low: NDArray[np.float64], high: NDArray[np.float64]) -> list[Contact]:
    """Every pair of boxes that overlap, carried things and their carriers among them. Corners: shape (n, 3)."""
    if not names:
        return []
    volumes, depths = aabb_overlaps(low, high), aabb_penetrations(low, high)
    pairs = [(i, j) for i, j in np.argwhere(np.triu(depths > TOUCH_M, 1)).tolist()]
    return [
        Contact(
            scene_id=scene_id,
            phase=phase,
            instance_a=names[i],
            body_b=names[j],
            box_overlap_m3=float(volumes[i, j]),
            penetration_m=float(depths[i, j]),
            is_allowed=False,
        )
        for i, j in pairs
    ]


def _steps(scene_id: str, names: Sequence[str], trace: Trace, step: float) -> list[OptimizationStep]:
    """One row per step of the algorithm, and step 0 for the state at rest."""
    start = OptimizationStep(
        scene_id=scene_id, step=0, instance_id=None, dx_m=0.0, dy_m=0.0, dz_m=0.0, dyaw_radians=0.0, loss=trace.start, smallest_loss=trace.start, outcome=OUTCOMES[0]
    )
    columns = (trace.things.tolist(), (trace.moves * step).tolist(), trace.loss.tolist(), trace.smallest.tolist(), trace.outcome.tolist())
    rows = zip(*columns, strict=True)
    return [start] + [
        OptimizationStep(
            scene_id=scene_id,
            step=number,
            instance_id=names[thing],
            dx_m=dx + 0.0,
            dy_m=dy + 0.0,
            dz_m=0.0,
            dyaw_radians=0.0,
            loss=loss,
            smallest_loss=smallest,
            outcome=OUTCOMES[code],
        )
        for number, (thing, (dx, dy), loss, smallest, code) in enumerate(rows, start=1)
    ]
