"""Assets sampled as alignment takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from schemas.candidates import Asset
from tasks.alignment.methods import method_of
from tasks.alignment.samples import Sample
from tasks.geometry.meshes import Surface, sample_surface, surface_of_glb
from tasks.geometry.triangles import surface_area

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig


def sample_asset(asset: Asset, glb: bytes, config: AlignmentConfig, rng: np.random.Generator) -> Sample:
    """Samples of a canonical asset.

    Raises:
        InputError: the GLB cannot be read.
        ValueError: its surface has no area.
    """
    return sample_of(surface_of_glb(glb, asset.mesh_blob), config, rng)


def sample_of(surface: Surface, config: AlignmentConfig, rng: np.random.Generator) -> Sample:
    """Samples of a surface in an asset's canonical frame.

    Raises:
        ValueError: it has no area.
    """
    area = surface_area(surface.vertices, surface.faces)
    points, colors, normals = sample_surface(surface, config.samples, rng)
    order = rng.permutation(config.samples)
    extents = np.maximum(surface.bounds[1] - surface.bounds[0], 1e-4)
    kept = surface if method_of(config.method).reads_surface else None
    return Sample(points[order], normals[order], colors[order], extents, area, kept)
