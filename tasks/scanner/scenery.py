"""A furnished scene as the scanner sees it: parts, which object each belongs to, and colors per face for rays."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.furniture.rooms import FurnishedRoom
from tasks.geometry.meshes import material_of, parse_node_name, sample_texture, vertex_colors
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import translation

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

STRUCTURE: tuple[str, ...] = ("floor", "wall", "ceiling")
"""Categories that are the room itself."""


@dataclasses.dataclass(frozen=True)
class SceneryObject:
    """What one model of a scene is. pose: Object to world, 4x4 [m], origin at the bottom center of its box; extents:
    along its own axes [m], shape (3,); parent: what it stands on, where the scene says so."""

    name: str
    category: str
    pose: Array
    extents: Array
    parent: str = ""


@dataclasses.dataclass(frozen=True)
class SceneryRoom:
    """What a furnished room says of itself. polygon: Inner floor corners [m], shape (n, 2), counter-clockwise."""

    room_type: str
    polygon: Array
    height: float


@dataclasses.dataclass(frozen=True)
class Scenery:
    """A scene to scan, in the world frame: parts, the object of every part, shape (parts,), objects, and its room if known."""

    parts: list[trimesh.Trimesh]
    object_of: NDArray[np.int64]
    objects: list[SceneryObject]
    room: SceneryRoom | None


def scenery_of(source: FurnishedRoom | Sequence[Any]) -> Scenery:
    """Scenery of a furnished room, of (node name, mesh) pairs, or of meshes that carry their node's name as metadata.

    Names are `model|category|part`; a plain name is an object and a category of its own.

    Raises:
        InputError: there are no parts.
    """
    known: dict[str, SceneryObject] = {}
    room = None
    if isinstance(source, FurnishedRoom):
        room = SceneryRoom(source.room_type, source.polygon, source.height)
        for obj in source.objects:
            known[obj.name] = SceneryObject(obj.name, obj.category, obj.pose, np.array(obj.extents), obj.parent)
        pairs = source.named_parts()
    else:
        pairs = [
            item if isinstance(item, tuple) else (str(item.metadata.get("name", f"part_{i:03d}")), item) for i, item in enumerate(source)
        ]
    if not pairs:
        raise InputError("scene", "parts", "there is nothing to scan", "name a scene with meshes")
    bounds: dict[str, Array] = {}
    categories: dict[str, str] = {}
    models = []
    for name, mesh in pairs:
        word = parse_node_name(name)
        model = word["model"]
        categories.setdefault(model, _category(word["category"]) or model)
        old = bounds.get(model)
        box = np.asarray(mesh.bounds, dtype=np.float64)
        bounds[model] = box if old is None else np.array([np.minimum(old[0], box[0]), np.maximum(old[1], box[1])])
        models.append(model)
    order = {model: index for index, model in enumerate(bounds)}
    objects = [known.get(model) or _object(model, categories[model], bounds[model]) for model in order]
    return Scenery([mesh for _, mesh in pairs], np.array([order[m] for m in models]), objects, room)


def _category(word: str) -> str:
    """A category in lower case. Scenes name a house's own parts in one word (`housewallb`, `floorb`): they become plain."""
    lower = " ".join(word.lower().replace("_", " ").split())
    part = re.fullmatch(r"(?:house|room|folding)? ?(wall|floor|ceiling|window|door)[a-z]?", lower)
    return part[1] if part else lower


def _object(model: str, category: str, bounds: Array) -> SceneryObject:
    center = bounds.mean(axis=0)
    return SceneryObject(model, category, translation([center[0], center[1], bounds[0, 2]]), bounds[1] - bounds[0])


class Paint:
    """Colors at hits of rays on a scene's parts, from vertex colors or textures, looked up for all parts at once."""

    def __init__(self, scene: RayScene) -> None:
        corners, textures = [], {}
        for index, part in enumerate(scene.parts):
            visual: Any = part.visual
            uv = getattr(visual, "uv", None)
            textured = visual.kind == "texture" and uv is not None and len(uv) == len(part.vertices)
            image, factor = material_of(part) if textured else (None, np.ones(3))
            if image is not None:
                textures[index] = (image, factor, np.asarray(uv), np.asarray(part.faces))
                corners.append(np.zeros((len(part.faces), 3, 3), dtype=np.float32))
            else:
                corners.append(vertex_colors(part)[np.asarray(part.faces)].astype(np.float32))
        self._corners = np.concatenate(corners)
        self._first = np.cumsum([0] + [len(c) for c in corners])
        self._textures = textures

    def at(self, part: NDArray[np.int64], face: NDArray[np.int64], bary: NDArray[np.float32]) -> NDArray[np.float32]:
        """RGB 0..255 at hits: part (n,), face in the part (n,), barycentric coordinates of corners 1 and 2 (n, 2); shape (n, 3)."""
        weights = np.column_stack([1 - bary.sum(axis=1), bary])
        colors = np.einsum("nk,nkd->nd", weights, self._corners[self._first[part] + face])
        if self._textures:
            for index in np.unique(part):
                if int(index) in self._textures:
                    image, factor, uv, faces = self._textures[int(index)]
                    where = part == index
                    at = np.einsum("nk,nkd->nd", weights[where], uv[faces[face[where]]])
                    colors[where] = sample_texture(image, at, factor)
        return np.asarray(colors, dtype=np.float32)
