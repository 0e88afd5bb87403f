"""Rows of the fidelity stage, from what was measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.fidelity import Fidelity, SceneFidelity
from tasks.fidelity.agreement import f_score, joined, share, shares_within
from tasks.fidelity.marked_points import SHELL
from tasks.fidelity.measures import OWN_M, ObjectAgreement, SceneAgreement
from tasks.fidelity.pictures import Likeness
from tasks.fidelity.scans import ScannedSurface
from tasks.geometry.triangles import surface_area

_AT = ("2cm", "5cm", "10cm")
"""The thresholds as columns name them."""

Shares = tuple[float | None, ...]


def object_row(scene_id: str, instance_id: str, row: ObjectAgreement, alike: Likeness) -> Fidelity:
    """The row of an object."""
    completeness = tuple(value or 0.0 for value in shares_within(row.scan.areas, row.to_asset))
    accuracy = shares_within(row.seen.areas, row.to_scan)
    return Fidelity(
        scene_id=scene_id,
        instance_id=instance_id,
        is_placed=row.is_placed,
        scan_area_m2=row.scan.area,
        visible_area_m2=row.seen.area if row.is_placed else None,
        seen_empty_share=share(row.seen.areas, row.empty),
        in_others_share=share(row.seen.areas, row.foreign),
        color_difference=alike.by_owner.get(instance_id),
        **_columns("", completeness, accuracy, row.is_placed),
    )


def scene_row(
    scene_id: str, scan: ScannedSurface, measured: SceneAgreement, alike: Likeness, source: str, cameras: int, points: str
) -> SceneFidelity:
    """The row of a scene. points: Name of the blob of marked points."""
    rows = list(measured.objects.values())
    scanned, seen = joined([row.scan for row in rows]), joined([row.seen for row in rows])
    placed = sum(row.is_placed for row in rows)
    flags = [np.concatenate([np.zeros(0, dtype=bool), *(getattr(row, name) for row in rows)]) for name in ("empty", "foreign")]
    unexplained = (measured.marked.part != SHELL) & (measured.marked.distance > OWN_M)
    left = measured.areas[measured.marked.part != SHELL].sum()
    area = float(measured.areas[unexplained].sum())
    return SceneFidelity(
        scene_id=scene_id,
        cameras=source,
        camera_count=cameras,
        object_count=len(rows),
        placed_count=placed,
        scan_area_m2=surface_area(scan.whole.vertices, scan.whole.faces),
        object_area_m2=scanned.area,
        shell_area_m2=measured.shell.area,
        unlabeled_area_m2=measured.unlabeled.area,
        unexplained_area_m2=area,
        unexplained_share=min(area / float(left), 1.0) if left > 0 else None,
        seen_empty_share=share(seen.areas, flags[0]),
        in_others_share=share(seen.areas, flags[1]),
        color_difference=alike.color_difference,
        structural_similarity=alike.structural_similarity,
        median_depth_error_m=alike.median_depth_error_m,
        mean_depth_error_m=alike.mean_depth_error_m,
        both_seen_share=alike.both_seen_share,
        distances_blob=points,
        **_columns(
            "object_", shares_within(scanned.areas, measured.object_to_any), shares_within(seen.areas, measured.seen_to_any), placed > 0
        ),
        **_columns(
            "shell_",
            shares_within(measured.shell.areas, measured.shell_to_replica),
            shares_within(measured.wall.areas, measured.wall_to_scan) if measured.shell.area else (None,) * len(_AT),
        ),
    )


def _columns(prefix: str, completeness: Shares, accuracy: Shares, is_placed: bool = True) -> dict[str, Any]:
    """Completeness, accuracy and F-score at the thresholds, by column. What nothing stands for has an F-score of 0."""
    values: dict[str, Any] = {}
    for at, complete, accurate in zip(_AT, completeness, accuracy, strict=True):
        f = f_score(accurate, complete) if is_placed or complete is None else 0.0
        values |= {f"{prefix}completeness_{at}": complete, f"{prefix}accuracy_{at}": accurate, f"{prefix}f_{at}": f}
    return values
