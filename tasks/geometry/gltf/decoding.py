"""Compressed contents of a GLB: Draco primitives, meshopt views and Basis Universal images, decoded together in one child."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from tasks.confinement import Limits, run_child
from tasks.geometry.gltf.arrays import DTYPES, WIDTHS, Array, Arrays, natural
from tasks.geometry.gltf.child import DATA, DECODED, JOBS
from tasks.geometry.gltf.features import DRACO, MESHOPT, Document, entries, extension_of

_CODE = "from tasks.geometry.gltf.child import main; main()"
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")


@dataclasses.dataclass(frozen=True)
class DecodingJob:
    """Bytes to decode. kind: `draco`, `meshopt` or `basis`. options: parameters of the decoder."""

    kind: str
    data: bytes
    options: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Decoded:
    """The result of a job: arrays by name, or the problem."""

    arrays: dict[str, Array]
    problem: str = ""


def decode(jobs: list[DecodingJob], max_bytes: int, file: str) -> list[Decoded]:
    """Decode all jobs in one child.

    Args:
        jobs: compressed contents.
        max_bytes: most bytes that they may decode to, all together.
        file: the file, for messages.

    Raises:
        InputError: the child exceeds a limit or dies.
    """
    if not jobs:
        return []
    ends = np.cumsum([len(job.data) for job in jobs]).tolist()
    listed = [
        job.options | {"kind": job.kind, "start": end - len(job.data), "end": end} for job, end in zip(jobs, ends, strict=True)
    ]  # fmt: skip
    written = min(max_bytes + 2**20, BUDGET.scene_bytes)
    limits = Limits.of_file(ends[-1], written)
    limits = dataclasses.replace(limits, memory=limits.memory + 2 * written)
    with temporary_folder() as folder:
        (folder / JOBS).write_text(json.dumps(listed))
        (folder / DATA).write_bytes(b"".join(job.data for job in jobs))
        facts = run_child(_CODE, [str(folder), str(written)], folder, limits, file)["jobs"]
        data = read_file(folder / DECODED, file, written)
    return [_decoded(fact, data) for fact in facts]


def _decoded(fact: dict[str, Any], data: bytes) -> Decoded:
    if "problem" in fact:
        return Decoded({}, str(fact["problem"]))
    arrays = {}
    for name, (dtype, shape, start) in fact["arrays"].items():
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(data, np.dtype(dtype), count, start).reshape(shape)
    return Decoded(arrays)


def decoded_views(document: Document, buffers: list[bytes], file: str) -> dict[int, bytes]:
    """Contents of the views that meshopt compressed, by view.

    Raises:
        InputError: one cannot be decoded.
    """
    jobs: dict[int, tuple[str, DecodingJob]] = {}
    for index, view in enumerate(entries(document, "bufferViews")):
        name = next((entry for entry in MESHOPT if extension_of(view, entry)), None)
        if name is None:
            continue
        stated = extension_of(view, name)
        start, length = natural(stated.get("byteOffset", 0)), natural(stated["byteLength"])
        data = buffers[natural(stated["buffer"])][start : start + length]
        stride, count = natural(stated["byteStride"]), natural(stated["count"])
        mode, kind = stated["mode"], stated.get("filter", "NONE")
        if mode not in _MODES or kind not in _FILTERS or len(data) != length or stride * count > _most_decoded(document):
            raise InputError(file, f"bufferView {index}", f"states no readable {name}", "export it again")
        jobs[index] = name, DecodingJob("meshopt", data, {"count": count, "stride": stride, "mode": mode, "filter": kind})
    results = decode([job for _, job in jobs.values()], _most_decoded(document), file)
    views = {}
    for (index, (name, _)), result in zip(jobs.items(), results, strict=True):
        if result.problem:
            raise InputError(file, f"bufferView {index}", f"{name} cannot be decoded ({result.problem})", "export it again")
        views[index] = result.arrays["view"].tobytes()
    return views


def decoded_accessors(document: Document, arrays: Arrays, file: str) -> dict[int, Array]:
    """Arrays of the primitives that Draco compressed, by accessor; those that the file holds uncompressed as well are left to it.

    Raises:
        InputError: one cannot be decoded, or differs from its accessor in count or width.
    """
    accessors, places = entries(document, "accessors"), []
    jobs: dict[int, DecodingJob] = {}
    for mesh in entries(document, "meshes"):
        for primitive in entries(mesh, "primitives"):
            stated = extension_of(primitive, DRACO)
            if stated and not _is_held(primitive, accessors):
                number = natural(stated["bufferView"])
                jobs.setdefault(number, DecodingJob("draco", arrays.view(number)))
                places.append((primitive, dict(stated["attributes"]), number))
    results = dict(zip(jobs, decode(list(jobs.values()), _most_decoded(document), file), strict=True))
    decoded: dict[int, Array] = {}
    for primitive, ids, number in places:
        if results[number].problem:
            raise InputError(file, f"bufferView {number}", f"{DRACO} cannot be decoded ({results[number].problem})", "export it again")
        mesh_arrays = results[number].arrays
        values = {primitive["attributes"][name]: mesh_arrays.get(str(id_)) for name, id_ in ids.items() if name in primitive["attributes"]}
        if "indices" in primitive:
            values[primitive["indices"]] = mesh_arrays["faces"].reshape(-1, 1)
        for index, array in values.items():
            stated = accessors[natural(index)]
            if array is None or len(array) != stated.get("count") or array.shape[1] != WIDTHS.get(stated.get("type", "")):
                raise InputError(file, f"accessor {index}", f"differs from its {DRACO}", "export it again")
            kind = np.dtype(DTYPES[stated["componentType"]])
            decoded[index] = array if array.dtype.kind == kind.kind == "f" or index == primitive.get("indices") else array.astype(kind)
    return decoded


def _is_held(primitive: Document, accessors: list[dict[str, Any]]) -> bool:
    """True if a compressed primitive is in the file uncompressed as well."""
    named = [*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive else [])]
    return all("bufferView" in accessors[natural(index)] for index in named)


def _most_decoded(document: Document) -> int:
    """Most bytes that compressed contents may decode to: the accessors' own, and what their decoder adds to them."""
    accessors = entries(document, "accessors")
    stated = sum(natural(entry["count"]) * WIDTHS.get(entry.get("type", ""), 16) * 4 for entry in accessors)
    return 4 * stated + sum(natural(entry["byteLength"]) for entry in entries(document, "bufferViews")) + BUDGET.zero_bytes
