"""Parts of an OBJ: one for each of its materials, with the material's color or image, or with colors of vertices."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.capture.files.obj import ObjText, parse_obj
from tasks.geometry.colors import bytes_of_linear, linear_of
from tasks.geometry.meshes import check_looks
from tasks.ingestion.materials import ObjMaterial, read_materials

if TYPE_CHECKING:
    import trimesh


def obj_parts(data: bytes, path: Path, root: Path, name: str) -> tuple[list[trimesh.Trimesh], list[str]]:
    """Parts of an OBJ in its own frame, and notes on what is not read, a line each.

    Args:
        data: its text, as `tasks.ingestion.materials.decoded` gives it.
        path: the file, next to which its materials lie.
        root: folder outside of which nothing is opened.
        name: the file, for messages.

    Raises:
        InputError: it is broken or larger than the budget, or its materials name a file outside `root`.
    """
    import trimesh

    materials = read_materials(data, path, root)
    if materials.outside:
        raise InputError(name, "materials", f"name {materials.outside[0]!r}, outside the dataset's folder", "copy it in")
    text = parse_obj(data, name)
    notes = dict.fromkeys((*materials.notes, *text.notes))
    scene, images = trimesh.Scene(), dict[Path, Any]()
    parts = []
    for number in np.unique(text.materials):
        faces = text.materials == number
        look = materials.looks.get(text.names[number]) if number >= 0 else None
        if number >= 0 and look is None and materials.looks:
            notes[f"material {text.names[number]!r:.80} is in no library, drawn without it"] = None
        if look is not None and look.image is not None and look.image not in images:
            images[look.image] = _image(look.image, notes)
        part = _part(text, faces, look, images.get(look.image) if look is not None and look.image is not None else None, notes)
        parts.append(part)
        scene.add_geometry(part, node_name=f"part_{len(parts)}", geom_name=f"part_{len(parts)}")
    check_looks(scene, name)
    return parts, [f"{name}: {note}" for note in notes]


def _part(text: ObjText, is_chosen: NDArray[np.bool_], look: ObjMaterial | None, image: Any, notes: dict[str, None]) -> trimesh.Trimesh:
    """The triangles of one material; vertices are split where they have several texture coordinates."""
    import trimesh

    corners = np.column_stack([text.faces[is_chosen].ravel(), text.corners[is_chosen].ravel()])
    if image is not None and (corners[:, 1] < 0).any():
        notes["some faces lack texture coordinates for their image: drawn without it"] = None
        image = None
    if image is None:
        corners[:, 1] = -1
    used, faces = np.unique(corners, axis=0, return_inverse=True)
    mesh = trimesh.Trimesh(text.vertices[used[:, 0]], faces.reshape(-1, 3), process=False)
    factor = np.asarray((look or ObjMaterial()).color)
    visual: Any = mesh.visual
    if image is not None and look is not None:
        if text.colors is not None:
            notes["colors of vertices under an image are not read"] = None
        uv = text.coordinates[used[:, 1]] * look.scale + look.offset
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=_material(factor, image))
    elif text.colors is not None:
        colors = bytes_of_linear(linear_of(text.colors[used[:, 0]] / 255.0) * linear_of(factor))
        visual.vertex_colors = np.column_stack([colors, np.full(len(colors), 255, dtype=np.uint8)])
    elif look is not None:
        mesh.visual = trimesh.visual.TextureVisuals(material=_material(factor, None))
    return mesh


def _material(color: NDArray[np.float64], image: Any) -> Any:
    import trimesh

    return trimesh.visual.material.SimpleMaterial(diffuse=color.tolist(), image=image)


def _image(file: Path, notes: dict[str, None]) -> Any:
    """An image, not decoded yet: its size is checked first; None, and a note, for one that cannot be decoded."""
    from PIL import Image

    try:
        data = read_file(file, file.name, BUDGET.model_bytes)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sizes are checked where images are decoded
            return Image.open(io.BytesIO(data))
    except Exception:  # the decoder raises whatever the bytes lead it to
        notes[f"{file.name} cannot be decoded, drawn without it"] = None
        return None
