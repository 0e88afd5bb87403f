"""ScanNet++: the mesh's instances, and what does not fit together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from schemas.errors import InputError
from tasks.capture.wholeness import find_gap
from tests.tasks.capture.formats.written import assert_same_instances, only_scan, read, sample, write_scannetpp


def write_sample(folder: Path) -> None:
    """A room with a chair."""
    write_scannetpp(folder, sample())


def test_instances_are_those_of_the_native_format(tmp_path: Path) -> None:
    write_sample(tmp_path / "0a5c013435")
    reading = read(tmp_path)
    assert_same_instances(reading, sample())
    assert only_scan(tmp_path).scene_id == "scannetpp/0a5c013435"
    assert [group.origin for group in reading.groups or ()][:1] == ["segments_anno.json: segGroups[0].label"]
    assert find_gap(only_scan(tmp_path)) is None


def test_what_two_instances_claim_is_the_smaller_ones(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "scans" / "segments_anno.json"
    document = json.loads(path.read_text())
    first = document["segGroups"][0]
    first["segments"] = [segment for entry in document["segGroups"] for segment in entry["segments"]]
    path.write_text(json.dumps(document))
    reading = read(tmp_path)
    assert_same_instances(reading, sample())
    assert any("stay with the smaller" in note for note in reading.degradations)


def test_without_an_annotation_instances_are_to_be_found(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    (tmp_path / "a" / "scans" / "segments_anno.json").unlink()
    assert read(tmp_path).groups is None
    gap = find_gap(only_scan(tmp_path))
    assert gap is not None
    assert gap.is_readable


def test_segments_of_another_mesh_are_refused(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "scans" / "segments.json"
    path.write_text(json.dumps({"segIndices": [1, 2, 3]}))
    with pytest.raises(InputError, match=r"^a/scans/segments.json: segIndices: has 3 values, the mesh"):
        read(tmp_path)
    path.unlink()
    with pytest.raises(InputError, match=r"^a/scans/segments.json: file: is missing"):
        read(tmp_path)
    assert find_gap(only_scan(tmp_path)) is not None
