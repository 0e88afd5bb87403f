"""What all formats have in common: a scan of the virtual scanner is the same scene in each, and broken files are refused."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import pytest

from schemas.capture import Instance
from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS
from schemas.record import check
from schemas.tables import TABLES
from tasks.capture import CaptureConfig, run
from tasks.capture.reading import Reading
from tasks.geometry.transforms import inverse, matrix, transform_points
from tasks.stage import Context, Outcome
from tests.fuzzing import seeds
from tests.fuzzing.cases import write_case
from tests.fuzzing.mutations import changed
from tests.fuzzing.targets import targets
from tests.tasks.capture.formats.written import (
    only_scan,
    read,
    write_arkitscenes,
    write_matterport3d,
    write_multiscan,
    write_replica_v1,
    write_scannetpp,
    write_threerscan,
    write_tum_rgbd,
)

MUTATIONS = 16
"""Broken scans of each format in the fast suite; `make fuzz` tries thousands."""

MAX_MUTATIONS = 200
"""Broken scans until one is refused: readers that leave out broken objects and rows refuse few."""


@pytest.mark.parametrize("format", SCAN_FORMATS)
def test_a_broken_scan_is_read_or_refused(format: str, tmp_path: Path) -> None:
    """A file that was changed gives rows that keep their schemas, which the reader holds them to, or an error that says what is wrong."""
    cases = seeds.capture(format)
    reader = targets()[format]
    refused: list[InputError] = []
    for number in range(MAX_MUTATIONS):
        if refused and number >= MUTATIONS:
            break
        random = Random(f"{format} {number}")
        case = changed(random.choice(cases), cases, [random.getrandbits(32) for _ in range(random.randint(1, 3))])
        write_case(case, tmp_path / str(number))
        try:
            reader.read(tmp_path / str(number))
        except InputError as error:
            refused.append(error)
    assert refused, "changes are such that a reader has to look"
    assert all(error.file and error.problem for error in refused)


def captured(folder: Path) -> Outcome:
    """The scene that the one scan in a folder becomes, under a name and seed that are the same for all."""
    scan = only_scan(folder)
    outcome = run(scan=scan, context=Context("demo/room", "capture", 3, {}), config=CaptureConfig())
    for table, rows in outcome.rows.items():
        check(rows, TABLES[table].record)
    return outcome


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A furnished room as the virtual scanner records it, in the native format; without alignment, which others do not state."""
    from tasks.furniture.rooms import furnish
    from tasks.scanner import ScannerConfig, scan_scene

    folder = tmp_path_factory.mktemp("scanned")
    rng = np.random.default_rng(8)
    scan_scene(furnish("bedroom", rng, object_count=10), folder, "scene0000_00", ScannerConfig(axis_alignment=False), rng)
    (folder / "scene0000_00.truth.json").unlink()
    return folder


def without(folder: Path, *names: str) -> Path:
    """A scan's folder without some of its files and folders."""
    for path in [path for name in names for path in folder.glob(f"*/{name}")]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return folder


@pytest.fixture(scope="module")
def bare(scanned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The native scan without its frames, which most data sets keep elsewhere, and what it says of its room."""
    folder = Path(shutil.copytree(scanned, tmp_path_factory.mktemp("bare") / "scans"))
    return without(folder, "color", "depth", "pose", "intrinsic", "*.txt")


@pytest.fixture(scope="module")
def native(bare: Path) -> Outcome:
    return captured(bare)


def instances(outcome: Outcome) -> list[Instance]:
    rows: Sequence[Instance] = outcome.rows["instances"]
    return [dataclasses.replace(row, source_id="") for row in rows]


BY_VERTEX: dict[str, Callable[[Path, Reading], Path]] = {
    "scannetpp": write_scannetpp,
    "threerscan": write_threerscan,
    "threerscan segments": partial(write_threerscan, is_labelled=False),
}


@pytest.mark.whole
@pytest.mark.parametrize("format", BY_VERTEX)
def test_labelled_vertices_make_the_rows_of_the_native_format(format: str, bare: Path, native: Outcome, tmp_path: Path) -> None:
    """Every instance, box and blob is the same."""
    BY_VERTEX[format](tmp_path / "room", read(bare))
    mine = captured(tmp_path)
    assert instances(mine) == instances(native)
    assert mine.rows["shells"] == native.rows["shells"]


@pytest.mark.whole
@pytest.mark.parametrize("write", [write_matterport3d, partial(write_replica_v1, is_quads=False)], ids=["matterport3d", "replica_v1"])
def test_labelled_faces_make_the_instances_of_the_native_format(
    write: Callable[[Path, Reading], Path], bare: Path, native: Outcome, tmp_path: Path
) -> None:
    """Faces between two instances are nobody's in the native format, so that some vertices there are nobody's here."""
    write(tmp_path / "room", read(bare))
    mine = captured(tmp_path)
    assert [(row.category, row.nyu40_id) for row in instances(mine)] == [(row.category, row.nyu40_id) for row in instances(native)]
    for one, other in zip(instances(mine), instances(native), strict=True):
        if one.is_structure:
            continue
        is_as_small = one.box_volume_m3 == pytest.approx(other.box_volume_m3, rel=0.05)  # of few sides seen, another turn may be
        apart = np.linalg.norm(matrix(one.box_pose)[:3, 3] - matrix(other.box_pose)[:3, 3])
        assert iou(one, other) > 0.85 or (is_as_small and apart < 0.3), (one.category, one.box_size, other.box_size)
        assert abs(one.point_count - other.point_count) <= 0.02 * other.point_count


@pytest.mark.whole
def test_labelled_faces_make_the_same_rows_however_they_are_written(bare: Path, tmp_path: Path) -> None:
    """Numbers of faces, lists of faces, and segments of faces: every instance, box and blob is the same."""
    write_matterport3d(tmp_path / "segments" / "room", read(bare))
    other = captured(tmp_path / "segments")
    for is_labelled in (True, False):
        write_multiscan(tmp_path / f"numbers {is_labelled}" / "room", read(bare), is_labelled)
        mine = captured(tmp_path / f"numbers {is_labelled}")
        assert instances(mine) == instances(other)
        assert mine.rows["shells"] == other.rows["shells"]
        assert mine.rows["surfaces"] == other.rows["surfaces"]


def iou(one: Instance, other: Instance) -> float:
    """Overlap of two boxes, by the centers of small cells of each."""
    grid = np.stack(np.meshgrid(*[(np.arange(24) + 0.5) / 24 - 0.5] * 3), axis=-1).reshape(-1, 3)

    def share(a: Instance, b: Instance) -> float:
        points = transform_points(grid * a.box_size, matrix(a.box_pose))
        local = transform_points(points, inverse(matrix(b.box_pose)))
        return float((np.abs(local) <= 0.5 * np.array(b.box_size) + 1e-9).all(axis=1).mean())

    common = 0.5 * (share(one, other) * one.box_volume_m3 + share(other, one) * other.box_volume_m3)
    return common / (one.box_volume_m3 + other.box_volume_m3 - common)


@pytest.mark.whole
def test_boxes_make_the_instances_of_the_native_format(bare: Path, native: Outcome, tmp_path: Path) -> None:
    """ARKitScenes has boxes in place of labelled vertices: those of the native instances give them back."""
    (scene,) = native.rows["scenes"]
    to_scan = inverse(matrix(scene.alignment))
    free = [row for row in native.rows["instances"] if not row.is_structure]
    boxes = [(row.instance_id, row.raw_label, to_scan @ matrix(row.box_pose), np.array(row.box_size)) for row in free]
    write_arkitscenes(tmp_path / "41069021", read(bare), boxes)
    mine = captured(tmp_path)
    found = {row.source_id: row for row in mine.rows["instances"]}
    overlaps = {row.instance_id: iou(found[row.instance_id], row) for row in free}
    assert all(found[row.instance_id].category == row.category for row in free)
    assert np.median(list(overlaps.values())) > 0.8, overlaps


@pytest.mark.whole
def test_frames_make_the_instances_of_the_native_format(scanned: Path, tmp_path: Path) -> None:
    """Without mesh and labels, both are found in what the frames fuse to."""
    folder = without(Path(shutil.copytree(scanned, tmp_path / "native")), "*.ply", "*.json", "*.txt")
    expected = captured(folder)
    write_tum_rgbd(tmp_path / "tum" / "room", read(folder).frames)
    mine = captured(tmp_path / "tum")
    assert mine.rows["scenes"][0].segmentation == expected.rows["scenes"][0].segmentation == "geometry"
    assert [row.category for row in instances(mine)] == [row.category for row in instances(expected)]
    for one, other in zip(instances(mine), instances(expected), strict=True):
        np.testing.assert_allclose(one.box_size, other.box_size, atol=2e-3)
        np.testing.assert_allclose(matrix(one.box_pose)[:3, 3], matrix(other.box_pose)[:3, 3], atol=2e-3)


def test_every_format_is_in_the_documentation() -> None:
    page = (Path(__file__).parents[4] / "docs" / "formats.md").read_text()
    for name in SCAN_FORMATS:
        assert f"| `{name}` |" in page
