"""Instances of a scan as rows: meaning, box, points, mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance
from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.merged import own_part
from tasks.capture.labels import Label
from tasks.capture.reading import Group
from tasks.geometry.meshes import Surface, dump_glb, dump_points, material_of, sample_texture
from tasks.geometry.transforms import flat
from tasks.geometry.triangles import spread, surface_area, used_vertices
from tasks.stage import Blobs

Array = NDArray[np.float64]

_SAMPLES_PER_M2 = 4000
"""Points on modelled surfaces: one every 16 mm, as close as a scan mesh has its vertices."""

_MIN_SAMPLES = 200


@dataclasses.dataclass(frozen=True)
class InstancePoints:
    """An instance in the world frame: points [m], shape (n, 3), colors, shape (n, 3), and faces of the scan mesh."""

    points: Array
    colors: NDArray[np.uint8]
    faces: NDArray[np.int64]
    is_exact: bool


def scanned_solid(surface: Surface, group: Group) -> InstancePoints:
    """An instance whose points are vertices of the scan mesh."""
    return InstancePoints(surface.vertices[group.vertices], surface.colors[group.vertices], group.faces, is_exact=False)


def modelled_solid(
    surface: Surface, group: Group, parts: Sequence[object], starts: NDArray[np.int64], rng: np.random.Generator, most: int
) -> InstancePoints:
    """An instance whose points are spread over its faces, colored by its textures.

    parts: Textured parts that make up the surface, in its order. starts: First face of each part, shape (len(parts) + 1,).
    """
    own = Surface(surface.vertices, surface.faces[group.faces], surface.colors)
    area = surface_area(own.vertices, own.faces)
    face, weights = spread(own.vertices, own.faces, int(np.clip(area * _SAMPLES_PER_M2, _MIN_SAMPLES, most)), rng)
    points = np.einsum("nk,nkd->nd", weights, own.vertices[own.faces[face]])
    colors = np.round(np.einsum("nk,nkd->nd", weights, own.colors[own.faces[face]].astype(np.float64))).astype(np.uint8)
    whole = group.faces[face]
    owner = np.searchsorted(starts, whole, side="right") - 1
    for index in np.unique(owner):
        part = parts[int(index)]
        visual = part.visual  # type: ignore[attr-defined]
        if visual.kind != "texture" or visual.uv is None or len(visual.uv) != len(part.vertices):  # type: ignore[attr-defined]
            continue
        image, factor = material_of(part)  # type: ignore[arg-type]
        if image is not None:
            mine = owner == index
            uv = np.asarray(visual.uv)[np.asarray(part.faces)[whole[mine] - starts[index]]]  # type: ignore[attr-defined]
            colors[mine] = sample_texture(image, np.einsum("nk,nkd->nd", weights[mine], uv), factor)
    return InstancePoints(points, colors, group.faces, is_exact=True)


def instance_row(
    scene_id: str, instance_id: str, group: Group, label: Label, solid: InstancePoints, surface: Surface, blobs: Blobs,
    rng: np.random.Generator, most: int, found_by: str, probability: float | None,
) -> Instance:  # fmt: skip
    """The row of an instance, without its views; keeps at most `most` points in its blob. found_by, probability: See `Instance`."""
    pose, size = box_of(solid, surface, label.category)
    count = len(solid.points)
    kept = np.sort(rng.choice(count, most, replace=False)) if count > most else np.arange(count)
    return Instance(
        scene_id=scene_id,
        instance_id=instance_id,
        source_id=group.source_id,
        raw_label=group.raw_label,
        category=label.category,
        nyu40_id=label.nyu40_id,
        nyu40_label=label.nyu40_label,
        is_structure=label.is_structure,
        found_by=found_by,
        category_probability=probability,
        room_index=None,
        box_pose=flat(pose),
        box_size=tuple(float(v) for v in size),
        box_volume_m3=float(np.prod(size)),
        hidden_m=None,
        point_count=count,
        points_blob=blobs.add(dump_points(solid.points[kept], solid.colors[kept]), "ply"),
        mesh_blob=blobs.add(cropped_mesh(surface, solid.faces), "glb") if len(solid.faces) else None,
        view_blob=None,
        best_frames=(),
    )


def box_of(solid: InstancePoints, surface: Surface, category: str) -> tuple[Array, Array]:
    """The oriented box of an instance: to the world frame, 4x4 [m], origin at its center, and its extents [m], shape (3,)."""
    exact = surface.vertices[used_vertices(surface.faces[solid.faces], len(surface.vertices))[0]] if solid.is_exact else solid.points
    own = exact if solid.is_exact else exact[own_part(exact, category)]
    return oriented_box(own, is_noisy=not solid.is_exact)


def cropped_mesh(surface: Surface, faces: NDArray[np.int64]) -> bytes:
    """GLB of some faces of a surface, in its frame, without the vertices that no face uses."""
    used, dense = used_vertices(surface.faces[faces], len(surface.vertices))
    return dump_glb([Surface(surface.vertices[used], dense, surface.colors[used]).to_trimesh()], ["instance"])
