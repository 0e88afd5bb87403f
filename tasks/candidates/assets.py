"""An asset's row and files from its parts: checked, canonical, measured."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.candidates import Asset
from tasks.meshes import Surface, canonical, dump_glb, surface_of

if TYPE_CHECKING:
    import trimesh

MAX_FACES = 500_000
"""More faces make a simulator crawl; such meshes are decimated to this."""

MIN_EXTENT_M, MAX_EXTENT_M = 1e-4, 50.0
"""Thinner than 0.1 mm along two axes, or longer than 50 m: not an object of a room, most often a wrong unit."""


@dataclasses.dataclass(frozen=True)
class MadeAsset:
    """An asset with its files by blob name."""

    asset: Asset
    files: Mapping[str, bytes]


def make_asset(
    parts: Sequence[trimesh.Trimesh],
    *,
    provider: str,
    name: str,
    category: str,
    source: str,
    license: str,
    author: str | None = None,
    pieces: Sequence[trimesh.Trimesh] = (),
) -> MadeAsset:
    """An asset of `parts` (+Z up) and, when its construction knows them, convex `pieces` in the same frame [m].

    Raises:
        ValueError: coordinates are not finite, extents are degenerate, or fewer than four vertices or faces are there.
    """
    surface = surface_of(parts)
    _check(surface)
    if len(surface.faces) > MAX_FACES:
        parts = [_decimated(surface)]
    shift = -np.array([surface.bounds[:, 0].mean(), surface.bounds[:, 1].mean(), surface.bounds[0, 2]])
    moved = canonical(parts)
    data = dump_glb(moved)
    asset_id = hashlib.sha256(data).hexdigest()
    files = {f"{asset_id}.glb": data}
    pieces_blob = None
    if pieces:
        placed = [piece.copy() for piece in pieces]
        for piece in placed:
            piece.apply_translation(shift)
        pieces_data = dump_glb(placed, [f"piece_{index:03d}" for index in range(len(placed))])
        pieces_blob = f"{hashlib.sha256(pieces_data).hexdigest()}.glb"
        files[pieces_blob] = pieces_data
    surface = surface_of(moved)
    is_watertight, volume = _solidity(surface)
    if pieces:
        volume = float(sum(abs(piece.volume) for piece in pieces))
    asset = Asset(
        asset_id=asset_id,
        provider=provider,
        name=name,
        category=category,
        source=source,
        license=license,
        author=author,
        mesh_blob=f"{asset_id}.glb",
        pieces_blob=pieces_blob,
        extents=tuple(float(v) for v in np.ptp(surface.bounds, axis=0)),
        volume_m3=volume,
        is_watertight=is_watertight,
        vertex_count=len(surface.vertices),
        face_count=len(surface.faces),
    )
    return MadeAsset(asset, files)


def _check(surface: Surface) -> None:
    """Refuse what no simulator can use."""
    if not np.isfinite(surface.vertices).all():
        raise ValueError("has coordinates that are not finite")
    if len(surface.vertices) < 4 or len(surface.faces) < 4:
        raise ValueError(f"has {len(surface.vertices)} vertices and {len(surface.faces)} faces, a solid needs four of each")
    extents = np.sort(np.ptp(surface.bounds, axis=0))
    if extents[1] < MIN_EXTENT_M or extents[2] > MAX_EXTENT_M:
        raise ValueError(f"has extents {' x '.join(f'{v:.3g}' for v in extents)} m, which is no object of a room")


def _decimated(surface: Surface) -> trimesh.Trimesh:
    """The surface with `MAX_FACES` faces (quadric error); colors of the nearest old vertices."""
    import fast_simplification
    from scipy.spatial import cKDTree

    vertices, faces = fast_simplification.simplify(
        surface.vertices.astype(np.float32), surface.faces.astype(np.int32), target_count=MAX_FACES, verbose=False
    )
    _, nearest = cKDTree(surface.vertices).query(vertices)
    return Surface(np.asarray(vertices, np.float64), np.asarray(faces, np.int64), surface.colors[nearest]).to_trimesh()


def _solidity(surface: Surface) -> tuple[bool, float]:
    """Whether a surface is closed once equal corners are one, and its volume [m3]; its hull's volume when it is open."""
    import trimesh

    _, first, merged = np.unique(np.round(surface.vertices, 7), axis=0, return_index=True, return_inverse=True)
    faces = merged.reshape(-1)[surface.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    mesh = trimesh.Trimesh(surface.vertices[first], faces, process=False)
    hull = hull_volume(surface)
    closed = bool(len(faces) and mesh.is_watertight)
    if closed and mesh.is_winding_consistent and mesh.volume > 0:
        return True, float(min(mesh.volume, hull)) if hull else float(mesh.volume)
    return closed, hull


def hull_volume(surface: Surface) -> float:
    """Volume of the convex hull [m3], 0 for what is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(surface.vertices).volume)
    except QhullError:
        return 0.0
