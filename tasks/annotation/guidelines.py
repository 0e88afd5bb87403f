"""The guidelines for annotators as figures: object matching, consistency of a scene, spatial accuracy of every answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.annotation import Annotation, AnnotationFigures
from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.selection import Selection
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import read_points
from tasks.geometry.pieces import PieceConfig
from tasks.geometry.proximity import closest_points
from tasks.geometry.transforms import matrix
from tasks.optimization.contacts import FLOOR, Colliders
from tasks.optimization.interior import Interior, furnish
from tasks.optimization.proposals import Proposal
from tasks.optimization.support.boundary import outside_share
from tasks.optimization.support.supports import SupportConfig
from tasks.stage import Caches

LOOKALIKE = 0.1
"""Instances of one category whose extents differ by less than this share look alike: two chairs of a set do, scanned badly."""

MOST_POINTS = 5000
"""Scanned points that are held against an asset, evenly taken: more do not change the mean."""


def figures(
    answers: Sequence[Annotation],
    instances: Sequence[Instance],
    selections: Sequence[Selection],
    shells: Sequence[Shell],
    assets: Sequence[Asset],
    blobs: Mapping[str, bytes],
    caches: Caches,
    batch_answers: Sequence[Annotation] = (),
) -> list[AnnotationFigures]:
    """Figures of answers for one scene, sorted by key; none of those that choose nothing or whose asset cannot be placed.

    Around an answer stand the same annotator's `batch_answers` and `answers`, and as selection aligned its first what they did not
    answer for. Selections and assets are those of the scene, and the assets that were chosen.
    """
    known = {asset.asset_id: asset for asset in assets}
    objects = {row.instance_id: row for row in instances if not row.is_structure}
    rows = []
    for annotator in sorted({row.annotator for row in answers}):
        own = {row.instance_id: row for row in sorted(batch_answers, key=lambda row: row.revision) if row.annotator == annotator}
        own |= {row.instance_id: row for row in answers if row.annotator == annotator}
        interior = furnished(own, instances, selections, shells, assets, blobs, caches)
        rows += _of_annotator([row for row in answers if row.annotator == annotator], interior, objects, known, blobs)
    return sorted(rows, key=lambda row: (row.scene_id, row.instance_id, row.annotator, row.revision))


def furnished(
    own: Mapping[str, Annotation],
    instances: Sequence[Instance],
    selections: Sequence[Selection],
    shells: Sequence[Shell],
    assets: Sequence[Asset],
    blobs: Mapping[str, bytes],
    caches: Caches,
) -> Interior:
    """A room as an annotator furnished it by their `own` answers, by instance; what they did not answer for stands as selection aligned
    its first. What cannot be placed is left out."""
    known = {asset.asset_id: asset for asset in assets}
    aligned: dict[str, list[Selection]] = {}
    for selection in sorted(selections, key=lambda row: (row.instance_id, row.rank)):
        aligned.setdefault(selection.instance_id, []).append(selection)
    objects = {row.instance_id: row for row in instances if not row.is_structure}
    proposals = [
        proposal
        for name, instance in sorted(objects.items())
        if (proposal := _proposed(instance, own.get(name), aligned.get(name, ()))) is not None and proposal.asset_id in known
    ]
    interior, _ = furnish(proposals, known, blobs, shells[0] if shells else None, SupportConfig(), PieceConfig(), caches)
    return interior


def size_ratio(instance: Instance, asset: Asset, scale: Sequence[float]) -> float:
    """Volume of a scaled asset's box over that of an instance's, with what the scan could not see of it."""
    _, size = grown_box(instance.box_pose, instance.box_size, instance.hidden_m)
    return float(np.prod(np.array(asset.extents) * np.array(scale)) / max(float(np.prod(size)), 1e-9))


def lookalikes(instance: Instance, objects: Mapping[str, Instance]) -> list[str]:
    """Other instances of a scene with the same category and nearly the same size, by id."""
    size = np.sort(np.array(instance.box_size))
    return [
        name
        for name, row in sorted(objects.items())
        if name != instance.instance_id
        and row.category == instance.category
        and bool((np.abs(np.sort(np.array(row.box_size)) - size) <= LOOKALIKE * np.maximum(size, 1e-6)).all())
    ]


def _proposed(instance: Instance, answer: Annotation | None, aligned: Sequence[Selection]) -> Proposal | None:
    """What stands for an instance: what its annotator chose, else the selection's first."""
    if answer is not None and answer.choice is not None and not answer.is_withdrawn:
        own = next((row for row in aligned if row.asset_id == answer.choice), None)
        pose, scale = answer.pose or (own.pose if own else None), answer.scale or (own.scale if own else (1.0, 1.0, 1.0))
        if pose is not None:
            return Proposal(instance, answer.choice, matrix(pose), np.array(scale), "annotation", answer.annotator)
    if not aligned:
        return None
    first = aligned[0]
    return Proposal(instance, first.asset_id, matrix(first.pose), np.array(first.scale), "selection")


def _of_annotator(
    answers: Sequence[Annotation],
    interior: Interior,
    objects: Mapping[str, Instance],
    assets: Mapping[str, Asset],
    blobs: Mapping[str, bytes],
) -> list[AnnotationFigures]:
    """Figures of one annotator's answers in the room as they furnished it."""
    deepest: dict[str, tuple[float, str]] = {}
    for pair in Colliders(interior.solids, interior.shell).penetrations(interior.poses):
        for name, other in ((pair.a, pair.b), (pair.b, pair.a)):
            if other != FLOOR and pair.depth_m > deepest.get(name, (0.0, ""))[0]:
                deepest[name] = (pair.depth_m, other)
    stands_as = {proposal.instance.instance_id: proposal.asset_id for proposal in interior.proposals}
    places = {name: index for index, name in enumerate(interior.names)}
    rows = []
    for row in answers:
        index = places.get(row.instance_id)
        if row.choice is None or row.is_withdrawn or index is None or stands_as[row.instance_id] != row.choice:
            continue
        instance, asset, proposal = objects[row.instance_id], assets[row.choice], interior.proposals[index]
        carrier, alike = interior.carriers[index], lookalikes(instance, objects)
        deep = deepest.get(row.instance_id)
        rows.append(
            AnnotationFigures(
                batch_id=row.batch_id,
                scene_id=row.scene_id,
                instance_id=row.instance_id,
                annotator=row.annotator,
                revision=row.revision,
                is_category_match=asset.category.strip().lower() == instance.category,
                size_ratio=size_ratio(instance, asset, tuple(proposal.scale)),
                lookalikes=len(alike),
                lookalikes_alike=sum(stands_as.get(name) == row.choice for name in alike),
                collision_m=deep[0] if deep else 0.0,
                collides_with=deep[1] if deep else None,
                floating_m=carrier.gap if carrier.relation in ("floor", "on", "inside") else None,
                outside_share=_outside(interior.objects[index].plan_points, interior.ring),
                scan_distance_m=_scan_distance(instance, interior, index, blobs),
            )
        )
    return rows


def _outside(points: NDArray[np.float64], ring: NDArray[np.float64] | None) -> float | None:
    """Share of what points cover in plan, shape (n, 2) [m], that lies beyond the floor."""
    import shapely

    outline = shapely.MultiPoint(points).convex_hull
    if ring is None or outline.geom_type != "Polygon":
        return None
    return min(1.0, outside_share(np.asarray(outline.exterior.coords)[:-1], ring))


def _scan_distance(instance: Instance, interior: Interior, index: int, blobs: Mapping[str, bytes]) -> float | None:
    """Mean distance of an instance's points from the asset that stands for it [m]."""
    try:
        points, _ = read_points(blobs[instance.points_blob], f"{instance.instance_id}.ply")
    except (KeyError, InputError):
        return None
    if not len(points):
        return None
    surface = interior.objects[index].surface
    return float(closest_points(surface.vertices, surface.faces, points[:: -(-len(points) // MOST_POINTS)]).distance.mean())
