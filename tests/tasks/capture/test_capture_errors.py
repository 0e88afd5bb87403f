"""Bad scans: one clear line that names file and field, nothing else touched; and whatever the bytes, no other exception."""

from __future__ import annotations

import dataclasses
import json
import re
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS
from tasks.capture import CaptureConfig, Scan, find_scans, run
from tasks.capture.files.documents import floats, integers
from tasks.capture.files.images import image_size, read_color, read_depth
from tasks.capture.files.ply import read_ply
from tasks.capture.files.sens import open_sens
from tasks.capture.files.trajectory import read_trajectory
from tasks.capture.fusion import FusionConfig
from tasks.capture.labels import label_map
from tasks.capture.scannet import read_scannet
from tasks.geometry.meshes import Surface, dump_glb
from tasks.stage import Context, Outcome
from tests.capture_scans import (
    BoxRoom,
    box_room,
    matrix_text,
    ply_bytes,
    rendered,
    sens_bytes,
    well_formed,
    write_posed_rgbd,
    write_scannet,
)

MESH, SEGMENTS = "scene0001_00_vh_clean_2.ply", "scene0001_00_vh_clean_2.0.010000.segs.json"
AGGREGATION, METADATA = "scene0001_00.aggregation.json", "scene0001_00.txt"


@pytest.fixture(scope="module")
def room() -> BoxRoom:
    return box_room(cameras=4)


@pytest.fixture
def scan(room: BoxRoom, tmp_path: Path) -> Path:
    return write_scannet(tmp_path / "scene0001_00", room)


def captured(path: Path) -> Outcome:
    (scan,), errors = find_scans(path)
    assert not errors
    return well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as raised:
        captured(path)
    error = raised.value
    assert "\n" not in str(error)
    assert str(path.parent) not in str(error)
    assert error.file
    assert error.field
    assert error.problem
    assert error.remedy
    return error


def edit_json(path: Path, change: Callable[[dict], object]) -> None:  # type: ignore[type-arg]
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def replace_surface(folder: Path, change: Callable[[Surface], Surface]) -> None:
    surface = read_ply(folder / MESH, MESH).surface
    (folder / MESH).write_bytes(ply_bytes(change(surface)))


def with_nan(surface: Surface) -> Surface:
    vertices = surface.vertices.copy()
    vertices[17, 1] = np.nan
    return dataclasses.replace(surface, vertices=vertices)


BROKEN: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "mesh cut in its vertices": (lambda f: cut(f / MESH, 0.2), MESH, "element vertex"),
    "mesh cut in its faces": (lambda f: cut(f / MESH, 0.9), MESH, "element face"),
    "mesh cut in its header": (lambda f: cut(f / MESH, 0.0001), MESH, "header"),
    "mesh empty": (lambda f: (f / MESH).write_bytes(b""), MESH, "does not begin"),
    "mesh with NaN": (lambda f: replace_surface(f, with_nan), MESH, "vertex 17"),
    "mesh without faces": (
        lambda f: replace_surface(f, lambda s: dataclasses.replace(s, faces=np.zeros((0, 3), dtype=np.int64))),
        MESH,
        "element face",
    ),
    "mesh in millimetres": (
        lambda f: replace_surface(f, lambda s: dataclasses.replace(s, vertices=s.vertices * 1000)),
        MESH,
        "vertex",
    ),
    "mesh with a stray face": (lambda f: stray_face(f / MESH), MESH, "face 5"),
    "50 million faces declared": (lambda f: declare(f / MESH, "face", 50_000_000), MESH, "element face"),
    "50 million vertices declared": (lambda f: declare(f / MESH, "vertex", 50_000_000), MESH, "element vertex"),
    "segments one short": (lambda f: edit_json(f / SEGMENTS, lambda d: d["segIndices"].pop()), SEGMENTS, "segIndices"),
    "segments of words": (lambda f: edit_json(f / SEGMENTS, lambda d: d.update(segIndices=["a"] * 9)), SEGMENTS, "segIndices"),
    "segments of fractions": (lambda f: edit_json(f / SEGMENTS, lambda d: d.update(segIndices=[0.5] * 9)), SEGMENTS, "segIndices"),
    "segments missing": (lambda f: (f / SEGMENTS).unlink(), SEGMENTS, "is missing"),
    "segments too large to be numbers": (
        lambda f: edit_json(f / SEGMENTS, lambda d: d["segIndices"].__setitem__(0, 10**30)),
        SEGMENTS,
        "segIndices",
    ),
    "aggregation is a list": (lambda f: (f / AGGREGATION).write_text("[1, 2]"), AGGREGATION, "content"),
    "aggregation is no JSON": (lambda f: (f / AGGREGATION).write_text("{segGroups"), AGGREGATION, "content"),
    "aggregation nested without end": (lambda f: (f / AGGREGATION).write_text("[" * 100_000), AGGREGATION, "content"),
    "aggregation of something else": (lambda f: (f / AGGREGATION).write_text("{}"), AGGREGATION, "segGroups"),
    "singular alignment": (
        lambda f: (f / METADATA).write_text("axisAlignment = 1 0 0 0 0 1 0 0 0 0 0 0 0 0 0 1\n"),
        METADATA,
        "axisAlignment",
    ),
    "short alignment": (lambda f: (f / METADATA).write_text("axisAlignment = 1 0 0 0\n"), METADATA, "axisAlignment"),
    "alignment that mirrors": (
        lambda f: (f / METADATA).write_text("axisAlignment = -1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"),
        METADATA,
        "axisAlignment",
    ),
    "alignment of words": (lambda f: (f / METADATA).write_text("axisAlignment = " + "one " * 16 + "\n"), METADATA, "axisAlignment"),
    "metadata that is no text": (lambda f: (f / METADATA).write_bytes(b"\xff\xfe\x00\x01"), METADATA, "content"),
    "depth of another size": (
        lambda f: Image.fromarray(np.zeros((7, 9), dtype=np.uint16)).save(f / "depth" / "2.png"),
        "depth/2.png",
        "depth",
    ),
    "color of another size": (lambda f: Image.new("RGB", (9, 7)).save(f / "color" / "1.jpg"), "color/1.jpg", "color"),
    "depth cut": (lambda f: cut(f / "depth" / "0.png", 0.5), "depth/0.png", "depth"),
    "depth in color": (lambda f: Image.new("RGB", (160, 120)).save(f / "depth" / "0.png"), "depth/0.png", "depth"),
    "color is no image": (lambda f: (f / "color" / "0.jpg").write_bytes(b"hello"), "color/0.jpg", "image"),
    "no intrinsics": (lambda f: [p.unlink() for p in (f / "intrinsic").iterdir()], "scene0001_00", "intrinsics"),
    "intrinsics of zeros": (lambda f: (f / "intrinsic/intrinsic_color.txt").write_text("0 " * 16), "intrinsic_color.txt", "intrinsics"),
}


def cut(path: Path, share: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: max(1, int(len(data) * share))])


def stray_face(path: Path) -> None:
    data = bytearray(path.read_bytes())
    faces = int(bytes(data).split(b"element face ")[1].split(b"\n")[0])
    start = len(data) - faces * 13
    data[start + 5 * 13 + 1 : start + 5 * 13 + 5] = struct.pack("<i", 10_000_000)
    path.write_bytes(bytes(data))


def declare(path: Path, element: str, count: int) -> None:
    head, mark, body = path.read_bytes().partition(b"end_header")
    start = f"element {element} ".encode()
    lines = [start + str(count).encode() if line.startswith(start) else line for line in head.split(b"\n")]
    path.write_bytes(b"\n".join(lines) + mark + body)


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_file_is_named_with_its_field(fault: str, scan: Path) -> None:
    break_it, file, field = BROKEN[fault]
    break_it(scan)
    error = refused(scan)
    assert file in f"{error.file} {error.field}"
    assert field in f"{error.field} {error.problem}"


def test_declared_size_is_refused_before_memory_is_taken(scan: Path) -> None:
    import tracemalloc

    declare(scan / MESH, "face", 2**60)
    tracemalloc.start()
    refused(scan)
    assert tracemalloc.get_traced_memory()[1] < 60e6
    tracemalloc.stop()


def test_container_that_is_cut(room: BoxRoom, tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, frames="sens")
    path = folder / "scene0001_00.sens"
    whole = path.read_bytes()
    for share, field in ((0.00001, "version"), (0.5, "frame"), (0.999, "frame 3")):
        path.write_bytes(whole[: int(len(whole) * share)])
        assert field in refused(folder).field
    broken = bytearray(whole)
    start = whole.index(b"\xff\xd8\xff")
    broken[start : start + 40] = bytes(40)
    path.write_bytes(bytes(broken))
    works_or_is_refused(lambda: captured(folder))


@pytest.mark.parametrize("written", ["-inf " * 16, "nan " * 16, "", "1 2 3", "hello", "1 0 0 0 0 2 0 0 0 0 1 0 0 0 0 1", "\xff"])
def test_unreadable_pose_loses_only_itself(written: str, scan: Path) -> None:
    """The frame is kept without a pose and reported; everything else is as before."""
    before = captured(scan)
    (scan / "pose" / "1.txt").write_text(written, encoding="latin-1")
    after = captured(scan)
    assert [f.frame_id for f in after.rows["frames"]] == [f.frame_id for f in before.rows["frames"]]
    assert [f.pose is None for f in after.rows["frames"]] == [False, True, False, False]
    assert any("000001" in note and "pose" in note for note in after.degradations)
    assert all(mask.frame_id != "000001" for mask in after.rows["masks"])
    assert [i.box_pose for i in after.rows["instances"]] == [i.box_pose for i in before.rows["instances"]]


def test_missing_pose_and_all_poses_gone(scan: Path) -> None:
    for index in range(4):
        (scan / "pose" / f"{index}.txt").write_text(matrix_text(np.full((4, 4), -np.inf)))
    outcome = captured(scan)
    assert all(frame.pose is None for frame in outcome.rows["frames"])
    assert not outcome.rows["masks"]
    assert any(note.startswith("4 of 4 frames without a pose (-inf)") for note in outcome.degradations)


def test_label_outside_the_map_is_kept(room: BoxRoom, tmp_path: Path) -> None:
    labels = [*room.labels[:-2], "Flux  Capacitor", "Flux Capacitor"]
    first = len(labels) - 2
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, frames="none", labels=labels))
    row = outcome.rows["instances"][-1]
    assert (row.raw_label, row.category, row.nyu40_id, row.nyu40_label) == ("Flux Capacitor", "flux capacitor", 0, "unlabeled")
    line = f"{AGGREGATION}: segGroups[{first}].label: 'Flux Capacitor' is not in the label map, nyu40 class 0"
    assert [note for note in outcome.degradations if "label map" in note] == [line]


def test_one_bad_scan_leaves_the_others_alone(room: BoxRoom, tmp_path: Path) -> None:
    for index in (1, 2, 3):
        write_scannet(tmp_path / f"scene000{index}_00", room, frames="none")
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "readme.md").write_text("no scan")
    (tmp_path / "scene0002_00.truth.json").write_text("{}")
    cut(tmp_path / "scene0002_00" / "scene0002_00_vh_clean_2.ply", 0.5)
    scans, errors = find_scans(tmp_path)
    assert [scan.scene_id for scan in scans] == [f"scannet/scene000{i}_00" for i in (1, 2, 3)]
    assert [(error.file, error.problem.split(" ")[0:2]) for error in errors] == [("empty", ["is", "empty"]), ("notes", ["holds", "no"])]
    for scan in (scans[0], scans[2]):
        captured(scan.path)
    assert refused(scans[1].path).file == "scene0002_00/scene0002_00_vh_clean_2.ply"


def test_two_scans_with_one_name_are_two_scenes(room: BoxRoom, tmp_path: Path) -> None:
    for place in ("a/scene0001_00", "b/scene0001_00", "b/scene0002_00"):
        write_scannet(tmp_path / place, room, frames="none")
    scans, errors = find_scans(tmp_path)
    assert errors == []
    named = {scan.path.relative_to(tmp_path).as_posix(): scan.scene_id for scan in scans}
    assert named["a/scene0001_00"] == "scannet/scene0001_00"
    assert re.fullmatch(r"scannet/scene0001_00-[0-9a-f]{8}", named["b/scene0001_00"])
    assert named["b/scene0002_00"] == "scannet/scene0002_00"


def test_find_scans_by_format(room: BoxRoom, tmp_path: Path) -> None:
    write_scannet(tmp_path / "scene0001_00", room, frames="none")
    write_posed_rgbd(tmp_path / "My Kitchen!", room)
    (tmp_path / "house.glb").write_bytes(dump_glb([room.surface.to_trimesh()], ["room|wall|0"]))
    scans, errors = find_scans(tmp_path)
    assert not errors
    assert [(s.scene_id, s.format) for s in scans] == [
        ("glb/house", "glb"), ("rgbd/My_Kitchen_", "posed_rgbd"), ("scannet/scene0001_00", "scannet"),
    ]  # fmt: skip
    for format in SCAN_FORMATS:
        only, _ = find_scans(tmp_path, format)
        wanted = {scan.format for scan in scans} | {"bare_mesh", "point_cloud"}  # any mesh is one where it is asked for
        assert {scan.format for scan in only} == {format} & wanted
    assert find_scans(tmp_path, dataset="Mine")[0][0].scene_id == "mine/My_Kitchen_"
    assert find_scans(tmp_path / "house.glb")[0][0].scene_id == "glb/house"
    with pytest.raises(InputError, match=rf"^{tmp_path}/nowhere: folder: does not exist; "):
        find_scans(tmp_path / "nowhere")
    with pytest.raises(InputError, match="not known"):
        find_scans(tmp_path, "las")


@pytest.mark.parametrize("beside", ["nothing", "a scan", "a lone GLB"])
@pytest.mark.parametrize("below", ["", "group"])
def test_a_folder_that_cannot_be_read_is_one_error(
    beside: str, below: str, room: BoxRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody is kept out by permissions who runs as root: the refusal is acted."""
    closed = tmp_path / "scans" / below / "closed"
    closed.mkdir(parents=True)
    if beside == "a scan":
        write_scannet(tmp_path / "scans" / "scene0001_00", room, frames="none")
    if beside == "a lone GLB":
        (tmp_path / "scans" / "house.glb").write_bytes(dump_glb([room.surface.to_trimesh()], ["room|wall|0"]))
    listed = Path.iterdir

    def iterdir(path: Path) -> Iterator[Path]:
        if path == closed.resolve():
            raise PermissionError(13, "Permission denied", str(path))
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    scans, errors = find_scans(tmp_path / "scans")
    assert [str(error) for error in errors] == ["closed: folder: cannot be read (Permission denied); check its permissions"]
    assert [scan.scene_id for scan in scans] == {"nothing": [], "a scan": ["scannet/scene0001_00"], "a lone GLB": ["glb/house"]}[beside]


@pytest.mark.parametrize("name", [AGGREGATION, "scene0001_00_vh_clean.aggregation.json"])
def test_an_aggregation_that_is_a_folder_is_refused(name: str, room: BoxRoom, scan: Path) -> None:
    (scan / AGGREGATION).unlink()
    (scan / name).mkdir()
    write_scannet(scan.parent / "scene0002_00", room, frames="none")
    scans, errors = find_scans(scan.parent)
    assert [found.scene_id for found in scans] == ["scannet/scene0002_00"]
    assert [(error.file, error.problem) for error in errors] == [(f"scene0001_00/{name}", "is a folder")]
    with pytest.raises(InputError, match="is a folder"):
        read_scannet(Scan("scannet", scan, "scannet", "scene0001_00"))


@pytest.mark.parametrize("field", ["segmentsFile", "segmentsId"])
@pytest.mark.parametrize(
    ("stated", "problem"),
    [
        ("../secret.segs.json", "is a path"),
        (f"/data/{SEGMENTS}", "is a path"),
        (f"..\\{SEGMENTS}", "is a path"),
        ("scannet.scene0002_00_vh_clean_2.0.010000.segs.json", "the scan has"),
        ("scene0001_00_vh_clean.segs.json", "the scan has"),
        (f"scannet{SEGMENTS}", "the scan has"),
        (7, "is no file name"),
    ],
)
def test_segments_of_another_place_or_scan_are_refused(field: str, stated: object, problem: str, scan: Path) -> None:
    (scan.parent / "secret.segs.json").write_text("{}")
    edit_json(scan / AGGREGATION, lambda d: d.update({field: stated}))
    error = refused(scan)
    assert (error.file, error.field) == (f"scene0001_00/{AGGREGATION}", field)
    assert problem in error.problem


@pytest.mark.parametrize("stated", [SEGMENTS, f"scannet.{SEGMENTS}", f"org.scannet.v2.{SEGMENTS}", "", None])
def test_segments_named_with_a_prefix_are_found(stated: str | None, scan: Path) -> None:
    edit_json(scan / AGGREGATION, lambda d: [d.pop("segmentsFile"), d.update(segmentsId=stated)])
    groups = read_scannet(Scan("scannet", scan, "scannet", "scene0001_00")).groups
    assert groups is not None
    assert len(groups) == 10


@pytest.mark.parametrize(
    ("values", "field"),
    [({name: 0}, name) for name in ("max_view_frames", "views_per_instance", "view_size_px", "max_points", "max_faces")],
)
def test_capture_counts_start_at_one(values: dict[str, int], field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: must be at least 1, is 0$"):
        CaptureConfig(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "values",
    [
        {"voxel_m": 0.0}, {"voxel_m": -0.02}, {"voxel_m": float("nan")}, {"voxel_m": float("inf")}, {"truncation_voxels": 0.0},
        {"max_depth_m": 0.1}, {"max_frames": 0}, {"min_weight": -1.0}, {"min_piece_faces": -1},
    ],
)  # fmt: skip
def test_fusion_values_that_cannot_be(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        FusionConfig(**values)  # type: ignore[arg-type]
    FusionConfig(min_weight=0, min_piece_faces=0, max_frames=1)


def test_aggregation_without_segments_of_its_own_group(scan: Path) -> None:
    edit_json(scan / AGGREGATION, lambda d: d["segGroups"][8].update(segments=[]))
    outcome = captured(scan)
    assert len(outcome.rows["instances"]) == 9
    assert any("instance 8 (cabinet): has no vertices" in note for note in outcome.degradations)


def test_mesh_without_aggregation_is_segmented_by_geometry(scan: Path) -> None:
    (scan / AGGREGATION).unlink()
    outcome = captured(scan)
    assert outcome.rows["scenes"][0].segmentation == "geometry"
    assert sum(not row.is_structure for row in outcome.rows["instances"]) >= 3


@pytest.mark.whole
def test_container_without_mesh_is_fused(room: BoxRoom, tmp_path: Path) -> None:
    folder = tmp_path / "scene0007_00"
    folder.mkdir()
    (folder / "scene0007_00.sens").write_bytes(sens_bytes(rendered(box_room(cameras=8)), room.cameras[0]))
    outcome = captured(folder)
    assert outcome.rows["scenes"][0].face_count > 10_000
    assert any("fused from its frames" in note for note in outcome.degradations)


# --- whatever the bytes ------------------------------------------------------------------------------------------


def mangled(data: bytes) -> st.SearchStrategy[bytes]:
    """The data cut anywhere, or with a few bytes changed anywhere, more often near its beginning."""
    place = st.one_of(st.integers(0, min(400, len(data) - 1)), st.integers(0, len(data) - 1))

    def flip(changes: list[tuple[int, int]]) -> bytes:
        out = bytearray(data)
        for where, value in changes:
            out[where] = value
        return bytes(out)

    flipped = st.lists(st.tuples(place, st.integers(0, 255)), min_size=1, max_size=4).map(flip)
    return st.one_of(place.map(lambda n: data[:n]), flipped)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small scan, so that each of many tries is quick."""
    small = box_room([("table", (0.5, 0.3, 0.35), (0.9, 0.6, 0.7), 0.2)], cameras=1)
    return write_scannet(tmp_path_factory.mktemp("fuzz") / "scene0001_00", small, frames="none")


FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def works_or_is_refused(call: Callable[[], object]) -> None:
    refusal = None
    try:
        call()
    except InputError as error:
        refusal = error
    assert refusal is None or (refusal.field and "\n" not in str(refusal))


@pytest.mark.parametrize("file", [MESH, SEGMENTS, AGGREGATION, METADATA])
def test_any_change_of_a_file_works_or_is_refused(file: str, tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    original = (tiny / file).read_bytes()
    scan = Scan("scannet", tiny, "scannet", "scene0001_00")

    @FUZZ
    @given(data=mangled(original))
    def attempt(data: bytes) -> None:
        (tiny / file).write_bytes(data)
        works_or_is_refused(lambda: read_scannet(scan))

    try:
        attempt()
    finally:
        (tiny / file).write_bytes(original)


def test_any_change_of_a_mesh_is_captured_or_refused(tiny: Path) -> None:
    """The whole stage, not only the reader: a vertex may have gone far astray."""
    original = (tiny / MESH).read_bytes()
    scan = Scan("scannet", tiny, "scannet", "scene0001_00")

    @settings(FUZZ, max_examples=25)
    @given(data=mangled(original))
    def attempt(data: bytes) -> None:
        (tiny / MESH).write_bytes(data)
        works_or_is_refused(lambda: run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))

    try:
        attempt()
    finally:
        (tiny / MESH).write_bytes(original)


@pytest.mark.parametrize("kind", ["binary", "text", "polygons"])
def test_any_change_of_a_ply_works_or_is_refused(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    path.write_bytes(_ply(kind))
    assert len(read_ply(path, "mesh.ply").surface.faces) == 4
    assert len(read_ply(path, "mesh.ply").surface.vertices) == 5

    @settings(FUZZ, max_examples=150)
    @given(data=mangled(_ply(kind)))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        works_or_is_refused(lambda: read_ply(path, "mesh.ply"))

    attempt()


def _ply(kind: str) -> bytes:
    """A roof: a square of two triangles, or one polygon, and two more faces."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 4]])
    if kind == "binary":
        return ply_bytes(Surface(vertices, faces, np.full((5, 3), 9, dtype=np.uint8)), ">")
    head = "ply\nformat ascii 1.0\nelement vertex 5\n" + "".join(f"property float {a}\n" for a in "xyz")
    rows = [f"3 {a} {b} {c}" for a, b, c in faces] if kind == "text" else ["4 0 1 2 3", "3 0 1 4", "3 1 2 4"]
    head += f"element face {len(rows)}\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + "".join(f"{x} {y} {z}\n" for x, y, z in vertices) + "\n".join(rows) + "\n").encode()


def test_any_change_of_a_container_works_or_is_refused(room: BoxRoom, tmp_path: Path) -> None:
    data = sens_bytes(rendered(box_room(cameras=1)), room.cameras[0])
    path = tmp_path / "scan.sens"

    def read() -> None:
        container = open_sens(path, "scan.sens")
        for index in range(len(container.frames)):
            assert container.color(index).shape == (*container.color_size[::-1], 3)
            assert container.depth(index).shape == container.depth_size[::-1]

    @settings(FUZZ, max_examples=150)
    @given(data=mangled(data))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        works_or_is_refused(read)

    attempt()


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_any_change_of_an_image_works_or_is_refused(kind: str, scan: Path, tmp_path: Path) -> None:
    path = next(iter((scan / kind).iterdir()))
    original = path.read_bytes()

    def read() -> None:
        size = image_size(path, path.name)
        image = read_color(path, path.name, size) if kind == "color" else read_depth(path, path.name, size, 1000.0)
        assert image.shape[:2] == size[::-1]

    @settings(FUZZ, max_examples=120)
    @given(data=mangled(original))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        works_or_is_refused(read)

    attempt()


def test_any_change_of_a_glb_is_captured_or_refused(tmp_path: Path) -> None:
    small = box_room([("table", (0.5, 0.3, 0.35), (0.9, 0.6, 0.7), 0.2)], cameras=1)
    data = dump_glb([small.surface.to_trimesh()], ["room|wall|0"])
    path = tmp_path / "room.glb"
    scan = Scan("glb", path, "glb", "room")

    @settings(FUZZ, max_examples=40)
    @given(data=mangled(data))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        works_or_is_refused(lambda: run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))

    attempt()


TRAJECTORIES = {
    "quaternions": "0 0 0 0 0 0 1\n1 0 0 0 0 0.70710678 0.70710678\n",
    "stamped": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0.70710678 0.70710678\n",
    "log": "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 2\n0 -1 0 1\n1 0 0 0\n0 0 1 0\n0 0 0 1\n",
    "rows": "1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 0 0 0 1 0\n",
    "square": "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n0 -1 0 1\n1 0 0 0\n0 0 1 0\n0 0 0 1\n",
    "commented": "# tx ty tz qx qy qz qw\n0, 0, 0, 0, 0, 0, 1\n\n1, 0, 0, 0, 0, 0.70710678, 0.70710678\n",
}


@pytest.mark.parametrize("kind", TRAJECTORIES)
def test_trajectories_say_the_same_in_every_layout(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(TRAJECTORIES[kind])
    poses, reasons = read_trajectory(path, path.name, ["0", "1"])
    expected = np.array([[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert not reasons
    assert np.allclose(poses[0], np.eye(4))
    assert np.allclose(poses[1], expected, atol=1e-7)
    inverted, _ = read_trajectory(path, path.name, ["0", "1"], "world-to-camera")
    assert np.allclose(inverted[1] @ expected, np.eye(4), atol=1e-7)

    @settings(FUZZ, max_examples=60)
    @given(data=mangled(TRAJECTORIES[kind].encode()))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        works_or_is_refused(lambda: read_trajectory(path, path.name, ["0", "1"]))

    attempt()


def test_trajectory_longer_than_the_frames_goes_by_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.log"
    blocks = "".join(f"{k} {k} {k + 1}\n1 0 0 {k}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for k in range(9))
    path.write_text(blocks)
    poses, reasons = read_trajectory(path, path.name, ["00000", "00004", "00008", "00012"])
    assert [pose[0, 3] for pose in poses[:3]] == [0, 4, 8]
    assert poses[3] is None
    assert reasons == {3: "none in the trajectory"}


def test_quaternion_order_is_as_described(tmp_path: Path) -> None:
    path = tmp_path / "pose.txt"
    path.write_text("0 0 0 1 0 0 0\n")
    assert np.allclose(read_trajectory(path, path.name, ["0"])[0][0], np.diag([1, -1, -1, 1]))
    assert np.allclose(read_trajectory(path, path.name, ["0"], "tx ty tz qw qx qy qz")[0][0], np.eye(4))


def test_floats_of_any_text() -> None:
    @settings(FUZZ, max_examples=200)
    @given(text=st.text(max_size=40), count=st.integers(1, 16))
    def attempt(text: str, count: int) -> None:
        works_or_is_refused(lambda: floats(text, "file", "field", count))

    attempt()


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("a,b\n1,2\n", "raw_label"),
        ("raw_label,category,nyu40_id\nchair,chair,41\n", "line 2"),
        ("raw_label,category,nyu40_id\nchair\n", "line 2"),
    ],
)
def test_label_map_that_is_none(text: str, field: str, tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(InputError) as raised:
        label_map(str(tmp_path / "labels.csv"))
    assert raised.value.file == "labels.csv"
    assert field in raised.value.field


def test_depth_units_that_cannot_be(room: BoxRoom, tmp_path: Path) -> None:
    folder = write_posed_rgbd(tmp_path / "room", room)
    edit_json(folder / "intrinsics.json", lambda d: d.update(depth_scale=1))
    assert refused(folder).field == "depth_scale"
    edit_json(folder / "intrinsics.json", lambda d: d.update(depth_scale="many"))
    assert refused(folder).field == "depth_scale"
    edit_json(folder / "intrinsics.json", lambda d: d.update(depth_scale=1000))
    (folder / "pose.txt").unlink()
    error = refused(folder)
    assert (error.field, error.problem) == ("poses", "there are none")
    assert "make open3d" in error.remedy


def test_a_long_word_among_integers_takes_no_memory() -> None:
    """An array of words would hold each of them at the length of the longest."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="must be a list of integers"):
            integers(["7" * 10_000, *range(1_000)], "a.segs.json", "segIndices")
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()
    with pytest.raises(InputError, match="64 bits"):
        integers([1, 2**63], "a.segs.json", "segIndices")
    np.testing.assert_array_equal(integers([3, 1], "a.segs.json", "segIndices"), [3, 1])
