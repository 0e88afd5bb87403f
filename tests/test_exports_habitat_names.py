"""The Habitat dataset: conventions, names, and files made by others."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks import exports
from tasks.exports.bodies import gather
from tasks.exports.habitat import object_handles, rotation, scene_handle
from tasks.exports.habitat_library import read_library
from tasks.exports.habitat_rules import check_habitat
from tasks.exports.navmesh_file import DEFAULTS, read_navmesh
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
    found = [rows[name] for name in ("scenes", "rooms", "instances", "captions", "assets", "placements", "supports")]
    replica, _ = gather(*found, blobs, exports.ExportsConfig())
    assert len(set(object_handles(replica).values())) == len(replica.bodies)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "tests" / "golden" / "navmesh").glob("*.navmesh")), ids=lambda path: path.name)
def test_navmeshes_baked_by_habitat_are_read(path: Path) -> None:
    navmesh = read_navmesh(path.read_bytes())
    assert navmesh.settings is not None
    assert set(navmesh.settings) == set(DEFAULTS)
    assert navmesh.polygons
    center = navmesh.polygons[0].mean(axis=0)
    assert navmesh.distance(center)[0] == 0.0
    assert navmesh.distance(center + np.array([100.0, 0, 0]))[0] > 50.0
    with pytest.raises(ValueError):
        read_navmesh(path.read_bytes()[:-7])


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
