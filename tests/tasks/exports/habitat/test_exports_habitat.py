"""The Habitat dataset: where objects stand, and that its episodes lead where they say by its own files alone."""

from __future__ import annotations

import csv
import dataclasses
import gzip
import io
import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial.transform import Rotation

from schemas.errors import InputError
from tasks import exports, navigation
from tasks.capture.labels import NYU40
from tasks.containers import open_glb
from tasks.exports.config import HabitatConfig
from tasks.exports.habitat import ACTIONS
from tasks.exports.habitat.rules import check_habitat
from tasks.exports.layout import layout, shared_files
from tasks.geometry.transforms import yaw_pose
from tasks.navigation import NavigationConfig
from tasks.navigation.navmesh import read_navmesh
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.stage import Context
from tests.replicas import cube, rows_of
from tests.tasks.exports.habitat.habitat_damage import edit
from tests.tasks.exports.habitat.habitat_datasets import FIRST, Rows, office, other_room, scene_file, write_dataset
from tests.tasks.exports.test_exports import export


@pytest.fixture(scope="module")
def scene() -> tuple[Rows, dict[str, bytes]]:
    return office()


@pytest.fixture(scope="module")
def dataset(scene: tuple[Rows, dict[str, bytes]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two scenes whose plain names contain one another."""
    return write_dataset(tmp_path_factory.mktemp("place"), [scene, other_room()])


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset, tmp_path / "habitat"))


def transform(item: dict[str, Any]) -> np.ndarray:
    """Pose of an object instance, its quaternion (w, x, y, z), by another library than the one that wrote it."""
    w, x, y, z = item["rotation"]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = item["translation"]
    return pose


def load(path: Path) -> trimesh.Trimesh:
    return trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb").to_geometry()


def test_a_sound_dataset_has_no_findings_wherever_it_lies(dataset: Path, copy: Path) -> None:
    assert check_habitat(dataset) == []
    assert check_habitat(copy) == []


def test_a_scene_from_before_there_were_lights_is_warned_of_beside_newer_ones(copy: Path) -> None:
    """An older export in the same folder: no lights, no margins; whoever exports newer scenes beside it is not stopped."""
    (copy / "lights" / f"{FIRST}_lights.lighting_config.json").unlink()
    edit(scene_file(copy), lambda values: values.update(default_lighting="no_lights"))
    config = copy / "metascenes.scene_dataset_config.json"
    edit(config, lambda values: values["light_setups"]["paths"].update({".json": ["lights/*.lighting_config.json"]}))
    older = [path for kind in ("objects", "stages") for path in sorted((copy / kind).glob(f"{FIRST}*_config.json"))]
    for path in older:
        edit(path, lambda values: values.pop("margin"))
    broken = check_habitat(copy)
    assert {finding.where for finding in broken} == {str(path.relative_to(copy)) for path in older}
    assert {(finding.rule, finding.is_error) for finding in broken} == {("margin", False)}


def test_objects_stand_where_the_replica_has_them(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    rows, blobs = scene
    assets = {asset.asset_id: asset for asset in rows["assets"]}
    items = {item["user_defined"]["instance_id"]: item for item in json.loads(scene_file(dataset).read_text())["object_instances"]}
    assert set(items) == {row.instance_id for row in rows["placements"]}
    for placement in rows["placements"]:
        item = items[placement.instance_id]
        config = json.loads((dataset / "objects" / f"{item['template_name']}.object_config.json").read_text())
        expected = np.concatenate([part.vertices for part in placed_parts(placement, blobs[assets[placement.asset_id].mesh_blob])])
        expected = np.column_stack([expected[:, 0], expected[:, 2], -expected[:, 1]])
        for key in ("render_asset", "collision_asset"):
            mesh = load(dataset / "objects" / config[key])
            mesh.apply_transform(transform(item))
            tolerance = 1e-5 if key == "render_asset" else 0.03
            np.testing.assert_allclose(mesh.bounds, [expected.min(axis=0), expected.max(axis=0)], atol=tolerance)


def test_the_stage_is_the_room_in_the_gltf_frame(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    shell = np.concatenate([mesh.vertices for _, mesh in room_shell(scene[0]["shells"][0])])
    mesh = load(dataset / "stages" / f"{FIRST}.glb")
    turned = np.column_stack([shell[:, 0], shell[:, 2], -shell[:, 1]])
    np.testing.assert_allclose(mesh.bounds, [turned.min(axis=0), turned.max(axis=0)], atol=1e-6)


def test_what_touches_starts_to_move_without_a_shell_around_it(dataset: Path) -> None:
    configs = [*(dataset / "objects").glob("*.object_config.json"), *(dataset / "stages").glob("*.stage_config.json")]
    assert len(configs) > 2
    assert {json.loads(path.read_text())["margin"] for path in configs} == {0.0}


def test_every_scene_is_lit_by_lamps_below_its_ceiling(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    room = scene[0]["shells"][0]
    name = json.loads(scene_file(dataset).read_text())["default_lighting"]
    places = np.array(
        [lamp["position"] for lamp in json.loads((dataset / "lights" / f"{name}.lighting_config.json").read_text())["lights"].values()]
    )
    assert len(places) >= 1
    assert shapely.contains_xy(shapely.Polygon(room.floor_polygon), places[:, 0], -places[:, 2]).all()
    assert ((places[:, 1] > 0.5 * room.height_m) & (places[:, 1] < room.height_m)).all()


def test_colliders_are_convex_and_equal_shapes_are_stored_once(dataset: Path) -> None:
    for path in sorted((dataset / "objects").glob("*.collider.glb")):
        for mesh in trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb").geometry.values():
            mesh.merge_vertices(merge_norm=True, merge_tex=True)
            assert mesh.is_watertight
            assert mesh.convex_hull.volume == pytest.approx(mesh.volume, rel=1e-3)
    handles = [f"{FIRST}_{number}" for number in ("0002", "0003")]
    configs = [json.loads((dataset / "objects" / f"{handle}.object_config.json").read_text()) for handle in handles]
    assert configs[0]["render_asset"] == configs[1]["render_asset"]
    assert [config["mass"] for config in configs] == [4.0, 7.0]
    assert [config["friction_coefficient"] for config in configs] == [0.5, 0.8]


def test_every_glb_says_what_its_buffers_hold(dataset: Path) -> None:
    paths = [*(dataset / "objects").glob("*.glb"), *(dataset / "stages").glob("*.glb")]
    assert len(paths) > 3
    for path in paths:
        document, _ = open_glb(path.read_bytes())
        views = [document["bufferViews"][accessor["bufferView"]]["target"] for accessor in document["accessors"]]
        for primitive in (primitive for mesh in document["meshes"] for primitive in mesh["primitives"]):
            assert {views[accessor] for accessor in primitive["attributes"].values()} == {34962}
            assert views[primitive["indices"]] == 34963


def test_every_asset_is_attributed_once(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    with (dataset / "metadata" / "attribution.csv").open(newline="") as file:
        lines = {line["asset_id"]: line for line in csv.DictReader(file)}
    items = [
        item["user_defined"] for path in (dataset / "scenes").glob("*.json") for item in json.loads(path.read_text())["object_instances"]
    ]
    assert set(lines) == {item["asset_id"] for item in items}
    for asset in scene[0]["assets"]:
        line = lines[asset.asset_id]
        assert (line["provider"], line["source"], line["license"]) == (asset.provider, asset.source, asset.license)
        assert FIRST in line["scenes"].split()


def test_scenes_that_show_one_asset_share_its_files(tmp_path: Path) -> None:
    sizes = [(0.3, 0.3, 0.3), (0.2, 0.4, 0.3)]
    poses = [yaw_pose(0.3, [0.5, -0.5, 0.0]), yaw_pose(1.0, [-1.5, 1.0, 0.0])]
    names = [f"demo/room_{number:02d}" for number in range(4)]
    scenes = [rows_of([cube(size, pose) for size, pose in zip(sizes, poses, strict=True)], name) for name in names]
    root = write_dataset(tmp_path, [({**rows, "navmeshes": [], "episodes": []}, dict(blobs)) for rows, blobs in scenes])
    assert len(list((root / "objects").glob("*.object_config.json"))) == 8
    files = sorted((root / "objects").glob("*.glb"))
    assert len(files) == 2 * len(sizes), "one to see and one to collide with, each"
    assert len({path.read_bytes() for path in files}) == len(files)
    assert not [finding for finding in check_habitat(root) if finding.is_error and finding.rule != "navmesh_settings"]


def episodes_of(root: Path, task: str) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for path in sorted((root / task).glob("*/content/*.json.gz")):
        content = json.loads(gzip.decompress(path.read_bytes()))
        for episode in content["episodes"]:
            yield content, episode


def test_episodes_lead_from_start_to_goal(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    rows = {row.episode_id: row for row in scene[0]["episodes"]}
    seen = 0
    for _, episode in episodes_of(dataset, "pointnav"):
        if episode["scene_id"] != FIRST:
            continue
        seen += 1
        row = rows[episode["info"]["episode"]]
        assert episode["info"]["scene"] == row.scene_id
        (path,) = episode["shortest_paths"]
        assert [state["action"] for state in path] == [ACTIONS[action] for action in row.actions]
        assert path[0]["position"] == episode["start_position"]
        assert path[0]["rotation"] == episode["start_rotation"]
        place, turn = np.array(path[0]["position"]), Rotation.from_quat(path[0]["rotation"])
        for state in path:  # replayed in Habitat's own frame
            np.testing.assert_allclose(state["position"], place, atol=1e-6)
            if state["action"] == 1:
                place = place + turn.apply([0.0, 0.0, -0.25])
            elif state["action"] in (2, 3):
                turn = turn * Rotation.from_rotvec([0.0, math.radians(30) * (1 if state["action"] == 2 else -1), 0.0])
        x, y, _ = row.final_position
        np.testing.assert_allclose(place[[0, 2]], [x, -y], atol=0.011)
        goal = np.array(episode["goals"][0]["position"])
        assert np.linalg.norm(place - goal) == pytest.approx(row.final_distance_m, abs=0.02)
        assert episode["info"]["geodesic_distance"] >= np.linalg.norm(np.array(episode["start_position"]) - goal) - 1e-6
    assert seen == len(rows) > 0


def test_object_goals_can_be_seen_from_their_view_points(dataset: Path) -> None:
    keys = set()
    for content, episode in episodes_of(dataset, "objectnav"):
        key = f"{episode['scene_id']}_{episode['object_category']}"
        keys.add(key)
        goals = content["goals_by_category"][key]
        assert episode["info"]["target_object_id"] in {goal["object_id"] for goal in goals}
        for view in (view for goal in goals for view in goal["view_points"]):
            state = view["agent_state"]
            ahead = Rotation.from_quat(state["rotation"]).apply([0.0, 0.0, -1.0])
            goal = next(goal for goal in goals if view in goal["view_points"])
            to = np.array(goal["position"]) - np.array(state["position"])
            to[1] = 0.0
            assert ahead @ to / np.linalg.norm(to) > 0.5, "a view point looks at its object"
            assert 0.0 <= view["iou"] <= 1.0
    assert len(keys) > 3


def test_pixels_of_an_object_are_of_its_own_class(tmp_path: Path) -> None:
    rows, blobs = other_room()
    classes = dict(zip((row.instance_id for row in rows["instances"]), (7, 24), strict=True))
    rows["instances"] = [
        dataclasses.replace(row, nyu40_id=classes[row.instance_id], nyu40_label=NYU40[classes[row.instance_id]])
        for row in rows["instances"]
    ]
    root = write_dataset(tmp_path, [(rows, blobs)])
    (lexicon,) = (root / "semantics").glob("*.json")
    names = {item["id"]: item["name"] for item in json.loads(lexicon.read_text())["classes"]}
    (scene_,) = (root / "scenes").glob("*.json")
    found = {}
    for item in json.loads(scene_.read_text())["object_instances"]:
        about = json.loads((root / "objects" / f"{item['template_name']}.object_config.json").read_text())
        found[item["user_defined"]["instance_id"]] = about["semantic_id"]
        assert names[about["semantic_id"]] == item["user_defined"]["nyu40_label"]
    assert found == classes


def test_object_goals_are_where_their_objects_are_and_fill_so_much_of_the_image(dataset: Path) -> None:
    """By the files alone: the middle of the object's box, and a level camera whose rays are held against that box one by one."""
    config, agent = HabitatConfig(), json.loads((dataset / "metadata" / "agent.json").read_text())
    half = math.tan(math.radians(config.view_fov_degrees) / 2)
    across, up = np.meshgrid(np.linspace(-half, half, 161)[:-1] + half / 160, np.linspace(-half, half, 121)[:-1] + half / 120)
    rays = np.stack([across, up / config.view_aspect, -np.ones_like(up)], axis=-1).reshape(-1, 3)
    items = {item["template_name"]: item for item in json.loads(scene_file(dataset).read_text())["object_instances"]}
    goals = {
        goal["object_id"]: goal
        for content, episode in episodes_of(dataset, "objectnav") if episode["scene_id"] == FIRST
        for group in content["goals_by_category"].values() for goal in group
    }  # fmt: skip
    shares = []
    for name, goal in goals.items():
        about = json.loads((dataset / "objects" / f"{name}.object_config.json").read_text())
        low, high = load(dataset / "objects" / about["render_asset"]).bounds
        pose = transform(items[name])
        np.testing.assert_allclose(goal["position"], pose[:3, :3] @ ((low + high) / 2) + pose[:3, 3], atol=1e-5)
        for view in goal["view_points"][:4]:
            eye = np.array(view["agent_state"]["position"]) + np.array([0.0, agent["height"], 0.0])
            turn = Rotation.from_quat(view["agent_state"]["rotation"]).as_matrix()
            corners = trimesh.bounds.corners([low, high]) @ pose[:3, :3].T + pose[:3, 3]
            if ((corners - eye) @ turn)[:, 2].max() > -0.1:
                continue  # partly behind the camera
            origin, ways = pose[:3, :3].T @ (eye - pose[:3, 3]), rays @ turn.T @ pose[:3, :3]
            with np.errstate(divide="ignore", invalid="ignore"):
                into, out = np.sort([(low - origin) / ways, (high - origin) / ways], axis=0)
            share = float((into.max(axis=1) < out.min(axis=1)).mean())
            assert view["iou"] == pytest.approx(share, abs=0.01)
            shares.append(share)
    assert len(shares) > 10
    assert max(shares) > 0.1


def test_replayed_actions_stay_on_the_navmesh_and_end_at_the_target(dataset: Path) -> None:
    """With another reader of the navmesh than the check has, and step by step."""
    seen = set()
    for task in ("pointnav", "objectnav"):
        for content, episode in episodes_of(dataset, task):
            scene = episode["scene_id"]
            (tile,) = read_navmesh((dataset / "navmeshes" / f"{scene}.navmesh").read_bytes()).tiles
            corners = [tile.vertices[polygon["vertices"][: polygon["count"]]][:, [0, 2]] for polygon in tile.polygons]
            floor = shapely.union_all([shapely.Polygon(polygon) for polygon in corners]).buffer(1e-5)
            place, turn = np.array(episode["start_position"]), Rotation.from_quat(episode["start_rotation"])
            length = 0.0
            for state in episode["shortest_paths"][0]:
                if state["action"] == ACTIONS["forward"]:
                    onward = place + turn.apply([0.0, 0.0, -0.25])
                    assert floor.covers(shapely.LineString([place[[0, 2]], onward[[0, 2]]]))
                    length, place = length + 0.25, onward
                elif state["action"] != ACTIONS["stop"]:
                    angle = math.radians(30 if state["action"] == ACTIONS["left"] else -30)
                    turn = turn * Rotation.from_rotvec([0.0, angle, 0.0])
            goals = [goal["position"] for goal in episode["goals"]]
            if task == "objectnav":
                chosen = content["goals_by_category"][f"{scene}_{episode['object_category']}"]
                views = [v for g in chosen if g["object_id"] == episode["info"]["target_object_id"] for v in g["view_points"]]
                goals = [view["agent_state"]["position"] for view in views]
            left = np.linalg.norm(np.array(goals) - place, axis=1).min()
            assert left <= 0.2
            assert episode["info"]["geodesic_distance"] <= length + 0.2 + 1e-6, "nothing is shorter than the shortest path"
            seen.add((task, scene))
    assert len(seen) == 4


def test_the_datasets_own_files_say_what_its_scenes_were_exported_with(tmp_path: Path) -> None:
    rows, blobs = rows_of([cube((0.3, 0.3, 0.3), yaw_pose(0.3, [0.5, -0.5, 0.0]))])
    walk = NavigationConfig(train_episodes=3, test_episodes=3, forward_m=0.2, turn_degrees=15.0, success_m=0.3)
    needed = {name: rows[name] for name in navigation.STAGE.reads}
    made = navigation.run(**needed, context=Context("demo/room_01", "navigation", 0, blobs), config=walk)
    walked = rows | {name: made.rows[name] for name in ("navmeshes", "episodes")}
    settings = exports.HabitatConfig(dataset="homes", dataset_folder="data/homes", forward_m=0.2, turn_degrees=15.0, success_m=0.3)
    outcome = export(walked, {**blobs, **made.blobs}, exports.ExportsConfig(formats=("habitat",), habitat=settings))
    assert [row for row in outcome.rows["export_checks"] if not row.passed] == []
    files = outcome.rows["export_files"]
    exports.write_folder(
        tmp_path, {path: outcome.blobs[name] for path, name in layout(files).items()} | shared_files(files, outcome.blobs)
    )  # fmt: skip
    root = tmp_path / "habitat"
    assert (root / "homes.scene_dataset_config.json").is_file()
    agent = json.loads((root / "metadata" / "agent.json").read_text())
    assert (agent["forward_step_size"], agent["turn_angle"], agent["success_distance"]) == (0.2, 15.0, 0.3)
    assert "data/homes/objectnav" in (root / "README.md").read_text()
    assert check_habitat(root) == []
    empty, blobs = rows_of([], "demo/room_02")
    other = export({**empty, "navmeshes": [], "episodes": []}, dict(blobs), exports.ExportsConfig(formats=("habitat",)))
    with pytest.raises(InputError, match=r"demo/room_0[12]: was exported with other settings of the dataset than demo/room_0[12]"):
        shared_files([*files, *other.rows["export_files"]], {**outcome.blobs, **other.blobs})
