"""One wrong value in one row of an annotation costs that row at most: every other instance of the scan is read as before."""

from __future__ import annotations

import copy
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import format_of
from tasks.capture.reading import Group, Reading
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.tasks.capture.formats import written
from tests.tasks.capture.formats.written import only_scan, read, sample

DOCUMENTS = {
    "scannet": ("scene0001_00.aggregation.json", "segGroups"),
    "scannetpp": ("scans/segments_anno.json", "segGroups"),
    "threerscan": ("semseg.v2.json", "segGroups"),
    "threerscan segments": ("semseg.v2.json", "segGroups"),
    "matterport3d": ("region_segmentations/region0.semseg.json", "segGroups"),
    "multiscan": ("scene_00000_00.annotations.json", "objects"),
    "multiscan names": ("scene_00000_00.annotations.json", "objects"),
    "arkitscenes": ("scan_3dod_annotation.json", "data"),
    "replica_v1": ("habitat/info_semantic.json", "objects"),
}
"""Annotation of each format, and its list of instances."""

WRONG: list[Any] = [None, "text", "", 0.5, 10**30, True, {}, [None]]
"""Values of other kinds than an annotation may hold; a missing value comes in addition."""


def write(kind: str, folder: Path) -> Path:
    """The sample scan in a format."""
    reading = dataclasses.replace(sample(), frames=())
    name, _, variant = kind.partition(" ")
    if name == "scannet":
        room = box_room(OBJECTS[1:2], cameras=3, step=0.1)
        return write_scannet(folder / "scene0001_00", room, aligned=False, scene_type=None, frames="none")
    place = folder / ("scene_00000_00" if name == "multiscan" else "scan")
    options: dict[str, Any] = {"is_labelled": False} if variant else {}
    if name == "arkitscenes":
        options["boxes"] = boxes_of((reading.groups or ())[-1], reading)
    getattr(written, f"write_{name}")(place, reading, **options)
    return place


def boxes_of(group: Group, reading: Reading) -> list[tuple[str, str, Any, Any]]:
    """The quarters of an instance as labelled boxes: id, label, pose and size [m]."""
    assert reading.surface is not None
    corners = reading.surface.vertices[group.vertices]
    size = np.ptp(corners, axis=0) * [0.5, 0.5, 1.0] + 0.001
    boxes = []
    for index, (x, y) in enumerate(((0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75))):
        pose = np.eye(4)
        pose[:3, 3] = corners.min(axis=0) + np.ptp(corners, axis=0) * [x, y, 0.5]
        boxes.append((f"box {index}", group.raw_label, pose, size))
    return boxes


def changes(row: Any) -> Iterator[tuple[str, Any]]:
    """Copies of a row, each with one value of it, at any depth, replaced or missing; and rows of another kind."""
    for wrong in WRONG:
        yield f"row {wrong!r}", wrong
    yield from ((f"{path} {what}", changed) for path, what, changed in _changed_parts(row))


def _changed_parts(value: Any, path: str = "") -> Iterator[tuple[str, str, Any]]:
    if isinstance(value, dict):
        for key in value:
            rest = {other: item for other, item in value.items() if other != key}
            yield f"{path}.{key}", "missing", rest
            yield from ((f"{path}.{key}", repr(wrong), value | {key: copy.deepcopy(wrong)}) for wrong in WRONG)
            yield from ((where, what, value | {key: part}) for where, what, part in _changed_parts(value[key], f"{path}.{key}"))
    elif isinstance(value, list) and value:
        yield from ((f"{path}[0]", repr(wrong), [copy.deepcopy(wrong), *value[1:]]) for wrong in WRONG)


def fingerprints(reading: Reading) -> dict[bytes, str]:
    """Labels of the instances of a scan by their vertices."""
    return {group.vertices.tobytes(): group.raw_label for group in reading.groups or ()}


def others_of(reading: Reading, lost: Group) -> dict[bytes, str]:
    return {group.vertices.tobytes(): group.raw_label for group in reading.groups or () if group.source_id != lost.source_id}


@pytest.mark.whole
@pytest.mark.parametrize("kind", DOCUMENTS)
def test_a_wrong_value_costs_its_row_at_most(kind: str, tmp_path: Path) -> None:
    folder = write(kind, tmp_path)
    path, field = folder / DOCUMENTS[kind][0], DOCUMENTS[kind][1]
    whole = json.loads(path.read_text())
    scan = only_scan(tmp_path)
    reader = format_of(scan).read
    before = reader(scan)
    assert before.groups is not None
    assert len(before.groups) >= 4
    place = len(whole[field]) - 1
    lost = before.groups[-1]
    count = 0
    for what, changed in changes(whole[field][place]):
        rows = [*whole[field][:place], changed]
        path.write_text(json.dumps(whole | {field: rows}))
        after = reader(scan)
        shared = fingerprints(after).items() & others_of(before, lost).items()
        assert len(shared) == len(before.groups) - 1, what
        assert len({group.source_id for group in after.groups or ()}) == len(after.groups or ()), what
        count += 1
    assert count > 20


def scannet(folder: Path, change: Any) -> Reading:
    write("scannet", folder)
    path = folder / "scene0001_00" / DOCUMENTS["scannet"][0]
    document = json.loads(path.read_text())
    change(document["segGroups"])
    path.write_text(json.dumps(document))
    return read(folder)


@pytest.mark.parametrize("convert", [str, float, lambda number: f"{number}.0", lambda number: f" {number} "])
def test_numbers_may_be_texts_or_floats(convert: Any, tmp_path: Path) -> None:
    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row.update(objectId=convert(row["objectId"]), id=convert(row["id"]), segments=[convert(number) for number in row["segments"]])

    plain, converted = scannet(tmp_path / "a", lambda rows: None), scannet(tmp_path / "b", change)
    assert converted.degradations == plain.degradations
    for one, other in zip(plain.groups or (), converted.groups or (), strict=True):
        assert (one.source_id, one.raw_label) == (other.source_id, other.raw_label)
        assert np.array_equal(one.vertices, other.vertices)


def test_a_segment_that_two_instances_claim_goes_to_the_smaller_one(tmp_path: Path) -> None:
    plain = scannet(tmp_path / "a", lambda rows: None)
    small = rows_by_size(plain)[0]

    def change(rows: list[dict[str, Any]]) -> None:
        rows[0]["segments"] = [number for row in rows for number in row["segments"]]  # the first claims all

    after = scannet(tmp_path / "b", change)
    groups = {group.source_id: group for group in after.groups or ()}
    assert np.array_equal(groups[small.source_id].vertices, small.vertices)
    assert any("claimed by two instances: they stay with the smaller" in note for note in after.degradations)


def rows_by_size(reading: Reading) -> list[Group]:
    return sorted((group for group in reading.groups or () if group.source_id != "0"), key=lambda group: len(group.vertices))


def test_an_instance_keeps_the_segments_that_exist(tmp_path: Path) -> None:
    plain = scannet(tmp_path / "a", lambda rows: None)
    after = scannet(tmp_path / "b", lambda rows: rows[1]["segments"].extend([4711, 4712]))
    assert fingerprints(after) == fingerprints(plain)
    assert any("segGroups[1].segments: names segment 4711" in note and "2 in all" in note for note in after.degradations)


def test_an_object_id_of_two_rows_keeps_both(tmp_path: Path) -> None:
    plain = scannet(tmp_path / "a", lambda rows: None)
    after = scannet(tmp_path / "b", lambda rows: rows[2].update(objectId=1, id=1))
    assert fingerprints(after) == fingerprints(plain)
    assert len({group.source_id for group in after.groups or ()}) == len(plain.groups or ())
    assert any("segGroups[2]: 1 names two instances: this one is called" in note for note in after.degradations)


def test_an_aggregation_of_another_scan_is_refused(tmp_path: Path) -> None:
    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row["segments"] = [number + 5000 for number in row["segments"]]

    with pytest.raises(InputError, match="use aggregation and segments of one and the same scan"):
        scannet(tmp_path, change)
