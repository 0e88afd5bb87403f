"""Layouts of a small world of two kinds of tables, for tests of models."""

from __future__ import annotations

import numpy as np

from tasks.synthesis.layout import Large, Layout

SMALL = {"mug": (0.09, 0.1, 0.1), "monitor": (0.2, 0.5, 0.4), "book": (0.2, 0.15, 0.03)}


def layout(rng: np.random.Generator, most: int = 4) -> Layout:
    """A desk in the office has a monitor and mugs, a table in the kitchen mugs and books."""
    is_desk = rng.random() < 0.5
    size = np.array([0.7, 1.4, 0.75]) * rng.uniform(0.8, 1.2, 3)
    large = Large("desk" if is_desk else "table", (float(size[0]), float(size[1]), float(size[2])), "office" if is_desk else "kitchen")
    names = ["monitor" if is_desk else "book", *rng.choice(["mug", "book"], int(rng.integers(0, most)))]
    sizes = np.array([SMALL[name] for name in names]) * rng.uniform(0.8, 1.2, (len(names), 3))
    centers = np.column_stack([rng.uniform(-0.4, 0.4, (len(names), 2)) * size[:2], size[2] + 0.5 * sizes[:, 2]])
    return Layout(large, tuple(map(str, names)), centers, sizes, rng.uniform(-np.pi, np.pi, len(names)))


def layouts(count: int, seed: int = 0, most: int = 4) -> list[Layout]:
    """So many of them."""
    rng = np.random.default_rng(seed)
    return [layout(rng, most) for _ in range(count)]
