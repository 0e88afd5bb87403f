"""The virtual scanner: what it writes is read back, agrees with what is true, and is the same every time."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.files.frames import exported_frames, sens_frames
from tasks.capture.files.ply import read_ply
from tasks.capture.scannet.layout import scannet_layout
from tasks.furniture.rooms import furnish
from tasks.geometry.meshes import Surface, load_glb
from tasks.geometry.proximity import closest_points
from tasks.geometry.transforms import is_rigid, transform_points
from tasks.geometry.triangles import vertex_normals
from tasks.scanner import ScannerConfig, scan_scene
from tasks.scanner.demo import ROOMS, demo_scan
from tasks.scanner.scenery import scenery_of
from tasks.scanner.segments import segment
from tasks.scanner.sensor import drift, scan_frame
from tasks.segments import edges_of

QUICK = ScannerConfig(depth_width=160, depth_height=120, color_width=160, color_height=120, voxel_m=0.03, view_limit=60, segment_least=12)
"""Coarse, so that a room takes seconds."""


@dataclasses.dataclass(frozen=True)
class Made:
    """A scan with what its files hold."""

    folder: Path
    truth: dict
    surface: Surface
    segments: np.ndarray
    aggregation: dict
    room: object

    @property
    def alignment(self) -> np.ndarray:
        return np.array(self.truth["alignment"]).reshape(4, 4)

    @property
    def world(self) -> np.ndarray:
        return transform_points(self.surface.vertices, self.alignment)

    def vertices_of(self, object_id: int) -> np.ndarray:
        return self.world[np.isin(self.segments, self.aggregation["segGroups"][object_id]["segments"])]


def make(out: Path, config: ScannerConfig, scan: str = "scene0000_00") -> Made:
    room = furnish("bedroom", np.random.default_rng(7), object_count=14)
    scan_scene(room, out, scan, config, np.random.default_rng(1))
    folder = out / scan
    segments = json.loads((folder / f"{scan}_vh_clean_2.0.010000.segs.json").read_text())
    return Made(
        folder,
        json.loads((out / f"{scan}.truth.json").read_text()),
        read_ply(folder / f"{scan}_vh_clean_2.ply", scan).surface,
        np.array(segments["segIndices"]),
        json.loads(next(folder.glob("*aggregation.json")).read_text()),
        room,
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    return make(tmp_path_factory.mktemp("scans"), dataclasses.replace(QUICK, lost_poses=3))


def digest(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.rglob("*")) if p.is_file()}


def distances(room, points: np.ndarray) -> np.ndarray:
    """From points to a room's true surfaces [m]."""
    whole = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces, process=False) for _, m in room.named_parts()])
    return closest_points(whole.vertices, whole.faces, points).distance


def test_the_folder_is_laid_out_as_scannet_has_it(made: Made) -> None:
    layout = scannet_layout(made.folder)
    assert layout is not None
    assert layout.mesh is not None
    assert layout.aggregation is not None
    assert layout.frames is not None
    assert [p.name for p in layout.segments] == ["scene0000_00_vh_clean_2.0.010000.segs.json"]
    stated = dict(line.split(" = ") for line in (made.folder / "scene0000_00.txt").read_text().splitlines())
    assert stated["sceneType"] == "Bedroom"
    assert int(stated["numDepthFrames"]) == made.truth["frame_count"] == len(list((made.folder / "depth").iterdir()))
    assert np.allclose(np.array(stated["axisAlignment"].split(), dtype=float), made.truth["alignment"], atol=1e-7)
    assert (made.folder / "LICENSE.txt").read_text().splitlines()[0] == "CC0-1.0"
    assert not list(made.folder.glob("*truth*"))


def test_the_mesh_lies_on_the_true_surfaces(made: Made) -> None:
    off = distances(made.room, made.world)
    assert np.median(off) < 0.012
    assert np.quantile(off, 0.97) < 0.05


def test_the_scan_frame_is_tilted_and_the_alignment_undoes_it(made: Made) -> None:
    assert is_rigid(made.alignment)
    lean = np.arccos(made.alignment[2, 2])
    assert 0.005 < lean <= QUICK.tilt_radians + 1e-9
    floor = next(o for o in made.truth["objects"] if o["category"] == "floor")
    assert abs(np.median(made.vertices_of(floor["object_id"])[:, 2])) < 0.01
    assert np.abs(made.world[:, :2].min(axis=0) - made.room.polygon.min(axis=0)).max() < 0.06
    assert np.abs(made.world[:, :2].max(axis=0) - made.room.polygon.max(axis=0)).max() < 0.06


def test_segments_part_the_mesh_along_objects(made: Made) -> None:
    assert len(made.segments) == len(made.surface.vertices)
    ids, first, counts = np.unique(made.segments, return_index=True, return_counts=True)
    assert (ids == first).all(), "a segment's number is its lowest vertex"
    assert len(ids) > 100
    assert np.mean(counts >= QUICK.segment_least) > 0.98
    claimed = [s for group in made.aggregation["segGroups"] for s in group["segments"]]
    assert len(claimed) == len(set(claimed))
    assert set(claimed) <= set(ids.tolist())


def test_instances_are_where_the_truth_has_them(made: Made) -> None:
    seen = [o for o in made.truth["objects"] if o["object_id"] is not None]
    assert len(seen) >= 0.85 * len(made.truth["objects"])
    for obj in seen:
        group = made.aggregation["segGroups"][obj["object_id"]]
        assert group["label"] == obj["category"]
        assert group["objectId"] == obj["object_id"]
        local = transform_points(made.vertices_of(obj["object_id"]), np.linalg.inv(np.array(obj["pose"]).reshape(4, 4)))
        half = 0.5 * np.array(obj["extents"])
        outside = np.maximum(np.abs(local - [0, 0, half[2]]) - half, 0).max(axis=1)
        assert np.mean(outside < 0.08) > 0.9, obj["name"]
    assert np.mean([o["observed"] for o in seen]) > 0.48
    assert all(0 <= o["observed"] <= 1 for o in made.truth["objects"])


def test_frames_agree_with_poses_and_truth(made: Made) -> None:
    layout = scannet_layout(made.folder)
    text = (made.folder / "scene0000_00.txt").read_text().splitlines()
    frames, _ = exported_frames(layout.frames, made.folder, dict(line.split(" = ") for line in text))
    assert sum(frame.pose is None for frame in frames) == 3
    for frame in [f for f in frames if f.pose is not None][::6]:
        depth = frame.depth()
        v, u = np.nonzero(depth)
        fx, fy, cx, cy = frame.depth_intrinsics
        z = depth[v, u]
        local = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
        world = transform_points(transform_points(local, frame.pose), made.alignment)
        off = distances(made.room, world)
        assert np.median(off) < 0.03
        assert depth.max() <= QUICK.max_range_m + 0.2
        assert depth[depth > 0].min() >= QUICK.min_range_m - 0.05
        assert np.array_equal(depth, np.round(depth, 3).astype(np.float32))


@pytest.mark.whole
def test_the_same_seed_writes_the_same_bytes(made: Made, tmp_path: Path) -> None:
    again = make(tmp_path, dataclasses.replace(QUICK, lost_poses=3))
    assert digest(again.folder) == digest(made.folder)
    assert again.truth == made.truth


@pytest.mark.whole
def test_variants_hold_the_same_scan(made: Made, tmp_path: Path) -> None:
    config = dataclasses.replace(QUICK, lost_poses=3, frames="sens", axis_alignment=False, aggregation="vh_clean", prefix="scannet.")
    other = make(tmp_path, config)
    assert (other.segments == made.segments).all()
    assert other.aggregation["segGroups"] == made.aggregation["segGroups"]
    assert other.aggregation["sceneId"] == "scannet.scene0000_00"
    assert (other.folder / "scene0000_00_vh_clean.aggregation.json").is_file()
    assert "axisAlignment" not in (other.folder / "scene0000_00.txt").read_text()
    contained, _ = sens_frames(other.folder / "scene0000_00.sens", other.folder)
    layout = scannet_layout(made.folder)
    text = (made.folder / "scene0000_00.txt").read_text().splitlines()
    exported, _ = exported_frames(layout.frames, made.folder, dict(line.split(" = ") for line in text))
    assert len(contained) == len(exported)
    for a, b in zip(contained[::7], exported[::7], strict=True):
        assert np.array_equal(a.depth(), b.depth())
        assert np.array_equal(a.color(), b.color())
        assert (a.pose is None) == (b.pose is None)
        assert a.pose is None or np.allclose(a.pose, b.pose, atol=1e-5)


def test_what_cannot_be_scanned_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    box = trimesh.creation.box((1, 1, 1))
    with pytest.raises(InputError, match="nothing to scan"):
        scan_scene([], tmp_path, "a", QUICK, rng)
    with pytest.raises(InputError, match="nowhere in it can one stand"):
        scan_scene([("box|box|box", box.copy().apply_translation([0, 0, 5]))], tmp_path, "b", QUICK, rng)
    (tmp_path / "c").mkdir()
    with pytest.raises(InputError, match="is there already"):
        scan_scene([("box|box|box", box)], tmp_path, "c", QUICK, rng)
    with pytest.raises(InputError, match="whole multiple"):
        scan_scene([("box|box|box", box)], tmp_path, "d", dataclasses.replace(QUICK, color_width=200), rng)
    assert not list(tmp_path.glob("*.truth.json"))


def test_names_of_any_scene_are_understood() -> None:
    box = trimesh.creation.box((1, 2, 3))
    scenery = scenery_of([("Chair_1|chair|seat", box), ("Chair_1|chair|legs", box), ("HouseWallB_01|housewallb|p", box), ("lamp", box)])
    assert [(t.name, t.category) for t in scenery.objects] == [("Chair_1", "chair"), ("HouseWallB_01", "wall"), ("lamp", "lamp")]
    assert scenery.object_of.tolist() == [0, 0, 1, 2]
    assert np.allclose(scenery.objects[0].extents, [1, 2, 3])


def joined_plainly(edges, weights, count, threshold, least):
    """Felzenszwalb and Huttenlocher's joining, as plainly as can be: sets of vertices."""
    region = {v: {v} for v in range(count)}
    limit = {id(r): threshold for r in region.values()}
    for (a, b), w in zip(edges, weights, strict=True):
        one, other = region[a], region[b]
        if one is not other and w <= limit[id(one)] and w <= limit[id(other)]:
            merged = one | other
            limit[id(merged)] = w + threshold / len(merged)
            limit["keep", id(merged)] = (one, other)  # ids stay unique while what they name lives
            for v in merged:
                region[v] = merged
    for a, b in edges:
        one, other = region[a], region[b]
        if one is not other and min(len(one), len(other)) < least:
            merged = one | other
            for v in merged:
                region[v] = merged
    return np.array([min(region[v]) for v in range(count)])


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), threshold=st.floats(0.001, 0.5), least=st.integers(1, 12), weight=st.floats(0, 1))
def test_segments_equal_a_plain_implementation(seed: int, threshold: float, least: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    n = 9
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    vertices = np.column_stack([x.reshape(-1), y.reshape(-1), rng.normal(0, 0.4, n * n)]).astype(float)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + n, i + n + 1], 1), np.stack([i, i + n + 1, i + 1], 1)])
    surface = Surface(vertices, faces, rng.integers(0, 256, (n * n, 3)).astype(np.uint8))
    owner = rng.integers(-1, 2, n * n)
    found = segment(surface, threshold, least, 0.3, owner, weight)
    edges = edges_of(faces, n * n)
    normals = vertex_normals(surface.vertices, surface.faces)
    a, b = edges.T
    bend = 1 - np.einsum("nd,nd->n", normals[a], normals[b])
    convex = np.einsum("nd,nd->n", normals[b], vertices[b] - vertices[a]) > 0
    weights = np.where(convex, 0.5 * bend, bend) + 0.3 * np.linalg.norm((surface.colors[a].astype(float) - surface.colors[b]) / 255, axis=1)
    weights = weights + weight * (owner[a] != owner[b])
    order = np.argsort(weights, kind="stable")
    assert (found == joined_plainly(edges[order].tolist(), weights[order], n * n, threshold, least)).all()


def test_drift_is_smooth_and_as_large_as_stated() -> None:
    config = ScannerConfig()
    offs = drift(4000, config, np.random.default_rng(0))
    shifts = np.array([off[:3, 3] for off in offs])
    assert all(is_rigid(off) for off in offs[:50])
    assert 0.6 * config.drift_m < shifts.std() < 1.6 * config.drift_m
    assert np.abs(np.diff(shifts, axis=0)).mean() < 0.35 * np.abs(shifts - np.roll(shifts, 1000, axis=0)).mean()


@given(seed=st.integers(0, 1000))
def test_the_scan_frame_is_rigid_and_nearly_upright(seed: int) -> None:
    config = ScannerConfig()
    pose = scan_frame(config, np.random.default_rng(seed), np.array([3.0, 2.0, 0.0]))
    assert is_rigid(pose)
    assert np.arccos(min(1.0, pose[2, 2])) <= config.tilt_radians + 1e-9


def test_the_demo_goes_through_the_variants() -> None:
    first = [config for _, config in ROOMS[:3]]
    assert {config.frames for config in first} == {"exported", "sens"}
    assert sum(not config.axis_alignment for config in first) == 1
    assert sum(config.aggregation == "vh_clean" and config.prefix == "scannet." for config in first) == 1
    with pytest.raises(InputError, match="count from 0"):
        demo_scan(Path("nowhere"), -1, 0)


@pytest.mark.slow
def test_a_house_of_several_rooms_is_covered(realdata, tmp_path: Path) -> None:
    parts = load_glb((realdata("scene_aws_small_house") / "house.glb").read_bytes())
    config = dataclasses.replace(QUICK, view_limit=400, frames="none", voxel_m=0.04)
    truth = scan_scene(parts, tmp_path, "house_00", config, np.random.default_rng(0))
    objects = [obj for obj in truth.objects if obj.category not in ("wall", "floor", "ceiling")]
    assert len(objects) > 50
    assert np.mean([obj.object_id is not None for obj in objects]) > 0.9
    assert np.median([obj.observed for obj in objects]) > 0.75
