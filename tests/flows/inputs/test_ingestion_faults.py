"""Faults of a Habitat dataset that cost neither a scene nor the dataset: several configs, mirrored objects, broken parts."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from flows.commands.ingest import command
from flows.inputs.ingestion import import_dataset
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.capture.labels import label_map
from tasks.geometry.meshes import surface_of
from tasks.ingestion.habitat import read_habitat
from tasks.ingestion.scene import FinishedScene
from tasks.ingestion.sources import find_sources
from warehouse.lake import Lake

SECTIONS = {
    name: {"paths": {".json": [folder]}} for name, folder in (("stages", "stages"), ("objects", "objects"), ("scene_instances", "scenes"))
}


def write_json(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def cabinet() -> trimesh.Trimesh:
    """A box with a knob at one side, so that its mirror image is another mesh."""
    knob = trimesh.creation.box([0.05, 0.05, 0.05]).apply_translation([0.2, 0.15, 0.225])
    return trimesh.util.concatenate([trimesh.creation.box([0.5, 0.5, 0.4]), knob])


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Two scenes with two objects each."""
    root = tmp_path / "set"
    for folder, name, mesh in (
        ("stages", "room", trimesh.creation.box([5, 0.1, 4])),
        ("objects", "cabinet_a", cabinet()),
        ("objects", "chair_a", trimesh.creation.box([0.4, 0.9, 0.4])),
    ):
        kind = "stage" if folder == "stages" else "object"
        write_json(root / folder / f"{name}.{kind}_config.json", {"render_asset": f"{name}.glb"})
        mesh.export(root / folder / f"{name}.glb")
    placed = [{"template_name": "cabinet_a", "translation": [1, 0.3, -1]}, {"template_name": "chair_a", "translation": [-1, 0.5, 1]}]
    for name in ("one", "two"):
        document = {"stage_instance": {"template_name": "room"}, "object_instances": placed}
        write_json(root / "scenes" / f"{name}.scene_instance.json", document)
    write_json(root / "own.scene_dataset_config.json", SECTIONS)
    return root


def edit(path: Path, change: Callable[[Any], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def read(root: Path) -> dict[str, FinishedScene]:
    return {source.scan: read_habitat(source, label_map()) for source in find_sources("habitat", root, "others")}


def with_two_configs(root: Path) -> None:
    shutil.copy(root / "own.scene_dataset_config.json", root / "own-uncluttered.scene_dataset_config.json")


def test_several_configs_are_listed_with_the_option_that_chooses_one(dataset: Path, tmp_path: Path) -> None:
    with_two_configs(dataset)
    arguments = ["habitat", str(dataset), "--dataset", "two", "--lake", str(tmp_path / "lake")]
    with pytest.raises(InputError) as refused:
        CliRunner().invoke(command, arguments, catch_exceptions=False, standalone_mode=False)
    assert str(refused.value) == (
        "set: *.scene_dataset_config.json: there are 2: own-uncluttered, own; choose one, for example --config own-uncluttered"
    )


@pytest.mark.parametrize(
    ("path", "config"),
    [
        ("set", "own"),
        ("set", "own.scene_dataset_config.json"),
        ("set", "./own"),
        ("set/own.scene_dataset_config.json", None),
        (".", "own"),
        (".", "set/own"),
    ],
)
def test_a_config_is_chosen_by_name_or_path(path: str, config: str | None, dataset: Path, tmp_path: Path) -> None:
    with_two_configs(dataset)
    edit(dataset / "own-uncluttered.scene_dataset_config.json", lambda document: document.pop("objects"))
    sources = find_sources("habitat", tmp_path / path, "others", config=config)
    assert [(source.scan, source.root, set(source.about["templates"])) for source in sources] == [
        (name, dataset.resolve(), {"cabinet_a", "chair_a"}) for name in ("one", "two")
    ]


def test_a_folder_above_the_only_config_is_that_dataset(dataset: Path, tmp_path: Path) -> None:
    assert [source.scan for source in find_sources("habitat", tmp_path, "others")] == ["one", "two"]


def test_a_config_that_is_not_there_is_refused_with_those_that_are(dataset: Path) -> None:
    with_two_configs(dataset)
    with pytest.raises(InputError, match=r"--config hssd: there is none; the folder has own-uncluttered, own; use --config own-"):
        find_sources("habitat", dataset, "others", config="hssd")
    with pytest.raises(InputError, match=r"does not end in \.scene_dataset_config\.json"):
        find_sources("habitat", dataset / "stages" / "room.glb", "others")


def test_scenes_of_two_configs_with_the_same_files_are_imported_once(dataset: Path, tmp_path: Path) -> None:
    with_two_configs(dataset)
    lake = Lake.open(tmp_path / "lake")
    first, second = (import_dataset(lake, "habitat", dataset, "others", config=name) for name in ("own", "own-uncluttered"))
    assert [scene.action for scene in (*first.scenes, *second.scenes)] == ["import", "import", "reuse", "reuse"]


@pytest.mark.parametrize("signs", [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, 1), (-1, -1, -1)])
@pytest.mark.parametrize("is_in_the_template", [False, True])
def test_a_negative_scale_mirrors_the_mesh(signs: tuple[int, int, int], is_in_the_template: bool, dataset: Path) -> None:
    scale = (np.array(signs) * [1.0, 2.0, 0.5]).tolist()
    turn = [0.5, 0.5, -0.5, 0.5]  # to x, y, z from y, z, x, with one sign
    scene_file = dataset / "scenes" / "one.scene_instance.json"
    edit(scene_file, lambda d: d["object_instances"][0].update(rotation=turn, translation_origin="asset_local"))
    if is_in_the_template:
        edit(dataset / "objects" / "cabinet_a.object_config.json", lambda document: document.update(scale=scale))
    else:
        edit(scene_file, lambda document: document["object_instances"][0].update(non_uniform_scale=scale))
    one = read(dataset)["one"].objects[0]
    found = surface_of(one.model.parts).transformed(one.pose, one.scale).to_trimesh()
    w, x, y, z = turn
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    expected = (cabinet().vertices * scale) @ rotation.T + [1, 0.3, -1]
    expected = np.column_stack([expected[:, 0], -expected[:, 2], expected[:, 1]])
    assert np.sort(found.vertices.round(5), axis=0) == pytest.approx(np.sort(expected.round(5), axis=0), abs=1e-4)
    distance = np.linalg.norm(found.vertices[:, None] - expected[None], axis=2)
    assert max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-4
    assert found.volume == pytest.approx(cabinet().volume, rel=1e-4), "faces look outward"
    assert np.linalg.det(one.pose[:3, :3]) == pytest.approx(1.0)
    assert (one.scale > 0).all()


def test_an_object_and_its_mirror_image_are_two_assets_of_one_scene(dataset: Path, tmp_path: Path) -> None:
    mirror_image = {"template_name": "cabinet_a", "translation": [2, 0.3, -1], "non_uniform_scale": [-1, 1, 1]}
    edit(dataset / "scenes" / "one.scene_instance.json", lambda document: document["object_instances"].append(mirror_image))
    lake = Lake.open(tmp_path / "lake")
    assert import_dataset(lake, "habitat", dataset, "others").failed == ()
    placements = lake.snapshot().rows(Placement, "others/one")
    assert len({row.asset_id for row in placements}) == len(placements) == 3


def broken(name: str, content: str | bytes) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return change


def config(**sections: Any) -> Callable[[Path], None]:
    """Sections of the dataset's config that are added or replaced."""
    return lambda root: edit(root / "own.scene_dataset_config.json", lambda document: document.update(sections))


def both(*changes: Callable[[Path], None]) -> Callable[[Path], None]:
    return lambda root: [change(root) for change in changes] and None


def in_scene(**values: Any) -> Callable[[Path], None]:
    return lambda root: edit(root / "scenes" / "one.scene_instance.json", lambda document: document.update(values))


LIGHTS = {"paths": {".json": ["lights/*"]}}
HARMLESS: dict[str, tuple[Callable[[Path], None], str]] = {
    "section of a newer simulator": (config(ray_tracing={"paths": {}}), "ray_tracing"),
    "section of another kind": (config(light_setups=7), "light_setups"),
    "lights cut off": (both(config(light_setups=LIGHTS), broken("lights/a.lighting_config.json", "{")), "a.lighting_config.json"),
    "lights of another kind": (both(config(light_setups=LIGHTS), broken("lights/a.lighting_config.json", "[1]")), "a.lighting_config.json"),
    "pattern that leaves": (config(stages={"paths": {".json": ["stages", "../*"]}}), "leaves the dataset's folder"),
    "pattern that is a number": (config(stages={"paths": {".json": ["stages", 3]}}), "stages.paths..json[1]"),
    "pattern without files": (config(stages={"paths": {".json": ["stages", "more/*"]}}), "more/* matches no file"),
    "empty pattern": (config(stages={"paths": {".json": ["stages", ""]}}), "is no pattern"),
    "entry of another kind": (config(objects={**SECTIONS["objects"], "configs": [3]}), "objects.configs[0]"),
    "entry of a missing file": (config(objects={**SECTIONS["objects"], "configs": [{"original_file": "no.json"}]}), "no.json"),
    "default of another kind": (config(objects={**SECTIONS["objects"], "default_attributes": {"scale": 2}}), "scale"),
    "license that is no text": (broken("LICENSE", b"\xff\xfe\x00"), "LICENSE"),
    "categories that are no text": (broken("metadata/a.csv", b"\xff\xfe\x00"), "a.csv"),
    "lexicon entry without name": (
        both(config(semantic_scene_descriptor_instances={"a": "a.json"}), broken("a.json", '{"classes": [{"id": 1}]}')),
        "classes[0]",
    ),
    "lexicon cut off": (both(config(semantic_scene_descriptor_instances={"a": "a.json"}), broken("a.json", "{")), "a.json"),
    "navmeshes of another kind": (config(navmesh_instances={"a": 3}), "navmesh_instances.a"),
    "lighting of another kind": (in_scene(default_lighting=3), "default_lighting"),
    "mass a text": (lambda root: edit(root / "objects" / "chair_a.object_config.json", lambda d: d.update(mass="2")), "mass"),
    "key of a newer simulator": (in_scene(ray_tracing=True), ""),
    "articulated object": (in_scene(articulated_object_instances=[{"template_name": "fridge"}]), "1 articulated object"),
    "articulated objects of another kind": (in_scene(articulated_object_instances="fridge"), ""),
    "navmesh missing": (both(config(navmesh_instances={"a": "a.navmesh"}), in_scene(navmesh_instance="a")), "a.navmesh does not exist"),
}


@pytest.mark.parametrize("fault", HARMLESS)
def test_a_fault_of_a_part_costs_no_scene_and_is_noted(fault: str, dataset: Path) -> None:
    before = read(dataset)
    change, said = HARMLESS[fault]
    change(dataset)
    after = read(dataset)
    assert {name: [one.source_id for one in scene.objects] for name, scene in after.items()} == {
        name: [one.source_id for one in scene.objects] for name, scene in before.items()
    }
    assert any(said in note for note in after["one"].notes) or not said


def test_scenes_are_found_once_by_several_patterns(dataset: Path) -> None:
    config(scene_instances={"paths": {".json": ["scenes", "scenes/*", "scenes/one*"]}})(dataset)
    broken("scenes/three.scene_instance.json", "{")(dataset)
    sources = find_sources("habitat", dataset, "others")
    assert [(source.scan, source.problem is None) for source in sources] == [("one", True), ("three", False), ("two", True)]


def test_a_navmesh_that_cannot_be_read_is_left_out(dataset: Path, tmp_path: Path) -> None:
    both(config(navmesh_instances={"a": "a.navmesh"}), in_scene(navmesh_instance="a"))(dataset)
    (dataset / "a.navmesh").mkdir()
    done = import_dataset(Lake.open(tmp_path / "lake"), "habitat", dataset, "others")
    assert done.failed == ()
    assert any("a.navmesh" in note for note in done.scenes[0].notes)


@pytest.mark.parametrize("value", [None, "text", 0.5, [], {}, True, ...])
@pytest.mark.parametrize(
    "key", ["template_name", "translation", "rotation", "non_uniform_scale", "uniform_scale", "user_defined", "mass_scale"]
)
def test_any_value_of_one_object_costs_that_object_at_most(key: str, value: Any, dataset: Path) -> None:
    def change(document: Any) -> None:
        placed = document["object_instances"][0]
        placed.pop(key, None)
        if value is not ...:
            placed[key] = value

    edit(dataset / "scenes" / "one.scene_instance.json", change)
    after = read(dataset)
    assert [one.source_id for one in after["one"].objects][-1:] == ["chair_a"]
    assert [one.instance_id for one in after["one"].objects][-1:] == ["0001"]
    assert len(after["two"].objects) == 2
