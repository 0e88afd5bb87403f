"""A scene as a recording for Rerun, read back by Rerun's own reader: everything where the lake has it, at every moment."""

from __future__ import annotations

import io
import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from flows.cli import cli
from flows.view.recording import MOMENTS, TIMELINE, write_recording
from flows.view.scene import Scenes
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.geometry.meshes import Surface, load_glb, surface_of, surface_of_glb
from tasks.geometry.transforms import matrix
from tests.flows.view.lakes import OBJECTS, SCENES, UNSTABLE, shown_lake
from warehouse.lake import Lake

SCALE = (1.25, 0.5, 2.0)
UNSETTLED = "0003"
NEEDS_RERUN = pytest.mark.slow
"""rerun-sdk takes 0.7 GB: `make test-all` asks for it, continuous integration does not."""


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("recording"))


@pytest.fixture(scope="module")
def scenes(lake: Lake) -> Scenes:
    """Scenes in which an asset is scaled, and one was not simulated."""
    scenes = Scenes(lake)
    objects = {row["id"]: row for row in scenes.shown(SCENES[0]).document["objects"]}
    objects["0001"]["placed"]["scale"] = SCALE
    objects[UNSETTLED]["placed"]["poses"]["settled"] = None
    return scenes


class Recorded:
    """What a recording holds: of every entity and component the values, by moment; those that always hold under None."""

    def __init__(self, path: Path) -> None:
        reader = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install 'metascenes[rerun]'").RrdReader(
            str(path)
        )
        self.recordings, self.blueprints = reader.recordings(), reader.blueprints()
        self.timelines: set[str] = set()
        self.values: dict[tuple[str, str], dict[int | None, Any]] = defaultdict(dict)
        for chunk in reader.stream():
            self.timelines |= set(chunk.timeline_names)
            for row in chunk.to_record_batch().to_pylist():
                for name, value in row.items():
                    if ":" in name and value is not None:
                        self.values[chunk.entity_path, name][row.get(TIMELINE)] = value

    def transform(self, path: str, moment: int | None = None) -> np.ndarray:
        """A transform, 4x4; Rerun keeps matrices column by column."""
        pose = np.eye(4)
        pose[:3, :3] = np.array(self.values[path, "Transform3D:mat3x3"][moment][0]).reshape(3, 3).T
        if moment is not None:
            pose[:3, 3] = self.values[path, "Transform3D:translation"][moment][0]
        return pose

    def glb(self, path: str) -> bytes:
        return bytes(self.values[path, "Asset3D:blob"][None][0])

    def mesh(self, path: str) -> Surface:
        """A mesh with colors of vertices, in the frame of its entity."""
        values = {name: self.values[path, f"Mesh3D:{name}"][None] for name in ("vertex_positions", "triangle_indices", "vertex_colors")}
        packed = np.array(values["vertex_colors"], dtype=np.uint32)
        colors = np.stack([packed >> 24, packed >> 16 & 255, packed >> 8 & 255], axis=1).astype(np.uint8)
        return Surface(np.array(values["vertex_positions"], dtype=float), np.array(values["triangle_indices"], dtype=np.int64), colors)


@pytest.fixture(scope="module")
def recorded(scenes: Scenes, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'metascenes[rerun]'")
    out = tmp_path_factory.mktemp("out") / "more" / "scene.rrd"
    assert write_recording(scenes, SCENES[0], out) == out.stat().st_size
    assert [path.name for path in out.parent.iterdir()] == ["scene.rrd"]
    return Recorded(out)


def raw(data: bytes) -> np.ndarray:
    """Vertices of a GLB in its own frame, +Y up, as other readers see them."""
    loaded = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
    return np.concatenate([np.asarray(mesh.vertices) for mesh in loaded.dump()])


@NEEDS_RERUN
def test_it_is_one_recording_with_the_scene_in_its_name(scenes: Scenes, recorded: Recorded) -> None:
    (entry,) = recorded.recordings
    assert (entry.application_id, entry.recording_id) == ("metascenes", f"{SCENES[0]} {scenes.reader.snapshot_id}")
    assert len(recorded.blueprints) == 1
    assert recorded.timelines == {TIMELINE}


@NEEDS_RERUN
def test_objects_stand_where_the_lake_has_them_at_every_moment(lake: Lake, scenes: Scenes, recorded: Recorded) -> None:
    rows = lake.snapshot().rows(Placement, SCENES[0])
    assert len(rows) == OBJECTS
    for row in rows:
        for moment, name in enumerate(MOMENTS):
            pose = getattr(row, f"{name}_pose")
            path = f"/replica/{row.instance_id}"
            if row.instance_id == UNSETTLED and name == "settled":
                assert moment not in recorded.values[path, "Transform3D:translation"]
                continue
            assert np.allclose(recorded.transform(path, moment), matrix(pose), atol=1e-6)
    (unstable,) = [row for row in rows if row.instance_id == UNSTABLE]
    assert unstable.settled_pose != unstable.optimized_pose


@NEEDS_RERUN
def test_assets_keep_their_colors_and_come_to_lie_where_they_are_placed(scenes: Scenes, recorded: Recorded) -> None:
    for row in scenes.shown(SCENES[0]).document["objects"]:
        placed, path = row["placed"], f"/replica/{row['id']}"
        whole, found = surface_of_glb(scenes.blob(placed["blob"])), recorded.mesh(f"{path}/asset")
        assert np.array_equal(found.colors, whole.colors)
        assert np.array_equal(found.faces, whole.faces)
        world = recorded.transform(path, 1) @ recorded.transform(f"{path}/asset")
        seen = found.vertices @ world[:3, :3].T + world[:3, 3]
        expected = whole.transformed(matrix(placed["poses"]["optimized"]), placed["scale"]).vertices
        assert np.allclose(np.sort(seen, axis=0), np.sort(expected, axis=0), atol=1e-5)
        assert np.allclose([seen.min(axis=0), seen.max(axis=0)], [expected.min(axis=0), expected.max(axis=0)], atol=1e-5)


@NEEDS_RERUN
def test_colliders_move_with_what_they_are_of(scenes: Scenes, recorded: Recorded) -> None:
    objects = {row["id"]: row for row in scenes.shown(SCENES[0]).document["objects"]}
    exported = {key for key, row in objects.items() if row["collider"] is not None}
    assert {path.split("/")[2] for path, _ in recorded.values if path.startswith("/colliders/")} == exported
    assert 0 < len(exported) < OBJECTS
    for key in exported:
        data = recorded.glb(f"/colliders/{key}/pieces")
        for moment in range(len(MOMENTS)):
            assert np.allclose(recorded.transform(f"/colliders/{key}", moment), recorded.transform(f"/replica/{key}", moment))
        turn = recorded.transform(f"/colliders/{key}/pieces")
        pieces = surface_of(load_glb(data)).vertices
        assert np.allclose(np.sort(raw(data) @ turn[:3, :3].T, axis=0), np.sort(pieces, axis=0), atol=1e-5)


@NEEDS_RERUN
def test_scan_room_and_navmesh_are_in_the_world_frame(scenes: Scenes, recorded: Recorded) -> None:
    document = scenes.shown(SCENES[0]).document
    scan = surface_of_glb(scenes.blob(document["scan"]))
    assert np.allclose(recorded.values["/scan/points", "Points3D:positions"][None], scan.vertices, atol=1e-5)
    packed = np.array(recorded.values["/scan/points", "Points3D:colors"][None], dtype=np.uint32)
    assert np.array_equal(packed >> 24, scan.colors[:, 0])
    shell = surface_of_glb(scenes.blob(document["shell"]))
    assert np.array_equal(recorded.mesh("/room").colors, shell.colors)
    found, expected = (np.sort(v, axis=0) for v in (recorded.mesh("/room").vertices, raw(scenes.blob(document["shell"]))))
    assert np.allclose(found, expected, atol=1e-6)
    (navmesh,) = document["navmeshes"]
    vertices = np.array(recorded.values["/navmesh/stretch", "Mesh3D:vertex_positions"][None])
    triangles = np.array(recorded.values["/navmesh/stretch", "Mesh3D:triangle_indices"][None])
    a, b = vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    assert np.linalg.norm(np.cross(a, b), axis=1).sum() / 2 == pytest.approx(navmesh["area"], abs=1e-3)
    boxes = {path: value for (path, name), value in recorded.values.items() if name == "Boxes3D:half_sizes"}
    assert {path: np.round(value[None][0], 5).tolist() for path, value in boxes.items()} == {
        f"/scan/boxes/{row['id']}": [round(side / 2, 5) for side in row["box"]["size"]] for row in document["objects"]
    }


@NEEDS_RERUN
def test_what_carries_what_is_a_graph_and_lines(recorded: Recorded) -> None:
    edges = recorded.values["/supports/graph", "GraphEdges:edges"][None]
    assert sorted((edge["first"], edge["second"]) for edge in edges) == [("0001", "0003"), *(("floor", f"000{n}") for n in range(3))]
    for moment in (0, 1, 2):
        (line,) = recorded.values["/supports/lines", "LineStrips3D:strips"][moment]
        last = recorded.transform(f"/replica/{UNSETTLED}", min(moment, 1))[:3, 3]
        assert np.allclose(line, [last, recorded.transform("/replica/0001", moment)[:3, 3]], atol=1e-6)


def test_without_the_package_one_is_told_how_to_get_it(scenes: Scenes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r"^--rerun: .*a\.rrd: needs the package rerun-sdk; pip install 'metascenes\[rerun\]'$"):
        write_recording(scenes, SCENES[0], tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


@NEEDS_RERUN
def test_recording_that_is_switched_off_is_no_empty_file(scenes: Scenes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'metascenes[rerun]'")
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(InputError, match="RERUN: the environment: switches recording off"):
        write_recording(scenes, SCENES[0], tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_one_whole_scene_alone(lake: Lake, tmp_path: Path) -> None:
    words = ["view", SCENES[0], "--lake", lake.address, "--rerun", str(tmp_path / "a.rrd")]
    both = CliRunner().invoke(cli, [*words, "--out", str(tmp_path / "a.html")])
    assert (both.exit_code, "give one of them" in both.output) == (2, True)
    part = CliRunner().invoke(cli, ["view", f"{SCENES[0]}/0001", *words[2:]])
    assert (part.exit_code, "--rerun writes a whole scene: leave /0001 away" in part.output) == (2, True)
    assert list(tmp_path.iterdir()) == []


@NEEDS_RERUN
def test_the_command_writes_one_scene_to_one_file(lake: Lake, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'metascenes[rerun]'")
    words = ["view", SCENES[0], "--lake", lake.address, "--rerun", str(tmp_path / "a.rrd"), "--json"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["bytes"] == (tmp_path / "a.rrd").stat().st_size
