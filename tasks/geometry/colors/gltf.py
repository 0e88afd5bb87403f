"""Colors of glTF documents: linear in the file, display values in the project.

Readers see factors and `COLOR_0` as display values, so whatever decodes the file next need not know of color spaces.
"""

from __future__ import annotations

import base64
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

_GLOSS = "KHR_materials_pbrSpecularGlossiness"
_NUMBERS = {5121: ("<u1", 255), 5123: ("<u2", 65535), 5126: ("<f4", 1)}
_WIDTHS = {"VEC3": 3, "VEC4": 4}
_OFFSETS = {5121: "<u1", 5123: "<u2", 5125: "<u4"}


def displayed_glb(data: bytes, document: Document, file: str) -> bytes:
    """A GLB whose factors and vertex colors are display values, for a decoder that does not convert them.

    Vertex colors are multiplied by their material's factor and take its place. With a texture, their mean goes
    into the factor. A material that only emits light shows that light.

    Args:
        data: the GLB.
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
    return _closed(copied.document, bytes(copied.binary))


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
        self.document, self.binary, self._file = document, bytearray(binary), file
        self._materials = [_linear_look(material) for material in _listed(document, "materials")]
        self._known: dict[tuple[Any, ...], int] = {}

    def convert(self) -> None:
        for primitive in [p for mesh in _listed(self.document, "meshes") for p in _listed(mesh, "primitives")]:
            attributes = _mapping(primitive, "attributes")
            if "COLOR_0" in attributes:
                self._color(primitive, attributes)
        for material in _listed(self.document, "materials"):
            _display_factor(material)

    def _color(self, primitive: Document, attributes: Document) -> None:
        """Merge the colors and the material of a primitive."""
        number, material, factor = primitive.get("material"), {}, np.ones(4)
        if number is not None:
            if type(number) is not int or not 0 <= number < len(self._materials):
                return  # a material that is not there: the decoder refuses it
            material, stated = self.document["materials"][number], self._materials[number]
            if stated is None:
                return  # a factor that is not a color: the reader refuses it
            factor = stated
        colors, points = attributes.pop("COLOR_0"), attributes.get("POSITION")
        if "TEXCOORD_0" in attributes and "baseColorTexture" in _mapping(material, "pbrMetallicRoughness"):
            primitive["material"] = self._tinted(number, self._linear(colors, points), factor)
            return
        key = (repr(colors), *factor.tolist())
        if key not in self._known:
            self._known[key] = self._add(self._linear(colors, points) * factor)
        attributes["COLOR_0"] = self._known[key]
        primitive.pop("material", None)

    def _tinted(self, number: Any, colors: Array, factor: Array) -> int:
        """Index of a copy of a material, times the mean of vertex colors, shape (n, 4). Its factor is linear still."""
        look = factor * colors.mean(axis=0)
        key = ("texture", number, *look.tolist())
        if key not in self._known:
            material = copy.deepcopy(self.document["materials"][number])
            material["pbrMetallicRoughness"]["baseColorFactor"] = look.tolist()
            self.document["materials"].append(material)
            self._known[key] = len(self.document["materials"]) - 1
        return self._known[key]

    def _add(self, linear: Array) -> int:
        """Index of a new accessor with the display bytes of linear colors, shape (n, 4)."""
        alpha = np.round(255 * np.clip(linear[:, 3:], 0, 1)).astype(np.uint8)
        data = np.hstack([bytes_of_linear(linear[:, :3]), alpha]).tobytes()
        buffers, views = (self.document.setdefault(name, []) for name in ("buffers", "bufferViews"))
        if not buffers or "uri" in buffers[0]:  # only the first buffer may be the binary chunk
            text = base64.b64encode(data).decode()
            buffers.append({"uri": f"data:application/octet-stream;base64,{text}", "byteLength": len(data)})
            views.append({"buffer": len(buffers) - 1, "byteOffset": 0, "byteLength": len(data)})
        else:
            self.binary += b"\0" * (-len(self.binary) % 4)
            views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
            self.binary += data
            buffers[0]["byteLength"] = len(self.binary)
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
        buffer = self.document["buffers"][_natural(view["buffer"])]
        data: bytes | bytearray = self.binary
        if "uri" in buffer:
            data = base64.b64decode(str(buffer["uri"]).partition("base64,")[2])
        start, size = _natural(view.get("byteOffset", 0)), _natural(view["byteLength"])
        wide = np.dtype(kind).itemsize * width
        stride = _natural(view.get("byteStride", wide)) or wide
        held = bytes(data[start : start + size])[_natural(offset) :]
        if count and (count - 1) * stride + wide > len(held):
            raise ValueError("ends before its last row")
        rows: NDArray[Any] = np.ndarray((count, width), kind, held, strides=(stride, np.dtype(kind).itemsize))
        return rows.astype(np.float64)


def _is_tinted(material: Any) -> bool:
    """True if a material has a color that needs conversion."""
    return "baseColorFactor" in _mapping(material, "pbrMetallicRoughness") or _GLOSS in _mapping(material, "extensions")


def _is_black(material: Any) -> bool:
    """True if a material emits light and reflects none."""
    factor = _numbers(_mapping(material, "pbrMetallicRoughness").get("baseColorFactor"), 4)
    light = _numbers(material.get("emissiveFactor") if isinstance(material, dict) else None, 3)
    return factor is not None and light is not None and not factor[:3].any() and bool(light.any())


def _linear_look(material: Any) -> Array | None:
    """Linear base color factor of a material, shape (4,). Diffuse color or emitted light take its place, in the material too.

    None if its factor is not a color.
    """
    gloss = _mapping(_mapping(material, "extensions"), _GLOSS)
    if gloss:
        names = {"diffuseFactor": "baseColorFactor", "diffuseTexture": "baseColorTexture"}
        look = {name: gloss[given] for given, name in names.items() if given in gloss}
        material["pbrMetallicRoughness"] = {"baseColorFactor": [1.0] * 4, "metallicFactor": 0.0, **look}
        del material["extensions"][_GLOSS]
    if _is_black(material):
        look, light = material["pbrMetallicRoughness"], _numbers(material.pop("emissiveFactor"), 3)
        stated = _mapping(_mapping(material, "extensions"), "KHR_materials_emissive_strength").get("emissiveStrength", 1.0)
        strength, factor = _numbers([stated], 1), _numbers(look["baseColorFactor"], 4)
        assert light is not None
        assert factor is not None
        look["baseColorFactor"] = [*np.clip(light * (1.0 if strength is None else strength), 0, 1).tolist(), float(factor[3])]
        texture = material.pop("emissiveTexture", None)
        look.pop("baseColorTexture", None)
        if texture is not None:
            look["baseColorTexture"] = texture
    return _numbers(_mapping(material, "pbrMetallicRoughness").get("baseColorFactor", [1.0] * 4), 4)


def _display_factor(material: Any) -> None:
    """Make the base color factor of a material a display value, in place."""
    look = _mapping(material, "pbrMetallicRoughness")
    factor = _numbers(look.get("baseColorFactor"), 4)
    if factor is not None:
        look["baseColorFactor"] = [*display_of(factor[:3]).tolist(), float(factor[3])]


def _numbers(value: Any, count: int) -> Array | None:
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
    value = document.get(name) if isinstance(document, dict) else None
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
