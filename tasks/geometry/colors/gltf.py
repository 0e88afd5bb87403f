"""Colors of glTF documents: linear in the file, display values in the project.

Readers see factors and `COLOR_0` as display values, so whatever decodes the file next need not know of color spaces.
"""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.geometry.colors import Array, bytes_of_linear, display_of, linear_of

Document = dict[str, Any]

PAINT: Document = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
"""Material of vertices with colors. Without one, viewers show glTF's default, a metal that is black without a sky."""

GRAY = 180
"""Display value of meshes without any color, which readers of scans and the viewer share."""

BARE: Document = {
    "pbrMetallicRoughness": {
        "baseColorFactor": [*np.round(linear_of([GRAY / 255] * 3), 6).tolist(), 1.0], **PAINT["pbrMetallicRoughness"]
    }
}  # fmt: skip
"""Material of meshes without any color: other readers show the gray that the project shows."""

_STRENGTH = "KHR_materials_emissive_strength"
_NUMBERS = {5121: ("<u1", 255), 5126: ("<f4", 1)}
_WIDTHS = {"VEC3": 3, "VEC4": 4}
_OFFSETS = {5121: "<u1", 5123: "<u2", 5125: "<u4"}


def displayed_glb(data: bytes, document: Document, file: str) -> bytes:
    """A GLB whose factors and vertex colors are display values, for a decoder that does not convert them.

    Vertex colors take the place of their material. A material that only emits light shows that light.

    Args:
        data: a plain GLB (`tasks.geometry.gltf.plain`): vertex colors are multiplied by the factor of their
            material already, and their mean is in the factor if there is a texture.
        document: its JSON document, which stays as it is.
        file: name for errors.

    Raises:
        InputError: vertex colors cannot be read.
    """
    primitives = [p for mesh in _listed(document, "meshes") for p in _listed(mesh, "primitives")]
    is_colored = any("COLOR_0" in _mapping(primitive, "attributes") for primitive in primitives)
    if not is_colored and not any(_is_tinted(material) for material in _listed(document, "materials")):
        return data
    copied = _Pass(copy.deepcopy(document), _binary_of(data), file)
    try:
        copied.convert()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        problem = f"cannot be converted ({type(error).__name__}: {error})"[:200]
        raise InputError(file, "colors", problem, "export it again") from error
    return _closed(copied.document, copied.binary)


def put_linear(tree: Document) -> None:
    """Make the display values of a document that trimesh wrote linear, in place.

    Vertex colors are the attribute `_COLOR_0`, linear and 16 bits already; glTF's own name and meaning replace it.
    """
    for material in tree.get("materials", []):
        look = material.get("pbrMetallicRoughness", {})
        if "baseColorFactor" in look:
            *color, alpha = look["baseColorFactor"]
            look["baseColorFactor"] = [*linear_of(color).tolist(), alpha]
    for primitive in (p for mesh in tree.get("meshes", []) for p in mesh["primitives"]):
        colors = primitive["attributes"].pop(COLORS, None)
        if colors is not None:
            primitive["attributes"]["COLOR_0"] = colors
            tree["accessors"][colors]["normalized"] = True
        if "material" not in primitive:
            materials = tree.setdefault("materials", [])
            material = BARE if colors is None else PAINT
            if material not in materials:
                materials.append(material)
            primitive["material"] = materials.index(material)


COLORS = "_COLOR_0"
"""Attribute that carries 16-bit vertex colors through trimesh, which writes 8 bits as `COLOR_0`."""


class _Pass:
    """One conversion of a document and its binary chunk."""

    def __init__(self, document: Document, binary: bytes, file: str) -> None:
        self.document, self._file = document, file
        self._source, self._added = binary, bytearray()
        self._known: dict[str, int] = {}

    @property
    def binary(self) -> bytes:
        """The binary chunk with the added colors."""
        return self._source + self._added

    def convert(self) -> None:
        for primitive in [p for mesh in _listed(self.document, "meshes") for p in _listed(mesh, "primitives")]:
            attributes = _mapping(primitive, "attributes")
            if "COLOR_0" in attributes:
                self._color(primitive, attributes)
        for material in _listed(self.document, "materials"):
            _show_light(material)
            _display_factor(material)

    def _color(self, primitive: Document, attributes: Document) -> None:
        """Make the vertex colors of a primitive display values, which take the place of its material."""
        number = primitive.get("material", 0)
        if "material" in primitive and (type(number) is not int or not 0 <= number < len(_listed(self.document, "materials"))):
            return  # a material that is not there: the decoder refuses it
        colors = attributes["COLOR_0"]
        if repr(colors) not in self._known:
            self._known[repr(colors)] = self._add(self._linear(colors, attributes.get("POSITION")))
        attributes["COLOR_0"] = self._known[repr(colors)]
        primitive.pop("material", None)

    def _add(self, linear: Array) -> int:
        """Index of a new accessor with the display bytes of linear colors, shape (n, 4)."""
        alpha = np.round(255 * np.clip(linear[:, 3:], 0, 1)).astype(np.uint8)
        data = np.hstack([bytes_of_linear(linear[:, :3]), alpha]).tobytes()
        buffers, views = (self.document.setdefault(name, []) for name in ("buffers", "bufferViews"))
        if not buffers:
            buffers.append({})
        self._added += b"\0" * (-(len(self._source) + len(self._added)) % 4)
        views.append({"buffer": 0, "byteOffset": len(self._source) + len(self._added), "byteLength": len(data)})
        self._added += data
        buffers[0]["byteLength"] = len(self._source) + len(self._added)
        accessors = self.document["accessors"]
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": 5121, "normalized": True, "type": "VEC4", "count": len(linear)}
        )  # fmt: skip
        return len(accessors) - 1

    def _linear(self, index: Any, points: Any) -> Array:
        """Vertex colors of an accessor as linear RGBA, shape (n, 4).

        Raises:
            InputError: it is not an accessor of colors, or has another count than the accessor of positions.
        """
        try:
            if self.document["accessors"][_natural(index)]["count"] != self.document["accessors"][_natural(points)]["count"]:
                raise ValueError("another count than POSITION")
            accessor = self.document["accessors"][_natural(index)]
            kind, most = _NUMBERS[accessor["componentType"]]
            width, count = _WIDTHS[accessor["type"]], _natural(accessor["count"])
            if not count:
                raise ValueError("no colors")
            if "bufferView" in accessor:
                values = self._rows(accessor["bufferView"], accessor.get("byteOffset", 0), kind, width, count)
            else:
                values = np.zeros((count, width))
            if "sparse" in accessor:
                values = self._replaced(values, accessor["sparse"], kind, width)
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            problem = f"is not an accessor of colors ({type(error).__name__}: {error})"[:200]
            raise InputError(self._file, "COLOR_0", problem, "export it again") from error
        colors = np.ones((count, 4))
        colors[:, :width] = np.clip(np.nan_to_num(values / most), 0, 1)
        return colors

    def _replaced(self, values: Array, sparse: Mapping[str, Any], kind: str, width: int) -> Array:
        """Values with those that a sparse accessor states, shape (n, width)."""
        places, stated, count = sparse["indices"], sparse["values"], _natural(sparse["count"])
        offsets = _OFFSETS[places["componentType"]]
        rows = self._rows(places["bufferView"], places.get("byteOffset", 0), offsets, 1, count)
        changed = values.copy()
        changed[rows.ravel().astype(np.int64)] = self._rows(stated["bufferView"], stated.get("byteOffset", 0), kind, width, count)
        return changed

    def _rows(self, number: Any, offset: Any, kind: str, width: int, count: int) -> Array:
        """Numbers of a buffer view, shape (count, width)."""
        view = self.document["bufferViews"][_natural(number)]
        if view["buffer"] != 0 or not self.document["buffers"]:
            raise ValueError("lies in a buffer that is not there")
        first, size = _natural(view.get("byteOffset", 0)), _natural(view["byteLength"])
        start, wide = first + _natural(offset), np.dtype(kind).itemsize * width
        stride = _natural(view.get("byteStride", wide)) or wide
        if count and start + (count - 1) * stride + wide > min(first + size, len(self._source)):
            raise ValueError("ends before its last row")
        rows: NDArray[Any] = np.ndarray((count, width), kind, self._source, start, (stride, np.dtype(kind).itemsize))
        return rows.astype(np.float64)


def _is_tinted(material: Any) -> bool:
    """True if a material has a color that needs conversion."""
    return "baseColorFactor" in _mapping(material, "pbrMetallicRoughness")


def is_black(material: Any) -> bool:
    """True if a material emits light and reflects none."""
    factor = numbers_of(_mapping(material, "pbrMetallicRoughness").get("baseColorFactor"), 4)
    light = numbers_of(material.get("emissiveFactor") if isinstance(material, dict) else None, 3)
    return factor is not None and light is not None and not factor[:3].any() and bool(light.any())


def emitted_light(material: Mapping[str, Any]) -> Array | None:
    """Linear light that a material emits, times its strength and at most 1, shape (3,); None without readable light."""
    light = numbers_of(material.get("emissiveFactor"), 3)
    strength = numbers_of([_mapping(_mapping(material, "extensions"), _STRENGTH).get("emissiveStrength", 1.0)], 1)
    return None if light is None else np.clip(light * (1.0 if strength is None else strength), 0.0, 1.0)


def _show_light(material: Any) -> None:
    """Put the light of a material that reflects none in place of its base color."""
    light = emitted_light(material) if is_black(material) else None
    if light is None:
        return
    look = material["pbrMetallicRoughness"]
    look["baseColorFactor"] = [*light.tolist(), *look["baseColorFactor"][3:]]
    texture = material.pop("emissiveTexture", None)
    look.pop("baseColorTexture", None)
    if texture is not None:
        look["baseColorTexture"] = texture


def _display_factor(material: Any) -> None:
    """Make the base color factor of a material a display value, in place."""
    look = _mapping(material, "pbrMetallicRoughness")
    factor = numbers_of(look.get("baseColorFactor"), 4)
    if factor is not None:
        look["baseColorFactor"] = [*display_of(factor[:3]).tolist(), float(factor[3])]


def numbers_of(value: Any, count: int) -> Array | None:
    """Finite numbers of a list, shape (count,), a missing alpha as 1; None for anything else."""
    try:
        numbers = np.array([float(number) for number in value if isinstance(number, int | float)], dtype=np.float64)
    except (TypeError, OverflowError):
        return None
    if len(numbers) != len(value) or len(numbers) not in (3, count) or not np.isfinite(numbers).all():
        return None
    return numbers if len(numbers) == count else np.append(numbers, 1.0)


def _natural(value: Any) -> int:
    """A whole number of at least 0.

    Raises:
        ValueError: it is anything else.
    """
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is not a count"[:80])
    return value


def _listed(document: Any, name: str) -> list[Any]:
    """A list of a document; an empty one for anything else."""
    value = document.get(name) if isinstance(document, dict) else None
    return value if isinstance(value, list) else []


def _mapping(document: Any, name: str) -> Document:
    """A mapping of a document; an empty one for anything else."""
    value = document.get(name) if isinstance(document, Mapping) else None
    return value if isinstance(value, dict) else {}


def _binary_of(data: bytes) -> bytes:
    """The binary chunk of a GLB, empty if it has none."""
    place = 20 + int.from_bytes(data[12:16], "little")
    size = int.from_bytes(data[place : place + 4], "little")
    return data[place + 8 : place + 8 + size]


def _closed(document: Document, binary: bytes) -> bytes:
    """A GLB of a document and a binary chunk. Names may hold lone surrogates, which only escapes can write."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = binary + b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
