"""The MetaScenes layout as tables of the lake: every object where the release puts it, before and after its physics engine."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flows.inputs.ingestion import import_dataset
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.capture.labels import label_map
from tasks.geometry.meshes import surface_of
from tasks.ingestion.metascenes import instance_ids
from tasks.ingestion.models import ENDINGS
from tasks.ingestion.scene import scaled_pose
from tasks.replica import Phase, placed_parts
from tests.flows.inputs.metascenes_release import FLOOR, HEIGHT, Truth, write_release
from tests.flows.inputs.test_ingestion import apart
from tests.replicas import cube, furnished
from warehouse.lake import Lake

SCANS = ("scene0001_00", "scene0001_01")


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Lake, dict[str, list[Truth]]]:
    folder = tmp_path_factory.mktemp("metascenes")
    small = [cube((0.3, 0.2, 0.25), np.eye(4)), cube((0.4, 0.4, 0.5), np.diag([1.0, 1, 1, 1]))]
    truths = write_release(folder / "release", {SCANS[0]: furnished(), SCANS[1]: small})
    lake = Lake.open(folder / "lake")
    done = import_dataset(lake, "metascenes", folder / "release", "MetaScenes")
    assert [one.error for one in done.scenes] == [None, None]
    return lake, truths


def vertices(lake: Lake, row: Placement, phase: Phase) -> np.ndarray:
    return surface_of(placed_parts(row, lake.blobs[f"{row.asset_id}.glb"], phase)).vertices


def test_every_object_is_where_people_put_it_and_where_the_physics_engine_left_it(imported: tuple[Lake, dict[str, list[Truth]]]) -> None:
    lake, truths = imported
    reader = lake.snapshot()
    for scan, objects in truths.items():
        instances = {row.source_id: row for row in reader.rows(Instance, f"metascenes/{scan}")}
        placements = {row.instance_id: row for row in reader.rows(Placement, f"metascenes/{scan}")}
        assert set(instances) == {truth.name for truth in objects}
        assert len(placements) == len(objects)
        for truth in objects:
            instance = instances[truth.name]
            row = placements[instance.instance_id]
            after = truth.annotated if truth.simulated is None else truth.simulated
            assert apart(vertices(lake, row, "optimized"), after) < 1e-4
            assert row.origin == "annotation"
            assert row.method == "imported"
            if truth.simulated is None:
                assert (row.displacement_m, row.lift_m) == (None, None)
                assert row.remains is not None
            else:
                assert apart(vertices(lake, row, "proposed"), truth.annotated) < 1e-4
                moved = np.array(row.optimized_pose).reshape(4, 4)[:3, 3] - np.array(row.proposed_pose).reshape(4, 4)[:3, 3]
                assert row.displacement_m == pytest.approx(float(np.hypot(moved[0], moved[1])))
                assert row.lift_m == pytest.approx(moved[2])
                assert row.remains is None
            own = label_map()[truth.label]
            assert (instance.raw_label, instance.category, instance.nyu40_id) == (truth.label, own.category, own.nyu40_id)
            assert instance.box_size[2] == pytest.approx(np.ptp(after[:, 2]), abs=1e-6)
            assert instance.box_volume_m3 <= np.prod(np.ptp(after, axis=0)) * 1.001, "never larger than the box along the axes"


def test_rooms_have_the_floor_that_the_release_states(imported: tuple[Lake, dict[str, list[Truth]]]) -> None:
    lake, truths = imported
    for scan in truths:
        (room,) = lake.snapshot().rows(Shell, f"metascenes/{scan}")
        (scene,) = lake.snapshot().rows(Scene, f"metascenes/{scan}")
        assert apart(np.array(room.floor_polygon), np.array(FLOOR)) < 1e-9
        assert room.floor_area_m2 == pytest.approx(24.0)
        assert (room.floor_source, room.height_source, room.height_m) == ("layout", "layout", HEIGHT)
        assert (scene.scan_format, scene.segmentation, scene.floor_tilt_radians) == ("metascenes", "objects", None)
        assert scene.room_id == "scannet/scene0001", "scans of one room of ScanNet, which splits must not part"


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda value: {"matrix": {name: np.ravel(m).tolist() for name, m in value["matrix"].items()}}, None),
        (lambda value: value["matrix"], None),
        (lambda value: {"matrix": {name: {"pose": m, "scale": 1.0, "label": "mug"} for name, m in value["matrix"].items()}}, "mug"),
    ],
    ids=["16 numbers", "no key matrix", "objects"],
)
def test_other_ways_to_write_the_matrices_say_the_same(write, said: str | None, tmp_path: Path) -> None:
    truths = write_release(tmp_path / "release", {SCANS[0]: furnished()[3:5]})
    file = tmp_path / "release" / "Physical_simu" / f"{SCANS[0]}.json"
    file.write_text(json.dumps(write(json.loads(file.read_text()))))
    lake = Lake.open(tmp_path / "lake")
    import_dataset(lake, "metascenes", tmp_path / "release", "other")
    reader = lake.snapshot()
    names = {row.instance_id: row.source_id for row in reader.rows(Instance)}
    by_name = {truth.name: truth for truth in truths[SCANS[0]]}
    for row in reader.rows(Placement):
        truth = by_name[names[row.instance_id]]
        assert truth.simulated is not None
        assert apart(vertices(lake, row, "optimized"), truth.simulated) < 1e-4
    assert {row.category for row in reader.rows(Instance)} == ({said} if said else {"box"})


def test_without_names_every_category_is_unlabeled_and_the_run_says_so(tmp_path: Path) -> None:
    write_release(tmp_path / "release", {SCANS[0]: furnished()[3:5]})
    (names := tmp_path / "names").mkdir()
    (tmp_path / "release" / "instance_id_to_name" / f"{SCANS[0]}.json").rename(names / f"{SCANS[0]}.json")
    lake = Lake.open(tmp_path / "lake")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    assert {(row.category, row.raw_label, row.nyu40_id) for row in lake.snapshot().rows(Instance)} == {("unlabeled", "", 0)}
    assert any("--labels" in note for note in one.notes)
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other", labels=names).scenes
    assert one.action == "import", "names are part of what a scene follows from"
    assert {row.category for row in lake.snapshot().rows(Instance)} == {"box"}


MIRRORED = np.diag([1.0, -1.0, 1.0, 1.0])
SHEARED = np.array([[1.0, 0.6, 0, 1], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("value", "note"),
    [
        (SHEARED.tolist(), "shears the object"),
        ([[1, 2], [3, 4]], r"has shape \(2, 2\)"),
        (["a"] * 16, "is no matrix of numbers"),
        (None, "has no matrix"),
        ({"label": "mug"}, "has no matrix"),
        ([[1e9] * 4] * 4, "is no 4x4 matrix of finite numbers"),
        (np.diag([0.0, 1, 1, 1]).tolist(), "to nothing"),
    ],
)
def test_an_object_with_a_matrix_of_no_use_stays_where_people_put_it(value, note: str, tmp_path: Path) -> None:
    truths = write_release(tmp_path / "release", {SCANS[0]: furnished()[3:5]})[SCANS[0]]
    file = tmp_path / "release" / "Physical_simu" / f"{SCANS[0]}.json"
    matrices = json.loads(file.read_text())["matrix"]
    file.write_text(json.dumps({"matrix": {**matrices, truths[0].name: value}}))
    lake = Lake.open(tmp_path / "lake")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    assert one.error is None
    rows = {row.instance_id: row for row in lake.snapshot().rows(Placement)}
    names = {row.source_id: row.instance_id for row in lake.snapshot().rows(Instance)}
    assert apart(vertices(lake, rows[names[truths[0].name]], "optimized"), truths[0].annotated) < 1e-4
    assert truths[1].simulated is not None
    assert apart(vertices(lake, rows[names[truths[1].name]], "optimized"), truths[1].simulated) < 1e-4
    (told,) = (line for line in one.notes if "stays where people put it" in line)
    assert re.search(rf"^Physical_simu/{SCANS[0]}\.json: matrix\.{truths[0].name}: .*{note}", told)


def test_a_matrix_that_mirrors_an_object_mirrors_its_mesh(tmp_path: Path) -> None:
    truths = write_release(tmp_path / "release", {SCANS[0]: furnished()[:2]})[SCANS[0]]
    file = tmp_path / "release" / "Physical_simu" / f"{SCANS[0]}.json"
    matrices = json.loads(file.read_text())["matrix"]
    matrix = np.array(matrices[truths[0].name]) @ MIRRORED
    file.write_text(json.dumps({"matrix": {**matrices, truths[0].name: matrix.tolist()}}))
    lake = Lake.open(tmp_path / "lake")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    assert one.error is None
    names = {row.source_id: row.instance_id for row in lake.snapshot().rows(Instance)}
    (row,) = (row for row in lake.snapshot().rows(Placement) if row.instance_id == names[truths[0].name])
    center = (truths[0].annotated.min(axis=0) + truths[0].annotated.max(axis=0)) / 2
    expected = (truths[0].annotated - center) @ matrix[:3, :3].T + matrix[:3, 3]
    assert apart(vertices(lake, row, "optimized"), expected) < 1e-4
    assert surface_of(placed_parts(row, lake.blobs[f"{row.asset_id}.glb"], "optimized")).to_trimesh().volume > 0
    assert any("its mesh is mirrored" in line for line in one.notes)


def test_an_object_whose_mesh_is_broken_is_left_out(tmp_path: Path) -> None:
    truths = write_release(tmp_path / "release", {SCANS[0]: furnished()[:3]})[SCANS[0]]
    folders = [tmp_path / "release" / "Annotation_scenes" / SCANS[0] / truth.name for truth in truths]
    meshes = [next(path for path in folder.iterdir() if path.suffix in ENDINGS) for folder in folders]
    meshes[0].write_bytes(b"glTF")
    meshes[1].unlink()
    meshes[1].symlink_to("/etc/hostname")
    names = tmp_path / "release" / "instance_id_to_name" / f"{SCANS[0]}.json"
    names.write_text(json.dumps({**json.loads(names.read_text()), truths[2].name: None}))
    lake = Lake.open(tmp_path / "lake")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    assert one.error is None
    assert {row.source_id for row in lake.snapshot().rows(Instance)} == {truths[2].name}
    for told in (f"{meshes[0].parent.name}/{meshes[0].name}: ", "leads out of the dataset's folder: left out", "is null, not a name"):
        assert sum(told in line for line in one.notes) == 1, told
    meshes[2].write_bytes(b"glTF")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    assert one.error is not None


def test_a_layout_elsewhere_is_passed_over_for_one_around_the_objects(tmp_path: Path) -> None:
    truths = write_release(tmp_path / "release", {SCANS[0]: furnished()})
    file = tmp_path / "release" / "Layout" / "Heuristic" / f"{SCANS[0]}.json"
    away = tmp_path / "release" / "Layout" / "RoomFormer" / f"{SCANS[0]}.json"
    document = json.loads(file.read_text())
    away.write_text(json.dumps({**document, "vert": [[x + 50, y, z] for x, y, z in document["vert"]]}))
    lake = Lake.open(tmp_path / "lake")
    (one,) = import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes
    (room,) = lake.snapshot().rows(Shell)
    points = np.concatenate([truth.annotated for truth in truths[SCANS[0]]])
    assert room.floor_area_m2 == pytest.approx(float(np.prod(np.ptp(points[:, :2], axis=0))))
    assert (room.floor_source, room.height_source) == ("layout", "extent")
    assert any("RoomFormer" in note and "0 of 6" in note for note in one.notes)


angles = st.floats(-3.1, 3.1)
sides = st.floats(0.01, 50)


@settings(max_examples=100, deadline=None)
@given(st.tuples(angles, angles, angles), st.tuples(sides, sides, sides), st.tuples(*[st.floats(-100, 100)] * 3))
def test_a_matrix_comes_apart_into_a_pose_and_a_scale_and_together_again(turn, scale, offset) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix() * np.array(scale)
    matrix[:3, 3] = offset
    pose, stretch = scaled_pose(matrix, "a.json", "matrix.1")
    assert stretch == pytest.approx(scale, rel=1e-9)
    assert pose @ np.diag([*stretch, 1.0]) == pytest.approx(matrix, abs=1e-6)
    for wrong, problem in (
        (matrix @ np.diag([-1.0, 1, 1, 1]), "mirrors"),
        (matrix * np.nan, "finite"),
        (matrix @ np.diag([1e-5, 1, 1, 1]), "nothing"),
    ):
        with pytest.raises(InputError, match=problem) as refused:
            scaled_pose(wrong, "a.json", "matrix.1")
        assert (refused.value.file, refused.value.field) == ("a.json", "matrix.1")
    sheared = matrix.copy()
    sheared[:3, 0] += 0.5 * scale[0] * matrix[:3, 1] / np.linalg.norm(matrix[:3, 1])
    with pytest.raises(InputError, match="shears"):
        scaled_pose(sheared, "a.json", "matrix.1")


@settings(max_examples=50, deadline=None)
@given(st.sets(st.from_regex(r"[0-9]{1,3}(-[0-9]{1,2})?", fullmatch=True), min_size=1, max_size=12))
def test_instances_keep_their_numbers_and_get_ids_of_their_own(names: set[str]) -> None:
    found = instance_ids(sorted(names))
    assert set(found) == names
    assert len(set(found.values())) == len(names)
    for name in names:
        if name.isdigit() and f"{int(name)}" == name:
            assert int(found[name]) == int(name)
    assert found == instance_ids(sorted(names, reverse=True))
