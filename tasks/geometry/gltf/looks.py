"""Looks of primitives in a plain GLB: one set of texture coordinates, one repeated image, vertex colors, a material."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from schemas.errors import InputError
from tasks.geometry.colors.gltf import emitted_light, is_black, numbers_of
from tasks.geometry.gltf.arrays import Array, Arrays, ArrayWriter, Floats, natural
from tasks.geometry.gltf.features import GLOSS, TRANSFORM, Document, entries, extension_of, objects
from tasks.geometry.gltf.images import REPEAT, Images, Padding, repeated_lookup

_UNLIT = "KHR_materials_unlit"
_PBR, _BASE = "pbrMetallicRoughness", "baseColorTexture"
_OTHERS = ("normalTexture", "occlusionTexture", "emissiveTexture")
_COLOR_UNITS = {"|u1": 255.0, "<u2": 65535.0, "<f4": 1.0}  # full intensity, by the types that `COLOR_0` may have


@dataclasses.dataclass(frozen=True)
class PlainLook:
    """Look of a primitive.

    material: of the new document, white under colors. uv: shape (n, 2). colors: linear RGBA from 0 to 1, shape (n, 4).
    """

    material: int | None = None
    uv: Floats | None = None
    colors: Array | None = None


class PlainLooks:
    """Materials of a document as plain ones, written as they are asked for.

    materials, textures, images: of the new document. notes: lines on what is not read.
    """

    def __init__(self, document: Document, arrays: Arrays, writer: ArrayWriter, file: str) -> None:
        self.materials: list[dict[str, Any]] = []
        self.textures: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self._document, self._arrays, self._writer, self._file = document, arrays, writer, file
        self._source = Images(document, arrays, file)
        self._notes: dict[str, None] = {}
        self._known: dict[str, int] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines on what is not read."""
        return (*self._source.notes, *self._notes)

    def _note(self, text: str) -> None:
        self._notes[f"{self._file}: {text}"] = None

    def note_misfits(self, attributes: list[str], name: str) -> None:
        """Note attributes of a mesh that are not as many as its positions."""
        if attributes:
            self._note(f"mesh {name}: {', '.join(attributes)} are not as many as its positions: drawn without them")

    def of(self, primitive: Document, attributes: dict[str, Floats], faces: Array, name: str) -> PlainLook:
        """The look of a primitive.

        Args:
            primitive: of the old document.
            attributes: its attributes as numbers, morph targets applied, shape (n, width).
            faces: vertices of its triangles, shape (m, 3).
            name: its mesh, for notes.
        """
        colors = self._vertex_colors(attributes, name)
        if "material" not in primitive:
            return PlainLook(colors=colors)
        material = entries(self._document, "materials")[primitive["material"]]
        plain = self._plain_material(material)
        base = plain[_PBR].pop(_BASE, None)
        uv, image, padding = None, None, Padding()
        if base is not None and (index := self._source.image_of(objects(base)[0].get("index"))) is not None:
            uv = self._coordinates(objects(base)[0], attributes, name)
            if uv is not None:
                wraps = self._wraps(base["index"])
                lookup = repeated_lookup(uv, faces, wraps, self._source.size(index))
                if not lookup.is_exact:
                    self._note(f"mesh {name}: its clamped texture is read at the vertices alone")
                uv, padding, image = lookup.uv, lookup.padding, self._image(index, lookup.padding)
        if image is not None:
            plain[_PBR][_BASE] = {"index": self._texture(image)}
        self._add_others(material, plain, base, padding, name)
        if colors is not None:
            colors = self._mixed(plain, colors, image is not None, name)
        if uv is None:
            uv = attributes.get("TEXCOORD_0")
        return PlainLook(self._add(self.materials, plain), uv, colors)

    def colors(self, index: Any) -> Floats:
        """Vertex colors of an accessor, linear, shape (n, width); whole numbers are scaled.

        Raises:
            InputError: it is not an accessor of colors.
        """
        try:
            values = self._arrays.raw(natural(index))
            most = _COLOR_UNITS[values.dtype.str]
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            problem = f"is not an accessor of colors ({type(error).__name__}: {error})"[:200]
            raise InputError(self._file, "COLOR_0", problem, "export it again") from error
        return values.astype(np.float64) / most

    def _vertex_colors(self, attributes: dict[str, Floats], name: str) -> Array | None:
        """Linear RGBA of each vertex; None without colors, or with colors that do not fit."""
        colors = attributes.get("COLOR_0")
        if colors is None:
            return None
        if colors.shape[1] not in (3, 4):
            self._note(f"mesh {name}: COLOR_0 has {colors.shape[1]} numbers for each vertex: drawn without it")
            return None
        colors = np.clip(np.nan_to_num(colors), 0.0, 1.0)
        return colors if colors.shape[1] == 4 else np.column_stack([colors, np.ones(len(colors))])

    def _mixed(self, plain: dict[str, Any], colors: Array, has_image: bool, name: str) -> Array | None:
        """Vertex colors times the factor of a material, which turns white; None if the material states the whole color.

        Raises:
            ValueError: the factor is not a color.
        """
        look = plain[_PBR]
        factor = numbers_of(look.get("baseColorFactor", [1.0] * 4), 4)
        if factor is None:
            raise ValueError(f"mesh {name} has a baseColorFactor that is not a color")
        # Vertex colors change reflected light alone, so a black surface shows the light that it emits.
        if is_black(plain):
            return None
        is_varying = np.ptp(colors, axis=0).max(initial=0.0) >= 1e-3
        if has_image or not is_varying:
            if is_varying:
                self._note(f"mesh {name}: vertex colors over a texture are read as their mean")
            look["baseColorFactor"] = (factor * colors.mean(axis=0)).tolist()
            return None
        if any(key in plain for key in _OTHERS) or "metallicRoughnessTexture" in look:
            self._note(f"mesh {name}: textures other than the base color of its vertex-colored surface are not read")
        look.pop("baseColorFactor", None)
        return np.clip(colors * factor, 0.0, 1.0)

    def _plain_material(self, material: Document) -> dict[str, Any]:
        """A material without extensions and without textures other than the base color's."""
        plain = {key: material[key] for key in ("name", "alphaMode", "alphaCutoff", "doubleSided", "emissiveFactor") if key in material}
        light = emitted_light(material)
        if light is not None:
            plain["emissiveFactor"] = light.tolist()
        gloss = extension_of(material, GLOSS)
        if gloss:
            if "specularGlossinessTexture" in gloss or any(gloss.get("specularFactor", [])):
                self._note(f"{GLOSS}: specular colors are not read")
            factors = {"metallicFactor": 0.0, "roughnessFactor": 1.0 - float(gloss.get("glossinessFactor", 1.0))}
            plain[_PBR] = factors | {"baseColorFactor": gloss.get("diffuseFactor", [1.0] * 4)}
            plain[_PBR] |= {_BASE: gloss["diffuseTexture"]} if "diffuseTexture" in gloss else {}
        else:
            stated = objects(material.get(_PBR, {}))[0]
            plain[_PBR] = {key: value for key, value in stated.items() if key not in ("extensions", "extras", "metallicRoughnessTexture")}
        if _UNLIT in objects(material.get("extensions", {}))[0]:
            plain["extensions"] = {_UNLIT: {}}
        return plain

    def _add_others(self, material: Document, plain: dict[str, Any], base: Any, padding: Padding, name: str) -> None:
        """Add the textures of a material that are looked up where its base color is; note the others."""
        stated = objects(material.get(_PBR, {}))[0]
        holders = [(plain, key, material.get(key)) for key in _OTHERS]
        if not extension_of(material, GLOSS):
            holders.append((plain[_PBR], "metallicRoughnessTexture", stated.get("metallicRoughnessTexture")))
        for holder, key, value in holders:
            if not isinstance(value, dict):
                continue
            is_alike = _BASE not in plain[_PBR] or _placing(value) == _placing(objects(base)[0])
            if not is_alike or not padding.is_empty or (_BASE not in plain[_PBR] and _placing(value) != _placing({})):
                self._note(f"mesh {name}: its {key} has texture coordinates of its own: drawn without it")
            elif (index := self._source.image_of(value.get("index"))) is not None:
                kept = {number: value[number] for number in ("scale", "strength") if number in value}
                holder[key] = {"index": self._texture(self._image(index, Padding()))} | kept

    def _coordinates(self, info: Document, attributes: dict[str, Floats], name: str) -> Floats | None:
        """Texture coordinates that a texture is looked up at, transformed, shape (n, 2); None where the mesh lacks them."""
        number, moved = info.get("texCoord", 0), extension_of(info, TRANSFORM)
        number = moved.get("texCoord", number)
        uv = attributes.get(f"TEXCOORD_{number}")
        if uv is None or uv.shape[1] != 2:
            self._note(f"mesh {name}: lacks the texture coordinates {number!r:.20} of its base color: drawn without its texture")
            return None
        if not moved:
            return uv
        angle = float(moved.get("rotation", 0.0))
        offset, scale = (
            np.array(moved.get(key, start), dtype=np.float64).reshape(2) for key, start in (("offset", [0, 0]), ("scale", [1, 1]))
        )
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        result: Floats = (uv * scale) @ turn.T + offset
        return result

    def _wraps(self, texture: int) -> tuple[int, int]:
        """Wrap modes of a texture along u and v."""
        stated = entries(self._document, "textures")[texture]
        samplers = entries(self._document, "samplers")
        sampler = samplers[stated["sampler"]] if "sampler" in stated else {}
        return sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)

    def _image(self, index: int, padding: Padding) -> int:
        """An image of the new document, extended."""
        data = self._source.file(index) if padding.is_empty else self._source.padded(index, padding)
        key = f"{index} {padding}"
        if key not in self._known:
            assert data is not None
            kind = "image/jpeg" if data[:2] == b"\xff\xd8" else "image/png"
            self.images.append({"bufferView": self._writer.view(data), "mimeType": kind})
            self._known[key] = len(self.images) - 1
        return self._known[key]

    def _texture(self, image: int) -> int:
        return self._add(self.textures, {"source": image})

    def _add(self, listed: list[dict[str, Any]], value: dict[str, Any]) -> int:
        """Number of a value in a list, added unless it is there."""
        key = f"{id(listed)} {json.dumps(value, sort_keys=True, default=str)}"
        if key not in self._known:
            listed.append(value)
            self._known[key] = len(listed) - 1
        return self._known[key]


def _placing(info: Document) -> str:
    """Texture coordinates and transform of a texture, to be compared."""
    moved = extension_of(info, TRANSFORM)
    return json.dumps([moved.get("texCoord", info.get("texCoord", 0)), {k: v for k, v in moved.items() if k != "texCoord"}], sort_keys=True)
