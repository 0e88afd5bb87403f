"""Reader of a modelled scene: a GLB whose nodes are named `model|category|part`, or just named."""

from __future__ import annotations

import re

import numpy as np

from schemas.errors import InputError
from tasks.capture.documents import license_of, name_of, read_bytes
from tasks.capture.formats import Scan, glb_file
from tasks.capture.ply import check_vertices
from tasks.capture.reading import Group, Reading
from tasks.meshes import load_glb, parse_node_name, surface_of

MAX_GLB_BYTES = 2 * 2**30
"""A worker with 8 GB can still unpack it."""


def read_glb_scene(scan: Scan) -> Reading:
    """The parts of a scene; those of one model are one instance. The frame is the file's, turned to +Z up.

    Raises:
        InputError: it is no GLB, holds no triangles, or is not in metres.
    """
    path = glb_file(scan.path)
    folder = path.parent
    name = name_of(path, folder)
    data = read_bytes(path, name, MAX_GLB_BYTES)
    if data[:4] != b"glTF":
        raise InputError(name, "content", "is no GLB", "export it as glTF binary")
    try:
        parts = load_glb(data, name)
        surface = surface_of(parts)
    except (ValueError, IndexError) as error:
        raise InputError(name, "meshes", f"are broken ({error})", "export it again") from error
    check_vertices(surface.vertices, name)
    if not np.isfinite(surface.vertices).all():
        raise InputError(name, "meshes", "have coordinates that are not finite", "export it again")
    members: dict[tuple[str, str], list[int]] = {}
    for index, part in enumerate(parts):
        named = parse_node_name(str(part.metadata["name"]))
        label = named["category"] if "|" in str(part.metadata["name"]) else _plain_label(named["model"])
        members.setdefault((named["model"], label), []).append(index)
    face_starts = np.concatenate([[0], np.cumsum([len(part.faces) for part in parts])])
    vertex_starts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in parts])])
    groups = tuple(
        Group(
            source_id=model,
            raw_label=label,
            vertices=np.concatenate([np.arange(vertex_starts[i], vertex_starts[i + 1]) for i in own]),
            faces=np.concatenate([np.arange(face_starts[i], face_starts[i + 1]) for i in own]),
            origin=f"{path.name}: node {str(parts[own[0]].metadata['name'])!r:.100}",
        )
        for (model, label), own in sorted(members.items())
    )
    return Reading(
        surface=surface,
        parts=tuple(parts),
        groups=groups,
        frames=(),
        alignment=None,
        room_type="",
        license=license_of(folder),
        is_dense=False,
        degradations=("no frames in the scene: no views, no masks",),
        glb=data,
    )


def _plain_label(name: str) -> str:
    """Label in a node's name that has no bars: without the numbers at its end (`Chair.001`, `table_2`)."""
    return re.sub(r"([._\s-]*\d+)+$", "", name) or name
