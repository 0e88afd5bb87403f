"""Boxes whose color is stated in every way that glTF has, written by hand, and the color that they show."""

from __future__ import annotations

import dataclasses
import io
import json
import struct
from typing import Any

import numpy as np
import trimesh
from PIL import Image

MID, DARK, SATURATED, TINT = (166, 165, 165), (12, 4, 2), (160, 60, 40), (200, 180, 220)
SIDE_M = 0.3


def decoded(display: Any) -> np.ndarray:
    """Linear values of sRGB bytes, by the standard's own formula."""
    return np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.ravel(display) / 255])


def encoded(linear: Any) -> np.ndarray:
    """sRGB bytes of linear values, not rounded, by the standard's own formula."""
    return np.array([255 * (12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055) for c in np.ravel(linear)])


@dataclasses.dataclass(frozen=True)
class Colored:
    """A box of one color. vertex, factor, light: linear RGB. image: sRGB. kind: the type of vertex colors.

    is_glossy: factor and image are those of a specular-glossiness material.
    """

    name: str
    vertex: np.ndarray | None = None
    factor: np.ndarray | None = None
    image: tuple[int, ...] | None = None
    light: np.ndarray | None = None
    kind: str = "<f4"
    is_glossy: bool = False

    @property
    def displayed(self) -> np.ndarray:
        """The color that is seen, sRGB from 0 to 255, shape (3,)."""
        if self.light is not None:
            return encoded(self.light)
        product = np.ones(3) if self.vertex is None else _stored(self.vertex, self.kind)[1]
        product = product * (1.0 if self.factor is None else self.factor)
        return encoded(product * (1.0 if self.image is None else decoded(self.image)))

    def glb(self) -> bytes:
        """A GLB of the box, which stands on the floor."""
        box = trimesh.creation.box((SIDE_M, SIDE_M, SIDE_M))
        points = (np.asarray(box.vertices) + np.array([0, SIDE_M / 2, 0])).astype("<f4")
        chunks: list[bytes] = []
        document = _document()

        def add(data: bytes, **accessor: Any) -> int:
            start = sum(len(chunk) for chunk in chunks)
            chunks.append(data + b"\0" * (-len(data) % 4))
            document["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": len(data)})
            number = len(document["bufferViews"]) - 1
            if not accessor:
                return number
            document["accessors"].append({"bufferView": number, **accessor})
            return len(document["accessors"]) - 1

        limits = {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
        attributes = {"POSITION": add(points.tobytes(), componentType=5126, type="VEC3", count=8, **limits)}
        primitive: dict[str, Any] = {"attributes": attributes}
        faces = np.asarray(box.faces, dtype="<u4")
        primitive["indices"] = add(faces.tobytes(), componentType=5125, type="SCALAR", count=36)
        if self.vertex is not None:
            rows = np.tile(_stored(self.vertex, self.kind)[0], (8, 1))
            component = {"<f4": 5126, "<u2": 5123, "u1": 5121}[self.kind]
            attributes["COLOR_0"] = add(rows.tobytes(), componentType=component, type="VEC4", count=8, normalized=self.kind != "<f4")
        if self.image is not None:
            file = io.BytesIO()
            Image.new("RGB", (4, 4), self.image).save(file, "PNG")
            document["images"] = [{"mimeType": "image/png", "bufferView": add(file.getvalue())}]
            document["textures"] = [{"source": 0}]
            uv = np.random.default_rng(0).random((8, 2)).astype("<f4")
            attributes["TEXCOORD_0"] = add(uv.tobytes(), componentType=5126, type="VEC2", count=8)
        look: dict[str, Any] = {"metallicFactor": 0.0}
        if self.factor is not None:
            look["baseColorFactor"] = [*self.factor.tolist(), 1.0]
        if self.image is not None:
            look["baseColorTexture"] = {"index": 0}
        material: dict[str, Any] = {"pbrMetallicRoughness": look}
        if self.light is not None:
            look["baseColorFactor"], material["emissiveFactor"] = [0.0, 0.0, 0.0, 1.0], self.light.tolist()
        if self.is_glossy:
            names = {"baseColorFactor": "diffuseFactor", "baseColorTexture": "diffuseTexture"}
            gloss = {given: look[name] for name, given in names.items() if name in look}
            material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}}
            document["extensionsUsed"] = list(material["extensions"])
        if self.factor is not None or self.image is not None or self.light is not None:
            document["materials"], primitive["material"] = [material], 0
        document["meshes"] = [{"primitives": [primitive]}]
        binary = b"".join(chunks)
        document["buffers"] = [{"byteLength": len(binary)}]
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        parts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


def _document() -> dict[str, Any]:
    nodes = [{"name": "box", "mesh": 0}]
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes, "accessors": [], "bufferViews": [],
    }  # fmt: skip


def _stored(linear: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """RGBA of a type, shape (4,), and the linear RGB that it states, shape (3,)."""
    most = {"<f4": 1.0, "<u2": 65535.0, "u1": 255.0}[kind]
    rgba = np.append(linear, 1.0) * most
    stored = (rgba if kind == "<f4" else np.round(rgba)).astype(kind)
    return stored, stored[:3].astype(np.float64) / most


COLORED = (
    *(Colored(f"vertices {color}", vertex=decoded(color)) for color in (MID, DARK, SATURATED)),
    Colored("vertices of 16 bits", vertex=decoded(DARK), kind="<u2"),
    Colored("vertices of 8 bits", vertex=decoded(SATURATED), kind="u1"),
    *(Colored(f"factor {color}", factor=decoded(color)) for color in (MID, DARK, SATURATED)),
    Colored("image", image=SATURATED),
    Colored("image and factor", image=TINT, factor=decoded(MID)),
    Colored("image and dark factor", image=TINT, factor=decoded((40, 80, 20))),
    Colored("vertices and factor", vertex=decoded(TINT), factor=decoded(MID)),
    Colored("vertices and image", vertex=decoded(MID), image=TINT),
    Colored("all three", vertex=decoded(MID), image=TINT, factor=decoded(SATURATED)),
    Colored("light alone", light=decoded(SATURATED)),
    Colored("diffuse color", factor=decoded(SATURATED), is_glossy=True),
    Colored("diffuse image and color", image=TINT, factor=decoded(MID), is_glossy=True),
    Colored("nothing stated"),
)
"""Midtones, dark and saturated colors; every product of vertex colors, factor and image."""
