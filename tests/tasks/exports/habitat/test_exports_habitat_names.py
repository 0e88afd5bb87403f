"""The Habitat dataset: conventions, names, and files made by others."""

from __future__ import annotations

import gzip
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks import exports
from tasks.exports.bodies import gather
from tasks.exports.findings import Finding
from tasks.exports.habitat import object_handles, rotation, scene_handle
from tasks.exports.habitat.library import read_library
from tasks.exports.habitat.navmesh_file import DEFAULTS, read_polygons
from tasks.exports.habitat.rules import check_habitat
from tasks.exports.habitat.shapes import CONTENT, mismatch
from tests.conftest import REPOSITORY
from tests.replicas import furnished, rows_of


def test_headings_are_turns_from_minus_z() -> None:
    for yaw in np.linspace(-7, 7, 29):
        ahead = Rotation.from_quat(rotation(float(yaw))).apply([0.0, 0.0, -1.0])
        np.testing.assert_allclose(ahead, [math.cos(yaw), 0.0, -math.sin(yaw)], atol=1e-8)


_NAME = st.from_regex(r"[a-z0-9][a-z0-9_.-]{0,5}", fullmatch=True)


@given(st.lists(st.tuples(_NAME, _NAME), min_size=2, max_size=8, unique=True))
def test_no_handle_contains_another(names: list[tuple[str, str]]) -> None:
    handles = [scene_handle(f"{dataset}/{scan}") for dataset, scan in names]
    assert all(a not in b for a in handles for b in handles if a is not b)


def test_every_object_has_its_own_handle() -> None:
    rows, blobs = rows_of(furnished())
    found = [rows[name] for name in ("scenes", "shells", "instances", "captions", "assets", "placements", "supports")]
    replica, _ = gather(*found, blobs, exports.ExportsConfig())
    assert len(set(object_handles(replica).values())) == len(replica.bodies)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "tests" / "golden" / "navmesh").glob("*.navmesh")), ids=lambda path: path.name)
def test_navmeshes_baked_by_habitat_are_read(path: Path) -> None:
    navmesh = read_polygons(path.read_bytes())
    assert navmesh.settings is not None
    assert set(navmesh.settings) == set(DEFAULTS)
    assert navmesh.polygons
    center = navmesh.polygons[0].mean(axis=0)
    assert navmesh.distance(center)[0] == 0.0
    assert navmesh.distance(center + np.array([100.0, 0, 0]))[0] > 50.0
    with pytest.raises(ValueError):
        read_polygons(path.read_bytes()[:-7])


def rules(findings: list[Finding], is_error: bool) -> set[str]:
    return {finding.rule for finding in findings if finding.is_error == is_error}


def copied(source: Path, target: Path) -> None:
    """A copy that can be changed, of a folder that may not."""
    shutil.copytree(source, target, copy_function=shutil.copyfile)
    for folder in (target, *(path for path in target.rglob("*") if path.is_dir())):
        folder.chmod(0o755)


@pytest.fixture
def others(realdata: Callable[[str], Path], tmp_path: Path) -> Path:
    """A scene of habitat-sim's own test assets, described as its documentation does: no provenance, few axes, dynamic objects."""
    root = tmp_path / "others"
    for name in ("objects", "scenes"):
        copied(realdata("habitat_sim_test_assets") / "data" / "test_assets" / name, root / name)
    listed = {"stages": "scenes/*.stage_config.json", "objects": "objects/*.object_config.json", "scene_instances": "*.scene_instance.json"}
    config = {section: {"paths": {".json": [pattern]}} for section, pattern in listed.items()}
    navmesh = {"navmesh_instances": {"room": "room1_default.navmesh"}}
    shutil.copyfile(REPOSITORY / "tests" / "golden" / "navmesh" / "room1_default.navmesh", root / "room1_default.navmesh")
    (root / "others.scene_dataset_config.json").write_text(json.dumps(config | navmesh))
    objects = [{"template_name": "chair", "translation": [0, 0, 0]}, {"template_name": "donut", "translation_origin": "asset_local"}]
    scene = {"stage_instance": {"template_name": "simple_room"}, "object_instances": objects, "navmesh_instance": "room"}
    (root / "lounge.scene_instance.json").write_text(json.dumps(scene))
    return root


def test_what_another_author_may_mean_so_is_a_warning(others: Path) -> None:
    found = check_habitat(others)
    assert rules(found, True) == set(), found
    assert rules(found, False) >= {"translation_origin", "upright", "navmesh_settings", "collider"}
    path = others / "lounge.scene_instance.json"
    path.write_text(path.read_text().replace('"chair"', '"armchair"'))
    assert rules(check_habitat(others), True) == {"handle_exact"}, "what nobody can mean is an error all the same"


@pytest.mark.parametrize(
    ("lights", "problem"),
    [
        ([], None),
        ({}, None),
        ({"0": {"position": [0, 2, 0], "intensity": 1.3}}, None),
        ([{"position": [0, 2, 0]}], "lights is no object"),
        (None, "lights is no object"),
        ({"0": {"intensity": "high"}}, "lights.0.intensity is no finite number"),
    ],
)
def test_lights_of_others_are_named_objects_or_an_empty_list(others: Path, lights: Any, problem: str | None) -> None:
    (others / "dusk.lighting_config.json").write_text(json.dumps({"lights": lights}))
    config, scene = others / "others.scene_dataset_config.json", others / "lounge.scene_instance.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {"light_setups": {"paths": {".json": ["*.lighting_config.json"]}}}))
    scene.write_text(json.dumps(json.loads(scene.read_text()) | {"default_lighting": "dusk"}))
    findings = [finding for finding in check_habitat(others) if finding.is_error or finding.rule == "lights"]
    if problem:
        assert Finding("shape", "dusk.lighting_config.json", problem) in findings
    elif lights:
        assert findings == []
    else:
        assert findings == [Finding("lights", "dusk.lighting_config.json", "lights: there are none", is_error=False)]


def test_a_value_that_may_be_null_is_named_when_it_is_wrong() -> None:
    goal = {"radius": None, "view_points": [{"agent_state": {"position": ["x"]}}]}
    assert mismatch({"episodes": [{"goals": [goal]}]}, CONTENT) == (
        "episodes[0].goals[0].view_points[0].agent_state.position[0] is no finite number"
    )


def test_episodes_of_others_are_read(others: Path, realdata: Callable[[str], Path]) -> None:
    """Episodes of HM3D: goals are ids of its semantic meshes, scenes are paths of stages, and there is nothing to replay."""
    copied(realdata("habitat_episodes") / "objectnav_hm3d_v2_val_mini", others / "objectnav" / "val_mini")
    found = check_habitat(others)
    assert rules(found, True) == {"episode_scene"}, "their scene is not in this dataset"
    shutil.copyfile(others / "scenes" / "simple_room.glb", others / "scenes" / "wcojb4TFT35.basis.glb")
    (others / "others.scene_dataset_config.json").unlink()
    config = {"stages": {"paths": {".glb": ["scenes/*.basis.glb"]}}}
    (others / "hm3d_annotated_basis.scene_dataset_config.json").write_text(json.dumps(config))
    found = check_habitat(others)
    assert rules(found, True) == set(), found
    assert any("15 episodes have no shortest_paths" in finding.message for finding in found)
    content = others / "objectnav" / "val_mini" / "content" / "wcojb4TFT35.json.gz"
    document = json.loads(gzip.decompress(content.read_bytes()))
    document["episodes"][3]["info"]["geodesic_distance"] = 0.1
    document["goals_by_category"].pop("wcojb4TFT35.basis.glb_chair")
    content.write_bytes(gzip.compress(json.dumps(document).encode()))
    assert rules(check_habitat(others), True) == {"geodesic", "goals"}


def test_datasets_of_others_are_read(realdata: Callable[[str], Path]) -> None:
    root = realdata("habitat_sim_test_assets") / "data" / "test_assets" / "dataset_tests"
    library = read_library(root / "dataset_0")
    assert {"dataset_test_stage", "modified_test_stage", "new_test_stage", "glbload_test_stage0"} <= set(library.sections["stages"])
    assert library.sections["objects"]["modified_test_object1_1_slick_heavy"].values["mass"] == 3.5
    assert library.sections["objects"]["dataset_test_object2"].values["inertia"] == [3, 2, 1], "the section's defaults count"
    found = check_habitat(root / "dataset_0")
    assert "handle_exact" not in {finding.rule for finding in found}, "its scene names templates that exist, some only in the config itself"
    assert any("test_navmesh_path1 does not exist" in finding.message for finding in found), "it has no navmeshes"
    assert not any(finding.rule == "geometry" for finding in found), "its GLBs are sound"
    other = {finding.rule for finding in check_habitat(root / "dataset_1")}
    assert "handle_exact" in other, "its scenes name objects by a part of their names"
