"""Instances from an over-segmentation and its aggregation, as ScanNet and several data sets after it write them: a segment for every
vertex or face (`segIndices`), and for each instance a label and its segments (`segGroups`)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.wording import counted
from tasks.capture.files.annotated_rows import instance_rows, whole_numbers
from tasks.capture.reading import Group, by_owner, groups_of, groups_of_faces
from tasks.geometry.meshes import Surface


def vertex_groups(
    document: dict[str, Any], name: str, of_vertex: NDArray[np.int64], segmented: str, surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    """Instances of the aggregation `document`, in its order, and what was odd about them.

    name, segmented: What errors call the aggregation and the file of segments. of_vertex: Segment of each vertex, shape (n,).

    A vertex that two instances claim belongs to the smaller one. A wrong value costs its instance at most, and is noted.

    Raises:
        InputError: the aggregation is none, or most of its instances have no segment that exists.
    """
    owned = _owned(document, name, of_vertex, segmented, "vertices")
    return _with_origins(groups_of(owned.named, owned.owner, surface), owned), owned.notes


def face_groups(
    document: dict[str, Any], name: str, of_face: NDArray[np.int64], segmented: str, surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    """The same of a mesh whose faces are segmented; see `vertex_groups`. of_face: Segment of each face, shape (m,)."""
    owned = _owned(document, name, of_face, segmented, "faces")
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


@dataclasses.dataclass(frozen=True)
class _Claim:
    """An instance as listed: its place in the list, its number, its label, and its own vertices or faces, sorted."""

    index: int
    number: int
    label: str
    own: NDArray[np.int64]


def _owned(document: dict[str, Any], name: str, of_element: NDArray[np.int64], segmented: str, elements: str) -> _Owned:
    claims, notes = _claims(document, name, of_element, segmented)
    owner = np.full(len(of_element), -1, dtype=np.int64)
    shared = 0
    for place in sorted(range(len(claims)), key=lambda place: len(claims[place].own)):
        own = claims[place].own
        free = own[owner[own] < 0]  # a vertex belongs to one instance
        shared += len(own) - len(free)
        owner[free] = place
    named: list[tuple[str, str, NDArray[np.int64]]] = []
    origins: list[str] = []
    kept = np.full(len(claims) + 1, -1, dtype=np.int64)
    for place, (claim, own) in enumerate(zip(claims, by_owner(owner, len(claims)), strict=True)):
        if len(own):
            kept[place] = len(named)
            named.append((str(claim.number), claim.label, own))
            origins.append(f"{Path(name).name}: segGroups[{claim.index}].label")
        else:
            notes.append(f"instance {claim.number} ({claim.label}): has no {elements} of its own, left out")
    if shared:
        notes.append(f"{shared} {elements} are claimed by two instances: they stay with the smaller")
    return _Owned(named, kept[owner], origins, notes)


def _claims(
    document: dict[str, Any], name: str, of_element: NDArray[np.int64], segmented: str
) -> tuple[list[_Claim], list[str]]:  # fmt: skip
    """Instances of the aggregation with the elements of those of their segments that exist, and notes on what is wrong."""
    listed = document.get("segGroups")
    if not isinstance(listed, list):
        raise InputError(name, "segGroups", "must be a list of instances", "is it the right file?")
    rows, notes = instance_rows(listed, Path(name).name, "segGroups")
    segments, dense = np.unique(of_element, return_inverse=True)
    order = np.argsort(dense, kind="stable")
    starts = np.searchsorted(dense[order], np.arange(len(segments) + 1))
    claims: list[_Claim] = []
    foreign = 0
    for row in rows:
        field = f"{Path(name).name}: segGroups[{row.index}].segments"
        ids, unreadable = whole_numbers(row.entry.get("segments"))
        if unreadable:
            notes.append(f"{field}: {counted(unreadable, 'value')} cannot be read as a number: left out")
        places = np.minimum(np.searchsorted(segments, ids), max(len(segments) - 1, 0))
        exists = segments[places] == ids if len(segments) else np.zeros(len(ids), dtype=bool)
        if not exists.all():
            missing = ids[~exists]
            problem = f"names segment {missing[0]}, which {Path(segmented).name} does not have"
            notes.append(f"{field}: {problem} ({len(missing)} in all): left out")
        foreign += int(len(ids) > 0 and not exists.any())
        parts = [order[starts[place] : starts[place + 1]] for place in np.unique(places[exists])]
        claims.append(_Claim(row.index, row.number, row.label, np.sort(np.concatenate(parts)) if parts else ids[:0]))
    if 2 * foreign > len(claims):
        problem = f"name segments that {Path(segmented).name} does not have, in {foreign} of {counted(len(claims), 'instance')}"
        raise InputError(name, "segGroups", problem, "use aggregation and segments of one and the same scan")
    return claims, notes
