"""Textures that are written as the files they came from: no second loss of a JPEG, and no ten times larger PNG of it."""

from __future__ import annotations

import io
from typing import Any

ENCODED = "encoded file"
"""Key in a texture's `info`: the image file as it was in the GLB."""

_TEXTURES = ("baseColorTexture", "image", "emissiveTexture", "normalTexture", "occlusionTexture", "metallicRoughnessTexture")


class _EncodedImage:
    """A texture that is written as the file it came from."""

    def __init__(self, data: bytes) -> None:
        self.format = "JPEG" if data[:2] == b"\xff\xd8" else "PNG"
        self._data = data

    def save(self, file: Any, format: str = "") -> None:
        file.write(self._data)


def encoded_image(data: bytes) -> Any:
    """The image of a JPEG or PNG file, which `tasks.geometry.meshes.dump_glb` writes as that file."""
    from PIL import Image

    image = Image.open(io.BytesIO(data))
    image.load()
    image.info[ENCODED] = data
    return image


def encoded_file(part: Any) -> tuple[bytes, str] | None:
    """The file that a part's base color image came from, and `png` or `jpg`; None where that is not known."""
    image = getattr(getattr(getattr(part, "visual", None), "material", None), "baseColorTexture", None)
    data = getattr(image, "info", {}).get(ENCODED)
    return None if data is None else (data, "jpg" if data[:2] == b"\xff\xd8" else "png")


def textures(part: Any, of_any_kind: bool = False) -> list[tuple[Any, str, Any]]:
    """Material, attribute and image of every texture of a part; what is no image only if asked for."""
    material = getattr(getattr(part, "visual", None), "material", None)
    maps = [(material, name, getattr(material, name, None)) for name in _TEXTURES] if material is not None else []
    return [(m, name, image) for m, name, image in maps if hasattr(image, "info") or (of_any_kind and image is not None)]


def has_image(part: Any) -> bool:
    """True if a part shows an image that was read, rather than the color of its material or its vertices."""
    uv = getattr(part.visual, "uv", None)
    has_coordinates = uv is not None and len(uv) == len(part.vertices)
    return has_coordinates and any(name in ("baseColorTexture", "image") for _, name, _ in textures(part))


def keep_encoded(part: Any) -> None:
    """Remember the image file of every texture that was not decoded yet; copies carry it along."""
    for _, _, image in textures(part):
        file: Any = getattr(image, "fp", None)
        if image.format in ("JPEG", "PNG") and hasattr(file, "getvalue"):
            image.info[ENCODED] = file.getvalue()


def put_encoded(part: Any) -> None:
    """Let the textures of a part be written as the files that they came from."""
    for material, name, image in textures(part):
        if ENCODED in image.info:
            setattr(material, name, _EncodedImage(image.info[ENCODED]))
