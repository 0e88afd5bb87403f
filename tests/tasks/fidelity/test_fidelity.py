"""The fidelity stage on rooms whose figures are known: scans of a replica itself, moved, thinned out and added to."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import trimesh

from schemas.capture import Frame, Instance
from schemas.errors import InputError
from schemas.fidelity import Fidelity, SceneFidelity
from schemas.record import check
from tasks.fidelity import STAGE, FidelityConfig, run
from tasks.fidelity.marked_points import OBJECT, SHELL, UNLABELED, MarkedPoints, dump_marked, read_marked
from tasks.fidelity.replicas import replica_surface
from tasks.geometry.meshes import dump_glb, dump_points
from tasks.geometry.transforms import flat, look_at, translation
from tasks.replica import placed_parts
from tasks.shell import ShellConfig
from tasks.stage import Blobs, Context, Outcome
from tests.replicas import Object, cube, furnished, rows_of
from tests.samples import sample

AT = ("2cm", "5cm", "10cm")
EYES = ((-2.5, -1.5, 1.5), (2.5, -1.5, 1.5), (2.5, 0.6, 1.4), (-2.5, 1.5, 1.6), (0.0, 0.0, 1.5), (0.6, 1.6, 1.3))
CONFIG = FidelityConfig(picture_width=80)
EDGE = 0.5


def frames() -> list[Frame]:
    """A walk along the walls: from each place all ways round, at the height of an eye and down."""
    rows = []
    for eye in EYES:
        for yaw in np.arange(6) * np.pi / 3:
            pose = look_at(eye, np.array(eye) + np.array([np.cos(yaw), np.sin(yaw), -0.5]))
            rows.append(
                sample(
                    Frame, scene_id="demo/room_01", frame_id=f"{len(rows):06d}", width=160, height=120, intrinsics=(75.0, 75.0, 79.5, 59.5),
                    pose=flat(pose),
                )
            )  # fmt: skip
    return rows


Rows = dict[str, list[Any]]


def scan_of(
    objects: Sequence[Object], moved: Callable[[int], np.ndarray] = lambda index: np.eye(4), unlabeled: Sequence[trimesh.Trimesh] = ()
) -> tuple[Rows, Blobs]:
    """A replica of objects, and a scan that shows just that, each object moved by a pose of its own, and what no instance has."""
    rows, blobs = rows_of(objects)
    replica = replica_surface(rows["shells"][0], rows["placements"], rows["assets"], blobs)
    parts: list[trimesh.Trimesh] = []
    for index, instance in enumerate(rows["instances"]):
        own = [part.copy() for part in replica.objects[instance.instance_id]]
        for part in own:
            part.apply_transform(moved(index))
        parts += own
        rows["instances"][index] = dataclasses.replace(instance, mesh_blob=blobs.add(dump_glb(own), "glb"))
    shell = replica.shell.to_trimesh()
    room = sample(
        Instance,
        scene_id="demo/room_01",
        instance_id="0900",
        category="wall",
        is_structure=True,
        mesh_blob=blobs.add(dump_glb([shell]), "glb"),
    )
    rows["instances"].append(room)
    mesh = blobs.add(dump_glb([*parts, shell, *unlabeled]), "glb")
    rows["scenes"] = [dataclasses.replace(rows["scenes"][0], mesh_blob=mesh)]
    return rows | {"frames": frames()}, blobs


def measured(rows: Rows, blobs: Blobs, config: FidelityConfig = CONFIG) -> Outcome:
    """The stage's outcome, its rows checked against their schemas and each other."""
    context = Context("demo/room_01", "fidelity", 0, blobs)
    outcome = run(**{name: rows[name] for name in STAGE.reads}, context=context, config=config)
    check(outcome.rows["fidelity"], Fidelity)
    check(outcome.rows["scene_fidelity"], SceneFidelity)
    for row, prefixes in [*((r, ("",)) for r in outcome.rows["fidelity"]), (scene_of(outcome), ("object_", "shell_"))]:
        for prefix in prefixes:
            for kind in ("completeness", "accuracy", "f"):
                values = figures(row, f"{prefix}{kind}")
                assert len({value is None for value in values}) == 1
                assert None in values or list(values) == sorted(values), "a wider threshold holds no less"
    return outcome


def scene_of(outcome: Outcome) -> SceneFidelity:
    (row,) = outcome.rows["scene_fidelity"]
    return row  # type: ignore[no-any-return]


def figures(row: object, name: str) -> tuple[Any, ...]:
    return tuple(getattr(row, f"{name}_{at}") for at in AT)


ONES = pytest.approx((1.0, 1.0, 1.0), abs=1e-9)


@pytest.mark.parametrize("has_frames", [True, False])
def test_a_scan_of_the_replica_itself_is_wholly_kept(has_frames: bool) -> None:
    rows, blobs = scan_of(furnished())
    rows["frames"] = rows["frames"] if has_frames else []
    outcome = measured(rows, blobs)
    scene = scene_of(outcome)
    assert scene.cameras == ("frames" if has_frames else "virtual")
    assert bool(outcome.degradations) != has_frames
    assert (scene.object_count, scene.placed_count) == (6, 6)
    for prefix in ("object", "shell"):
        for kind in ("completeness", "accuracy", "f"):
            assert figures(scene, f"{prefix}_{kind}") == ONES
    nothing = (scene.unlabeled_area_m2, scene.unexplained_area_m2, scene.unexplained_share, scene.seen_empty_share, scene.in_others_share)
    assert nothing == (0, 0, 0, 0, 0)
    assert scene.object_area_m2 + scene.shell_area_m2 == pytest.approx(scene.scan_area_m2, rel=1e-5)
    assert scene.structural_similarity == pytest.approx(1.0, abs=1e-3)
    assert scene.color_difference == pytest.approx(0.0, abs=0.05)
    assert scene.median_depth_error_m == pytest.approx(0.0, abs=1e-5)
    assert scene.both_seen_share == pytest.approx(1.0)
    rows_by = {row.instance_id: row for row in outcome.rows["fidelity"]}
    assert sorted(rows_by) == ["0001", "0002", "0003", "0004", "0005", "0006"], "no walls among them"
    for row in rows_by.values():
        assert figures(row, "completeness") == ONES
        assert row.visible_area_m2 > 0
        assert figures(row, "accuracy") == ONES
        assert figures(row, "f") == ONES
        assert (row.seen_empty_share, row.in_others_share) == (0, 0)


def test_the_same_rows_in_another_order_give_the_same_rows_and_bytes() -> None:
    rows, blobs = scan_of(furnished())
    outcome = measured(rows, blobs)
    again = measured({name: values[::-1] for name, values in rows.items()}, blobs)
    assert sorted(again.rows["fidelity"], key=lambda row: row.instance_id) == outcome.rows["fidelity"]
    assert again.rows["scene_fidelity"] == outcome.rows["scene_fidelity"]
    assert dict(again.blobs) == dict(outcome.blobs)


def spread(share: float, count: int) -> float:
    """Five standard errors of a share of so many samples."""
    return 5 * float(np.sqrt(max(share * (1 - share), 0.0) / count)) + 2 / count


def test_a_cube_lifted_by_three_centimetres_agrees_as_theory_says() -> None:
    """Of the scanned cube, bottom included, within t = 2 cm of the lifted one: the sides but for the lowest d - t, and a frame
    of width t around the top, beside which the lifted one's sides pass; nothing of the bottom. Of what can be seen of the lifted
    one: the sides but for the highest d - t, and nothing of the top. Within 5 cm: all."""
    lift, near = 0.03, 0.02
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))], lambda index: translation([0, 0, -lift]))
    config = dataclasses.replace(CONFIG, max_samples=40_000, object_samples_per_m2=25_000.0)
    (row,) = measured(rows, blobs, config).rows["fidelity"]
    sides, frame = 4 * EDGE * (EDGE - (lift - near)), EDGE**2 - (EDGE - 2 * near) ** 2
    expected = (sides + frame) / (6 * EDGE**2)
    count = round(25_000 * 6 * EDGE**2)
    assert row.completeness_2cm == pytest.approx(expected, abs=spread(expected, count))
    assert (row.completeness_5cm, row.completeness_10cm) == (1.0, 1.0)
    assert row.visible_area_m2 == pytest.approx(5 * EDGE**2, rel=0.02)
    seen = sides / (5 * EDGE**2)
    assert row.accuracy_2cm == pytest.approx(seen, abs=0.01)
    assert (row.accuracy_5cm, row.accuracy_10cm) == (1.0, 1.0)
    assert row.f_2cm == pytest.approx(2 * expected * seen / (expected + seen), abs=0.01)
    assert row.f_5cm == 1.0
    assert row.seen_empty_share == 0.0, "3 cm are within the margin"


def test_an_asset_in_the_middle_of_an_empty_floor_was_seen_to_be_wrong() -> None:
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))], lambda index: translation([-1.5, -1.0, 0.0]))
    outcome = measured(rows, blobs)
    (row,) = outcome.rows["fidelity"]
    assert figures(row, "completeness") == figures(row, "accuracy") == figures(row, "f") == (0.0, 0.0, 0.0)
    # all of it but the lowest 5 cm, which lie near the scanned floor
    assert row.seen_empty_share == pytest.approx((4 * EDGE * (EDGE - 0.05) + EDGE**2) / (5 * EDGE**2), abs=0.03)
    assert row.in_others_share == 0.0
    scene = scene_of(outcome)
    # nothing is near the scanned cube but the floor: its bottom and the lowest 5 cm of its sides
    assert scene.unexplained_share == pytest.approx((4 * EDGE * (EDGE - 0.05) + EDGE**2) / (6 * EDGE**2), abs=0.03)
    assert figures(scene, "shell_f") == pytest.approx((1, 1, 1), abs=0.02)


def test_assets_that_changed_places_lie_in_each_other() -> None:
    places = [translation([0.5, -0.5, 0.0]), translation([-1.0, -0.5, 0.0])]
    swap = [places[1] @ np.linalg.inv(places[0]), places[0] @ np.linalg.inv(places[1])]
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), place) for place in places], lambda index: swap[index])
    outcome = measured(rows, blobs)
    for row in outcome.rows["fidelity"]:
        assert row.in_others_share == 1.0
        assert row.seen_empty_share == 0.0
        assert row.f_10cm == 0.0
    scene = scene_of(outcome)
    assert figures(scene, "object_f") == ONES, "pooled, all of it stands for something"
    assert scene.in_others_share == 1.0
    assert scene.unexplained_share == 0.0


def test_what_no_asset_stands_for_is_missing_and_unexplained() -> None:
    box = (EDGE, EDGE, EDGE)
    rows, blobs = scan_of([cube(box, translation([0.5, 0.0, 0.0])), cube(box, translation([-1.0, -0.5, 0.0]))])
    rows["placements"] = rows["placements"][:1]
    outcome = measured(rows, blobs)
    kept, lost = outcome.rows["fidelity"]
    assert figures(kept, "f") == ONES
    assert not lost.is_placed
    assert figures(lost, "completeness") == figures(lost, "f") == (0.0, 0.0, 0.0)
    assert figures(lost, "accuracy") == (None, None, None)
    assert (lost.visible_area_m2, lost.seen_empty_share, lost.in_others_share, lost.color_difference) == (None, None, None, None)
    scene = scene_of(outcome)
    assert (scene.object_count, scene.placed_count) == (2, 1)
    assert figures(scene, "object_completeness") == pytest.approx((0.5, 0.5, 0.5))
    assert figures(scene, "object_accuracy") == ONES
    assert figures(scene, "object_f") == pytest.approx((2 / 3,) * 3)
    share = (4 * EDGE * (EDGE - 0.05) + EDGE**2) / (6 * EDGE**2)  # but what is near the floor
    assert scene.unexplained_share == pytest.approx(share / 2, abs=0.02)
    rows["placements"] = []
    empty = scene_of(measured(rows, blobs))
    assert figures(empty, "object_f") == (0.0, 0.0, 0.0)
    assert figures(empty, "object_accuracy") == (None, None, None)


def test_surface_of_no_instance_is_unlabeled_and_unexplained() -> None:
    clutter = trimesh.creation.box((0.4, 0.4, 0.4)).apply_translation([-1.0, -0.5, 0.8])
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))], unlabeled=[clutter])
    outcome = measured(rows, blobs)
    scene = scene_of(outcome)
    assert scene.unlabeled_area_m2 == pytest.approx(clutter.area, rel=0.1)
    assert scene.unexplained_area_m2 == pytest.approx(scene.unlabeled_area_m2)
    assert scene.unexplained_share == pytest.approx(clutter.area / (clutter.area + 6 * EDGE**2), rel=0.1)
    assert figures(scene, "object_f") == ONES
    marked = read_marked(outcome.blobs[scene.distances_blob])
    stray = marked.points[marked.part == UNLABELED]
    assert np.abs(stray - [-1.0, -0.5, 0.8]).max(axis=1) == pytest.approx(0.2, abs=1e-6)
    assert (marked.distance[marked.part == UNLABELED] > 0.05).all()
    assert marked.distance[marked.part != UNLABELED].max() < 1e-5


def test_denser_samples_change_no_figure_much() -> None:
    rows, blobs = scan_of(furnished(), lambda index: translation([0.01 * index, 0.02, 0.01]))
    few = scene_of(measured(rows, blobs))
    many = scene_of(measured(rows, blobs, dataclasses.replace(CONFIG, object_samples_per_m2=4000.0, max_samples=16_000)))
    for kind in ("completeness", "accuracy", "f"):
        assert figures(few, f"object_{kind}") == pytest.approx(figures(many, f"object_{kind}"), abs=0.02)
    assert few.seen_empty_share == pytest.approx(many.seen_empty_share, abs=0.02)


def test_instances_of_points_alone_are_measured_by_them() -> None:
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))])
    (part,) = placed_parts(rows["placements"][0], blobs[rows["assets"][0].mesh_blob])
    points = part.sample(3000, seed=0)
    blob = blobs.add(dump_points(points, np.zeros((3000, 3), np.uint8)), "ply")
    rows["instances"][0] = dataclasses.replace(rows["instances"][0], mesh_blob=None, points_blob=blob)
    outcome = measured(rows, blobs)
    (row,) = outcome.rows["fidelity"]
    assert row.f_5cm == pytest.approx(1.0, abs=0.01)
    assert outcome.degradations == ("0001: it has no faces, its points stand in for them",)


def test_a_scene_without_objects_or_room_is_measured_as_far_as_it_goes() -> None:
    rows, blobs = scan_of([])
    scene = scene_of(measured(rows, blobs))
    assert figures(scene, "object_f") == (None, None, None)
    assert figures(scene, "shell_f") == ONES
    assert scene.unexplained_share is None
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))])
    bare = scene_of(measured(rows | {"shells": [], "frames": []}, blobs))
    assert figures(bare, "object_completeness") == ONES
    assert figures(bare, "shell_completeness") == (0.0, 0.0, 0.0)
    assert figures(bare, "shell_f") == (None, None, None)


def test_what_is_not_there_is_named() -> None:
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))])
    with pytest.raises(InputError, match=r"^demo/room_01: scenes: has no row for this scene; run the capture stage again$"):
        measured(rows | {"scenes": []}, blobs)
    with pytest.raises(InputError, match=r"^demo/room_01: placement 0001: asset [0-9a-f]{12} is not in assets; run the candidates stage"):
        measured(rows | {"assets": []}, blobs)


def test_walls_hide_nothing_from_cameras_behind_them() -> None:
    """A scan of a part of a room, whose outline ends before the cameras: of walls only the far ones were read."""
    rows, blobs = scan_of([cube((EDGE, EDGE, EDGE), translation([0.5, 0.0, 0.0]))])
    (part,) = placed_parts(rows["placements"][0], blobs[rows["assets"][0].mesh_blob])
    corners = [[-2.0, -1.5, 0], [2.0, -1.5, 0], [2.0, 0.9, 0], [-2.0, 0.9, 0]]
    floor = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    rows["scenes"] = [dataclasses.replace(rows["scenes"][0], mesh_blob=blobs.add(dump_glb([part, floor]), "glb"))]
    rows["instances"][-1] = dataclasses.replace(rows["instances"][-1], mesh_blob=blobs.add(dump_glb([floor]), "glb"))
    eyes = [(-4.5, -1.0, 1.5), (4.5, 0.5, 1.5), (0.5, -4.5, 1.5), (2.0, 4.5, 1.5)]
    rows["frames"] = [
        dataclasses.replace(frame, pose=flat(look_at(eye, (0.5, 0, 0.2)))) for eye, frame in zip(eyes, frames(), strict=False)
    ]
    outcome = measured(rows, blobs)
    (row,) = outcome.rows["fidelity"]
    assert row.visible_area_m2 == pytest.approx(5 * EDGE**2, rel=0.02)
    assert figures(row, "f") == ONES
    scene = scene_of(outcome)
    assert scene.cameras == "frames"
    assert scene.mean_depth_error_m == pytest.approx(0.0, abs=1e-5)
    assert figures(scene, "shell_f") == ONES, "nothing was read where there are walls"


def test_backs_of_walls_are_not_the_replica_s_surface() -> None:
    rows, blobs = scan_of([])
    shell = replica_surface(rows["shells"][0], [], [], blobs).shell
    room = rows["shells"][0]
    ring = np.array(room.floor_polygon)
    length = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum()
    walls = shell.vertices[shell.faces][:, :, 2].max(axis=1) > 1.0
    areas = 0.5 * np.linalg.norm(np.cross(*np.diff(shell.vertices[shell.faces], axis=1).transpose(1, 0, 2)), axis=1)
    assert areas[walls].sum() == pytest.approx(length * room.height_m)
    assert shell.vertices[shell.faces][:, :, 2].min() == pytest.approx(0.0)


def test_marked_points_come_back_as_they_went() -> None:
    rng = np.random.default_rng(0)
    marked = MarkedPoints(
        rng.normal(size=(9, 3)).astype(np.float32), np.array([np.inf, *rng.random(8)], np.float32), np.repeat([OBJECT, SHELL, UNLABELED], 3)
    )
    data = dump_marked(marked)
    back = read_marked(data)
    assert np.array_equal(back.points, marked.points)
    assert np.array_equal(back.distance, marked.distance)
    assert np.array_equal(back.part, marked.part)
    for broken in (data[:-1], data[:20], b""):
        with pytest.raises(InputError, match="is not a file of marked points"):
            read_marked(broken)


def test_what_lies_on_unlabeled_surface_is_not_seen_empty_however_few_its_samples() -> None:
    inside = trimesh.creation.box((EDGE - 0.02,) * 3).apply_translation([0.5, 0.0, EDGE / 2])
    rows, blobs = scan_of(
        [cube((EDGE,) * 3, translation([0.5, 0.0, 0.0]))], lambda index: translation([-1.5, -1.0, 0.0]), unlabeled=[inside]
    )
    config = dataclasses.replace(CONFIG, max_room_samples=500, room_samples_per_m2=5.0)
    (row,) = measured(rows, blobs, config).rows["fidelity"]
    assert row.visible_area_m2 == pytest.approx(5 * EDGE**2, rel=0.05)
    assert row.seen_empty_share == 0.0


@pytest.mark.parametrize("depth", [0.01, 0.05, 0.1, 0.3, 0.46])
@pytest.mark.parametrize("turned", [False, True])
def test_the_back_of_a_niche_is_seen_however_deep_it_is(depth: float, turned: bool) -> None:
    """A door in the wall at y = -2: of the shell, beside floor and walls, the panel's front."""
    left, right, top = (1.0, 0.2, 2.0) if turned else (0.2, 1.0, 2.0)
    rows, blobs = rows_of([])
    room = dataclasses.replace(rows["shells"][0], openings=((left, -2.0, right, -2.0, 0.0, top, depth),))
    shell = replica_surface(room, [], [], blobs).shell
    triangles = shell.vertices[shell.faces]
    front = max(depth, ShellConfig().thickness_m - ShellConfig().panel_m)
    back = triangles[np.abs(triangles[..., 1] - (-2.0 - front)).max(axis=1) < 1e-9]
    crosses = np.cross(back[:, 1] - back[:, 0], back[:, 2] - back[:, 0])
    assert (crosses[:, 1] > 0).all(), "it looks into the room"
    assert np.abs(crosses[:, 1]).sum() / 2 == pytest.approx(0.8 * top)
    walls = triangles[np.ptp(triangles[..., 2], axis=1) > 1e-9]
    assert set(walls[..., 1].min(axis=1).round(6)) == {round(-2.0 - front, 6), -2.0, 1.0, 2.0}, "no frame behind the wall"


def test_the_outside_of_a_wall_is_not_seen_across_a_thin_one() -> None:
    """Two arms of a room, 14 cm apart: each wall between ends 4 cm before the other arm."""
    rows, blobs = rows_of([])
    ring = ((-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (0.14, 2.0), (0.14, 0.0), (0.0, 0.0), (0.0, 2.0), (-3.0, 2.0))
    shell = replica_surface(dataclasses.replace(rows["shells"][0], floor_polygon=ring), [], [], blobs).shell
    triangles = shell.vertices[shell.faces]
    between = triangles[
        ((triangles[..., 0] > -0.001) & (triangles[..., 0] < 0.141)).all(axis=1) & (np.ptp(triangles[..., 0], axis=1) < 1e-9)
    ]
    assert set(between[..., 0].ravel().round(6)) == {0.0, 0.14}
