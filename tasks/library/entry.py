"""An entry of the index: everything that is known of one model, as plain values, and as bytes that are a function of them."""

from __future__ import annotations

import base64
import dataclasses
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset, TextureCharts
from schemas.parsing import json_value
from tasks.library.descriptors import Descriptor
from tasks.library.fields import SurfaceField

Vectors = NDArray[np.float32]


@dataclasses.dataclass(frozen=True, eq=False)
class IndexEntry:
    """A model of a library.

    file: Path relative to the library, forward slashes. content: Hash of the file and all that it draws on, 64 hex digits.
    format: As in `tasks.library.formats`. unit_m: Metres per unit [m]; up, front: its axes; front is '' where nobody says. `*_known`: How,
    `file`, `metadata`, `plausibility` or `assumed`. category_known: `lvis`, `tags`, `name`, `product_type`, `index` ... or `file name`.
    license: SPDX where there is one. extents: Of the canonical model along x, y, z [m]. descriptor, field: What it is found by.
    signature: What equal geometry has in common, shape (34,). image_vectors: Of pictures from around, shape (k, d), and text_vector: of
    its name and category, shape (d,), by the model `weights` (a hash), where one was named. asset: What candidates are given: its files
    are made of the model's again, or lie where the index was made. charts: How its texture is laid out, as far as that is known. notes:
    What is odd or missing, a line each. duplicate_of: The file that holds the same, '' for the first; duplicate_by: `bytes`, or
    `geometry`, whatever its colors.
    """

    file: str
    content: str
    format: str
    unit_m: float
    unit_known: str
    up: str
    up_known: str
    front: str
    front_known: str
    category: str
    category_known: str
    name: str
    license: str
    is_noncommercial: bool
    author: str
    source_url: str
    extents: tuple[float, float, float]
    vertex_count: int
    face_count: int
    has_texture: bool
    descriptor: Descriptor
    field: SurfaceField
    signature: Vectors
    image_vectors: Vectors | None
    text_vector: Vectors | None
    weights: str
    asset: Asset
    charts: TextureCharts | None
    notes: tuple[str, ...]
    duplicate_of: str = ""
    duplicate_by: str = ""


_ARRAYS = {"descriptor": Descriptor, "field": SurfaceField}


def dumped(entry: IndexEntry) -> bytes:
    """An entry as bytes; equal entries give equal bytes."""
    values = {field.name: _plain(getattr(entry, field.name)) for field in dataclasses.fields(entry)}
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def loaded(data: bytes) -> IndexEntry:
    """The entry in bytes of `dumped`.

    Raises:
        ValueError: they are none, or of other code.
    """
    values = json_value(data)
    names = {field.name for field in dataclasses.fields(IndexEntry)}
    if not isinstance(values, dict) or set(values) != names:
        raise ValueError("no entry of an index")
    try:
        return IndexEntry(**{name: _filled(name, value) for name, value in values.items()})
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"no entry of an index ({error})") from error


def _plain(value: Any) -> Any:
    """A value of an entry as JSON has it."""
    if isinstance(value, np.ndarray):
        kept = np.ascontiguousarray(value)
        return {"type": kept.dtype.newbyteorder("<").str, "shape": list(kept.shape), "data": base64.b64encode(kept.tobytes()).decode()}
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    return value


def _filled(name: str, value: Any) -> Any:
    """A value of an entry out of JSON."""
    if name == "charts":
        return None if value is None else TextureCharts(**value)
    if name == "asset":
        stated: dict[str, Any] = value | {"extents": tuple(value["extents"])}
        return Asset(**stated)
    if name in _ARRAYS:
        return _ARRAYS[name](**{key: _array(item) for key, item in value.items()})
    if isinstance(value, dict):
        return _array(value)
    return tuple(value) if isinstance(value, list) else value


def _array(value: dict[str, Any]) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(value["data"]), dtype=value["type"]).reshape(value["shape"])
