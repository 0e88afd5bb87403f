"""Pictures of scenes: cameras, what is cut away, what collides; and thumbnails."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from schemas.capture import Shell
from schemas.optimization import Contact
from tasks.geometry.meshes import load_glb
from tasks.geometry.rendering import Camera, RayScene
from tasks.shell import room_shell
from tasks.stats import collisions, photographs, scenes, thumbnails
from tasks.stats.scenes import PictureConfig, RoomOutline
from tests.furnished import HEIGHT, solid
from tests.samples import sample

SMALL = PictureConfig(width=120, height=84, oversampling=1)


def outline(width: float, depth: float, height: float = HEIGHT) -> RoomOutline:
    return RoomOutline(np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]]), height)


@given(
    width=st.floats(1.0, 25.0), depth=st.floats(1.0, 25.0), height=st.floats(2.0, 5.0), corner=st.integers(-1, 3), x=st.floats(-50, 50)
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_cameras_see_the_whole_room_and_little_else(width: float, depth: float, height: float, corner: int, x: float) -> None:
    room = RoomOutline(outline(width, depth).ring + np.array([x, -x]), height)
    config = PictureConfig()
    camera = scenes.top_camera(room, config) if corner < 0 else scenes.corner_camera(room, corner, config)
    pixels, depths = camera.project(room.corners)
    assert (depths > 0).all()
    size = np.array([config.width, config.height])
    assert (pixels >= -0.5).all()
    assert (pixels <= size - 0.5).all()
    used = np.ptp(pixels, axis=0) / size
    assert used.max() > 0.9  # the room fills the picture along one of its sides
    assert np.allclose(pixels.max(axis=0) + pixels.min(axis=0), size - 1, atol=0.03 * size.max())  # and is in its middle
    assert np.allclose(camera.pose[:3, :3] @ camera.pose[:3, :3].T, np.eye(3))
    if corner >= 0:
        assert camera.pose[2, 3] > height / 2


def test_the_long_side_of_a_room_lies_across_the_top_view() -> None:
    for width, depth in ((8.0, 3.0), (3.0, 8.0)):
        room = outline(width, depth)
        pixels, _ = scenes.top_camera(room, PictureConfig()).project(room.corners)
        spread = np.ptp(pixels, axis=0)
        assert spread[0] > 1.5 * spread[1]


@given(width=st.floats(2.0, 12.0), depth=st.floats(2.0, 12.0), corner=st.integers(0, 3), turn=st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_the_cut_opens_the_view_on_the_whole_floor(width: float, depth: float, corner: int, turn: int) -> None:
    ring = np.roll(outline(width, depth).ring, turn, axis=0)
    room = sample(Shell, scene_id="demo/a", floor_polygon=tuple(map(tuple, ring.tolist())), interior_walls=(), height_m=HEIGHT)
    ceiling = trimesh.creation.box(bounds=[[0, 0, HEIGHT], [width, depth, HEIGHT + 0.05]])
    parts = [mesh for _, mesh in room_shell(room)] + [ceiling]
    shape = RoomOutline.of_room(room)
    camera = scenes.corner_camera(shape, corner, SMALL)
    grid = np.stack(np.meshgrid(np.linspace(0.2, width - 0.2, 7), np.linspace(0.2, depth - 0.2, 7)), axis=-1).reshape(-1, 2)
    floor = np.column_stack([grid, np.zeros(len(grid))])
    eye = camera.pose[:3, 3]
    rays = np.concatenate([np.broadcast_to(eye, floor.shape), floor - eye], axis=1).astype(np.float32)
    hidden = RayScene(parts).cast(rays)["t_hit"] < 0.99
    assert hidden.all()  # by ceiling or walls
    kept = scenes.opened(parts, shape, camera, SMALL)
    seen = RayScene(kept).cast(rays)["t_hit"]
    assert np.allclose(seen, 1.0, atol=1e-3)
    heights = np.concatenate([mesh.vertices[np.unique(mesh.faces)] for mesh in kept])[:, 2]
    assert heights.max() == pytest.approx(HEIGHT)  # the walls behind stand


def test_the_cut_leaves_furniture_alone() -> None:
    mesh = solid(1)
    mesh.apply_translation([2.0, 1.5, 0.0])
    room = outline(4.0, 3.0)
    kept = scenes.opened([mesh], room, scenes.corner_camera(room, 2, SMALL), SMALL)
    assert kept == [mesh]


def test_what_hangs_on_a_cut_wall_goes_with_it_and_what_stands_before_it_stays_whole() -> None:
    room = outline(4.0, 3.0)
    camera = scenes.corner_camera(room, 2, SMALL)  # beyond x = 0 and y = 0

    def box(*bounds: list[float]) -> trimesh.Trimesh:
        return trimesh.creation.box(bounds=bounds)

    frame = [box([0.0, 1.0, 1.2], [0.04, 1.8, 1.8]), box([0.04, 1.1, 1.3], [0.14, 1.7, 1.7])]
    across = [part.copy().apply_translation([3.86, 0.0, 0.0]) for part in frame]
    shelf = [box([0.0, 2.0, 0.0], [0.05, 2.9, 2.0]), box([0.05, 2.0, 0.9], [0.2, 2.9, 0.95])]
    assert scenes.shown([frame, across, shelf], room, camera, SMALL) == [*across, *shelf]


def test_scan_and_replica_of_the_same_parts_are_the_same_picture_and_differ_when_something_is_missing() -> None:
    mesh = solid(0)
    mesh.apply_translation([2.0, 1.5, 0.0])
    ring = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))
    room = sample(Shell, scene_id="demo/a", floor_polygon=ring, interior_walls=(), height_m=HEIGHT)
    shell = [part for _, part in room_shell(room)]
    same = scenes.picture_scene([*shell, mesh], shell, [[mesh]], RoomOutline.of_room(room), SMALL)
    assert same.corner_scan == same.corner_replica
    assert same.top_scan == same.top_replica
    other = scenes.picture_scene([*shell, mesh], shell, [], RoomOutline.of_room(room), SMALL)
    assert other.corner_scan != other.corner_replica
    assert dataclasses.astuple(same) == dataclasses.astuple(
        scenes.picture_scene([*shell, mesh], shell, [[mesh]], RoomOutline.of_room(room), SMALL)
    )


def test_the_corner_is_the_one_from_which_the_furniture_is_seen() -> None:
    # a high screen before the far corner hides what stands behind it from the two corners on this side
    room = outline(5.0, 5.0)
    lamp = solid(2)
    lamp.apply_translation([4.3, 4.3, 0.0])
    screens = [
        trimesh.creation.box(bounds=[[3.6, 3.5, 0], [5.0, 3.6, 2.2]]),
        trimesh.creation.box(bounds=[[3.5, 3.5, 0], [3.6, 5.0, 2.2]]),
    ]
    camera = scenes.best_corner([[lamp]], screens, room, PictureConfig())
    assert camera.pose[0, 3] > 5.0
    assert camera.pose[1, 3] > 5.0


def cube(low: tuple[float, float, float], size: float = 1.0) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, np.add(low, size)])


@given(shift=st.tuples(*[st.floats(0.1, 0.9)] * 3), at=st.floats(-20, 20))
@settings(max_examples=40, deadline=None)
def test_two_objects_overlap_where_their_surfaces_cut_each_other(shift: tuple[float, float, float], at: float) -> None:
    first, second = cube((at, -at, 0.0)), cube((at + shift[0], shift[1] - at, shift[2]))
    place, turned = collisions.overlap_place([first], [second]), collisions.overlap_place([second], [first])
    low, high = second.bounds[0], first.bounds[1]
    # of corners that overlap, the cut runs around all of the overlap's box
    assert np.allclose(place.center, (low + high) / 2, atol=0.02)
    assert place.radius == pytest.approx(np.linalg.norm(high - low) / 2, abs=0.04)
    assert np.allclose(place.center, turned.center, atol=0.01)


def test_an_object_wholly_inside_another_overlaps_where_it_is_and_objects_apart_between_them() -> None:
    inside = collisions.overlap_place([cube((0, 0, 0))], [cube((0.6, 0.2, 0.3), 0.2)])
    assert np.allclose(inside.center, (0.7, 0.3, 0.4))
    apart = collisions.overlap_place([cube((0, 0, 0))], [cube((1.5, 0, 0))])
    assert np.allclose(apart.center, (1.25, 0.5, 0.5))


def marked(objects: dict[str, list[trimesh.Trimesh]], pairs: list[tuple[str, str]], corner: int = 0) -> tuple[np.ndarray, Camera]:
    """A marked picture of a room of 4 x 3 m as RGB, and the camera it was taken with."""
    config = dataclasses.replace(SMALL, width=400, height=280, jpeg_quality=95)
    ring = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))
    room = sample(Shell, scene_id="demo/a", floor_polygon=ring, interior_walls=(), height_m=HEIGHT)
    shell = {name: [part] for name, part in room_shell(room)}
    camera = scenes.corner_camera(RoomOutline.of_room(room), corner, config)
    file = collisions.marked_picture(objects, shell, pairs, RoomOutline.of_room(room), camera, config)
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"), dtype=np.int64), camera


def red(image: np.ndarray) -> np.ndarray:
    return np.asarray(image[..., 0] - image[..., 1:].max(axis=2) > 50)


def test_only_what_collides_is_tinted_and_a_ring_lies_where_it_overlaps() -> None:
    objects = {"0000": [cube((1.0, 1.0, 0.0), 0.6)], "0001": [cube((1.5, 1.2, 0.0), 0.6)], "0002": [cube((3.0, 2.0, 0.0), 0.6)]}
    plain, camera = marked(objects, [])
    shown, _ = marked(objects, [("0000", "0001")])
    assert not red(plain).any()
    tinted = red(shown)
    place = collisions.overlap_place(objects["0000"], objects["0001"])
    (center,), _ = camera.project(place.center[None])
    rows, columns = np.nonzero(tinted)
    assert np.hypot(columns - center[0], rows - center[1]).max() < 90
    for name, is_tinted in (("0000", True), ("0001", True), ("0002", False)):
        middle, _ = camera.project(objects[name][0].bounds.mean(axis=0)[None])
        column, row = np.round(middle[0]).astype(int)
        assert tinted[row, column] == is_tinted, name
    # white of the halo, all around
    white = (shown.min(axis=2) > 235) & (plain.min(axis=2) < 225)
    angles = np.arctan2(*(np.argwhere(white) - center[::-1]).T)
    assert set(np.floor(angles / (np.pi / 4)).astype(int)) >= set(range(-4, 4))
    far = np.hypot(*(np.indices(tinted.shape) - center[::-1, None, None])) > 100
    assert np.abs(shown - plain)[far].max() <= 12  # JPEG


def test_what_collides_is_shown_where_its_wall_is_cut_away() -> None:
    # a picture on the wall at x = 0, which the camera beyond that wall looks through
    objects = {"0000": [trimesh.creation.box(bounds=[[0.0, 1.0, 1.2], [0.04, 1.8, 1.8]])]}
    assert not red(marked(objects, [], corner=2)[0]).any()
    assert red(marked(objects, [("0000", "wall_03")], corner=2)[0]).sum() > 200


def test_an_object_that_is_nowhere_costs_its_own_place_in_the_picture_only() -> None:
    lost = cube((2.0, 2.0, 0.0), 0.5)
    lost.vertices[0] = np.nan
    objects = {"0000": [cube((1.0, 1.0, 0.0), 0.6)]}
    assert (marked({**objects, "0001": [lost]}, [("0000", "0001")])[0] == marked(objects, [("0000", "0001")])[0]).all()


def test_pairs_that_collide_are_deeper_than_2_mm_and_not_allowed() -> None:
    contacts = [
        sample(Contact, scene_id="demo/a", phase=phase, instance_a="0000", body_b=body, penetration_m=depth, is_allowed=allowed)
        for phase, body, depth, allowed in (
            ("proposed", "wall_00", 0.01, False), ("proposed", "0001", 0.0021, False), ("proposed", "0002", 0.002, False),
            ("proposed", "wall_01", 0.5, True), ("optimized", "0003", 0.01, False),
        )
    ]  # fmt: skip
    assert collisions.colliding_pairs(contacts, "proposed") == [("0000", "0001"), ("0000", "wall_00")]
    assert collisions.colliding_pairs(contacts, "optimized") == [("0000", "0003")]


@pytest.mark.whole
def test_a_real_house_is_pictured_from_above_and_opened(realdata: Callable[[str], Path]) -> None:
    parts = load_glb(realdata("scene_aws_small_house/house.glb").read_bytes())
    shape = RoomOutline.of_parts(parts)
    (x0, y0), (x1, y1) = shape.ring.min(axis=0), shape.ring.max(axis=0)
    parts.append(trimesh.creation.box(bounds=[[x0, y0, shape.height - 0.05], [x1, y1, shape.height]]))  # the model has no ceiling
    camera = scenes.top_camera(shape, SMALL)
    closed, view = RayScene(parts).render(camera), RayScene(scenes.opened(parts, shape, camera, SMALL)).render(camera)
    floor = (view.depth > camera.pose[2, 3] - 0.05) & np.isfinite(view.depth)
    covered = (closed.depth > camera.pose[2, 3] - 0.05) & np.isfinite(closed.depth)
    assert floor.sum() > 1.5 * covered.sum()
    image = np.asarray(Image.open(io.BytesIO(scenes.render(scenes.opened(parts, shape, camera, SMALL), camera, SMALL))))
    assert image.shape == (SMALL.height, SMALL.width, 3)
    assert image[np.isfinite(view.depth)].std() > 20  # furniture, not one flat color


def jpeg(image: np.ndarray) -> bytes:
    made = io.BytesIO()
    Image.fromarray(image.astype(np.uint8)).save(made, "JPEG", quality=95)
    return made.getvalue()


def pixels(file: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"), dtype=np.int64)


@pytest.mark.whole
@given(left=st.integers(0, 500), top=st.integers(0, 350), width=st.integers(150, 300), height=st.integers(150, 200))
@settings(max_examples=30, deadline=None)
def test_a_tile_is_cut_to_what_its_pictures_show(left: int, top: int, width: int, height: int) -> None:
    empty = np.tile(np.array(PictureConfig.background), (560, 800, 1))
    scan, replica = empty.copy(), empty.copy()
    scan[top : top + height, left : left + width] = (200, 30, 30)
    replica[top : top + height // 2, left : left + width] = (30, 30, 200)
    tile = thumbnails.scene_tile("demo/a", (jpeg(scan), jpeg(replica)))
    shown = [pixels(file) for file in (tile.scan, tile.replica) if file is not None]
    assert [image.shape for image in shown] == [(thumbnails.SCENE_PX[1], thumbnails.SCENE_PX[0], 3)] * 2
    red, blue = shown[0][..., 0] - shown[0][..., 2] > 100, shown[1][..., 2] - shown[1][..., 0] > 100
    # whole and as large as it goes along one side, in both pictures at one place and scale
    used = np.array(
        [np.ptp(np.flatnonzero(red.any(axis=0))) / thumbnails.SCENE_PX[0], np.ptp(np.flatnonzero(red.any(axis=1))) / thumbnails.SCENE_PX[1]]
    )
    assert 0.9 < used.max() < 0.99
    assert used[0] / used[1] * thumbnails.SCENE_PX[0] / thumbnails.SCENE_PX[1] == pytest.approx(width / height, rel=0.06)
    assert blue.sum() == pytest.approx(red.sum() / 2, rel=0.06)


def test_a_scene_without_pictures_says_why() -> None:
    assert thumbnails.scene_tile("demo/a", "cannot be read") == thumbnails.SceneTile("demo/a", None, None, "cannot be read")


def covered(file: bytes) -> np.ndarray:
    return np.asarray(np.abs(pixels(file) - PictureConfig.background).max(axis=2) > 30)


@pytest.mark.parametrize("size", [0.01, 1.0, 30.0])
def test_an_object_fills_its_thumbnail_however_large_it_is(size: float) -> None:
    box = trimesh.creation.box((size, 0.6 * size, 0.8 * size))
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=np.tile([150, 60, 30, 255], (8, 1)).astype(np.uint8))
    seen = covered(thumbnails.object_thumbnail([box]))
    assert seen.shape == (thumbnails.OBJECT_PX, thumbnails.OBJECT_PX)
    assert max(np.ptp(np.flatnonzero(seen.any(axis=axis))) for axis in (0, 1)) > 0.9 * thumbnails.OBJECT_PX
    assert not seen[[0, -1]].any()
    assert not seen[:, [0, -1]].any()


def test_a_thumbnail_shows_scale_and_turn_of_what_was_placed() -> None:
    box = trimesh.creation.box((0.5, 0.5, 0.5))
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=np.tile([150, 60, 30, 255], (8, 1)).astype(np.uint8))

    def proportion(scale: tuple[float, float, float], turn: np.ndarray) -> float:
        seen = covered(thumbnails.object_thumbnail([box], scale, turn))
        return float(np.ptp(np.flatnonzero(seen.any(axis=0))) / np.ptp(np.flatnonzero(seen.any(axis=1))))

    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert proportion((1.0, 1.0, 3.0), np.eye(3)) < 0.6
    wide = proportion((1.0, 3.0, 1.0), np.eye(3))  # across the view
    assert wide > 1.4
    assert proportion((3.0, 1.0, 1.0), quarter) == pytest.approx(wide, rel=0.02)
    assert np.allclose(box.bounds, [[-0.25] * 3, [0.25] * 3])  # the mesh itself stays


def test_a_crop_of_any_shape_fits_without_being_cut_or_stretched() -> None:
    crop = np.zeros((40, 100, 3))
    crop[:, :50], crop[:, 50:] = (200, 30, 30), (30, 30, 200)
    made = pixels(thumbnails.fitted(jpeg(crop), (132, 132)))
    assert made.shape == (132, 132, 3)
    red, blue = (made[..., 0] - made[..., 2] > 100), (made[..., 2] - made[..., 0] > 100)
    assert red.sum() == pytest.approx(66 * 52.8, rel=0.06)
    assert blue.sum() == pytest.approx(66 * 52.8, rel=0.06)
    with pytest.raises(OSError, match="identify"):
        thumbnails.fitted(b"no image", (10, 10))


@pytest.mark.parametrize("factor", [2, 3])
def test_a_photograph_is_as_smooth_as_one_with_all_rays_at_half_of_them(factor: int, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = [(1.0, 0.6, 0.5), (0.03, 0.03, 1.8), (3.8, 3.8, 0.02)]  # an object, a thin one, a floor
    parts = [trimesh.creation.box(size) for size in sizes]
    for part, color, place in zip(parts, (70, 180, 120), ([2.0, 1.6, 0.3], [1.0, 2.0, 0.9], [2.0, 2.0, 0.0]), strict=True):
        part.apply_translation(place).visual.vertex_colors = [color, 90, 200 - color, 255]
    config = PictureConfig(width=240, height=168, oversampling=factor)
    camera = scenes.corner_camera(outline(4.0, 4.0), 0, config)
    cast: list[int] = []
    casting = RayScene.cast

    def counted(scene: RayScene, rays: np.ndarray) -> dict[str, np.ndarray]:
        cast.append(rays.size // 6)
        return casting(scene, rays)

    monkeypatch.setattr(RayScene, "cast", counted)
    image = photographs.photograph(parts, camera, config)
    assert sum(cast) < 0.5 * factor**2 * config.width * config.height
    fine = Camera(
        camera.pose,
        camera.fx * factor,
        camera.fy * factor,
        (camera.cx + 0.5) * factor - 0.5,
        (camera.cy + 0.5) * factor - 0.5,
        camera.width * factor,
        camera.height * factor,
    )
    every = photographs.photograph(parts, fine, dataclasses.replace(config, oversampling=1))
    every = every.reshape(config.height, factor, config.width, factor, 3).mean(axis=(1, 3))
    difference = np.abs(image - every)
    assert difference.mean() < 0.5  # of 255
    assert (difference.max(axis=2) > 24).mean() < 0.002
    single = photographs.photograph(parts, camera, dataclasses.replace(config, oversampling=1))
    assert difference.mean() < 0.5 * np.abs(single - every).mean()
