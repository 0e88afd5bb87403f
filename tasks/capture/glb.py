"""A modelled scene: a GLB whose nodes are named `model|category|part`, or just named."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.bare_mesh.upright import Y_UP, bare_reading
from tasks.capture.files.documents import license_of, name_of, read_bytes
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.survey import shift_note, survey_shift
from tasks.capture.joined import split_joined
from tasks.capture.labels import Label
from tasks.capture.premises import Premises
from tasks.capture.reading import Group, Reading
from tasks.capture.scan import Scan, ScanFormat, files_named, license_path, single_file
from tasks.containers import GLB_MAGIC
from tasks.geometry.gltf.plain import read_features
from tasks.geometry.meshes import Surface, load_glb, parse_node_name, surface_of
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP, translation
from tasks.geometry.triangles import face_areas

SUFFIXES = (".glb",)

MOST_SURFACE = 0.5
"""Share of a scene's surface that is more than a single object of a room has, and more than nodes without labels may have."""

_NO_LABELS = frozenset({
    "body", "circle", "combined", "component", "cone", "cube", "curve", "cylinder", "default", "element", "empty", "entity",
    "export", "fbx", "file", "geom", "geometry", "glb", "gltf", "group", "grp", "icosphere", "id", "imported", "instance", "item",
    "layer", "lod", "mat", "material", "merged", "mesh", "mesher", "meshes", "model", "models", "name", "node", "nodes", "null",
    "nurbs", "obj", "object", "objects", "output", "part", "plane", "poly", "polygon", "polysurface", "prim", "primitive",
    "primitives", "root", "scan", "scene", "shape", "solid", "sphere", "static", "sub", "submesh", "surface", "texture", "textured",
    "thing", "torus", "tri", "unnamed", "untitled", "world",
})  # fmt: skip
"""What programs call the nodes of a mesh by themselves."""


def read_glb_scene(scan: Scan) -> Reading:
    """The parts of a scene; those of one model are one instance. The frame is the file's, turned to +Z up.

    Raises:
        InputError: it is no GLB, holds no triangles, or is not in metres.
    """
    path = single_file(scan, SUFFIXES)
    folder = path.parent
    name = name_of(path, folder)
    data = read_bytes(path, name, BUDGET.scene_bytes, GLB_MAGIC)
    try:
        plain = read_features(data, name)
        parts = load_glb(plain.data, name)
        surface = surface_of(parts)
    except (ValueError, IndexError) as error:
        raise InputError(name, "meshes", f"are broken ({error})", "export it again") from error
    shift = survey_shift(surface.vertices, name) if np.isfinite(surface.vertices).all() else None
    from_file, notes = Y_UP_TO_Z_UP, ["no frames in the scene: no views, no masks"]
    if shift is not None:
        for part in parts:
            part.apply_translation(shift)
        surface, from_file = surface_of(parts), translation(shift) @ Y_UP_TO_Z_UP
        notes.append(shift_note(shift, name))
    check_vertices(surface.vertices, name)
    if not np.isfinite(surface.vertices).all():
        raise InputError(name, "meshes", "have coordinates that are not finite", "export it again")
    # A node `chair` is not a part of a model `chair|chair|seat`.
    members: dict[tuple[str, str, bool], list[int]] = {}
    for index, part in enumerate(parts):
        called = str(part.metadata["name"])
        named = parse_node_name(called)
        is_part = called.removeprefix(named["model"])[1:2] not in ("", "|")
        label = named["category"] if is_part else plain_label(named["model"])
        members.setdefault((named["model"], label, is_part), []).append(index)
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
        for (model, label, _), own in sorted(members.items())
    )
    groups, joined_notes = split_joined(groups, surface, name)
    return Reading(
        surface=surface,
        parts=tuple(parts),
        groups=groups,
        frames=(),
        alignment=None,
        room_type="",
        license=license_of(license_path(folder, scan.premises)),
        is_dense=False,
        degradations=(*notes, *plain.notes, *joined_notes),
        glb=plain.data if shift is None else None,
        from_file=from_file,
    )


def is_label(name: str) -> bool:
    """Whether a name says what an object is: `Chair.001` and `mesh_chair` do, `Mesh_0`, `geometry_0`, `Object_12` and `7f3a` do not."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_A-Za-z]+", name)
    return any((len(word) > 1 or not word.isascii()) and word.lower() not in _NO_LABELS for word in words)


def undivided(groups: Sequence[Group], meanings: Sequence[Label], surface: Surface) -> str:
    """What tells a mesh that is in one piece, or in pieces that nobody named; '' for a scene of objects.

    A node that is no wall, floor or ceiling must not hold more than MOST_SURFACE of all surface, nor must all nodes together
    whose names are no labels. groups, meanings: Nodes and what their labels mean.
    """
    areas = face_areas(surface.vertices, surface.faces)
    shares = {index: float(areas[group.faces].sum() / max(areas.sum(), 1e-12)) for index, group in enumerate(groups)}
    loose = {index: share for index, share in shares.items() if not (meanings[index].is_structure and is_label(groups[index].raw_label))}
    nameless = {index: share for index, share in loose.items() if not is_label(groups[index].raw_label)}
    largest = max(loose, key=lambda index: loose[index], default=None)
    if largest is not None and loose[largest] > MOST_SURFACE:
        return f"node {groups[largest].source_id!r:.60} holds {loose[largest]:.0%} of the surface"
    if sum(nameless.values()) > MOST_SURFACE:
        first = groups[max(nameless, key=lambda index: nameless[index])].source_id
        return f"{len(nameless)} nodes with {sum(nameless.values()):.0%} of the surface have names that are no labels, as {first!r:.60}"
    return ""


def plain_label(name: str) -> str:
    """Label in a node's name that has no bars: without the numbers at its end (`Chair.001`, `table_2`)."""
    end = len(name)
    if name[-1:].isdecimal():
        while end and (name[end - 1].isdecimal() or name[end - 1].isspace() or name[end - 1] in "._-"):
            end -= 1
    return name[:end] or name


def _recognize(folder: Path) -> str | None:
    return folder.name if len(files_named(folder, SUFFIXES)) == 1 else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    return [single_file(scan, SUFFIXES)]


def _bare(scan: Scan, reading: Reading, meanings: Sequence[Label]) -> Reading | None:
    """The file as a mesh without labels, where its nodes are no objects: instances are found in its geometry then."""
    assert reading.surface is not None
    problem = undivided(reading.groups or (), meanings, reading.surface)
    if not problem:
        return None
    name = name_of(single_file(scan, SUFFIXES), scan.folder)
    note = f"{name}: {problem}: read as a bare mesh; a node for each object (chair_01, or model|category|part) would be taken by its name"
    bare = bare_reading(reading.parts, Y_UP, (*reading.degradations, note), reading.license, name)
    assert bare.from_file is not None
    assert reading.from_file is not None
    return dataclasses.replace(bare, from_file=bare.from_file @ Z_UP_TO_Y_UP @ reading.from_file)


GLB = ScanFormat(
    name="glb",
    dataset="glb",
    expected="one .glb file",
    recognize=_recognize,
    is_recorded=lambda folder: False,
    files=_files,
    read=read_glb_scene,
    suffixes=SUFFIXES,
    is_modelled=True,
    bare=_bare,
)
