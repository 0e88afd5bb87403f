"""glTF files with their buffers and images in files next to them: packed into a GLB, then read as one."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.capture.files.named import Folders
from tasks.containers import Document, close_glb
from tasks.library.format import ModelFormat, ReadModel

_IMAGE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}


def _read(path: Path, root: Path) -> ReadModel:
    """The model in a glTF.

    Raises:
        InputError: it is broken, larger than the budget, or a buffer is missing or lies outside of the folder.
    """
    from tasks.geometry.gltf.plain import read_features
    from tasks.geometry.meshes import load_glb

    name = path.relative_to(root).as_posix()
    packed, notes = packed_gltf(path, root, name)
    try:
        plain = read_features(packed, name)
        parts = load_glb(plain.data, name)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(name, "meshes", f"are broken ({error})", "export it again") from error
    return ReadModel(parts, GLTF.name, 1.0, "y", is_turned=True, notes=(*notes, *plain.notes))


def packed_gltf(path: Path, root: Path, name: str) -> tuple[bytes, list[str]]:
    """A glTF as a GLB with its buffers and images, and the images that are missing, a line each.

    Raises:
        InputError: it is not a glTF, or a buffer is missing or lies outside of the folder.
    """
    document = _document(path, name)
    binary = bytearray()
    starts: list[int] = []
    for index, buffer in enumerate(_listed(document, "buffers")):
        uri = buffer.get("uri")
        if not isinstance(uri, str):
            raise InputError(name, f"buffer {index}", "names no file", "export it again, or as one GLB")
        data = _content(uri, path, root, name, f"buffer {index}")
        if data is None:
            raise InputError(name, f"buffer {index}", f"{_shown(uri)} is missing", "copy it next to the glTF")
        starts.append(_append(binary, data, name))
    views = _listed(document, "bufferViews")
    for index, view in enumerate(views):
        buffer, offset = view.get("buffer", 0), view.get("byteOffset", 0)
        if not _is_index(buffer, len(starts)) or not _is_index(offset, 2**40):
            raise InputError(name, f"bufferViews {index}", "names a buffer that is not there", "export it again")
        view["buffer"], view["byteOffset"] = 0, starts[buffer] + offset
    missing, notes = set(), []
    for index, image in enumerate(_listed(document, "images")):
        uri = image.get("uri")
        if not isinstance(uri, str):
            continue
        data = _content(uri, path, root, name, f"image {index}")
        if data is None:
            missing.add(index)
            notes.append(f"{name}: {_shown(uri)} is missing, drawn without it")
            data = _WHITE
        image.pop("uri")
        kind = _IMAGE_TYPES.get(Path(urlsplit(uri).path).suffix.lower(), image.get("mimeType", "image/png"))
        image["mimeType"], image["bufferView"] = image.get("mimeType", kind), len(views)
        views.append({"buffer": 0, "byteOffset": _append(binary, data, name), "byteLength": len(data)})
    if missing:
        lost = {index for index, texture in enumerate(_listed(document, "textures")) if texture.get("source") in missing}
        document["materials"] = [_without(material, lost) for material in _listed(document, "materials")]
    document["bufferViews"] = views
    document["buffers"] = [{"byteLength": len(binary)}]
    return close_glb({key: value for key, value in document.items() if value != []}, bytes(binary)), notes


_WHITE = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEANl9ngAAAAABJRU5ErkJggg==")
"""A white pixel in place of an image that is missing; no material draws with it."""


def _document(path: Path, name: str) -> Document:
    try:
        document = json_value(read_file(path, name, BUDGET.glb_json_bytes).decode("utf-8-sig"))
    except ValueError as error:
        raise InputError(name, "content", f"is not JSON ({error})"[:200], "export it again") from error
    version = document.get("asset", {}) if isinstance(document, dict) else {}
    if not isinstance(document, dict) or not isinstance(version, dict) or not str(version.get("version", "")).startswith("2"):
        raise InputError(name, "asset", "is not glTF 2.0", "export it again as glTF 2.0")
    return document


def _listed(document: Document, key: str) -> list[dict[str, Any]]:
    values = document.get(key)
    return [value if isinstance(value, dict) else {} for value in values] if isinstance(values, list) else []


def _is_index(value: object, count: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count


def _append(binary: bytearray, data: bytes, name: str) -> int:
    """Add bytes at a multiple of four, and give their start."""
    binary += b"\0" * (-len(binary) % 4)
    start = len(binary)
    if start + len(data) > BUDGET.asset_bytes:
        raise InputError(name, "buffers", f"have more than {BUDGET.asset_bytes} bytes", "decimate it")
    binary += data
    return start


def _content(uri: str, path: Path, root: Path, name: str, field: str) -> bytes | None:
    """Bytes of a data URI or of a file next to a glTF; None for a file that is missing.

    Raises:
        InputError: the file lies outside of the folder, or the data URI is broken.
    """
    if uri.startswith("data:"):
        head, comma, data = uri.partition(",")
        try:
            if not comma:
                raise ValueError("without data")
            return base64.b64decode(data, validate=True) if head.endswith(";base64") else unquote(data).encode("latin-1")
        except (binascii.Error, ValueError) as error:
            raise InputError(name, field, "has a broken data URI", "export it again") from error
    file = _file(uri, path, root)
    if file is not None:
        return read_file(file, file.name, BUDGET.asset_bytes)
    if "://" in uri or Folders(root).leads_out(unquote(uri), path.parent):
        raise InputError(name, field, f"names {_shown(uri)}, outside of the folder", "copy it in")
    return None


def _file(uri: str, path: Path, root: Path) -> Path | None:
    return Folders(root).find((unquote(uri), uri), path.parent, path.parent)


def _shown(uri: str) -> str:
    return repr(uri[:60])


def _without(value: Any, lost: set[int]) -> Any:
    """A material without the textures of some numbers."""
    if not isinstance(value, dict):
        return value
    return {
        key: _without(item, lost)
        for key, item in value.items()
        if not (key.endswith("Texture") and isinstance(item, dict) and item.get("index") in lost)
    }


def _beside(path: Path, root: Path) -> list[Path]:
    """Files that a glTF draws on, those that exist inside of `root`."""
    try:
        document = _document(path, path.name)
    except (InputError, OSError):
        return []
    return sorted({file for uri in _uris(document) if (file := _file(uri, path, root)) is not None})


def _uris(document: Document) -> Iterator[str]:
    for entry in (*_listed(document, "buffers"), *_listed(document, "images")):
        if isinstance(entry.get("uri"), str) and not entry["uri"].startswith("data:"):
            yield entry["uri"]


GLTF = ModelFormat((".gltf",), _read, _beside)
