"""Libraries of drawn models, as folders of GLB files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb


def write_library(folder: Path, **categories: tuple[str, tuple[float, float, float]]) -> Path:
    folder.mkdir()
    for seed, (stem, (category, extents)) in enumerate(categories.items()):
        parts = generate(category, extents, np.random.default_rng(seed)).parts
        for part in parts:
            part.apply_translation([5, 3, -2])  # libraries have their origin anywhere
        (folder / f"{stem}.glb").write_bytes(dump_glb(parts))
    return folder
