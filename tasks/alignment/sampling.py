"""Assets sampled as alignment takes them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.alignment.methods import method_of
from tasks.alignment.samples import Sample
from tasks.geometry.meshes import Surface, load_glb, material_of, sample_texture, surface_of, surface_of_glb, vertex_colors
from tasks.geometry.triangles import face_crosses, spread_by, surface_area

if TYPE_CHECKING:
    import trimesh

    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]

Paint = Callable[[NDArray[np.int64], Array], Array]
"""Colors, shape (k, 3), at places: faces, shape (k,), and barycentric coordinates, shape (k, 3)."""

SIZED = "library"
"""Provider of assets whose size is their own."""


def sample_asset(asset: Asset, glb: bytes, config: AlignmentConfig, rng: np.random.Generator) -> Sample:
    """Samples of a canonical asset; those of a textured one have the colors of its texture.

    Raises:
        InputError: the GLB cannot be read.
        ValueError: its surface has no area.
    """
    parts = load_glb(glb, asset.mesh_blob) if asset.has_texture else None
    surface = surface_of_glb(glb, asset.mesh_blob) if parts is None else surface_of(parts)
    sample = sample_of(surface, config, rng, None if parts is None else partial(_painted, parts))
    return dataclasses.replace(sample, has_own_size=asset.provider == SIZED)


def sample_of(surface: Surface, config: AlignmentConfig, rng: np.random.Generator, paint: Paint | None = None) -> Sample:
    """Samples of a surface in an asset's canonical frame.

    Args:
        surface: triangles of the asset.
        config: how many samples.
        rng: draws them.
        paint: colors at places on the surface, where those of its vertices are not all that it shows.

    Raises:
        ValueError: it has no area.
    """
    area = surface_area(surface.vertices, surface.faces)
    crosses = face_crosses(surface.vertices, surface.faces)
    lengths = np.linalg.norm(crosses, axis=1)
    if not lengths.sum() > 0:
        raise ValueError("surface: has no area")
    face, weights = spread_by(lengths, config.samples, rng)
    corners = surface.faces[face]
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[corners])
    normals = crosses[face] / np.maximum(lengths[face], 1e-300)[:, None]
    mixed = np.einsum("nk,nkd->nd", weights, surface.colors[corners].astype(np.float64)) if paint is None else paint(face, weights)
    order = rng.permutation(config.samples)
    extents = np.maximum(surface.bounds[1] - surface.bounds[0], 1e-4)
    whole = surface if method_of(config.method).reads_surface else None
    return Sample(points[order], normals[order], np.round(mixed).astype(np.uint8)[order], extents, area, whole)


def _painted(parts: Sequence[trimesh.Trimesh], face: NDArray[np.int64], weights: Array) -> Array:
    """Colors of parts at places on `surface_of(parts)`, shape (k, 3), 0 to 255.

    Args:
        parts: parts with textures, vertex colors or plain materials.
        face: faces of the surface, shape (k,).
        weights: barycentric coordinates in them, shape (k, 3).
    """
    counts = np.array([len(part.faces) for part in parts])
    index = np.repeat(np.arange(len(parts)), counts)[face]
    colors = np.empty((len(face), 3))
    for number, part in enumerate(parts):
        where = np.flatnonzero(index == number)
        if not len(where):
            continue
        corners = np.asarray(part.faces, dtype=np.int64)[face[where] - int(counts[:number].sum())]
        visual: Any = part.visual
        image, factor = material_of(part) if visual.kind == "texture" and visual.uv is not None else (None, np.ones(3))
        if image is None or len(visual.uv) != len(part.vertices):
            colors[where] = np.einsum("nk,nkd->nd", weights[where], vertex_colors(part)[corners].astype(np.float64))
        else:
            places = np.einsum("nk,nkd->nd", weights[where], np.asarray(visual.uv, dtype=np.float64)[corners])
            colors[where] = sample_texture(image, places, factor)
    return colors
