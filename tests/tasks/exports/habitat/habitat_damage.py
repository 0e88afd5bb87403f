"""What can be wrong with a Habitat dataset beside its episodes: kinds of damage, and the rule that must refuse each."""

from __future__ import annotations

import dataclasses
import gzip
import json
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.tasks.exports.habitat.habitat_datasets import FIRST, scene_file

FIRST_VERTEX = 96 + 8 + 100
"""Where the first tile's vertices begin in a navmesh of version 2."""


@dataclasses.dataclass(frozen=True)
class Damage:
    """What is done to a dataset, and how it must be refused: by which rule, naming which file and what in it."""

    rule: str
    file: str
    field: str
    do: Callable[[Path], None]


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
    return lambda root: edit(root / "stages" / f"{FIRST}.stage_config.json", change)


def in_lights(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "lights" / f"{FIRST}_lights.lighting_config.json", change)


def in_config(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "metascenes.scene_dataset_config.json", change)


def in_lexicon(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "semantics" / "metascenes_lexicon.json", change)


def in_agent(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(root / "metadata" / "agent.json", change)


def in_episodes(task: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda root: edit(sorted((root / task).glob(f"*/content/{FIRST}.json.gz"))[0], change)


def in_navmesh(offset: int, data: bytes) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        path = root / "navmeshes" / f"{FIRST}.navmesh"
        old = path.read_bytes()
        path.write_bytes(old[:offset] + data + old[offset + len(data) :])

    return damage


def second_config(root: Path) -> None:
    shutil.copy(root / "metascenes.scene_dataset_config.json", root / "b.scene_dataset_config.json")


def first(scene: Any) -> Any:
    return scene["object_instances"][0]


def rename(root: Path) -> None:
    """Name one object by the beginning of the others' names, as unpadded numbers would."""
    short = f"{FIRST}_000"
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
    path = root / "stages" / f"{FIRST}.glb"
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


def polygons_of(data: bytes) -> Iterator[int]:
    """Where every polygon of a navmesh's first tile begins."""
    polygons, vertices = struct.unpack_from("<ii", data, FIRST_VERTEX - 100 + 24)
    yield from (FIRST_VERTEX + 12 * vertices + 32 * index for index in range(polygons))


def in_polygons(offset: int, data: bytes) -> Callable[[Path], None]:
    """Write bytes into every polygon of the navmesh."""

    def damage(root: Path) -> None:
        path = root / "navmeshes" / f"{FIRST}.navmesh"
        old = bytearray(path.read_bytes())
        for begin in polygons_of(bytes(old)):
            old[begin + offset : begin + offset + len(data)] = data
        path.write_bytes(bytes(old))

    return damage


no_walkable_polygon = in_polygons(28, struct.pack("<H", 4))  # habitat-sim's flag of a polygon that is switched off


def first_version(root: Path) -> None:
    """The same navmesh as habitat-sim wrote it before it kept the settings."""
    path = root / "navmeshes" / f"{FIRST}.navmesh"
    old = path.read_bytes()
    path.write_bytes(old[:4] + struct.pack("<i", 1) + old[8:40] + old[96:])


DATASET_DAMAGES: dict[str, Damage] = {
    "no stage": Damage("stage_instance", "scenes/*.scene_instance.json", "stage_instance", in_scene(lambda s: s.pop("stage_instance"))),
    "unknown stage": Damage(
        "handle_exact",
        "scenes/*.scene_instance.json",
        "template_name",
        in_scene(lambda s: s["stage_instance"].update(template_name="nothing")),
    ),
    "unknown object": Damage(
        "handle_exact",
        "scenes/*.scene_instance.json",
        "object_instances[0]: template_name",
        in_scene(lambda s: first(s).update(template_name="nothing")),
    ),
    "object named in part": Damage(
        "handle_exact",
        "scenes/*.scene_instance.json",
        "object_instances[0]: template_name",
        in_scene(lambda s: first(s).update(template_name=first(s)["template_name"][:-1])),
    ),
    "margin left to the default": Damage("margin", "objects/*.object_config.json", "margin", in_object(lambda o: o.pop("margin"))),
    "stage with a thick margin": Damage("margin", "stages/*.stage_config.json", "margin", in_stage(lambda s: s.update(margin=0.04))),
    "negative margin": Damage("margin", "objects/*.object_config.json", "margin", in_object(lambda o: o.update(margin=-0.01))),
    "unknown lights": Damage(
        "lights", "scenes/*.scene_instance.json", "default_lighting", in_scene(lambda s: s.update(default_lighting="dusk"))
    ),
    "unlit": Damage(
        "lights", "scenes/*.scene_instance.json", "default_lighting", in_scene(lambda s: s.update(default_lighting="no_lights"))
    ),
    "no lamps": Damage("lights", "lights/*.lighting_config.json", "lights", in_lights(lambda v: v.update(lights={}))),
    "unknown navmesh": Damage(
        "handle_exact", "scenes/*.scene_instance.json", "navmesh_instance", in_scene(lambda s: s.update(navmesh_instance="nothing"))
    ),
    "unknown lexicon": Damage(
        "handle_exact",
        "scenes/*.scene_instance.json",
        "semantic_scene_instance",
        in_scene(lambda s: s.update(semantic_scene_instance="nothing")),
    ),
    "names within names": Damage("handle_contained", "metascenes.scene_dataset_config.json", "objects", rename),
    "missing object geometry": Damage("files_exist", "objects/*.object_config.json", "render_asset", remove("objects/*[0-9a-f].glb")),
    "missing collider": Damage("files_exist", "objects/*.object_config.json", "collision_asset", remove("objects/*.collider.glb")),
    "missing stage geometry": Damage("files_exist", "stages/*.stage_config.json", "render_asset", remove("stages/*.glb")),
    "missing navmesh": Damage("files_exist", "metascenes.scene_dataset_config.json", "navmesh_instances", remove("navmeshes/*.navmesh")),
    "missing lexicon": Damage(
        "files_exist", "metascenes.scene_dataset_config.json", "semantic_scene_descriptor_instances", remove("semantics/*.json")
    ),
    "lexicon out of the folder": Damage(
        "dataset_config",
        "metascenes.scene_dataset_config.json",
        "semantic_scene_descriptor_instances",
        in_config(lambda c: c["semantic_scene_descriptor_instances"].update(metascenes_lexicon="/etc/hostname")),
    ),
    "navmesh out of the folder": Damage(
        "dataset_config",
        "metascenes.scene_dataset_config.json",
        "navmesh_instances",
        in_config(lambda c: c["navmesh_instances"].update({f"{FIRST}_navmesh": "../x.navmesh"})),
    ),
    "empty pattern": Damage(
        "dataset_config",
        "metascenes.scene_dataset_config.json",
        "objects",
        in_config(lambda c: c["objects"]["paths"].update({".json": [""]})),
    ),
    "missing object config": Damage(
        "files_exist", "metascenes.scene_dataset_config.json", "objects", remove("objects/*_0001.object_config.json")
    ),
    "missing split file": Damage("files_exist", "objectnav/*/*.json.gz", "does not exist", remove("objectnav/*/*.json.gz")),
    "cut scene": Damage(
        "json",
        "scenes/*.scene_instance.json",
        "cannot be read",
        lambda root: scene_file(root).write_text(scene_file(root).read_text()[:-30]),
    ),
    "cut episodes": Damage("json", "pointnav/*/content/*.json.gz", "cannot be read", cut("pointnav/*/content/*.json.gz", 0.7)),
    "NaN in a scene": Damage(
        "json", "scenes/*.scene_instance.json", "NaN", in_scene(lambda s: first(s).update(translation=[0, float("nan"), 0]))
    ),
    "scale of zero": Damage("shape", "objects/*.object_config.json", "scale", in_object(lambda o: o.update(scale=[1, 0, 1]))),
    "collidable in words": Damage(
        "shape", "stages/*.stage_config.json", "is_collidable", in_stage(lambda o: o.update(is_collidable="yes"))
    ),
    "objects as a mapping": Damage(
        "shape", "scenes/*.scene_instance.json", "object_instances", in_scene(lambda s: s.update(object_instances={}))
    ),
    "cut geometry": Damage("geometry", "objects/*.glb", "", cut("objects/*[0-9a-f].glb", 0.6)),
    "geometry with NaN": Damage("geometry", "stages/*.glb", "", poison_glb),
    "no up axis": Damage("upright", "stages/*.stage_config.json", "up", in_stage(lambda s: s.pop("up"))),
    "no front axis": Damage("upright", "objects/*.object_config.json", "front", in_object(lambda o: o.pop("front"))),
    "front along up": Damage("upright", "stages/*.stage_config.json", "front", in_stage(lambda s: s.update(front=[0, 1, 0]))),
    "long up axis": Damage("upright", "objects/*.object_config.json", "up", in_object(lambda o: o.update(up=[0, 2, 0]))),
    "gravity sideways": Damage("gravity", "stages/*.stage_config.json", "gravity", in_stage(lambda s: s.update(gravity=[0, 0, -9.8]))),
    "centimetres": Damage(
        "gravity", "objects/*.object_config.json", "units_to_meters", in_object(lambda o: o.update(units_to_meters=0.01))
    ),
    "rotation of three numbers": Damage(
        "rotation", "scenes/*.scene_instance.json", "object_instances[0]: rotation", in_scene(lambda s: first(s).update(rotation=[0, 0, 0]))
    ),
    "rotation of length 2": Damage(
        "rotation",
        "scenes/*.scene_instance.json",
        "object_instances[0]: rotation",
        in_scene(lambda s: first(s).update(rotation=[2, 0, 0, 0])),
    ),
    "rotation in the other order": Damage(
        "rotation_order",
        "scenes/*.scene_instance.json",
        "object_instances[1]: rotation",
        in_scene(lambda s: wrong_order(s["object_instances"][1])),
    ),
    "translation of two numbers": Damage(
        "translation",
        "scenes/*.scene_instance.json",
        "object_instances[0]: translation",
        in_scene(lambda s: first(s).update(translation=[0, 0])),
    ),
    "positions of box centers": Damage(
        "translation_origin",
        "scenes/*.scene_instance.json",
        "object_instances[0]: translation_origin",
        in_scene(lambda s: first(s).update(translation_origin="COM")),
    ),
    "unknown motion": Damage(
        "motion_type",
        "scenes/*.scene_instance.json",
        "object_instances[0]: motion_type",
        in_scene(lambda s: first(s).update(motion_type="floating")),
    ),
    "moving furniture": Damage(
        "motion_type",
        "scenes/*.scene_instance.json",
        "object_instances[0]: motion_type",
        in_scene(lambda s: first(s).update(motion_type="DYNAMIC")),
    ),
    "lost object": Damage(
        "object_count", "scenes/*.scene_instance.json", "object_instances", in_scene(lambda s: s["object_instances"].pop())
    ),
    "no mass": Damage("physics", "objects/*.object_config.json", "mass", in_object(lambda o: o.update(mass=0))),
    "inertia below zero": Damage("physics", "objects/*.object_config.json", "inertia", in_object(lambda o: o.update(inertia=[1, -1, 1]))),
    "center of mass in the plane": Damage("physics", "objects/*.object_config.json", "COM", in_object(lambda o: o.update(COM=[0, 1]))),
    "joined hulls": Damage(
        "collider", "objects/*.object_config.json", "join_collision_meshes", in_object(lambda o: o.pop("join_collision_meshes"))
    ),
    "navmesh of another kind": Damage("navmesh", "navmeshes/*.navmesh", "magic", in_navmesh(0, b"TESN")),
    "navmesh of version 3": Damage("navmesh", "navmeshes/*.navmesh", "version", in_navmesh(4, struct.pack("<i", 3))),
    "cut navmesh": Damage("navmesh", "navmeshes/*.navmesh", "tile", cut(f"navmeshes/{FIRST}.navmesh", 0.9)),
    "navmesh for another agent": Damage("navmesh_settings", "navmeshes/*.navmesh", "agentRadius", in_navmesh(52, struct.pack("<f", 0.3))),
    "navmesh of other cells": Damage("navmesh_settings", "navmeshes/*.navmesh", "cellSize", in_navmesh(40, struct.pack("<f", 0.03))),
    "navmesh without furniture": Damage("navmesh_settings", "navmeshes/*.navmesh", "includeStaticObjects", in_navmesh(95, b"\0")),
    "undocumented agent": Damage(
        "navmesh_settings", "metascenes.scene_dataset_config.json", "metadata/agent.json", remove("metadata/agent.json")
    ),
    "semantic id above 10000": Damage(
        "semantics", "semantics/metascenes_lexicon.json", "classes: ids", in_lexicon(lambda s: s["classes"][3].update(id=10001))
    ),
    "semantic id without a class": Damage(
        "semantics", "objects/*.object_config.json", "semantic_id", in_object(lambda o: o.update(semantic_id=77))
    ),
    "two classes of one id": Damage(
        "semantics", "semantics/metascenes_lexicon.json", "classes: ids", in_lexicon(lambda s: s["classes"][3].update(id=4))
    ),
    "nobody to name": Damage("provenance", "metascenes.scene_dataset_config.json", "attribution.csv", remove("metadata/attribution.csv")),
    "object without a license": Damage(
        "provenance",
        "scenes/*.scene_instance.json",
        "object_instances[0]: user_defined has no license",
        in_scene(lambda s: first(s)["user_defined"].pop("license")),
    ),
    "asset that nobody lists": Damage(
        "provenance",
        "scenes/*.scene_instance.json",
        "object_instances[0]: asset_id",
        in_scene(lambda s: first(s)["user_defined"].update(asset_id="0" * 64)),
    ),
    "misspelt section": Damage(
        "dataset_config",
        "metascenes.scene_dataset_config.json",
        "scene_instance",
        in_config(lambda c: c.update(scene_instance=c.pop("scene_instances"))),
    ),
    "two dataset configs": Damage("dataset_config", ".", "*.scene_dataset_config.json", second_config),
    "path out of the folder": Damage(
        "dataset_config",
        "metascenes.scene_dataset_config.json",
        "objects: ../x.json",
        in_config(lambda c: c["objects"]["paths"][".json"].append("../x.json")),
    ),
    "semantic id of no kind": Damage(
        "shape", "objects/*.object_config.json", "semantic_id", in_object(lambda o: o.update(semantic_id="chair"))
    ),
    "no friction": Damage(
        "physics", "objects/*.object_config.json", "friction_coefficient", in_object(lambda o: o.update(friction_coefficient=-0.1))
    ),
    "box as a collider": Damage(
        "collider",
        "objects/*.object_config.json",
        "use_bounding_box_for_collision",
        in_object(lambda o: o.update(use_bounding_box_for_collision=True)),
    ),
    "navmesh without polygons": Damage("navmesh", "navmeshes/*.navmesh", "polygons", no_walkable_polygon),
    "navmesh with a far vertex": Damage("navmesh", "navmeshes/*.navmesh", "vertex", in_navmesh(FIRST_VERTEX, struct.pack("<f", 1e30))),
    "navmesh of version 1": Damage("navmesh", "navmeshes/*.navmesh", "version", first_version),
}
