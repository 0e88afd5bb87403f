"""Rows of the optimization stage, from what was found."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.optimization import Contact, Optimization, Placement, Support
from tasks.geometry.boxes import aabb_overlaps
from tasks.geometry.transforms import flat
from tasks.optimization.certificates import Certified
from tasks.optimization.colliders.brackets import BRACKET
from tasks.optimization.contacts import Penetration
from tasks.optimization.interior import Interior
from tasks.optimization.search.collisions import plan_ring
from tasks.optimization.search.descent import TOUCH_M
from tasks.optimization.search.trace import Resolution
from tasks.optimization.support.boundary import outside_share
from tasks.optimization.support.resting import DEEP_M
from tasks.optimization.support.supports import Carrier, SupportConfig

Array = NDArray[np.float64]

ABOVE_M = 0.15
"""An object may reach this far above the ceiling [m]: its height is known no better."""

OUTSIDE = 0.05
"""Share of an object outside of the floor, seen from above, from which on it is said to be outside."""

TOPPLES = "it cannot stand so: its center of mass lies beyond what it stands on"
"""Said of what would tip too far, where an engine agrees."""

UPSIDE_DOWN = -0.5
"""Height of the tip of an object's upright axis below which it stands on its head; lying on its side it is at 0."""


def placement_rows(
    scene_id: str, interior: Interior, poses: Array, certified: Sequence[Certified], method: str, remains: Mapping[str, str],
    cut: Mapping[str, float], distances: Mapping[str, float], losses: Mapping[str, float],
) -> list[Placement]:  # fmt: skip
    """Placements, by instance. cut: shares of the volume of colliders that was cut away. distances: of colliders from what is seen
    [m]. losses: of F-scores. All three by instance."""
    settled = {row.name: row.settled_pose for row in certified if row.engine == "mujoco" and row.settled_pose is not None}
    rows = []
    for proposal, solid, pose in zip(interior.proposals, interior.solids, poses, strict=True):
        name = proposal.instance.instance_id
        moved = pose[:3, 3] - proposal.pose[:3, 3]
        rows.append(
            Placement(
                scene_id=scene_id,
                instance_id=name,
                asset_id=proposal.asset_id,
                origin=proposal.origin,
                annotator=proposal.annotator,
                annotation_match=proposal.annotation_match,
                scale=tuple(float(v) for v in proposal.scale),
                proposed_pose=flat(proposal.pose),
                optimized_pose=flat(pose),
                settled_pose=flat(settled[name]) if name in settled else None,
                displacement_m=float(np.hypot(moved[0], moved[1])),
                lift_m=float(moved[2]) + 0.0,
                method=method,
                remains=remains.get(name),
                collider_pieces=len(solid.hulls),
                collider_faces=sum(len(hull.faces) for hull in solid.hulls),
                collider_early_share=None if solid.shares is None else solid.shares.early,
                collider_miss_share=None if solid.shares is None else solid.shares.miss,
                collider_blob=solid.blob,
                collider_cut_share=cut.get(name, 0.0),
                collider_distance_m=distances.get(name),
                fidelity_loss=losses.get(name),
            )
        )
    return sorted(rows, key=lambda row: row.instance_id)


def support_rows(scene_id: str, interior: Interior, lost: Collection[str], proposed: Mapping[str, Carrier]) -> list[Support]:
    """What carries each object, by instance. `lost`: the objects that it carries no more at the optimized poses. proposed: what carried
    each before its collider was cut, by instance: how deep it sank."""
    brackets = {bracket.name.removeprefix(BRACKET): bracket.blob for bracket in interior.brackets}
    rows = [
        Support(
            scene_id=scene_id,
            instance_id=name,
            relation=carrier.relation,
            parent_id=carrier.parent_id,
            against=carrier.against,
            gap_m=(proposed[name].gap if proposed[name].parent_id == carrier.parent_id else carrier.gap) + carrier.reach,
            is_fixed=fixed,
            is_kept=name not in lost,
            is_inferred=carrier.is_inferred,
            bracket_blob=brackets.get(name),
        )
        for name, carrier, fixed in zip(interior.names, interior.carriers, interior.fixed.tolist(), strict=True)
    ]
    return sorted(rows, key=lambda row: row.instance_id)


def contact_rows(
    scene_id: str,
    interior: Interior,
    poses: Array,
    penetrations: Sequence[Penetration],
    phase: str,
    allowed: Mapping[tuple[str, str], float],
) -> list[Contact]:
    """Every pair whose boxes overlap or whose pieces penetrate, and what sticks in the room's shell, at poses (n, 4, 4).

    `allowed`: depths to which objects may be in parts of the room [m] (`allowed_depths`).
    """
    n, names = len(interior.objects), interior.names
    if not n:
        return []
    corners = [np.concatenate([hull.vertices for hull in solid.placed(pose)]) for solid, pose in zip(interior.solids, poses, strict=True)]
    low, high = np.array([c.min(axis=0) for c in corners]), np.array([c.max(axis=0) for c in corners])
    volumes = aabb_overlaps(low, high)
    sides = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None])
    deep = {(p.a, p.b): p.depth_m for p in penetrations}
    boxes = {(names[i], names[j]): float(volumes[i, j]) for i, j in np.argwhere(np.triu((sides > TOUCH_M).all(axis=2), 1)).tolist()}
    known = set(names)
    rows = []
    for a, b in {*deep, *boxes}:
        is_room = b not in known
        first, second = (a, b) if is_room else sorted((a, b))
        rows.append(
            Contact(
                scene_id=scene_id,
                phase=phase,
                instance_a=first,
                body_b=second,
                box_overlap_m3=boxes.get((a, b), 0.0),
                penetration_m=deep.get((a, b), 0.0),
                is_allowed=deep.get((a, b), 0.0) <= allowed.get((a, b), -1.0) + DEEP_M,
            )
        )
    return sorted(rows, key=lambda row: (row.instance_a, row.body_b))


def allowed_depths(interior: Interior, before: Sequence[Penetration]) -> dict[tuple[str, str], float]:
    """How deep fixed objects, which hang or are built in, were in parts of the room as proposed [m], by (object, part).

    So deep they may stay: they are let into a wall or set against it, and the room's shell is only an estimate. Two of them, or one of them
    and a bracket, may be in each other: neither ever moves.
    """
    known = set(interior.names)
    fixed = {name for name, is_fixed in zip(interior.names, interior.fixed, strict=True) if is_fixed}
    let_in = {(p.a, p.b): p.depth_m for p in before if p.a in fixed and p.b not in known}
    unmoved = fixed | {bracket.name for bracket in interior.brackets}
    return let_in | {(a, b): np.inf for a in fixed for b in unmoved if a != b}


def remains_of(
    interior: Interior, poses: Array, after: Sequence[Penetration], resolution: Resolution, lost: Collection[str],
    allowed: Mapping[tuple[str, str], float], certified: Sequence[Certified],
) -> dict[str, str]:  # fmt: skip
    """What is still wrong with objects at their optimized poses, by instance, one line each.

    All are among them that an engine found unstable or could not simulate.
    """
    fixed = {name for name, is_fixed in zip(interior.names, interior.fixed, strict=True) if is_fixed}
    known = set(interior.names)
    lines: dict[str, list[str]] = {name: [] for name in interior.names}
    restless = {row.name for row in certified if not (row.is_stable_1cm and row.is_stable_5cm and row.is_stable_nudged is not False)}
    for name, text in resolution.problems.items():
        if text != TOPPLES or name in restless:  # an engine knows better
            lines[name].append(text)
    for name in sorted(set(lost) - set(resolution.problems)):
        lines[name].append("what carried it carries it no more")
    for i, (name, carrier) in enumerate(zip(interior.names, interior.carriers, strict=True)):
        if interior.proposals[i].pose[2, 2] < UPSIDE_DOWN:
            lines[name].append("it stands upside down, as it was proposed")
        if carrier.relation == "none" and not carrier.is_inferred:
            held = ", held there: nobody knows by what" if name in fixed else ""
            lines[name].append(f"nothing carries it; it hangs {carrier.gap:.2f} m above the floor{held}")
    for penetration in sorted(after, key=lambda p: -p.depth_m):
        if penetration.depth_m > DEEP_M and penetration.depth_m > allowed.get((penetration.a, penetration.b), -1.0) + DEEP_M:
            lines[penetration.a].append(f"{100 * penetration.depth_m:.1f} cm in {penetration.b}")
            if penetration.b in known:
                lines[penetration.b].append(f"{100 * penetration.depth_m:.1f} cm in {penetration.a}")
    if interior.ring is not None and interior.shell:
        for i, (obj, solid) in enumerate(zip(interior.objects, interior.solids, strict=True)):
            if obj.instance_id in fixed:
                continue
            ring = plan_ring(np.concatenate([hull.vertices for hull in solid.placed(poses[i])])[:, :2])
            share = outside_share(ring, interior.ring)
            if share > OUTSIDE:
                lines[obj.instance_id].append(f"{100 * share:.0f} % of it lies outside of the room")
    if interior.room is not None:
        for i, solid in enumerate(interior.solids):
            top = max(float(hull.vertices[:, 2].max()) for hull in solid.placed(poses[i]))
            if top > interior.room.height_m + ABOVE_M and solid.name not in fixed:
                lines[solid.name].append(f"it reaches {top - interior.room.height_m:.2f} m above the ceiling")
    for certificate in certified:
        if certificate.problem is not None:
            lines[certificate.name].append(f"no certificate: {certificate.problem}")
        elif not (certificate.is_stable_1cm and certificate.is_stable_5cm):
            moved, tilted = 100 * (certificate.displacement_m or 0.0), np.degrees(certificate.tilt_radians or 0.0)
            lines[certificate.name].append(
                f"left alone it moves by {moved:.1f} cm and tilts by {tilted:.1f} degrees ({certificate.engine})"
            )
        elif certificate.is_stable_nudged is False:
            moved, tilted = 100 * (certificate.nudged_displacement_m or 0.0), np.degrees(certificate.nudged_tilt_radians or 0.0)
            lines[certificate.name].append(
                f"after a nudge it moves by {moved:.1f} cm and tilts by {tilted:.1f} degrees ({certificate.engine})"
            )
    return {name: "; ".join(texts) for name, texts in sorted(lines.items()) if texts}


def set_down(interior: Interior, config: SupportConfig) -> list[str]:
    """Objects that nothing carried within reach and that were set down onto what lies below them, or whose colliders reach down to that, a
    line each."""
    notes = []
    for name, carrier in zip(interior.names, interior.carriers, strict=True):
        if carrier.relation == "none" and carrier.is_inferred:
            notes.append(f"{name}: nothing carried it; a bracket at {carrier.against}, in colliders alone, does")
        if carrier.relation not in ("floor", "on", "inside"):
            continue
        onto = carrier.parent_id or "the floor"
        if carrier.gap > config.reach_m:
            notes.append(f"{name}: nothing carried it; it was set down {carrier.gap:.2f} m onto {onto}")
        if carrier.reach > config.reach_m:
            notes.append(f"{name}: nothing carried it; its collider reaches {carrier.reach:.2f} m down to {onto}")
    return sorted(notes)


def optimization_row(
    scene_id: str, interior: Interior, resolution: Resolution, contacts: Sequence[Contact], method: str, remains: Mapping[str, str],
    left_out: Sequence[str],
) -> Optimization:  # fmt: skip
    """The row of `optimizations`."""
    return Optimization(
        scene_id=scene_id,
        method=method,
        object_count=len(interior.objects),
        loss_start=resolution.start,
        loss_final=resolution.final,
        moves=resolution.tried,
        chains=resolution.chains,
        ended=resolution.ended,
        fixed_count=int(interior.fixed.sum()),
        deep_pairs=sum(c.phase == "optimized" and c.penetration_m > DEEP_M and not c.is_allowed for c in contacts),
        remains=(*left_out, *(f"{name}: {text}" for name, text in remains.items())),
    )
