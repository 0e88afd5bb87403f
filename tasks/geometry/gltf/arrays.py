"""Arrays of a GLB: read as stated (strides, sparse values, normalized integers), and written back as plain accessors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.gltf.features import Document, entries, objects

Array = NDArray[Any]
Floats = NDArray[np.float64]

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_COMPONENTS = {np.dtype(text): code for code, text in DTYPES.items()}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Arrays:
    """The accessors of a document over its buffers.

    buffers: contents of each buffer. views: decoded contents of compressed views, by view. unpacked: decoded arrays that replace
    accessors, by accessor, shape (count, width). decoded: the given views.
    """

    def __init__(self, document: Document, buffers: list[bytes], views: Mapping[int, bytes], unpacked: Mapping[int, Array]) -> None:
        self._accessors, self._views = entries(document, "accessors"), entries(document, "bufferViews")
        self.decoded = views
        self._buffers, self._unpacked = buffers, unpacked

    def view(self, index: int) -> bytes:
        """Copy the contents of a view.

        Raises:
            ValueError: it reaches beyond its buffer.
        """
        return bytes(self._window(index))

    def _window(self, index: int) -> memoryview:
        """Contents of a view, not copied: many accessors can share a large view; raises as `view` does."""
        if index in self.decoded:
            return memoryview(self.decoded[index])
        view = self._views[natural(index)]
        start, length = natural(view.get("byteOffset", 0)), natural(view["byteLength"])
        buffer = self._buffers[natural(view["buffer"])]
        if start + length > len(buffer):
            raise ValueError(f"bufferView {index} reaches beyond its buffer")
        return memoryview(buffer)[start : start + length]

    def raw(self, index: int) -> Array:
        """Elements of an accessor in its own type, shape (count, width); zeros where no buffer holds them.

        Raises:
            ValueError: it reaches beyond its view, or is of an unknown type.
        """
        if index in self._unpacked:
            return self._unpacked[index]
        accessor = self._accessors[natural(index)]
        if accessor.get("componentType") not in DTYPES or accessor.get("type") not in WIDTHS:
            raise ValueError(f"accessor {index} has the type {accessor.get('componentType')!r}, {accessor.get('type')!r}")
        dtype, width, count = np.dtype(DTYPES[accessor["componentType"]]), WIDTHS[accessor["type"]], natural(accessor["count"])
        if "bufferView" in accessor:
            number = natural(accessor["bufferView"])
            stride = natural(self._views[number].get("byteStride", 0)) or dtype.itemsize * width
            data, start = self._window(number), natural(accessor.get("byteOffset", 0))
            if count and (start + stride * (count - 1) + dtype.itemsize * width > len(data) or stride < dtype.itemsize * width):
                raise ValueError(f"accessor {index} reaches beyond its view")
            values = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize)) if count else np.zeros((0, width), dtype)
        else:
            values = np.zeros((count, width), dtype)
        return self._with_sparse(accessor, values) if "sparse" in accessor else values

    def _with_sparse(self, accessor: Document, values: Array) -> Array:
        """Elements with the sparse ones in their places."""
        sparse = objects(accessor["sparse"])[0]
        count, (where, what) = natural(sparse["count"]), (objects(sparse[key])[0] for key in ("indices", "values"))
        kind = np.dtype(DTYPES[where["componentType"]])
        places = np.frombuffer(self._window(where["bufferView"]), kind, count, natural(where.get("byteOffset", 0)))
        data, start = self._window(what["bufferView"]), natural(what.get("byteOffset", 0))
        changed = values.copy()
        changed[places] = np.frombuffer(data, values.dtype, count * values.shape[1], start).reshape(count, -1)
        return changed

    def is_normalized(self, index: int) -> bool:
        """True if the integers of an accessor stand for numbers from -1 or 0 to 1."""
        return self._accessors[index].get("normalized") is True

    def numbers(self, index: int) -> Floats:
        """Elements of an accessor as numbers, normalized integers scaled, shape (count, width)."""
        values = self.raw(index)
        if not self.is_normalized(index) or values.dtype.kind == "f":
            return values.astype(np.float64)
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)


class ArrayWriter:
    """Views and accessors of a new document, all in one buffer."""

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._chunks: list[bytes] = []
        self._size = 0
        self._known: dict[tuple[bytes, str], int] = {}

    def view(self, data: bytes, target: int | None = None) -> int:
        """A view of bytes; the number."""
        padding = b"\0" * (-len(data) % 4)
        stated: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        self.views.append(stated | ({} if target is None else {"target": target}))
        self._chunks += [data, padding]
        self._size += len(data) + len(padding)
        return len(self.views) - 1

    def accessor(self, values: Array, is_index: bool = False, is_normalized: bool = False) -> int:
        """An accessor of values, shape (count, width), in their own type; equal arrays share one."""
        values = np.ascontiguousarray(values)
        data, kind = values.tobytes(), f"{values.dtype.str} {values.shape} {is_index} {is_normalized}"
        if (data, kind) not in self._known:
            stated: dict[str, Any] = {
                "bufferView": self.view(data, 34963 if is_index else 34962), "componentType": _COMPONENTS[values.dtype],
                "count": len(values), "type": _SHAPES[values.shape[1]],
            }  # fmt: skip
            stated |= {"normalized": True} if is_normalized else {}
            if len(values) and values.shape[1] == 3 and values.dtype.kind == "f":
                stated |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
            self.accessors.append(stated)
            self._known[data, kind] = len(self.accessors) - 1
        return self._known[data, kind]

    def binary(self) -> bytes:
        """Contents of the buffer."""
        return b"".join(self._chunks)


def natural(value: Any) -> int:
    """A number from 0.

    Raises:
        ValueError: it is another value.
    """
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r:.40} is not a number from 0")
    return value
