"""Scans of wild rooms: the same every time, and the truth states each strip that bears a neighbor's label."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tasks.capture.files.ply import read_ply
from tasks.furniture.dwellings import Dwelling
from tasks.furniture.wild import wild_room
from tasks.scanner.dwellings import HARD, WILD, scan_dwelling
from tasks.scanner.truth import DwellingTruth

COARSE = dataclasses.replace(
    WILD,
    scanner=dataclasses.replace(HARD, depth_width=120, depth_height=90, color_width=120, color_height=90, voxel_m=0.05, segment_least=4),
)


@cache
def room() -> Dwelling:
    return wild_room((11, 8))


def scanned(out: Path) -> DwellingTruth:
    return scan_dwelling(room(), out, "scene0008_00", COARSE, np.random.default_rng(8))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DwellingTruth]:
    out = tmp_path_factory.mktemp("wild")
    return out, scanned(out)


@pytest.mark.whole
def test_the_same_room_gives_the_same_bytes(made: tuple[Path, DwellingTruth], tmp_path: Path) -> None:
    scanned(tmp_path)
    first, second = (
        {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.rglob("*")) if path.is_file()}
        for out in (made[0], tmp_path)
    )
    assert first == second


@pytest.mark.whole
def test_the_truth_reads_back_and_older_truths_have_no_bleeds(made: tuple[Path, DwellingTruth]) -> None:
    out, truth = made
    text = (out / "scene0008_00.truth.json").read_text()
    assert DwellingTruth.from_json(text) == truth
    older = json.loads(text)
    del older["bleeds"]
    assert DwellingTruth.from_json(json.dumps(older)).bleeds == ()


@pytest.mark.whole
def test_labels_bleed_by_5_to_15_cm_and_instances_hold_their_neighbors(made: tuple[Path, DwellingTruth]) -> None:
    _, truth = made
    assert len(truth.bleeds) > 10
    names = {obj.name for obj in truth.objects}
    for row in truth.bleeds:
        assert 0.05 <= row.reach_m <= 0.15
        assert {row.source, row.into} & names
    mixed = [instance for instance in truth.instances if len(instance.objects) > 1 and instance.objects[1][1] > 0.02]
    assert len(mixed) > 5


@pytest.mark.whole
def test_openings_without_doors_are_in_the_truth_and_colors_are_blurred(made: tuple[Path, DwellingTruth]) -> None:
    out, truth = made
    assert any(row.kind == "passage" and row.to == -1 and row.instance is None for row in truth.openings)
    soft = read_ply(out / "scene0008_00" / "scene0008_00_vh_clean_2.ply", "mesh").surface
    assert len(soft.vertices) > 1000
    ends = soft.colors[soft.faces[:, :2]].astype(int)
    assert np.abs(ends[:, 0] - ends[:, 1]).mean() < 12
