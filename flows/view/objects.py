"""What the page is told of an object: what it is, what stands for it and why, what could, and how it stands."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from schemas.fidelity import Fidelity
from schemas.lineage.licenses import of_asset
from schemas.optimization import Certificate, Placement, Support
from schemas.selection import Selection
from schemas.wording import noun
from tasks.lineage.words import UNRECORDED, number, scaled

Facts = list[list[str]]
"""Names and values, as they are shown."""

R = TypeVar("R")


@dataclasses.dataclass(frozen=True)
class ObjectRows:
    """Rows of a scene that tell of its objects; `scans`: license of each scan."""

    instances: Sequence[Instance]
    captions: Sequence[Caption]
    candidates: Sequence[Candidate]
    selections: Sequence[Selection]
    placements: Sequence[Placement]
    supports: Sequence[Support]
    certificates: Sequence[Certificate]
    fidelity: Sequence[Fidelity]
    assets: Sequence[Asset]
    scans: Mapping[str, str | None]


def objects_of(rows: ObjectRows, colliders: Mapping[str, str]) -> list[dict[str, Any]]:
    """Every object of a scene, sorted by id, as JSON values; lengths in metres, poses 4x4 row by row. `colliders`: blob by instance."""
    assets = {asset.asset_id: asset for asset in rows.assets}
    captions, placements = _by_instance(rows.captions), _by_instance(rows.placements)
    supports, fidelity = _by_instance(rows.supports), _by_instance(rows.fidelity)
    candidates, selections, certificates = _grouped(rows.candidates), _grouped(rows.selections), _grouped(rows.certificates)
    listed = []
    for instance in rows.instances:
        if instance.is_structure:
            continue
        key = instance.instance_id
        placement = placements.get(key)
        asset = assets.get(placement.asset_id) if placement else None
        groups = {
            "In the scan": _seen(instance),
            "Described as": _described(captions.get(key)),
            "What stands for it": _placed(placement, asset, selections.get(key, []), candidates.get(key, []), rows.scans),
            "How it stands": _standing(placement, supports.get(key), certificates.get(key, [])),
            "How near it comes": _fidelity(fidelity.get(key)),
        }
        listed.append({
            "id": key,
            "category": instance.category,
            "label": instance.raw_label,
            "box": {"pose": instance.box_pose, "size": instance.box_size},
            "view": instance.view_blob,
            "frames": instance.best_frames,
            "placed": _placed_values(placement, asset),
            "collider": colliders.get(key),
            "support": _support(supports.get(key)),
            "unstable": [row.engine for row in certificates.get(key, []) if not row.is_stable_1cm],
            "remains": placement.remains if placement else None,
            "facts": [{"title": title, "rows": facts} for title, facts in groups.items() if facts],
            "candidates": _offered(candidates.get(key, []), selections.get(key, []), assets, placement),
        })  # fmt: skip
    return listed


def blobs_of(objects: Iterable[Mapping[str, Any]]) -> set[str]:
    """Names of all blobs that objects, as the page is told of them, are drawn from."""
    names = {row[key] for row in objects for key in ("view", "collider")}
    names |= {row["placed"]["blob"] for row in objects if row["placed"]}
    names |= {offer["blob"] for row in objects for offer in row["candidates"]}
    return {name for name in names if name}


def _seen(row: Instance) -> Facts:
    facts = [["label", row.raw_label], ["NYU40", f"{row.nyu40_label} ({row.nyu40_id})"], ["box", _lengths(row.box_size)]]
    facts += [["volume of the box", f"{number(row.box_volume_m3)} m³"], ["points", number(row.point_count)]]
    if row.hidden_m is not None and any(row.hidden_m):
        sides = zip(("-x", "+x", "-y", "+y", "below", "above"), row.hidden_m, strict=True)
        facts.append(["reaches unseen", ", ".join(f"{scaled(length, 100, 0)} cm {side}" for side, length in sides if length)])
    return facts


def _described(row: Caption | None) -> Facts:
    if row is None:
        return []
    density = UNRECORDED if row.density_kg_m3 is None else f"{number(row.density_kg_m3, 0)} kg/m³"
    who = f"{row.provider} {row.provider_version}{', a fallback' if row.is_fallback else ''}"
    return [
        ["caption", row.sentence], ["materials", ", ".join(row.materials) or UNRECORDED], ["mass", f"{number(row.mass_kg)} kg"],
        ["density", density], ["friction", number(row.friction)], ["body", row.body_type], ["described by", who],
    ]  # fmt: skip


def _placed(
    row: Placement | None, asset: Asset | None, selections: Sequence[Selection], candidates: Sequence[Candidate],
    scans: Mapping[str, str | None],
) -> Facts:  # fmt: skip
    if row is None or asset is None:
        return [["asset", "none: nothing was placed here"]] if row is None else [["asset", f"{row.asset_id} {UNRECORDED}"]]
    who = {"annotation": f"annotator {row.annotator or UNRECORDED}", "imported": "the imported dataset"}.get(row.origin, "selection")
    facts = [["asset", asset.name], ["made by", asset.provider], ["from", asset.source]]
    facts += [["license", of_asset(asset.license, asset.source, scans) or UNRECORDED], ["author", asset.author or UNRECORDED]]
    facts += [["chosen by", who], ["scale", " x ".join(number(value, 2) for value in row.scale)], ["faces", number(asset.face_count)]]
    chosen = next((s for s in selections if s.asset_id == row.asset_id), None)
    if chosen is not None:
        facts.append(["score", f"{number(chosen.score)}, rank {chosen.rank} of {len(selections)}"])
        facts.append(["covers of the scan", f"{scaled(chosen.coverage, 100, 0)} %, boxes share {scaled(chosen.box_iou, 100, 0)} %"])
        slot = next((c for c in candidates if c.slot == chosen.slot), None)
        if slot is not None and slot.is_fallback:
            facts.append(["fallback", slot.reason or "its slot's provider had nothing"])
    if row.displacement_m is not None:
        facts.append(["moved", f"{scaled(row.displacement_m, 100)} cm aside, {scaled(row.lift_m, 100)} cm up, by the {row.method} method"])
    if row.collider_pieces is not None:
        facts.append(
            [
                "collider",
                (
                    f"{number(row.collider_pieces)} {noun(row.collider_pieces, 'convex piece')}, "
                    f"{number(row.collider_faces)} {noun(row.collider_faces or 0, 'face')}"
                ),
            ]
        )
    return facts


def _standing(row: Placement | None, support: Support | None, certificates: Sequence[Certificate]) -> Facts:
    facts = []
    if support is not None:
        carrier = support.parent_id or (support.against if support.relation in ("wall", "ceiling") else "") or ""
        against = f", against {support.against}" if support.against and support.against != carrier else ""
        relation = "bracket" if support.bracket_blob is not None else support.relation
        facts.append(["carried by", f"{relation} {carrier}".strip() + against])
        facts.append(["may move", "no, it is fastened" if support.is_fixed else "yes"])
    for issued in certificates:
        verdict = "stays" if issued.is_stable_1cm else "stays within 5 cm" if issued.is_stable_5cm else "does not stay"
        if issued.problem is not None:
            verdict = f"not simulated: {issued.problem}"
        elif issued.displacement_m is not None and issued.tilt_radians is not None:
            verdict += f": {scaled(issued.displacement_m, 1000)} mm, {number(math.degrees(issued.tilt_radians), 1)}°"
            verdict += " after 2 s" if issued.simulated_seconds == 2.0 else f" after {number(issued.simulated_seconds)} s"
        verdict += ", not after a nudge" if issued.is_stable_1cm and issued.is_stable_nudged is False else ""
        facts.append([issued.engine, verdict])
    if row is not None and row.remains:
        facts.append(["remains", row.remains])
    return facts


def _fidelity(row: Fidelity | None) -> Facts:
    if row is None:
        return []
    shares = [("F-score at 2 cm", row.f_2cm), ("F-score at 5 cm", row.f_5cm), ("F-score at 10 cm", row.f_10cm)]
    facts = [[name, UNRECORDED if value is None else number(value)] for name, value in shares]
    if row.color_difference is not None:
        facts.append(["color difference", f"{number(row.color_difference, 1)} CIEDE2000"])
    return facts


def _support(row: Support | None) -> dict[str, Any] | None:
    if row is None:
        return None
    return {"relation": row.relation, "parent": row.parent_id, "against": row.against, "fixed": row.is_fixed}


def _placed_values(row: Placement | None, asset: Asset | None) -> dict[str, Any] | None:
    if row is None or asset is None:
        return None
    poses = {"proposed": row.proposed_pose, "optimized": row.optimized_pose, "settled": row.settled_pose}
    return {"asset": row.asset_id, "name": asset.name, "blob": asset.mesh_blob, "scale": row.scale, "origin": row.origin, "poses": poses}


def _offered(
    candidates: Sequence[Candidate], selections: Sequence[Selection], assets: Mapping[str, Asset], placement: Placement | None
) -> list[dict[str, Any]]:
    """Slots by rank, those without one last."""
    aligned = {row.slot: row for row in selections}
    offers = []
    for row in candidates:
        asset, choice = assets.get(row.asset_id or ""), aligned.get(row.slot)
        offers.append({
            "slot": row.slot,
            "rank": choice and choice.rank,
            "score": choice and choice.score,
            "provider": row.provider,
            "outcome": row.outcome,
            "fallback": row.is_fallback,
            "reason": row.reason,
            "name": asset and asset.name,
            "asset": row.asset_id,
            "blob": asset and asset.mesh_blob,
            "pose": choice and choice.pose,
            "scale": choice and choice.scale,
            "placed": False,
        })  # fmt: skip
    offers.sort(key=lambda offer: (offer["rank"] or 99, offer["slot"]))
    for offer in offers:  # two slots may hold the same asset
        if placement is not None and offer["asset"] == placement.asset_id:
            offer["placed"] = True
            break
    return offers


def _lengths(values: Sequence[float]) -> str:
    return " x ".join(number(value, 2) for value in values) + " m"


def _by_instance(rows: Iterable[R]) -> dict[str, R]:
    return {getattr(row, "instance_id"): row for row in rows}  # noqa: B009


def _grouped(rows: Iterable[R]) -> dict[str, list[R]]:
    groups: dict[str, list[R]] = {}
    for row in rows:
        groups.setdefault(getattr(row, "instance_id"), []).append(row)  # noqa: B009
    return groups
