"""The geometric method's rows on a generated room: those that were recorded, and those of a second computation."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import defaultdict

import numpy as np
import pytest

from schemas.record import check
from schemas.selection import Selection
from tasks.alignment import align, make_target, sample_asset
from tasks.geometry.boxes import oriented_iou
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import flat, inverse, matrix, transform_points, yaw_of, yaw_pose
from tasks.selection.coloring import color_histogram, color_similarity
from tasks.selection.looks import shared
from tasks.selection.neighbors import Neighborhood, foreign_share
from tests.tasks.selection.generated import GEOMETRIC, generated_room

RECORDED = "13007aff63f2ebeb33a8365dc5d2d6c6f8e9bf6b442ae1b016cb0cd673e1c94d"
"""Rows since one weight counts for all providers. Only a change on purpose changes rows."""


def digest(rows: list[Selection]) -> str:
    """Rows to nine digits, as text, with the version of then: since then, what is let in and was seen in part has another pose."""
    numbers = ("score", "chamfer_m", "coverage", "box_iou", "foreign_share", "color_similarity")
    texts = [
        f"{row.instance_id} {row.rank} {row.slot} {row.asset_id} {row.look} {row.provider} 4 "
        + " ".join(f"{value + 0.0:.9f}" for value in (*(getattr(row, name) for name in numbers), *row.pose, *row.scale))
        for row in rows
    ]
    return hashlib.sha256("\n".join(texts).replace("-0.000000000", "0.000000000").encode()).hexdigest()


@pytest.mark.whole
def test_rows_are_those_that_were_recorded() -> None:
    rows = generated_room().selections()
    check(rows, Selection)
    assert len(rows) == 48
    assert digest(rows) == RECORDED


@pytest.mark.whole
def test_rows_are_those_of_a_second_computation() -> None:
    """Every number anew from the parts that measure, in one loop and in plain arithmetic; equal to the last bit."""
    room, config = generated_room(), GEOMETRIC
    context, weights = room.context(), config.score
    nearby = Neighborhood.of(room.instances, room.blobs)
    assets = {asset.asset_id: asset for asset in room.assets}
    rankings: dict[str, list[Selection]] = defaultdict(list)
    for instance in room.instances:
        box, size = matrix(instance.box_pose), np.array(instance.box_size)
        bottom, top = box[2, 3] - 0.5 * size[2], box[2, 3] + 0.5 * size[2]
        is_grounded = abs(bottom) <= 0.05 < top
        bottom = 0.0 if is_grounded else bottom
        frame = yaw_pose(yaw_of(box), [box[0, 3], box[1, 3], bottom])
        points, colors = read_points(room.blobs[instance.points_blob])
        local = transform_points(points, inverse(frame))
        extent = np.array([size[0], size[1], top - bottom])
        inside = (np.abs(local - [0.0, 0.0, 0.5 * extent[2]]) <= 0.5 * extent + 0.05).all(axis=1)
        assert inside.mean() > 0.3
        target = make_target(local[inside], colors[inside], extent, config.alignment, context.rng("instance", instance.instance_id))
        target = dataclasses.replace(target, is_grounded=is_grounded)
        long = float(np.linalg.norm(target.size))
        reach = np.array([0.5 * long, 0.5 * long, 0.0])
        foreign = nearby.within(instance.instance_id, frame[:3, 3] - reach, frame[:3, 3] + reach + [0.0, 0.0, target.size[2]])
        foreign, own_cubes = transform_points(foreign, inverse(frame)), len(nearby.seen[instance.instance_id])
        for candidate in sorted((c for c in room.candidates if c.instance_id == instance.instance_id), key=lambda c: c.slot):
            if candidate.asset_id is None:
                continue
            asset = assets[candidate.asset_id]
            sample = sample_asset(asset, room.blobs[asset.mesh_blob], config.alignment, context.rng("asset", asset.asset_id))
            fit, fitting = align(target, sample, max(min(0.03, 0.05 * long), 0.01), config.alignment)
            placed, normals, _ = sample.placed(fit)
            share = foreign_share(foreign, own_cubes, placed, normals)
            color = color_similarity(color_histogram(colors[inside]), color_histogram(sample.colors))
            stands = frame @ yaw_pose(fit.yaw, fit.offset)
            middle = stands.copy()
            middle[2, 3] += 0.5 * (sample.extents * fit.scale)[2]
            overlap = oriented_iou(middle, sample.extents * fit.scale, instance.box_pose, instance.box_size)
            falloff = max(0.04 * long, target.resolution)
            fits = [fitting.coverage, float(np.exp(-fitting.scan / falloff)), float(np.exp(-fitting.asset / falloff))]
            assert "scan_crop" not in candidate.provider
            covered, scan, surface = fits
            total = 0.3 * covered + 0.25 * scan + 0.25 * surface + 0.1 * overlap + 0.1 * color
            rankings[instance.instance_id].append(
                Selection(
                    scene_id=instance.scene_id, instance_id=instance.instance_id, rank=1, slot=candidate.slot, asset_id=asset.asset_id,
                    score=float(np.clip(total * (1.0 - 0.6 * share), 0.0, 1.0)), chamfer_m=fitting.chamfer, coverage=fitting.coverage,
                    box_iou=overlap, foreign_share=share, color_similarity=color, pose=flat(stands),
                    scale=tuple(float(v) for v in fit.scale), look=None, provider="geometric", provider_version="7",
                )
            )  # fmt: skip
    ordered = {}
    for name, rows in rankings.items():
        rows = sorted(rows, key=lambda row: (-round(row.score, 9), row.slot))
        ordered[name] = [type(row)(**{**_fields(row), "rank": rank}) for rank, row in enumerate(rows, start=1)]
    expected = shared(ordered, {row.instance_id: row.category for row in room.instances}, weights.look_loss)
    assert room.selections() == [row for rows in expected.values() for row in rows]


def _fields(row: Selection) -> dict[str, object]:
    return {name: getattr(row, name) for name in Selection.__slots__}
