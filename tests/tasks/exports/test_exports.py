"""The exports stage: what goes in comes out, in every format, and every rule has passed."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.exports import ExportCheck, ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.record import check
from tasks import exports
from tasks.exports.bodies import identifier, stem
from tasks.exports.layout import layout, shared_files
from tasks.stage import Context, Outcome, in_turn
from tests.conftest import REPOSITORY
from tests.replicas import cube, furnished, rows_of, with_navigation


def export(
    rows: dict[str, list[Any]], blobs: dict[str, bytes], config: exports.ExportsConfig | None = None,
    spread: Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]] = in_turn,
) -> Outcome:  # fmt: skip
    context = Context(rows["scenes"][0].scene_id, "exports", 0, blobs, spread=spread)
    return exports.run(**{name: rows[name] for name in exports.STAGE.reads}, context=context, config=config or exports.ExportsConfig())


@pytest.fixture(scope="module")
def scene() -> tuple[dict[str, list[Any]], dict[str, bytes]]:
    return with_navigation(*rows_of(furnished()))


@pytest.fixture(scope="module")
def outcome(scene: tuple[dict[str, list[Any]], dict[str, bytes]]) -> Outcome:
    return export(*scene)


def test_every_rule_passes_and_rows_keep_their_schema(outcome: Outcome) -> None:
    check(outcome.rows["export_files"], ExportFile)
    check(outcome.rows["export_checks"], ExportCheck)
    assert [f"{row.format} {row.rule}: {row.message}" for row in outcome.rows["export_checks"] if not row.passed] == []
    assert {row.format for row in outcome.rows["export_checks"]} == set(EXPORT_FORMATS)
    assert len(outcome.rows["export_checks"]) > 50
    assert outcome.degradations == ()


def test_every_file_is_a_blob_and_every_blob_a_file(outcome: Outcome) -> None:
    files = outcome.rows["export_files"]
    assert {row.file_blob for row in files} == set(outcome.blobs)
    assert all(len(outcome.blobs[row.file_blob]) == row.size_bytes for row in files)
    roles = {row.role for row in files}
    assert {"scene", "stage", "object", "asset", "collision", "navmesh", "episodes"} <= roles


def test_nothing_in_the_files_tells_where_they_were_made(outcome: Outcome) -> None:
    for row in outcome.rows["export_files"]:
        data = outcome.blobs[row.file_blob]
        assert b"/tmp/" not in data, row.path
        assert str(REPOSITORY).encode() not in data, row.path


@pytest.mark.parametrize("format_", ["mjcf", "sdf", "urdf"])
def test_a_format_by_itself_and_far_away_is_what_it_is_beside_others(
    outcome: Outcome, scene: tuple[dict[str, list[Any]], dict[str, bytes]], format_: str
) -> None:
    """What formats have of a shape alike is made once, and travels to other processes: neither shows."""
    alone = export(*scene, exports.ExportsConfig(formats=(format_,)))
    both = exports.ExportsConfig(formats=(format_, "glb"))
    far = export(*scene, both, lambda made, items: [made(pickle.loads(pickle.dumps(item))) for item in items])
    for table in ("export_files", "export_checks"):
        rows = [row for row in outcome.rows[table] if row.format == format_]
        assert alone.rows[table] == rows
        assert [row for row in far.rows[table] if row.format == format_] == rows


_AGAIN = """
import sys
from tests.tasks.exports.test_exports import export
from tests.replicas import furnished, rows_of, with_navigation
outcome = export(*with_navigation(*rows_of(furnished())))
print("\\n".join(sorted(f"{row.format}/{row.path} {row.file_blob}" for row in outcome.rows["export_files"])))
"""


@pytest.mark.whole
def test_another_process_makes_the_same_bytes(outcome: Outcome) -> None:
    env = {"PYTHONHASHSEED": "7", "PXR_WORK_THREAD_LIMIT": "3", "PATH": "", "PYTHONPATH": str(REPOSITORY), "HOME": "/nonexistent"}
    again = subprocess.run([sys.executable, "-c", _AGAIN], cwd=REPOSITORY, env=env, capture_output=True, text=True, check=True)
    here = sorted(f"{row.format}/{row.path} {row.file_blob}" for row in outcome.rows["export_files"])
    assert again.stdout.splitlines() == here


def test_what_cannot_be_exported_is_left_out_and_said(scene: tuple[dict[str, list[Any]], dict[str, bytes]]) -> None:
    rows, blobs = scene
    broken = dict(blobs)
    victim = rows["placements"][3]
    asset = next(a for a in rows["assets"] if a.asset_id == victim.asset_id)
    broken[asset.mesh_blob] = b"no mesh"
    found = export(rows, broken)
    named = [line for line in found.degradations if "left out" in line]
    assert any(line.startswith(victim.instance_id) for line in named)
    verdict = {(row.format, row.rule): row for row in found.rows["export_checks"]}
    assert not verdict["usd", "complete"].passed
    assert not verdict["habitat", "complete"].passed
    assert verdict["usd", "usd_validation"].passed
    assert verdict["habitat", "handle_exact"].passed


def test_an_object_without_a_caption_gets_a_mass_and_says_so(scene: tuple[dict[str, list[Any]], dict[str, bytes]]) -> None:
    rows, blobs = scene
    some = rows | {"captions": [row for row in rows["captions"] if row.instance_id != "0002"]}
    found = export(some, blobs, exports.ExportsConfig(formats=("usd",)))
    assert [line for line in found.degradations if line.startswith("0002: no caption")]
    assert all(row.passed for row in found.rows["export_checks"])


def test_a_scene_without_navmesh_has_no_episodes(scene: tuple[dict[str, list[Any]], dict[str, bytes]]) -> None:
    rows, blobs = scene
    found = export(rows | {"navmeshes": [], "episodes": []}, blobs, exports.ExportsConfig(formats=("habitat",)))
    assert all(row.passed for row in found.rows["export_checks"])
    assert {row.role for row in found.rows["export_files"]} == {"scene", "stage", "object", "collision"}
    assert found.degradations


def test_a_scene_without_a_room_is_refused(scene: tuple[dict[str, list[Any]], dict[str, bytes]]) -> None:
    rows, blobs = scene
    with pytest.raises(InputError, match="shells: scene_id: 0 rows"):
        export(rows | {"shells": []}, blobs)


def test_an_empty_room_can_be_exported() -> None:
    found = export(*with_navigation(*rows_of([])))
    assert all(row.passed for row in found.rows["export_checks"]), [row for row in found.rows["export_checks"] if not row.passed]


def test_layout_of_several_scenes(outcome: Outcome, tmp_path: Path) -> None:
    other = export(*with_navigation(*rows_of([cube((0.3, 0.3, 0.3), np.eye(4))], "demo/room_010")))
    rows = [*outcome.rows["export_files"], *other.rows["export_files"]]
    blobs = {**outcome.blobs, **other.blobs}
    tree = layout(rows)
    assert len(tree) == len(rows)
    assert {path.split("/")[1] for path in tree if path.startswith("usd/")} == {"demo_room_01", "demo_room_010"}
    shared = shared_files(rows, blobs)
    assert not set(shared) & set(tree)
    assert shared == shared_files(rows[::-1], blobs), "the order of rows must not matter"
    exports.write_folder(tmp_path, {path: blobs[name] for path, name in tree.items()} | shared)
    from tasks.exports.habitat.rules import check_habitat

    assert check_habitat(tmp_path / "habitat") == []


@pytest.mark.parametrize("path", ["../up", "/root", "a/../../b", "a\\b", ""])
def test_layout_refuses_paths_that_leave_the_folder(outcome: Outcome, path: str) -> None:
    row = dataclasses.replace(outcome.rows["export_files"][0], path=path)
    with pytest.raises(InputError, match="leaves the folder"):
        layout([row])


_DATASET = st.from_regex(r"[a-z0-9][a-z0-9_.-]{0,6}", fullmatch=True)
_SCAN = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,6}", fullmatch=True)


@pytest.mark.whole
@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(_DATASET, _SCAN), min_size=2, max_size=6, unique=True))
def test_every_scene_has_its_own_stem(names: list[tuple[str, str]]) -> None:
    stems = [stem(f"{dataset}/{scan}") for dataset, scan in names]
    assert len(set(stems)) == len(names)
    assert all("." not in name and "/" not in name for name in stems)


@given(st.text(max_size=20))
def test_identifiers_are_valid_prim_names(text: str) -> None:
    from pxr import Sdf

    assert Sdf.Path.IsValidIdentifier(identifier(text))
