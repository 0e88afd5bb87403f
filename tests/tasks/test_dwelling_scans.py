"""Scans of dwellings: what is wrong with them lies in its bounds, is written down, and is the same every time."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import trimesh

import tasks.scanner.dwellings
from tasks.capture.files.ply import read_ply
from tasks.furniture.dwellings import DwellingSettings, dwelling
from tasks.geometry.rendering import RayScene
from tasks.scanner.defects import DefectSettings, misspelled, thin_faces, written
from tasks.scanner.dwellings import HARD, HardScanSettings, hurried_views, scan_dwelling
from tasks.scanner.route import Targets
from tasks.scanner.scenery import Scenery
from tasks.scanner.truth import DwellingTruth

COARSE = dataclasses.replace(HARD, depth_width=120, depth_height=90, color_width=120, color_height=90, voxel_m=0.05, segment_least=4)
SMALL = DwellingSettings(fewest=40, most=44)


def scan(out: Path, seed: int, settings: HardScanSettings) -> DwellingTruth:
    return scan_dwelling(dwelling((5, seed), SMALL), out, f"scene{seed:04d}_00", settings, np.random.default_rng([5, seed]))


def coarse(folder: str, seed: int) -> dict[str, str]:
    out = Path(folder) / str(seed)
    scan(out, seed, HardScanSettings(scanner=COARSE))
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(out.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, DwellingTruth]:
    out = tmp_path_factory.mktemp("dwellings")
    return out, scan(out, 0, HardScanSettings(frames="exported"))


@pytest.mark.slow
@pytest.mark.whole
def test_the_truth_reads_back_as_it_was_written(made) -> None:
    out, truth = made
    assert DwellingTruth.from_json((out / "scene0000_00.truth.json").read_text()) == truth


@pytest.mark.slow
@pytest.mark.whole
def test_a_quarter_to_nearly_half_of_what_could_be_seen_is_not(made) -> None:
    assert 0.25 <= made[1].unseen <= 0.45


@pytest.mark.whole
def test_the_mesh_is_of_the_size_of_scannets(made) -> None:
    out, _ = made
    surface = read_ply(out / "scene0000_00" / "scene0000_00_vh_clean_2.ply", "mesh").surface
    assert 60_000 <= len(surface.vertices) <= 84_000


@pytest.mark.whole
def test_every_instance_is_traced_to_what_is_truly_there(made) -> None:
    out, truth = made
    aggregation = json.loads((out / "scene0000_00" / "scene0000_00.aggregation.json").read_text())
    names = {obj.name for obj in truth.objects}
    own = ("floor", "wall", "ceiling", "half_wall")
    assert [row["label"] for row in aggregation["segGroups"]] == [instance.label for instance in truth.instances]
    for row, instance in zip(aggregation["segGroups"], truth.instances, strict=True):
        assert len(row["segments"]) == instance.segment_count
        assert all(name in names or name.startswith(own) for name, _ in instance.objects)
        assert sum(share for _, share in instance.objects) <= 1.001
    assert any(instance.is_merged for instance in truth.instances)
    assert any(instance.is_split for instance in truth.instances)
    wrong = [instance for instance in truth.instances if instance.label != instance.category]
    assert 0.05 <= len(wrong) / len(truth.instances) <= 0.5
    assert any(obj.has_lost_legs for obj in truth.objects)
    assert any(obj.has_lost_glass for obj in truth.objects)


@pytest.mark.slow
@pytest.mark.whole
def test_the_same_seed_gives_the_same_bytes_on_one_worker_and_on_two(tmp_path: Path) -> None:
    alone = [coarse(str(tmp_path / "alone"), seed) for seed in (1, 2)]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        together = list(pool.map(partial(coarse, str(tmp_path / "together")), (1, 2)))
    assert alone == together
    assert set(alone[0].values()) - set(alone[1].values())


def test_a_misspelled_word_differs_and_is_near() -> None:
    rng = np.random.default_rng(0)
    for word in ("sofa", "kitchen cabinet", "tv", "bookshelf", "oo"):
        for _ in range(20):
            wrong = misspelled(word, rng)
            assert wrong != word
            assert abs(len(wrong) - len(word)) <= 1


def test_without_slips_a_label_is_the_category() -> None:
    settings = DefectSettings(misspelled=0.0, other_words=0.0)
    rng = np.random.default_rng(1)
    assert all(written("sofa", settings, rng).lower() == "sofa" for _ in range(50))


def test_legs_are_thin_and_tops_are_not() -> None:
    from tasks.furniture import generate

    table = generate("table", (0.8, 1.3, 0.75), np.random.default_rng(2))
    found = {part.metadata["name"]: thin_faces(np.asarray(part.vertices), np.asarray(part.faces), np.eye(4)).all() for part in table.parts}
    assert not found["top"]


def test_a_walk_goes_on_past_a_stop_that_its_looks_did_not_exhaust(monkeypatch: pytest.MonkeyPatch) -> None:
    eyes = np.array([[0.0, 0.0, 1.5], [20.0, 0.0, 1.5]])
    monkeypatch.setattr(tasks.scanner.dwellings, "standpoints", lambda *_: eyes)
    ways = [np.linspace(0, 2 * np.pi, count, endpoint=False) for count in (60, 8)]
    outward = [np.column_stack([np.cos(way), np.sin(way), np.zeros(len(way))]) for way in ways]
    points = np.concatenate([eye + 2.0 * way for eye, way in zip(eyes, outward, strict=True)])
    targets = Targets(points, -np.concatenate(outward), np.zeros(68, dtype=np.int64), np.ones(68))
    scene = RayScene([trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((0, 0, 50)))])
    config = dataclasses.replace(HARD, yaws=1, pitches_degrees=(0.0,))  # one look from a stop: most round it stays unseen
    views = hurried_views(
        scene, Scenery([], np.zeros(0, dtype=np.int64), [], None), targets, np.ones(68), 0.0, config, np.random.default_rng(3)
    )
    assert {tuple(view[:3, 3]) for view in views} == {tuple(eye) for eye in eyes}


@pytest.mark.whole
def test_scans_of_a_dwelling_are_not_written_over(tmp_path: Path) -> None:
    from schemas.errors import InputError

    (tmp_path / "scene0000_00").mkdir()
    with pytest.raises(InputError, match="is there already"):
        scan(tmp_path, 0, HardScanSettings())
