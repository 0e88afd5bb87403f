"""Habitat datasets as tables of the lake: ours come back as they left, and others' say what an independent reading says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flows.inputs.ingestion import import_dataset
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Scene, Shell
from schemas.navigation import Navmesh
from schemas.optimization import Placement
from schemas.runs import StageRun
from tasks.capture.labels import label_map
from tasks.geometry.meshes import surface_of
from tasks.ingestion.habitat import read_habitat
from tasks.ingestion.sources import find_sources
from tasks.replica import placed_parts
from tasks.shell import floor_ring
from tests.flows.inputs.test_ingestion import apart
from tests.tasks.exports.habitat.habitat_datasets import Rows, office, other_room, write_dataset
from warehouse.lake import Lake

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def scenes() -> list[tuple[Rows, dict[str, bytes]]]:
    return [office(), other_room()]


@pytest.fixture(scope="module")
def exported(scenes: list[tuple[Rows, dict[str, bytes]]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("exported"), scenes)


@pytest.fixture(scope="module")
def lake(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> Lake:
    lake = Lake.open(tmp_path_factory.mktemp("imported") / "lake")
    done = import_dataset(lake, "habitat", exported, "back")
    assert done.failed == ()
    assert {note.rpartition(": ")[2] for one in done.scenes for note in one.notes} == {"episodes are not read"}
    return lake


@pytest.mark.whole
def test_our_own_export_comes_back(scenes: list[tuple[Rows, dict[str, bytes]]], lake: Lake) -> None:
    reader = lake.snapshot()
    names = {json.loads(row.config)["import"] for row in reader.rows(StageRun)}
    assert names == {"habitat"}
    imported = {row.scene_id: row for row in reader.rows(Scene)}
    assert len(imported) == len(scenes)
    for rows, blobs in scenes:
        (old,) = rows["scenes"]
        (scene_id,) = [name for name in imported if name.startswith(f"back/{old.scene_id.replace('/', '_')}_")]
        assert (imported[scene_id].license, imported[scene_id].scan_format) == (old.license, "habitat")
        placements = {row.instance_id: row for row in reader.rows(Placement, scene_id)}
        instances = {row.instance_id: row for row in reader.rows(Instance, scene_id)}
        captions = {row.instance_id: row for row in reader.rows(Caption, scene_id)}
        assets = {row.asset_id: row for row in reader.rows(Asset)}
        before = {row.asset_id: row for row in rows["assets"]}
        assert set(placements) == set(instances) == {row.instance_id for row in rows["placements"]}
        for row in rows["placements"]:
            new = placements[row.instance_id]
            assert np.array(new.optimized_pose) == pytest.approx(np.array(row.optimized_pose), abs=1e-5)
            extents = np.array(assets[new.asset_id].extents) * new.scale
            assert extents == pytest.approx(np.array(before[row.asset_id].extents) * row.scale, abs=1e-4)
            vertices = surface_of(placed_parts(new, lake.blobs[f"{new.asset_id}.glb"])).vertices
            assert apart(vertices, surface_of(placed_parts(row, blobs[f"{row.asset_id}.glb"])).vertices) < 1e-4
            assert assets[new.asset_id].license == before[row.asset_id].license
            assert (new.origin, new.displacement_m, new.lift_m) == ("imported", None, None)
        for row in rows["instances"]:
            new_row = instances[row.instance_id]
            assert (new_row.category, new_row.nyu40_id, new_row.nyu40_label) == (row.category, row.nyu40_id, row.nyu40_label)
        for row in rows["captions"]:
            said = captions[row.instance_id]
            assert (said.mass_kg, said.friction, said.restitution) == pytest.approx((row.mass_kg, row.friction, row.restitution))
            assert (said.density_kg_m3, said.solid_fraction, said.provider) == (None, None, "imported")
        (navmesh,) = reader.rows(Navmesh, scene_id)
        (known,) = rows["navmeshes"]
        assert navmesh.navmesh_blob == known.navmesh_blob, "the file itself, byte by byte"
        assert (navmesh.agent_radius_m, navmesh.agent_height_m) == pytest.approx((known.agent_radius_m, known.agent_height_m))
        assert navmesh.area_m2 == pytest.approx(known.area_m2, rel=1e-4)
        assert navmesh.largest_island_m2 == pytest.approx(known.largest_island_m2, rel=1e-4)
        assert navmesh.island_count == known.island_count


def test_the_room_is_found_in_the_stage(scenes: list[tuple[Rows, dict[str, bytes]]], lake: Lake) -> None:
    import shapely

    for rows, _ in scenes:
        (old,) = rows["shells"]
        (new,) = [row for row in lake.snapshot().rows(Shell) if f"_{old.scene_id.rpartition('/')[2]}_" in row.scene_id]
        before, after = shapely.Polygon(floor_ring(old)), shapely.Polygon(floor_ring(new))
        assert before.intersection(after).area / before.union(after).area > 0.95
        assert new.room_type == old.room_type
        assert new.height_m == pytest.approx(old.height_m, abs=0.3)


def rotation(quaternion: Any) -> Array:
    """Rotation matrix of a quaternion (w, x, y, z) of any length, by its action on the axes: v + 2 u x (u x v + w v)."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, u = q[0] / np.linalg.norm(q), q[1:] / np.linalg.norm(q)
    return np.column_stack([v + 2 * np.cross(u, np.cross(u, v) + w * v) for v in np.eye(3)])


def expected_vertices(placed: dict[str, Any], template: dict[str, Any], mesh: Path, default_origin: str | None) -> Array:
    """Vertices of an object in Habitat's frame, read from the JSON and the GLB by themselves, shape (n, 3) [m]."""
    scene = trimesh.load_scene(mesh, process=False)
    drawn = [scene.graph.get(node) for node in scene.graph.nodes_geometry]
    points = np.concatenate([trimesh.transform_points(scene.geometry[name].vertices, pose) for pose, name in drawn])
    up, front = np.array(template.get("up", [0, 1, 0]), float), np.array(template.get("front", [0, 0, -1]), float)
    points = points @ np.column_stack([np.cross(front, up), up, -front])
    scale = np.array(template.get("scale", [1, 1, 1]), float) * template.get("units_to_meters", 1.0)
    scale = scale * np.array(placed.get("non_uniform_scale", [1, 1, 1]), float) * placed.get("uniform_scale", 1.0)
    if (placed.get("translation_origin") or default_origin or "COM").lower() == "com":
        points = points - np.array(template["COM"] if "COM" in template else (points.min(axis=0) + points.max(axis=0)) / 2)
    return (points * scale) @ rotation(placed.get("rotation", [1, 0, 0, 0])).T + np.array(placed.get("translation", [0, 0, 0]), float)


def to_z_up(points: Array) -> Array:
    """From +Y up, -Z forward to +Z up, shape (n, 3)."""
    return np.column_stack([points[:, 0], -points[:, 2], points[:, 1]])


def check_against_files(root: Path, tmp_path: Path, resolve: dict[str, str]) -> int:
    """Import a dataset and hold every placed object against an independent reading; how many there were.

    `resolve`: object config by the name that a scene gives it, where that is not the file's own.
    """
    lake = Lake.open(tmp_path / "lake")
    done = import_dataset(lake, "habitat", root, "others")
    assert [one.error for one in done.scenes] == [None] * len(done.scenes)
    (config,) = root.glob("*.scene_dataset_config.json")
    defaults = json.loads(config.read_text()).get("objects", {}).get("default_attributes", {})
    files = {path.name.removesuffix(".object_config.json"): path for path in root.rglob("*.object_config.json")}
    reader = lake.snapshot()
    count = 0
    for path in root.rglob("*.scene_instance.json"):
        document = json.loads(path.read_text())
        scene_id = f"others/{path.name.removesuffix('.scene_instance.json')}"
        rows = reader.rows(Placement, scene_id)
        captions = {row.instance_id: row for row in reader.rows(Caption, scene_id)}
        instances = {row.instance_id: row for row in reader.rows(Instance, scene_id)}
        assert len(rows) == len(document["object_instances"])
        for row, placed in zip(rows, document["object_instances"], strict=True):
            file = files[resolve.get(placed["template_name"], placed["template_name"])]
            template = {**defaults, **json.loads(file.read_text())}
            there = expected_vertices(placed, template, file.parent / template["render_asset"], document.get("translation_origin"))
            there = to_z_up(there)
            here = surface_of(placed_parts(row, lake.blobs[f"{row.asset_id}.glb"])).vertices
            assert apart(here, there) < 1e-5 * max(1.0, float(np.abs(there).max()))
            box = instances[row.instance_id]
            corners = np.linalg.inv(np.reshape(box.box_pose, (4, 4))) @ np.column_stack([there, np.ones(len(there))]).T
            assert 2 * np.abs(corners[:3]).max(axis=1) == pytest.approx(box.box_size, abs=1e-4, rel=1e-4)
            if "mass" in template:
                assert captions[row.instance_id].mass_kg == pytest.approx(template["mass"] * placed.get("mass_scale", 1.0))
            count += 1
    return count


@pytest.mark.parametrize(
    ("name", "count", "resolve"),
    [
        ("dataset_0", 2, {}),
        ("dataset_1", 4, {"dataset_test_object1": "dataset_test_object1_0", "dataset_test_object2": "dataset_test_object2_1"}),
    ],
)
def test_others_datasets_say_what_their_files_say(name: str, count: int, resolve: dict[str, str], realdata, tmp_path: Path) -> None:
    root = realdata(f"habitat_sim_test_assets/data/test_assets/dataset_tests/{name}")
    assert check_against_files(root, tmp_path, resolve) == count


def others(root: Path, objects: list[dict[str, Any]], templates: list[dict[str, Any]], origin: str | None) -> Path:
    """A dataset that nobody of ours wrote: files by patterns, defaults, meshes of several nodes."""
    (root / "objects" / "deep").mkdir(parents=True)
    (root / "stages").mkdir()
    (root / "scenes").mkdir()
    trimesh.Scene({"floor": trimesh.creation.box([6, 0.1, 6])}).export(root / "stages" / "hall.glb")
    (root / "stages" / "hall.stage_config.json").write_text(json.dumps({"render_asset": "hall.glb", "up": [0, 1, 0], "front": [0, 0, -1]}))
    for index, template in enumerate(templates):
        scene = trimesh.Scene()
        for part in range(2):
            mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.1 + 0.1 * part)
            scene.add_geometry(mesh, node_name=f"part {part}", transform=trimesh.transformations.translation_matrix([0.3 * part, 0.2, 0.1]))
        scene.export(root / "objects" / "deep" / f"gizmo_{index}.glb")
        written = {"render_asset": f"gizmo_{index}.glb", **template}
        (root / "objects" / "deep" / f"gizmo_{index}.object_config.json").write_text(json.dumps(written))
    scene_values = {"stage_instance": {"template_name": "hall"}, "object_instances": objects}
    if origin is not None:
        scene_values["translation_origin"] = origin
    (root / "scenes" / "one.scene_instance.json").write_text(json.dumps(scene_values))
    config = {
        "stages": {"paths": {".json": ["stages/*.json"]}},
        "objects": {"default_attributes": {"mass": 2.5}, "paths": {".json": ["objects/*"]}},
        "scene_instances": {"paths": {".json": ["scenes"]}},
    }
    (root / "others.scene_dataset_config.json").write_text(json.dumps(config))
    return root


numbers = st.floats(-20, 20, allow_nan=False)
factors = st.floats(0.05, 5)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
origins = st.sampled_from(["COM", "com", "asset_local", "ASSET_LOCAL"])
axes = st.permutations([0, 1, 2]).flatmap(
    lambda order: st.tuples(st.just(order), st.sampled_from([-1.0, 1.0]), st.sampled_from([-1.0, 1.0]))
)


def optional(**fields: st.SearchStrategy) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=fields)


templates = st.tuples(
    optional(
        scale=st.lists(factors, min_size=3, max_size=3),
        units_to_meters=factors,
        COM=st.lists(numbers, min_size=3, max_size=3),
        mass=st.floats(0.01, 500),
    ),
    st.none() | axes,
).map(lambda pair: pair[0] | ({} if pair[1] is None else frame(*pair[1])))


def frame(order: Any, up: float, front: float) -> dict[str, Any]:
    """Two of the axes at right angles, either way around."""
    return {"up": (up * np.eye(3)[order[0]]).tolist(), "front": (front * np.eye(3)[order[1]]).tolist()}


placed = optional(
    translation=st.lists(numbers, min_size=3, max_size=3),
    rotation=quaternions.map(list),
    uniform_scale=factors,
    non_uniform_scale=st.lists(factors, min_size=3, max_size=3),
    translation_origin=origins,
    mass_scale=factors,
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(made=st.lists(templates, min_size=1, max_size=2), objects=st.lists(placed, min_size=1, max_size=4), origin=st.none() | origins)
def test_any_pose_scale_frame_and_origin_is_read_as_habitat_has_it(
    made: list[dict[str, Any]], objects: list[dict[str, Any]], origin: str | None, tmp_path_factory: pytest.TempPathFactory
) -> None:
    listed = [{"template_name": f"gizmo_{index % len(made)}", **one} for index, one in enumerate(objects)]
    root = others(tmp_path_factory.mktemp("others") / "data", listed, made, origin)
    (source,) = find_sources("habitat", root, "others")
    found = read_habitat(source, label_map()).objects
    assert len(found) == len(objects)
    for one, values in zip(found, listed, strict=True):
        template = {"mass": 2.5, **made[int(values["template_name"].removeprefix("gizmo_"))]}
        mesh = root / "objects" / "deep" / f"{values['template_name']}.glb"
        there = to_z_up(expected_vertices(values, template, mesh, origin))
        here = surface_of(one.model.parts).transformed(one.pose, one.scale).vertices
        assert apart(here, there) < 1e-5 * max(1.0, float(np.abs(there).max()))
        assert one.physics is not None
        assert one.physics.mass_kg == pytest.approx(max(template["mass"] * values.get("mass_scale", 1.0), 0.001))


def test_a_generated_dataset_says_what_its_files_say(tmp_path: Path) -> None:
    objects = [
        {"template_name": "gizmo_0", "translation": [1, 0.2, -2], "rotation": [0.5, 0.5, -0.5, 0.5]},
        {"template_name": "gizmo_1", "translation": [-1, 0, 0.5], "rotation": [0.9, 0, 0.4, 0], "translation_origin": "asset_local"},
        {"template_name": "gizmo_1", "non_uniform_scale": [1, 2, 0.5], "uniform_scale": 0.7, "mass_scale": 3.0},
    ]
    made = [{"COM": [0.1, 0.2, 0.3]}, {"up": [0, 0, 1], "front": [0, 1, 0], "scale": [1, 1, 2], "mass": 4.0}]
    assert check_against_files(others(tmp_path / "data", objects, made, "COM"), tmp_path, {}) == 3


def test_categories_come_from_where_a_dataset_has_them(tmp_path: Path) -> None:
    objects = [{"template_name": f"gizmo_{index}"} for index in range(4)]
    objects[0]["user_defined"] = {"category": "Couch"}
    root = others(tmp_path / "data", objects, [{}, {"user_defined": {"category": "office chair"}}, {}, {"semantic_id": 7}], None)
    (root / "metadata").mkdir()
    (root / "metadata" / "object_categories_filtered.csv").write_text("id,clean_category,type\ngizmo_2,mug,small\ngizmo_3,,\n")
    (root / "lexicon.json").write_text(json.dumps({"classes": [{"id": 7, "name": "table_lamp"}]}))
    config = root / "others.scene_dataset_config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {"semantic_scene_descriptor_instances": {"words": "lexicon.json"}}))
    (source,) = find_sources("habitat", root, "others")
    labels = label_map()
    found = {one.source_id: one for one in read_habitat(source, labels).objects}
    for name, raw in {"gizmo_0": "Couch", "gizmo_1": "office chair", "gizmo_2": "mug", "gizmo_3": "table_lamp"}.items():
        assert found[name].raw_label == raw
        assert found[name].label.category == labels[raw].category
        assert found[name].label.nyu40_id == labels[raw].nyu40_id > 0


def test_an_object_without_words_is_unlabeled(tmp_path: Path) -> None:
    root = others(tmp_path / "data", [{"template_name": "gizmo_0"}], [{}], None)
    (source,) = find_sources("habitat", root, "others")
    (one,) = read_habitat(source, label_map()).objects
    assert (one.raw_label, one.label.category, one.label.nyu40_id, one.label.is_known) == ("", "unlabeled", 0, False)


def test_what_is_no_asset_is_still_an_instance_and_says_why(tmp_path: Path) -> None:
    root = others(tmp_path / "data", [{"template_name": "gizmo_0"}], [{}], None)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    flat.export(root / "objects" / "deep" / "gizmo_0.glb")
    lake = Lake.open(tmp_path / "lake")
    (done,) = import_dataset(lake, "habitat", root, "others").scenes
    reader = lake.snapshot()
    assert len(reader.rows(Instance)) == 1
    (candidate,) = reader.rows(Candidate)
    assert (candidate.outcome, candidate.asset_id) == ("failed", None)
    assert "3 vertices" in str(candidate.reason)
    assert reader.rows(Placement) == []
    assert any("no asset" in note for note in done.notes)


def test_one_mesh_of_many_objects_is_one_asset(tmp_path: Path) -> None:
    objects = [{"template_name": "gizmo_0", "translation": [index, 0, 0]} for index in range(5)]
    root = others(tmp_path / "data", objects, [{}], None)
    lake = Lake.open(tmp_path / "lake")
    import_dataset(lake, "habitat", root, "others")
    assert len(lake.snapshot().rows(Asset)) == 1
    assert [row.instance_id for row in lake.snapshot().rows(Placement)] == [f"{index:04d}" for index in range(5)]


def test_articulated_objects_and_unknown_navmeshes_are_named_and_left_out(tmp_path: Path) -> None:
    root = others(tmp_path / "data", [{"template_name": "gizmo_0"}], [{}], None)
    file = root / "scenes" / "one.scene_instance.json"
    more = {"articulated_object_instances": [{"template_name": "fridge"}], "navmesh_instance": "nosuch"}
    file.write_text(json.dumps(json.loads(file.read_text()) | more))
    (done,) = import_dataset(Lake.open(tmp_path / "lake"), "habitat", root, "others").scenes
    assert done.error is None
    assert any("1 articulated objects" in note for note in done.notes)
    assert any("'nosuch' is no navmesh" in note for note in done.notes)
