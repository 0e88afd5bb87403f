"""Desks by a rule, for tests: a keyboard before a monitor, a mouse beside it, a mug at one end, a book at the other."""

from __future__ import annotations

import numpy as np

from tasks.synthesis.layout import Large, Layout


def desk(rng: np.random.Generator) -> Layout:
    """A desk with two to five things on it, none in another, none over the edge."""
    depth, width, height = rng.uniform(0.6, 0.8), rng.uniform(1.2, 1.8), rng.uniform(0.7, 0.78)
    middle = rng.uniform(-0.05, 0.05)
    sizes = {"monitor": (0.08, 0.5, 0.4), "keyboard": (0.14, 0.4, 0.03), "mouse": (0.1, 0.06, 0.04), "mug": (0.08, 0.08, 0.1),
             "book": (0.2, 0.15, 0.03)}  # fmt: skip
    places = {
        "monitor": (-0.5 * depth + rng.uniform(0.1, 0.12), middle), "keyboard": (-0.5 * depth + rng.uniform(0.28, 0.32), middle),
        "mouse": (-0.5 * depth + 0.3, middle - rng.uniform(0.27, 0.3)), "mug": (rng.uniform(-0.2, 0.2), 0.5 * width - 0.08),
        "book": (rng.uniform(-0.15, 0.15), -0.5 * width + 0.13),
    }  # fmt: skip
    names = ("monitor", "keyboard", *(name for name, share in (("mouse", 0.8), ("mug", 0.5), ("book", 0.4)) if rng.random() < share))
    return Layout(
        Large("desk", (depth, width, height), "office" if rng.random() < 0.5 else "bedroom"),
        names,
        np.array([(*places[name], height + 0.5 * sizes[name][2]) for name in names]),
        np.array([sizes[name] for name in names]),
        rng.normal(0.0, 0.03, len(names)),
    )


def desks(count: int, seed: int) -> list[Layout]:
    """Desks by the rule, drawn."""
    rng = np.random.default_rng(seed)
    return [desk(rng) for _ in range(count)]


def layout_of(*objects: tuple[str, tuple[float, float, float], tuple[float, float, float], float], large: Large | None = None) -> Layout:
    """A layout of (category, middle [m], size [m], yaw [rad])."""
    names, centers, sizes, yaws = zip(*objects, strict=True) if objects else ((), (), (), ())
    return Layout(large or Large("desk", (1.0, 2.0, 0.7)), tuple(names), np.array(centers), np.array(sizes), np.array(yaws))
