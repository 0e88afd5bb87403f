"""The toy problem of specs C.8: boxes, balls, cylinders and tables, stretched and colored; the one that was scanned is
among ten that are more or less like it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.clouds import packed, spread_cloud
from tasks.selection.model.examples import AlignedCandidate, Example
from tasks.selection.model.features import EVIDENCE, Scanned

KINDS = ("box", "ball", "cylinder", "table")


def surface(kind: str, count: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Points and unit normals on a shape in the unit cube whose bottom lies on z = 0."""
    if kind == "ball":
        normals = rng.normal(size=(count, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return 0.5 * normals + [0, 0, 0.5], normals
    if kind == "cylinder":
        angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(size=count)
        normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        points = 0.5 * normals + np.stack([np.zeros(count), np.zeros(count), height], axis=1)
        lid = rng.uniform(size=count) < 0.3
        reach = np.sqrt(rng.uniform(size=count))
        points[lid] = (normals * 0.5 * reach[:, None])[lid] + [0, 0, 1]
        normals[lid] = [0, 0, 1]
        return points, normals
    points, normals = rng.uniform(size=(count, 3)) - [0.5, 0.5, 0], np.zeros((count, 3))
    axis, side = rng.integers(3, size=count), rng.integers(2, size=count)
    rows = np.arange(count)
    points[rows, axis] = np.where(axis == 2, side, side - 0.5)
    normals[rows, axis] = 2.0 * side - 1.0
    if kind == "table":
        leg = points[:, 2] < 0.85
        points[leg, :2] = 0.42 * np.sign(points[leg, :2]) + 0.08 * points[leg, :2]
    return points, normals


def toy(count: int, seed: int, *, points: int = 128, candidates: int = 10) -> tuple[list[Example], dict[str, bytes]]:
    """Objects, ten to a room, and the packed clouds of their candidates, of which the ranking is by likeness."""
    rng = np.random.default_rng(seed)
    examples, clouds = [], {}
    for number in range(count):
        looks = [(KINDS[int(rng.integers(4))], np.exp(rng.normal(0, 0.35, 3)), rng.uniform(30, 225, 3)) for _ in range(candidates)]
        kind, size, color = looks[0]
        for other in range(1, 4):  # some that differ little
            looks[other] = (kind, size * np.exp(rng.normal(0, 0.15, 3)), np.clip(color + rng.normal(0, 30, 3), 0, 255))
        order = rng.permutation(candidates)
        looks = [looks[i] for i in order]
        unlike = [float(k != kind) + np.abs(np.log(s / size)).mean() + np.abs(c - color).mean() / 255 for k, s, c in looks]
        ranking = tuple(int(i) for i in np.argsort(unlike, kind="stable")[:5])
        at, _ = surface(kind, 4 * points, rng)
        seen = at[at[:, 2] + 0.6 * at[:, 0] > 0.0]  # from one side
        seen = seen * size + rng.normal(0, 0.01, (len(seen), 3))
        colors = np.clip(color + rng.normal(0, 15, (len(seen), 3)), 0, 255).astype(np.uint8)
        image = np.clip(np.full((40, 32, 3), color) + rng.normal(0, 10, (40, 32, 3)), 0, 255).astype(np.uint8)
        scanned = Scanned(spread_cloud(seen, colors, points), size.astype(np.float32), kind, None, image if number % 5 else None)
        rows = []
        for place, (k, s, c) in enumerate(looks):
            name = f"{seed}-{number}-{place}"
            at, normals = surface(k, 2 * points, rng)
            normals = normals / s
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            tint = np.broadcast_to(c.astype(np.uint8), (len(at), 3))
            clouds[name] = packed(spread_cloud(at * s, tint, points, normals))
            evidence = np.zeros(len(EVIDENCE), dtype=np.float32)
            rows.append(AlignedCandidate(name, s.astype(np.float32), np.eye(4), np.ones(3), evidence))
        examples.append(Example(f"toy/room{number // 10}", f"toy/room{number // 10}", f"{number:04d}", scanned, tuple(rows), (ranking,)))
    return examples, clouds
