"""What cannot be put right, and input that is none, is said by both methods."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import trimesh

from tasks.geometry.pieces import PieceConfig, pieces
from tasks.geometry.transforms import flat, translation, yaw_pose
from tasks.optimization import Default, Released, SupportConfig
from tests.tasks.optimization.scenes import (
    DEEP_M,
    METHODS,
    SOFA,
    TABLE,
    Scene,
    are_apart,
    block,
    bounds,
    box,
    collider_bounds,
    optimized,
    poses_of,
    remains,
    room_scene,
)


@METHODS
def test_two_sofas_in_a_closet(method: Released | Default) -> None:
    scene = Scene(box(0.9, 1.6))
    for x in (-0.05, 0.05):
        scene.add(SOFA, yaw_pose(0.0, [x, 0.0, 0.0]), "sofa")
    outcome, summary = optimized(scene, method)
    assert summary.ended in ("no_move_helps", "out_of_moves")
    assert 0.0 < summary.loss_final <= summary.loss_start
    assert summary.deep_pairs > 0
    assert summary.remains
    assert any(remains(outcome).values())
    assert any(f"{summary.loss_final:.3g} m" in text and "left" in text for text in outcome.degradations)
    assert min(step.loss for step in outcome.rows["optimization_steps"]) == pytest.approx(summary.loss_final, abs=1e-9), "the best state"


@METHODS
def test_an_object_larger_than_the_room(method: Released | Default) -> None:
    scene = Scene()
    big = scene.add(block(9.0, 8.0, 1.0), np.eye(4), "cabinet")
    scene.add(block(0.4, 0.4, 0.4), translation([0.5, 0.5, 0.0]), "box")
    outcome, summary = optimized(scene, method)
    assert summary.loss_final > 0.0
    assert summary.deep_pairs > 0
    text = remains(outcome)[big] or ""
    assert "outside of the room" in text
    assert "cm in wall_" in text


@METHODS
def test_an_object_higher_than_the_room_is_said(method: Released | Default) -> None:
    scene = Scene()
    high = scene.add(block(0.6, 1.0, 5.0), np.eye(4), "wardrobe")
    outcome, summary = optimized(scene, method)
    assert "2.50 m above the ceiling" in (remains(outcome)[high] or "")
    assert any(line.startswith(high) for line in summary.remains)


def test_what_is_built_in_stays_where_it_is_and_others_give_way() -> None:
    scene = Scene()
    toilet = scene.add(block(0.5, 0.4, 0.7), translation([0.3, 1.0, 0.0]), "toilet")
    sofa = scene.add(block(0.8, 1.6, 0.8), translation([0.9, 1.0, 0.0]), "sofa")
    outcome, summary = optimized(scene, Default())
    after, before = poses_of(outcome), poses_of(outcome, "proposed")
    assert np.array_equal(after[toilet], before[toilet])
    assert np.abs(after[sofa] - before[sofa]).max() < 0.01
    assert collider_bounds(outcome, scene)[sofa][0, 0] >= 0.55 - 1e-4, "it ends beside the toilet"
    assert summary.deep_pairs == 0


def test_what_was_pushed_into_another_object_stands_beside_it() -> None:
    scene = Scene()
    table = scene.add(TABLE, np.eye(4), "table")
    pedestal = scene.add(block(0.2, 0.2, 0.08), translation([0.2, 0.0, 0.75]), "sculpture")
    can = scene.add(block(0.07, 0.07, 0.12), translation([0.28, 0.0, 0.75]), "can")
    outcome, summary = optimized(scene, Default())
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert supports[can].parent_id == table
    assert supports[can].is_kept
    assert f"{can}: it stands beside {pedestal}, on {table}" in outcome.degradations
    assert summary.deep_pairs == 0
    moved = {name: np.linalg.norm((poses_of(outcome)[name] - poses_of(outcome, "proposed")[name])[:2, 3]) for name in (can, pedestal)}
    assert max(moved.values()) < 0.01
    assert are_apart(outcome, scene, can, pedestal)


@METHODS
def test_too_few_steps_are_said(method: Released | Default) -> None:
    few = dataclasses.replace(method, **({"max_steps": 3} if isinstance(method, Released) else {"max_moves": 3, "chains": 2}))  # type: ignore[arg-type]
    scene = Scene(box(1.6, 1.2))  # too small to put one of them elsewhere
    for x in (0.0, 0.1):
        scene.add(block(0.9, 0.9, 0.5), translation([x, 0.0, 0.0]))
    outcome, summary = optimized(scene, few)
    assert summary.ended == "out_of_moves"
    assert summary.moves == 3 * summary.chains
    assert summary.loss_final > 0.0
    assert all(text and " cm in 000" in text for text in remains(outcome).values())


@METHODS
def test_a_table_scanned_upside_down(method: Released | Default) -> None:
    scene = Scene()
    table = scene.add(TABLE, np.diag([1.0, -1.0, -1.0, 1.0]) + translation([0.0, 0.0, 0.75]) - np.eye(4), "table")
    mug = scene.add(block(0.1, 0.1, 0.1), translation([0.0, 0.0, 0.3]), "mug")
    outcome, summary = optimized(scene, method)
    assert "upside down" in (remains(outcome)[table] or "")
    assert bounds(outcome, scene)[table][0, 2] == pytest.approx(0.0, abs=1e-6)
    assert any(mug in text and "nothing carried it" in text for text in outcome.degradations)
    if isinstance(method, Default):
        assert bounds(outcome, scene)[mug][0, 2] == pytest.approx(0.3, abs=0.002), "where it was scanned"
        assert collider_bounds(outcome, scene)[mug][0, 2] == pytest.approx(0.04, abs=1e-4), "its collider reaches down to its underside"
    else:
        assert bounds(outcome, scene)[mug][0, 2] == pytest.approx(0.04, abs=1e-6), "down onto its underside"
    assert summary.remains


def surface(vertices: Any, faces: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def cube() -> trimesh.Trimesh:
    mesh = trimesh.creation.box((0.5, 0.5, 0.5))
    mesh.apply_translation([0.0, 0.0, 0.25])
    return mesh


def open_box() -> trimesh.Trimesh:
    mesh = cube()
    return surface(mesh.vertices, mesh.faces[mesh.face_normals[:, 2] < 0.5])


MESHES = {
    "a triangle": surface([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]], [[0, 1, 2]]),
    "a plane": surface([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], [[0, 1, 2], [0, 2, 3]]),
    "an upright plane": surface([[-0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [-0.5, 0, 1]], [[0, 1, 2], [0, 2, 3]]),
    "duplicate faces": surface(cube().vertices, np.concatenate([cube().faces, cube().faces, cube().faces[:, ::-1]])),
    "inside out": surface(cube().vertices, cube().faces[:, ::-1]),
    "a line": surface([[-0.5, 0, 0], [0.5, 0, 0], [0, 0, 0]], [[0, 1, 2]]),
    "a point": surface([[0, 0, 0]] * 3, [[0, 1, 2]]),
}


@METHODS
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_meshes_without_volume_or_with_holes(method: Released | Default, mesh: trimesh.Trimesh) -> None:
    """They stand, collide and are moved like any other."""
    scene = Scene()
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 4), 200, dtype=np.uint8)
    scene.add([mesh], translation([0.0, 0.0, 0.02]))
    scene.add(block(0.5, 0.5, 0.5), translation([0.1, 0.0, 0.0]), "box")
    hulls = pieces([mesh], None, PieceConfig())  # what it takes to decompose it is not this stage's time
    assert hulls.properties.volume > 0.0
    scene.run(method)
    outcome, summary = optimized(scene, method)
    assert summary.object_count == 2
    lies = 0.5 * PieceConfig().thickness_m  # a plane without thickness that was laid down is in the middle of its body
    assert bounds(outcome, scene)["0000"][0, 2] == pytest.approx(0.0, abs=lies + 1e-3)
    if isinstance(method, Default):
        assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
    else:  # of boxes without volume it sees nothing; the contacts do
        assert (summary.deep_pairs > 0) == any(c.penetration_m > DEEP_M for c in outcome.rows["contacts"] if c.phase == "optimized")


@pytest.mark.slow
def test_a_box_without_a_lid() -> None:
    """Decomposing it takes a minute; then what stands in its side is moved out of it, or put elsewhere, and that is said."""
    mesh = open_box()
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 4), 200, dtype=np.uint8)
    for way, is_put_elsewhere in ((0.45, False), (0.1, True)):
        scene = Scene()
        scene.add([mesh], translation([0.0, 0.0, 0.02]))
        scene.add(block(0.5, 0.5, 0.5), translation([way, 0.0, 0.0]), "box")
        scene.run(Released())  # the first decomposes
        _, summary = optimized(scene, Default())
        assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
        assert [("moved by" in line) for line in summary.remains] == [True] * is_put_elsewhere


def wrong_poses() -> dict[str, np.ndarray]:
    nowhere, endless = translation([np.nan, 0.0, 0.0]), translation([0.0, 0.0, np.inf])
    sheared, long = np.eye(4), np.diag([2.0, 1.0, 1.0, 1.0])
    sheared[0, 1] = 0.3
    return {
        "nan": nowhere, "infinite": endless, "sheared": sheared, "stretched": long, "mirrored": np.diag([-1.0, 1.0, 1.0, 1.0]),
        "zero": np.zeros((4, 4)),
    }  # fmt: skip


WRONG = [(pose, (1.0, 1.0, 1.0)) for pose in wrong_poses().values()]
WRONG += [(np.eye(4), scale) for scale in ((0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, np.nan, 1.0), (1.0, 1.0, np.inf))]


@METHODS
@pytest.mark.parametrize(("pose", "scale"), WRONG, ids=[*wrong_poses(), "zero scale", "negative scale", "nan scale", "infinite scale"])
def test_poses_and_scales_that_are_none(method: Released | Default, pose: np.ndarray, scale: tuple[float, ...]) -> None:
    """The object is left out, with a word; the others are placed as if it had not been there."""
    scene, without = Scene(), Scene()
    name = scene.add(block(0.5, 0.5, 0.5), np.eye(4), "box")
    scene.selections[0] = dataclasses.replace(scene.selections[0], pose=flat(pose), scale=scale)
    for other in (scene, without):
        for x in (0.1, 0.3):
            other.add(block(0.5, 0.5, 0.5), translation([x, 0.0, 0.0]), "box")
    outcome, summary = optimized(scene, method)
    (text,) = summary.remains
    assert text.startswith(f"{name}: nothing stands for it")
    assert "pose, scale" in text
    assert text in outcome.degradations
    expected = without.run(method)
    assert [row.optimized_pose for row in outcome.rows["placements"]] == [row.optimized_pose for row in expected.rows["placements"]]


@METHODS
def test_a_blob_that_is_missing_or_none(method: Released | Default) -> None:
    scene = Scene()
    gone, broken, _ = (scene.add(block(0.3, 0.3, 0.3 + i / 10), translation([i - 1.0, 0, 0])) for i in range(3))
    for name, blob in ((gone, "e" * 64 + ".glb"), (broken, scene.blobs.add(b"no mesh", "glb"))):
        asset = next(s.asset_id for s in scene.selections if s.instance_id == name)
        scene.assets[asset] = dataclasses.replace(scene.assets[asset], mesh_blob=blob)
    outcome, summary = optimized(scene, method)
    assert [row.instance_id for row in outcome.rows["placements"]] == ["0002"]
    assert summary.remains[0].startswith(f"{gone}: ")
    assert f"blob {'e' * 64}.glb is missing" in summary.remains[0]
    assert summary.remains[1].startswith(f"{broken}: ")
    assert "not a readable GLB" in summary.remains[1]


@METHODS
def test_an_empty_scene_is_no_error(method: Released | Default) -> None:
    outcome, summary = optimized(Scene(), method)
    assert {table: len(rows) for table, rows in outcome.rows.items()} == {
        "placements": 0, "supports": 0, "contacts": 0, "optimization_steps": 1, "optimizations": 1, "certificates": 0,
    }  # fmt: skip
    assert (summary.ended, summary.object_count, summary.remains) == ("nothing_to_do", 0, ())


@METHODS
def test_without_a_room_it_is_said_and_done_all_the_same(method: Released | Default) -> None:
    scene = room_scene()
    scene.shells = []
    outcome, summary = optimized(scene, method)
    assert len(outcome.rows["placements"]) == 7
    assert any("no room is known" in text for text in summary.remains)
    assert summary.loss_final == 0.0


@METHODS
@pytest.mark.parametrize("polygon", [((-2, -2), (2, 2), (2, -2), (-2, 2)), ((0, 0), (1, 0), (2, 0)), ((0, 0), (0, 0), (0, 0))])
def test_a_room_that_crosses_itself_or_has_no_area_is_said(method: Released | Default, polygon: Any) -> None:
    scene = Scene(tuple((float(x), float(y)) for x, y in polygon))
    for x in (0.0, 0.3):
        scene.add(block(0.5, 0.5, 0.5), translation([x, 0.0, 0.0]))
    outcome, summary = optimized(scene, method)
    (text,) = summary.remains
    assert "floor_polygon" in text
    assert text in outcome.degradations
    assert (summary.deep_pairs, summary.loss_final) == (0, 0.0)


def test_what_is_far_outside_comes_in() -> None:
    scene = Scene()
    scene.add(block(0.5, 0.5, 0.5), translation([1e6, -1e6, 0.3]))
    outcome, summary = optimized(scene, Default())
    assert bounds(outcome, scene)["0000"] == pytest.approx(np.array([[1.5, -2.0, 0.3], [2.0, -1.5, 0.8]]), abs=1e-6)
    assert collider_bounds(outcome, scene)["0000"][0, 2] == pytest.approx(0.0, abs=1e-6), "it reaches down to the floor"
    assert summary.remains == ()


@pytest.mark.parametrize("values", [{"step_m": 0.0}, {"step_m": -0.05}, {"step_m": float("nan")}, {"max_steps": -1}, {"shift_reach": -1}])
def test_a_method_that_cannot_be_is_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        Released(**values)  # type: ignore[arg-type]
    assert Released(max_steps=0, shift_reach=0).max_steps == 0


@pytest.mark.parametrize("values", [{"cell_m": 0.0}, {"base_m": 0.0}, {"reach_m": -0.1}, {"share": 1.5}, {"rest_quantile": float("nan")}])
def test_supports_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        SupportConfig(**values)  # type: ignore[arg-type]
