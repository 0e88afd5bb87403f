"""The Habitat dataset: where things stand, what episodes say, and that every kind of damage is refused by its rule."""

from __future__ import annotations

import gzip
import io
import json
import math
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tasks import exports
from tasks.exports.habitat import ACTIONS, scene_handle
from tasks.exports.habitat_rules import RULES, check_habitat
from tasks.exports.layout import layout, shared_files
from tasks.replica import placed_parts, room_shell
from tests.replicas import cube, furnished, rows_of, with_navigation
from tests.test_exports import export

Rows = dict[str, list[Any]]


@pytest.fixture(scope="module")
def scene() -> tuple[Rows, dict[str, bytes]]:
    return with_navigation(*rows_of(furnished()), episodes=8)


@pytest.fixture(scope="module")
def dataset(scene: tuple[Rows, dict[str, bytes]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two scenes whose plain names contain one another."""
    config = exports.ExportsConfig(formats=("habitat",))
    other = with_navigation(*rows_of([cube((0.3, 0.3, 0.3), np.eye(4)), cube((0.2, 0.3, 0.3), np.eye(4))], "demo/room_010"), episodes=3)
    done = [export(*scene, config), export(*other, config)]
    rows = [row for outcome in done for row in outcome.rows["export_files"]]
    blobs = {name: data for outcome in done for name, data in outcome.blobs.items()}
    root = tmp_path_factory.mktemp("place")
    exports.write_folder(root, {path: blobs[name] for path, name in layout(rows).items()} | shared_files(rows, blobs))
    return root / "habitat"


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset, tmp_path / "habitat"))


def scene_file(root: Path) -> Path:
    return root / "scenes" / f"{scene_handle('demo/room_01')}.scene_instance.json"


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
    shell = np.concatenate([mesh.vertices for _, mesh in room_shell(scene[0]["rooms"][0])])
    mesh = load(dataset / "stages" / f"{scene_handle('demo/room_01')}.glb")
    turned = np.column_stack([shell[:, 0], shell[:, 2], -shell[:, 1]])
    np.testing.assert_allclose(mesh.bounds, [turned.min(axis=0), turned.max(axis=0)], atol=1e-6)


def test_colliders_are_convex_and_equal_shapes_are_stored_once(dataset: Path) -> None:
    for path in sorted((dataset / "objects").glob("*.collider.glb")):
        for mesh in trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb").geometry.values():
            mesh.merge_vertices(merge_norm=True, merge_tex=True)
            assert mesh.is_watertight
            assert mesh.convex_hull.volume == pytest.approx(mesh.volume, rel=1e-3)
    handles = [f"{scene_handle('demo/room_01')}_{number}" for number in ("0002", "0003")]
    configs = [json.loads((dataset / "objects" / f"{handle}.object_config.json").read_text()) for handle in handles]
    assert configs[0]["render_asset"] == configs[1]["render_asset"]
    assert [config["mass"] for config in configs] == [4.0, 7.0]


def episodes_of(root: Path, task: str) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for path in sorted((root / task).glob("*/content/*.json.gz")):
        content = json.loads(gzip.decompress(path.read_bytes()))
        for episode in content["episodes"]:
            yield content, episode


def test_episodes_lead_from_start_to_goal(scene: tuple[Rows, dict[str, bytes]], dataset: Path) -> None:
    rows = {row.episode_id: row for row in scene[0]["episodes"]}
    seen = 0
    for _, episode in episodes_of(dataset, "pointnav"):
        if episode["scene_id"] != scene_handle("demo/room_01"):
            continue
        seen += 1
        row = rows[episode["info"]["episode"]]
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


# ---- damage: each kind must be refused, and by the rule that is about it


def edit(path: Path, change: Callable[[Any], None]) -> None:
    """Change a JSON file in place, compressed or not."""
    zipped = path.suffix == ".gz"
    value = json.loads(gzip.decompress(path.read_bytes()) if zipped else path.read_bytes())
    change(value)
    data = json.dumps(value).encode()
    path.write_bytes(gzip.compress(data) if zipped else data)


def in_scene(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(scene_file(root), change)


def in_object(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(sorted((root / "objects").glob("*_0001.object_config.json"))[0], change)


def in_stage(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "stages" / f"{scene_handle('demo/room_01')}.stage_config.json", change)


def in_config(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "metascenes.scene_dataset_config.json", change)


def in_lexicon(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "semantics" / "metascenes_lexicon.json", change)


def second_config(root: Path) -> None:
    shutil.copy(root / "metascenes.scene_dataset_config.json", root / "b.scene_dataset_config.json")


def in_episode(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change the first PointNav episode."""
    return in_episodes("pointnav", lambda content: change(content["episodes"][0]))


def in_goal(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change the first goal of ObjectNav."""
    return in_episodes("objectnav", lambda content: change(next(iter(content["goals_by_category"].values()))[0]))


def in_episodes(task: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(sorted((root / task).glob(f"*/content/{scene_handle('demo/room_01')}.json.gz"))[0], change)


def in_split(task: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        for path in sorted((root / task).glob("*/*.json.gz")):
            edit(path, change)

    return damage


def in_navmesh(offset: int, data: bytes) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        path = root / "navmeshes" / f"{scene_handle('demo/room_01')}.navmesh"
        old = path.read_bytes()
        path.write_bytes(old[:offset] + data + old[offset + len(data) :])

    return damage


def first(scene: Any) -> Any:
    return scene["object_instances"][0]


def rename(root: Path) -> None:
    """Name one object by the beginning of the others' names, as unpadded numbers would."""
    short = f"{scene_handle('demo/room_01')}_000"
    (root / "objects" / f"{short}1.object_config.json").rename(root / "objects" / f"{short}.object_config.json")
    for path in (scene_file(root), root / "metascenes.scene_dataset_config.json"):
        path.write_text(path.read_text().replace(f"{short}1.object", f"{short}.object").replace(f'"{short}1"', f'"{short}"'))


def cut(pattern: str, share: float) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        path = sorted(root.glob(pattern))[0]
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])

    return damage


def remove(pattern: str) -> Callable[[Path], None]:
    return lambda root: sorted(root.glob(pattern))[0].unlink()


def poison_glb(root: Path) -> None:
    """A position that is not a number."""
    path = root / "stages" / f"{scene_handle('demo/room_01')}.glb"
    data = bytearray(path.read_bytes())
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    start = 28 + size + document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
    struct.pack_into("<f", data, start, float("nan"))
    path.write_bytes(bytes(data))


def wrong_order(item: Any) -> None:
    w, x, y, z = item["rotation"]
    item["rotation"] = [x, y, z, w]


DAMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "no stage": ("stage_instance", in_scene(lambda s: s.pop("stage_instance"))),
    "unknown stage": ("handle_exact", in_scene(lambda s: s["stage_instance"].update(template_name="nothing"))),
    "unknown object": ("handle_exact", in_scene(lambda s: first(s).update(template_name="nothing"))),
    "object named in part": ("handle_exact", in_scene(lambda s: first(s).update(template_name=first(s)["template_name"][:-1]))),
    "unknown navmesh": ("handle_exact", in_scene(lambda s: s.update(navmesh_instance="nothing"))),
    "unknown lexicon": ("handle_exact", in_scene(lambda s: s.update(semantic_scene_instance="nothing"))),
    "names within names": ("handle_contained", rename),
    "missing object geometry": ("files_exist", remove("objects/*_0001.glb")),
    "missing collider": ("files_exist", remove("objects/*_0001.collider.glb")),
    "missing stage geometry": ("files_exist", remove("stages/*.glb")),
    "missing navmesh": ("files_exist", remove("navmeshes/*.navmesh")),
    "missing lexicon": ("files_exist", remove("semantics/*.json")),
    "missing object config": ("files_exist", remove("objects/*_0001.object_config.json")),
    "missing split file": ("files_exist", remove("objectnav/*/*.json.gz")),
    "cut scene": ("json", lambda root: scene_file(root).write_text(scene_file(root).read_text()[:-30])),
    "cut episodes": ("json", cut("pointnav/*/content/*.json.gz", 0.7)),
    "NaN in a scene": ("json", in_scene(lambda s: first(s).update(translation=[0, float("nan"), 0]))),
    "scale below zero": ("shape", in_object(lambda o: o.update(scale=[1, -1, 1]))),
    "collidable in words": ("shape", in_stage(lambda o: o.update(is_collidable="yes"))),
    "objects as a mapping": ("shape", in_scene(lambda s: s.update(object_instances={}))),
    "cut geometry": ("geometry", cut("objects/*_0001.glb", 0.6)),
    "geometry with NaN": ("geometry", poison_glb),
    "no up axis": ("upright", in_stage(lambda s: s.pop("up"))),
    "no front axis": ("upright", in_object(lambda o: o.pop("front"))),
    "front along up": ("upright", in_stage(lambda s: s.update(front=[0, 1, 0]))),
    "long up axis": ("upright", in_object(lambda o: o.update(up=[0, 2, 0]))),
    "gravity sideways": ("gravity", in_stage(lambda s: s.update(gravity=[0, 0, -9.8]))),
    "centimetres": ("gravity", in_object(lambda o: o.update(units_to_meters=0.01))),
    "rotation of three numbers": ("rotation", in_scene(lambda s: first(s).update(rotation=[0, 0, 0]))),
    "rotation of length 2": ("rotation", in_scene(lambda s: first(s).update(rotation=[2, 0, 0, 0]))),
    "rotation in the other order": ("rotation_order", in_scene(lambda s: wrong_order(s["object_instances"][1]))),
    "translation of two numbers": ("translation", in_scene(lambda s: first(s).update(translation=[0, 0]))),
    "positions of box centers": ("translation_origin", in_scene(lambda s: first(s).update(translation_origin="COM"))),
    "unknown motion": ("motion_type", in_scene(lambda s: first(s).update(motion_type="floating"))),
    "moving furniture": ("motion_type", in_scene(lambda s: first(s).update(motion_type="DYNAMIC"))),
    "lost object": ("object_count", in_scene(lambda s: s["object_instances"].pop())),
    "no mass": ("physics", in_object(lambda o: o.update(mass=0))),
    "joined hulls": ("collider", in_object(lambda o: o.pop("join_collision_meshes"))),
    "navmesh of another kind": ("navmesh", in_navmesh(0, b"TESN")),
    "navmesh of version 3": ("navmesh", in_navmesh(4, struct.pack("<i", 3))),
    "cut navmesh": ("navmesh", cut(f"navmeshes/{scene_handle('demo/room_01')}.navmesh", 0.9)),
    "navmesh for another agent": ("navmesh_settings", in_navmesh(52, struct.pack("<f", 0.3))),
    "navmesh of other cells": ("navmesh_settings", in_navmesh(40, struct.pack("<f", 0.03))),
    "navmesh without furniture": ("navmesh_settings", in_navmesh(95, b"\0")),
    "undocumented agent": ("navmesh_settings", remove("metadata/agent.json")),
    "semantic id above 10000": ("semantics", in_lexicon(lambda s: s["classes"][3].update(id=10001))),
    "semantic id without a class": ("semantics", in_object(lambda o: o.update(semantic_id=77))),
    "two classes of one id": ("semantics", in_lexicon(lambda s: s["classes"][3].update(id=4))),
    "misspelt section": ("dataset_config", in_config(lambda c: c.update(scene_instance=c.pop("scene_instances")))),
    "two dataset configs": ("dataset_config", second_config),
    "path out of the folder": ("dataset_config", in_config(lambda c: c["objects"]["paths"][".json"].append("../x.json"))),
    "unknown key in an episode": ("episode_keys", in_episode(lambda e: e.update(note="x"))),
    "episode without a start": ("episode_keys", in_episodes("objectnav", lambda c: c["episodes"][0].pop("start_position"))),
    "unknown key in a goal": ("goal_keys", in_goal(lambda g: g.update(color="red"))),
    "goal without object": ("goal_keys", in_goal(lambda g: g.pop("object_id"))),
    "numeric episode id": ("episode_id", in_episode(lambda e: e.update(episode_id=0))),
    "episode id twice": ("episode_id", in_episodes("pointnav", lambda c: c["episodes"][1].update(episode_id="0"))),
    "episode in no scene": ("episode_scene", in_episode(lambda e: e.update(scene_id="demo_room"))),
    "episode of another dataset": ("episode_scene", in_episode(lambda e: e.update(scene_dataset_config="default"))),
    "start outside": ("start", in_episode(lambda e: e.update(start_position=[50.0, 0.0, 0.0]))),
    "start upstairs": ("start", in_episode(lambda e: e["start_position"].__setitem__(1, 2.0))),
    "start in the scan's frame": ("start", in_episode(lambda e: e.update(start_position=[0.0, 1.5, 0.0]))),
    "start rotation in the other order": ("start_rotation", in_episode(lambda e: e.update(start_rotation=[0.8, 0.0, 0.6, 0.0]))),
    "start rotation of length 2": ("start_rotation", in_episode(lambda e: e.update(start_rotation=[0.0, 0.0, 0.0, 2.0]))),
    "no goals": ("goals", in_episode(lambda e: e.update(goals=[]))),
    "no goals of the category": ("goals", in_episodes("objectnav", lambda c: c["goals_by_category"].popitem())),
    "goal outside": ("goals", in_episode(lambda e: e["goals"][0].update(position=[0.0, 0.0, 40.0]))),
    "goal of no object": ("goal_object", in_goal(lambda g: g.update(object_id="nothing"))),
    "no view points": ("view_points", in_goal(lambda g: g.update(view_points=None))),
    "view point without iou": ("view_points", in_goal(lambda g: g["view_points"][0].pop("iou"))),
    "view point in a wall": ("view_points", in_goal(lambda g: g["view_points"][0]["agent_state"].update(position=[9.0, 0.0, 9.0]))),
    "bare actions": ("shortest_paths", in_episode(lambda e: e.update(shortest_paths=[[1, 1, 0]]))),
    "shorter than straight": ("geodesic", in_episode(lambda e: e["info"].update(geodesic_distance=0.01))),
    "infinite distance": ("geodesic", in_episode(lambda e: e["info"].update(geodesic_distance=None))),
    "category maps of different keys": ("category_maps", in_split("objectnav", lambda s: s["category_to_task_category_id"].popitem())),
    "no category maps": ("category_maps", in_split("objectnav", lambda s: s.pop("category_to_task_category_id"))),
    "category in no map": ("category_maps", in_episodes("objectnav", lambda c: c["episodes"][0].update(object_category="yacht"))),
    "no episodes": ("split_file", in_episodes("pointnav", lambda c: c.update(episodes=[]))),
    "split without episodes": ("split_file", in_split("pointnav", lambda s: s.pop("episodes"))),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    rule, damage = DAMAGES[name]
    damage(copy)
    found = check_habitat(copy)
    assert rule in {finding.rule for finding in found if finding.is_error}, found


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _ in DAMAGES.values()} == set(RULES)


_WRONG = [None, 3, -1.5, "x", [], {}, [1], {"a": 1}, True, [None], 1e300, "../x", [[]], [{}], {"id": []}]


def places(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to everything inside a JSON value; of lists the first items only."""
    yield here
    inner = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    for key, item in inner:
        yield from places(item, (*here, key))


def test_no_value_of_the_wrong_kind_stops_the_check(copy: Path) -> None:
    import random

    chance = random.Random(5)
    files = sorted(path for path in copy.rglob("*") if path.name.endswith((".json", ".json.gz")) and "objects" not in path.parts)
    noticed = 0
    for _ in range(40):
        path = chance.choice(files)
        old = path.read_bytes()
        where = chance.choice(list(places(json.loads(gzip.decompress(old) if path.suffix == ".gz" else old)))[1:])

        def change(value: Any, where: tuple[Any, ...] = where) -> None:
            for key in where[:-1]:
                value = value[key]
            value[where[-1]] = chance.choice(_WRONG)

        edit(path, change)
        found = check_habitat(copy)
        assert all(finding.rule in RULES for finding in found)
        noticed += bool(found)
        path.write_bytes(old)
    assert noticed > 25, "most such damage is noticed; what the rest hits is free text"
