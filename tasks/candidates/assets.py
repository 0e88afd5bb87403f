"""An asset's row and files from its parts: checked, canonical, measured."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.candidates import Asset, TextureCharts
from tasks.geometry.encoded_images import has_image
from tasks.geometry.meshes import Surface, canonical, dump_bodies, dump_glb, surface_of
from tasks.geometry.plain_glb import PlainBody
from tasks.geometry.triangles import distinct_rows, enclosed_volume, is_closed, openness, signed_volumes, welded
from tasks.texturing.rows import own_charts
from tasks.views.pictures import thumbnail

if TYPE_CHECKING:
    import trimesh

    from tasks.geometry.colliders import TriangleMesh

MAX_FACES = 500_000
"""More faces make a simulator crawl; such meshes are decimated to this."""

MIN_EXTENT_M, MAX_EXTENT_M = 1e-4, 50.0
"""Thinner than 0.1 mm along two axes, or longer than 50 m: not an object of a room, most often a wrong unit."""


@dataclasses.dataclass(frozen=True)
class MadeAsset:
    """An asset with its files by blob name. call_id: The call of a model that made it. library, library_file, library_score: Where it was
    found, as a candidate's row says it. charts: How its texture is laid out, as far as that is known. seen_share: Of a texture that was
    painted, the share that frames show."""

    asset: Asset
    files: Mapping[str, bytes]
    call_id: str | None = None
    library: str | None = None
    library_file: str | None = None
    library_score: float | None = None
    charts: TextureCharts | None = None
    seen_share: float | None = None


def make_asset(
    parts: Sequence[trimesh.Trimesh],
    *,
    provider: str,
    name: str,
    category: str,
    source: str,
    license: str,
    author: str | None = None,
    source_url: str | None = None,
    pieces: Sequence[TriangleMesh] = (),
) -> MadeAsset:
    """An asset of `parts` (+Z up) and, when its construction knows them, convex `pieces` in the same frame [m].

    Raises:
        ValueError: coordinates are not finite, extents are degenerate, or fewer than four vertices or faces are there.
    """
    surface = surface_of(parts)
    _check(surface)
    if len(surface.faces) > MAX_FACES:
        surface = decimated(surface, MAX_FACES)
        parts = [surface.to_trimesh()]
    shift = -np.array([surface.bounds[:, 0].mean(), surface.bounds[:, 1].mean(), surface.bounds[0, 2]])
    surface = dataclasses.replace(surface, vertices=surface.vertices + shift)
    textured = any(getattr(part.visual, "kind", None) == "texture" for part in parts)
    # Vertex colors lose nothing in one mesh, and one mesh is a tenth of the work for all who read it.
    # Names inside the file make its hash, and so the asset, differ wherever the row would: one asset, one row.
    if textured:
        data = dump_glb(canonical(parts), [f"{name}|{category}|{index:03d}" for index in range(len(parts))])
    else:
        opaque = np.column_stack([surface.colors, np.full(len(surface.colors), 255, dtype=np.uint8)])
        data = dump_bodies([PlainBody(f"{name}|{category}|000", surface.vertices, surface.faces, opaque)])
    asset_id = hashlib.sha256(data).hexdigest()
    files = {f"{asset_id}.glb": data}
    closed, pieces_blob = _closed(surface), None
    if pieces:
        placed = [
            PlainBody(f"piece_{index:03d}", np.asarray(piece.vertices) + shift, np.asarray(piece.faces))
            for index, piece in enumerate(pieces)
        ]
        pieces_data = dump_bodies(placed)
        pieces_blob = f"{hashlib.sha256(pieces_data).hexdigest()}.glb"
        files[pieces_blob] = pieces_data
        volume = sum(_volumes(placed))
    else:
        volume = _volume(surface, closed)
    picture = thumbnail(parts if textured else [surface.to_trimesh()])
    thumbnail_blob = f"{hashlib.sha256(picture).hexdigest()}.png"
    files[thumbnail_blob] = picture
    asset = Asset(
        asset_id=asset_id,
        provider=provider,
        name=name,
        category=category,
        source=source,
        license=license,
        author=author,
        source_url=source_url,
        mesh_blob=f"{asset_id}.glb",
        pieces_blob=pieces_blob,
        thumbnail_blob=thumbnail_blob,
        extents=tuple(float(v) for v in np.ptp(surface.bounds, axis=0)),
        volume_m3=volume,
        is_watertight=closed is not None,
        open_reason=None if closed is not None else openness(distinct_faces(joined(surface)).faces),
        has_texture=any(has_image(part) for part in parts),
        vertex_count=len(surface.vertices),
        face_count=len(surface.faces),
    )
    return MadeAsset(asset, files)


def _volumes(bodies: Sequence[PlainBody]) -> list[float]:
    """Volume inside of each of some closed bodies [m3]."""
    starts = np.cumsum([0, *(len(body.vertices) for body in bodies[:-1])])
    vertices = np.concatenate([body.vertices for body in bodies])
    faces = np.concatenate([body.faces + start for body, start in zip(bodies, starts, strict=True)])
    signed = np.split(signed_volumes(vertices, faces), np.cumsum([len(body.faces) for body in bodies[:-1]]))
    return [abs(float(each.sum() / 6.0)) for each in signed]


def charted(made: MadeAsset, parts: Sequence[trimesh.Trimesh]) -> MadeAsset:
    """An asset of others with figures of the layout that it came with, where there are some (`tasks.texturing.rows`)."""
    return dataclasses.replace(made, charts=own_charts(made.asset.asset_id, parts)) if made.asset.has_texture else made


def _check(surface: Surface) -> None:
    """Refuse what no simulator can use."""
    if not np.isfinite(surface.vertices).all():
        raise ValueError("has coordinates that are not finite")
    if len(surface.vertices) < 4 or len(surface.faces) < 4:
        raise ValueError(f"has {len(surface.vertices)} vertices and {len(surface.faces)} faces, a solid needs four of each")
    extents = np.sort(np.ptp(surface.bounds, axis=0))
    if extents[1] < MIN_EXTENT_M or extents[2] > MAX_EXTENT_M:
        raise ValueError(f"has extents {' x '.join(f'{v:.3g}' for v in extents)} m, which is no object of a room")


def decimated(surface: Surface, face_count: int) -> Surface:
    """The surface with about `face_count` faces (quadric error); colors of the nearest old vertices."""
    import fast_simplification
    from scipy.spatial import cKDTree

    vertices, faces = fast_simplification.simplify(
        surface.vertices.astype(np.float32), surface.faces.astype(np.int32), target_count=face_count, verbose=False
    )
    _, nearest = cKDTree(surface.vertices).query(vertices)
    return Surface(np.asarray(vertices, np.float64), np.asarray(faces, np.int64), surface.colors[nearest])


def _closed(surface: Surface) -> Surface | None:
    """A surface that is closed, as it is indexed or once equal corners are one (textures split them); None for an open one.

    Faces of the same three corners count once where that closes the surface: some programs list each face again for
    its other side. Two closed bodies that touch have such faces, too, and keep both.
    """
    made = joined(surface)
    single = distinct_faces(made)
    if len(single.faces) < len(made.faces) and is_closed(single.faces):
        return _consistent(single)
    if is_closed(surface.faces):
        return surface
    return made if is_closed(made.faces) else None


def distinct_faces(surface: Surface) -> Surface:
    """A surface with the first of the faces that have the same three corners, in whichever order."""
    first, _ = distinct_rows(np.sort(surface.faces, axis=1))
    return dataclasses.replace(surface, faces=surface.faces[np.sort(first)])


def _consistent(surface: Surface) -> Surface:
    """A closed surface whose faces are wound the same way around."""
    import trimesh

    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
    return dataclasses.replace(surface, faces=np.asarray(mesh.faces, dtype=np.int64))


def joined(surface: Surface) -> Surface:
    """A surface whose equal corners are one, without the faces that are lines then."""
    first, place = welded(surface.vertices, 7)
    faces = place[surface.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return Surface(surface.vertices[first], faces, surface.colors[first])


def _volume(surface: Surface, closed: Surface | None) -> float:
    """Volume of a surface whose closed form is known [m3]; its hull's volume when it is open or wound inconsistently."""
    import trimesh

    hull = hull_volume(surface)
    if closed is None or not trimesh.Trimesh(closed.vertices, closed.faces, process=False).is_winding_consistent:
        return hull
    volume = abs(enclosed_volume(closed.vertices, closed.faces))
    # Bodies that reach into each other count twice in the sum over faces, never more than the hull holds.
    return min(volume, hull) if volume > 0 else hull


def hull_volume(surface: Surface) -> float:
    """Volume of the convex hull [m3], 0 for what is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(surface.vertices).volume)
    except QhullError:
        return 0.0
