"""Instances from an over-segmentation and its aggregation, as ScanNet and several data sets after it write them: a segment for every
vertex or face (`segIndices`), and for each instance a label and its segments (`segGroups`)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import integers, plain_text
from tasks.capture.reading import Group, by_owner, groups_of, groups_of_faces
from tasks.geometry.meshes import Surface


def vertex_groups(
    document: dict[str, Any], name: str, of_vertex: NDArray[np.int64], segmented: str, surface: Surface, smaller_first: bool = False
) -> tuple[tuple[Group, ...], list[str]]:
    """Instances of the aggregation `document`, in its order, and what was odd about them.

    name, segmented: What errors call the aggregation and the file of segments. of_vertex: Segment of each vertex, shape (n,).
    smaller_first: What two instances claim is the smaller one's, as where a set labels things within things; else the first one's.

    Raises:
        InputError: the aggregation is none, or names segments that are not there.
    """
    owned = _owned(document, name, of_vertex, segmented, "vertices", smaller_first)
    return _with_origins(groups_of(owned.named, owned.owner, surface), owned), owned.notes


def face_groups(
    document: dict[str, Any], name: str, of_face: NDArray[np.int64], segmented: str, surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    """The same of a mesh whose faces are segmented; see `vertex_groups`. of_face: Segment of each face, shape (m,)."""
    owned = _owned(document, name, of_face, segmented, "faces", smaller_first=False)
    return _with_origins(groups_of_faces([part[:2] for part in owned.named], owned.owner, surface), owned), owned.notes


@dataclasses.dataclass(frozen=True)
class _Owned:
    """What of the vertices or faces is whose. named: Number, label and own elements of each instance. owner: Instance of each element,
    -1 for none, shape (n,). origins: Where the label of each is read from."""

    named: list[tuple[str, str, NDArray[np.int64]]]
    owner: NDArray[np.int64]
    origins: list[str]
    notes: list[str]


def _with_origins(groups: tuple[Group, ...], owned: _Owned) -> tuple[Group, ...]:
    origins = {source_id: origin for (source_id, _, _), origin in zip(owned.named, owned.origins, strict=True)}
    return tuple(dataclasses.replace(group, origin=origins[group.source_id]) for group in groups)


def _owned(
    document: dict[str, Any], name: str, of_element: NDArray[np.int64], segmented: str, elements: str, smaller_first: bool
) -> _Owned:
    listed = document.get("segGroups")
    if not isinstance(listed, list):
        raise InputError(name, "segGroups", "must be a list of instances", "is it the right file?")
    segments, dense = np.unique(of_element, return_inverse=True)
    order = np.argsort(dense, kind="stable")
    starts = np.searchsorted(dense[order], np.arange(len(segments) + 1))
    claims: list[tuple[str, str, NDArray[np.int64]]] = []
    seen: set[int] = set()
    for index, entry in enumerate(listed):
        number, label, ids = _group(entry, name, f"segGroups[{index}]")
        if number in seen:
            raise InputError(name, f"segGroups[{index}].objectId", f"{number} names two instances", "give every instance its own number")
        seen.add(number)
        places = np.minimum(np.searchsorted(segments, ids), len(segments) - 1)
        missing = ids[segments[places] != ids]
        if len(missing):
            problem = f"names segment {missing[0]}, which {Path(segmented).name} does not have"
            raise InputError(name, f"segGroups[{index}].segments", problem, "use aggregation and segments of one and the same scan")
        own = np.sort(np.concatenate([order[starts[p] : starts[p + 1]] for p in np.unique(places)])) if len(ids) else ids
        claims.append((str(number), label, own))
    owner = np.full(len(of_element), -1, dtype=np.int64)
    shared = 0
    for index in sorted(range(len(claims)), key=lambda i: len(claims[i][2])) if smaller_first else range(len(claims)):
        own = claims[index][2]
        free = own[owner[own] < 0]  # a vertex belongs to one instance
        shared += len(own) - len(free)
        owner[free] = index
    named: list[tuple[str, str, NDArray[np.int64]]] = []
    origins: list[str] = []
    notes: list[str] = []
    kept = np.full(len(claims) + 1, -1, dtype=np.int64)
    for index, ((object_id, label, _), own) in enumerate(zip(claims, by_owner(owner, len(claims)), strict=True)):
        if len(own):
            kept[index] = len(named)
            named.append((object_id, label, own))
            origins.append(f"{Path(name).name}: segGroups[{index}].label")
        else:
            notes.append(f"instance {object_id} ({label}): has no {elements} of its own, left out")
    owner = kept[owner]
    if shared:
        notes.append(f"{shared} {elements} are claimed by two instances: they stay with the {'smaller' if smaller_first else 'first'}")
    return _Owned(named, owner, origins, notes)


def _group(entry: Any, name: str, field: str) -> tuple[int, str, NDArray[np.int64]]:
    if not isinstance(entry, dict):
        raise InputError(name, field, "must be an object", "is it the right file?")
    object_id = entry.get("objectId", entry.get("id"))
    if not isinstance(object_id, int) or isinstance(object_id, bool) or not 0 <= object_id < 2**62:
        raise InputError(name, f"{field}.objectId", "must be a number from 0", "is it the right file?")
    label = entry.get("label", "")
    if not isinstance(label, str):
        raise InputError(name, f"{field}.label", "must be a text", "is it the right file?")
    ids = integers(entry.get("segments"), name, f"{field}.segments", minimum=-(2**62))
    return object_id, plain_text(label), ids
