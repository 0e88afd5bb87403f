"""Charts, scene pictures and the report."""

from __future__ import annotations

import dataclasses
import io
import itertools
import math
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.stats import STAGES, answers_of, draw_charts, picture_scene_of, stage_table, write_report
from schemas.capture import Room
from schemas.errors import InputError
from schemas.optimization import Contact, Placement
from tasks.meshes import load_glb
from tasks.rendering import Camera, RayScene
from tasks.replica import room_shell
from tasks.stats import charts, collisions, grids, scenes, words
from tasks.stats.scenes import Outline, PictureConfig
from tasks.stats.style import GRID, INK, MUTED, PAPER, SERIES, Tone
from tasks.transforms import matrix
from tests.furnished import HEIGHT, furnished_lake, solid
from tests.samples import sample
from warehouse.lake import Lake
from warehouse.views import listing

CHARTS = 10
"""Charts over all scenes of a lake in which there is something of everything."""
SMALL = PictureConfig(width=120, height=84, oversampling=1)


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return furnished_lake(tmp_path_factory.mktemp("furnished") / "lake")


@pytest.fixture(scope="module")
def report(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    return write_report(lake, folder / "report.html", pictures=folder / "pictures", look=SMALL, workers=1)


def luminance(color: str) -> float:
    """Relative luminance of a color `#rrggbb` (WCAG 2.2)."""
    channels = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, second: str) -> float:
    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("tone", [INK, MUTED, *SERIES], ids=lambda tone: tone.role)
def test_colors_can_be_read_on_light_and_on_dark_paper(tone: Tone) -> None:
    assert contrast(tone.light, PAPER.light) >= 4.5
    assert contrast(tone.dark, PAPER.dark) >= 4.5


def test_roles_and_colors_are_distinct() -> None:
    tones = (INK, MUTED, GRID, PAPER, *SERIES)
    for field in ("role", "light", "dark"):
        assert len({getattr(tone, field) for tone in tones}) == len(tones)


def many_boxes(count: int) -> tuple[pa.Table, pa.Table]:
    """Rows of `volume_by_category` and `volume_outliers`, most frequent first, the smallest of volume zero."""
    boxes = [
        {
            "frequency_rank": rank, "category": f"category {rank}", "objects": 100 - rank,
            "whisker_low_m3": 0.0 if rank == 1 else 0.001 * rank, "q1_m3": 0.002 * rank, "median_m3": 0.003 * rank,
            "q3_m3": 0.004 * rank, "whisker_high_m3": 0.006 * rank,
        }
        for rank in range(1, count + 1)
    ]  # fmt: skip
    outliers = [{"category": f"category {rank}", "box_volume_m3": 2.0 * rank} for rank in range(1, count + 1)]
    return pa.Table.from_pylist(boxes), pa.Table.from_pylist(outliers)


def texts(svg: str) -> list[str]:
    """Text elements of an SVG that is well-formed."""
    root = ET.fromstring(svg)
    return ["".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text")]


def test_the_box_plot_shows_the_fifty_most_frequent_categories_on_a_logarithmic_axis() -> None:
    drawn = charts.volume_boxes(*many_boxes(53))
    assert drawn is not None
    labels = texts(drawn.svg)
    assert [label for label in labels if label.startswith("category")] == [f"category {n} ({100 - n})" for n in range(1, 51)]
    ticks = [float(label) for label in labels if re.fullmatch(r"[0-9.]+", label)]
    steps = {round(math.log10(b / a), 6) for a, b in itertools.pairwise(ticks)}
    assert len(ticks) >= 3
    assert steps == {1.0}


def test_a_narrow_volume_axis_still_has_ticks() -> None:
    boxes = pa.Table.from_pylist(
        [
            {
                "frequency_rank": 1, "category": "mug", "objects": 3, "whisker_low_m3": 0.24, "q1_m3": 0.3, "median_m3": 0.4,
                "q3_m3": 0.5, "whisker_high_m3": 0.9,
            }
        ]
    )  # fmt: skip
    drawn = charts.volume_boxes(boxes, pa.table({"category": pa.array([], pa.string()), "box_volume_m3": pa.array([], pa.float64())}))
    assert drawn is not None
    assert sum(bool(re.fullmatch(r"[0-9.]+", label)) for label in texts(drawn.svg)) >= 2


@given(counts=st.lists(st.integers(0, 500), min_size=charts.SCENE_LIMIT + 1, max_size=60))
@settings(max_examples=15, deadline=None)
def test_the_histogram_counts_every_scene_once(counts: list[int]) -> None:
    edges = charts._integer_bins(np.array(counts))
    histogram, _ = np.histogram(counts, edges)
    assert histogram.sum() == len(counts)
    assert len(edges) <= 22
    assert np.allclose(edges % 1, 0.5)  # no whole number lies on an edge


def test_few_scenes_get_a_bar_each_and_many_a_histogram() -> None:
    def labels(count: int) -> list[str]:
        rows = pa.table({"scene_id": [f"demo/{n:03d}" for n in range(count)], "objects": list(range(count))})
        drawn = charts.per_scene(rows, "objects", "objects")
        assert drawn is not None
        return [label for label in texts(drawn.svg) if label.startswith("demo/")]

    assert len(labels(charts.SCENE_LIMIT)) == charts.SCENE_LIMIT
    assert labels(charts.SCENE_LIMIT + 1) == []


def test_charts_of_a_lake_are_named_after_views_and_the_same_twice(lake: Lake) -> None:
    answers = answers_of(lake.snapshot())
    drawn, again = draw_charts(answers), draw_charts(answers)
    assert drawn == again
    assert len(drawn) == CHARTS
    assert {chart.name for chart in drawn} <= {name for name, _ in listing()}
    for chart in drawn:
        assert chart.png.startswith(b"\x89PNG")
        assert texts(chart.svg)
        assert "prefers-color-scheme: dark" in chart.svg
        assert INK.light not in chart.svg.partition("</style>")[2]  # all colors are variables
        assert chart.alt.endswith(".")
        assert not re.search(rb"tIME|date:|Software", chart.png)


def test_an_empty_lake_has_nothing_to_draw(tmp_path: Path) -> None:
    reader = Lake.open(tmp_path / "none").snapshot()
    assert draw_charts(answers_of(reader)) == []
    assert stage_table(reader) == "no stage has run"


def test_the_word_cloud_holds_every_category_larger_when_more_frequent() -> None:
    counts = {"chair": 50, "mug & <saucer>": 20, "lamp": 5, " ": 3, "gone": 0}
    cloud = words.word_cloud(counts)
    assert cloud is not None
    root = ET.fromstring(cloud.svg)
    sizes = {"".join(node.itertext()): int(node.attrib["font-size"]) for node in root.iter("{http://www.w3.org/2000/svg}text")}
    assert sizes.keys() == {"chair", "mug & <saucer>", "lamp"}
    assert sizes["chair"] > sizes["mug & <saucer>"] > sizes["lamp"]
    assert cloud == words.word_cloud(dict(reversed(counts.items())))
    assert words.word_cloud({}) is None


def test_equally_frequent_categories_are_equally_large() -> None:
    cloud = words.word_cloud({f"category {n}": 3 if n < 20 else 1 for n in range(40)})
    assert cloud is not None
    root = ET.fromstring(cloud.svg)
    sizes = {"".join(node.itertext()): node.attrib["font-size"] for node in root.iter("{http://www.w3.org/2000/svg}text")}
    assert len(sizes) == 40
    assert len({sizes[f"category {n}"] for n in range(20)}) == len({sizes[f"category {n}"] for n in range(20, 40)}) == 1


def outline(width: float, depth: float, height: float = HEIGHT) -> Outline:
    return Outline(np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]]), height)


@given(
    width=st.floats(1.0, 25.0), depth=st.floats(1.0, 25.0), height=st.floats(2.0, 5.0), corner=st.integers(-1, 3), x=st.floats(-50, 50)
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_cameras_see_the_whole_room_and_little_else(width: float, depth: float, height: float, corner: int, x: float) -> None:
    room = Outline(outline(width, depth).ring + np.array([x, -x]), height)
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
    room = sample(Room, scene_id="demo/a", floor_polygon=tuple(map(tuple, ring.tolist())), interior_walls=(), height_m=HEIGHT)
    ceiling = trimesh.creation.box(bounds=[[0, 0, HEIGHT], [width, depth, HEIGHT + 0.05]])
    parts = [mesh for _, mesh in room_shell(room)] + [ceiling]
    shape = Outline.of_room(room)
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
    room = sample(Room, scene_id="demo/a", floor_polygon=ring, interior_walls=(), height_m=HEIGHT)
    shell = [part for _, part in room_shell(room)]
    same = scenes.picture_scene([*shell, mesh], shell, [[mesh]], Outline.of_room(room), SMALL)
    assert same.corner_scan == same.corner_replica
    assert same.top_scan == same.top_replica
    other = scenes.picture_scene([*shell, mesh], shell, [], Outline.of_room(room), SMALL)
    assert other.corner_scan != other.corner_replica
    assert dataclasses.astuple(same) == dataclasses.astuple(
        scenes.picture_scene([*shell, mesh], shell, [[mesh]], Outline.of_room(room), SMALL)
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
def test_two_things_overlap_where_their_surfaces_cut_each_other(shift: tuple[float, float, float], at: float) -> None:
    first, second = cube((at, -at, 0.0)), cube((at + shift[0], shift[1] - at, shift[2]))
    place, turned = collisions.overlap_place([first], [second]), collisions.overlap_place([second], [first])
    low, high = second.bounds[0], first.bounds[1]
    # of corners that overlap, the cut runs around all of the overlap's box
    assert np.allclose(place.center, (low + high) / 2, atol=0.02)
    assert place.radius == pytest.approx(np.linalg.norm(high - low) / 2, abs=0.04)
    assert np.allclose(place.center, turned.center, atol=0.01)


def test_a_thing_wholly_inside_another_overlaps_where_it_is_and_things_apart_between_them() -> None:
    inside = collisions.overlap_place([cube((0, 0, 0))], [cube((0.6, 0.2, 0.3), 0.2)])
    assert np.allclose(inside.center, (0.7, 0.3, 0.4))
    apart = collisions.overlap_place([cube((0, 0, 0))], [cube((1.5, 0, 0))])
    assert np.allclose(apart.center, (1.25, 0.5, 0.5))


def marked(objects: dict[str, list[trimesh.Trimesh]], pairs: list[tuple[str, str]], corner: int = 0) -> tuple[np.ndarray, Camera]:
    """A marked picture of a room of 4 x 3 m as RGB, and the camera it was taken with."""
    from PIL import Image

    config = dataclasses.replace(SMALL, width=400, height=280, jpeg_quality=95)
    ring = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))
    room = sample(Room, scene_id="demo/a", floor_polygon=ring, interior_walls=(), height_m=HEIGHT)
    shell = {name: [part] for name, part in room_shell(room)}
    camera = scenes.corner_camera(Outline.of_room(room), corner, config)
    file = collisions.marked_picture(objects, shell, pairs, Outline.of_room(room), camera, config)
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


def test_a_thing_that_is_nowhere_costs_its_own_place_in_the_picture_only() -> None:
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


def test_the_loss_curve_of_many_steps_is_small_and_says_start_and_end() -> None:
    rng = np.random.default_rng(0)
    loss = np.concatenate([[0.5], rng.random(9999) * 0.4 + 0.1, [0.0]])
    steps = pa.table({"step": range(len(loss)), "loss": loss, "smallest_loss": np.minimum.accumulate(loss)})
    drawn = charts.loss_curve(steps, "paper", "demo/a")
    assert drawn is not None
    assert drawn == charts.loss_curve(steps.take(rng.permutation(len(loss))), "paper", "demo/a")
    assert len(drawn.svg) < 40_000
    assert "500 l at the start, 0 l in the end" in drawn.alt
    assert "0" in texts(drawn.svg)  # the axis reaches zero
    assert any("[l]" in text for text in texts(drawn.svg))
    in_depth = charts.loss_curve(steps.slice(0, 3), "default", "demo/a")
    assert in_depth is not None
    assert any("[mm]" in text for text in texts(in_depth.svg))
    assert charts.loss_curve(steps.slice(0, 0), "paper", "demo/a") is None


def test_a_share_says_all_or_none_only_when_it_is() -> None:
    assert [grids.as_share(share) for share in (1.0, 0.9999, 0.985, 1 / 6, 0.0001, 0.0)] == [
        "100%",
        "99.9%",
        "98.5%",
        "16.7%",
        "0.1%",
        "0%",
    ]


def test_a_real_house_is_pictured_from_above_and_opened(realdata: Callable[[str], Path]) -> None:
    from PIL import Image

    parts = load_glb(realdata("scene_aws_small_house/house.glb").read_bytes())
    shape = Outline.of_parts(parts)
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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/home/me/scans/scene0001_00/scene0001_00.txt: axisAlignment: bad", "scene0001_00.txt: axisAlignment: bad"),
        ("cannot read '/tmp/x y/lake/a.glb'", "cannot read 'a.glb'"),
        ("file:///srv/data/a.ply", "a.ply"),
        (r"C:\Users\me\scan\a.txt: gone", "a.txt: gone"),
        ("scannet/scene0001_00: 3/4 frames, 0.5 kg/m3, and/or", "scannet/scene0001_00: 3/4 frames, 0.5 kg/m3, and/or"),
        ("https://example.org/a/b.glb", "https://example.org/a/b.glb"),
    ],
)
def test_reports_name_files_without_their_folders(text: str, expected: str) -> None:
    assert grids.portable(text) == expected


@given(value=st.floats(1e-5, 1e7))
@settings(deadline=None)
def test_numbers_keep_three_digits(value: float) -> None:
    text = grids.as_number(value).replace("\u202f", "")
    assert "e" not in text
    assert float(text) == pytest.approx(value, rel=0.006 if value >= 1e-4 else 0.06)


class Page(HTMLParser):
    """Ids, links, images and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if given.get("id"):
            self.ids.append(str(given["id"]))
        if tag == "a":
            self.links.append(str(given["href"]))
        if tag == "img":
            self.images.append(given)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_is_one_file_that_refers_to_nothing_outside(report: Path) -> None:
    html = report.read_text()
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert len(page.images) == CHARTS + 2 * 8  # of each scene six pictures, loss curve, floor plan
    assert all(str(image["src"]).startswith("data:image/") and image["alt"] for image in page.images)
    assert not {"link", "iframe", "object", "embed"} & set(page.tags)
    assert not re.search(r"(?:src|href)=\"(?!data:|#)|@import|url\((?!data:)", re.sub(r"data:[^\"]*", "data:", html))
    assert len(html) < 10e6
    assert page.tags.count("h1") == 1


def test_the_report_says_what_the_views_say(report: Path, lake: Lake) -> None:
    page = Page(report.read_text())
    answers = answers_of(lake.snapshot())
    for name, question in listing():
        assert f"sql-{name}" in page.ids
        assert question in page.text
    for row in answers["scene_objects"].to_pylist():
        assert row["instance_id"] in page.text
    assert "28.8 m²" in page.text  # 12.8 + 16
    assert "1 → 0" in page.text  # pairs deeper than 2 mm before and after
    assert "4 of 5, 80%" in page.text  # free objects that stay within 5 cm; one of six is fixed
    assert "80% (16.7% fixed)" in page.text
    assert "free objects stable at 5 cm; 2 fixed" in page.text
    assert "0003 book, 50.0 cm" in page.text
    assert "<nothing> carries it" in page.text
    assert "9 of 10" in page.text  # exports
    assert "determinant is 0; remove the line to have it estimated" in page.text
    assert "no view; shape by category" in page.text
    assert "up is <missing>" in page.text
    assert "CC-BY-4.0" in page.text
    assert f"Snapshot {lake.snapshot().snapshot_id} of " in page.text


def test_a_scene_has_a_picture_before_and_one_after_its_optimization(report: Path) -> None:
    images = {str(image["alt"]): str(image["src"]) for image in Page(report.read_text()).images}
    for scene in ("demo/room_0", "demo/room_1"):
        before, after = (images[f"{name} of {scene} seen with what collides marked"] for name in ("Proposed", "Optimized"))
        assert before != after
        assert any(alt.startswith(f"Collision loss of {scene} over 2 steps: 250 mm at the start, 0 mm") for alt in images)


def test_the_picture_before_shows_the_proposed_poses_and_the_one_after_the_optimized(lake: Lake) -> None:
    reader = lake.snapshot()
    placements = reader.rows(Placement, "demo/room_0")
    room = reader.rows(Room, "demo/room_0")[0]
    shell = {name: [part] for name, part in room_shell(room)}
    parts = [solid(int(placement.instance_id)) for placement in placements]
    pictures = picture_scene_of(lake, reader.snapshot_id, "demo/room_0", SMALL)

    def expected(phase: str, pairs: list[tuple[str, str]]) -> bytes:
        objects, optimized = (
            {
                placement.instance_id: [part.copy().apply_transform(matrix(getattr(placement, f"{name}_pose")))]
                for placement, part in zip(placements, parts, strict=True)
            }
            for name in (phase, "optimized")
        )
        camera = scenes.best_corner(list(optimized.values()), [part for of in shell.values() for part in of], Outline.of_room(room), SMALL)
        return collisions.marked_picture(objects, shell, pairs, Outline.of_room(room), camera, SMALL)

    assert pictures.before == expected("proposed", [("0000", "0001")])
    assert pictures.after == expected("optimized", [])


def test_the_report_tells_nothing_of_the_machine(report: Path, lake: Lake) -> None:
    html = report.read_text()
    for secret in ("secret-host", "secret folder", "/srv", lake.address, str(Path.home()) + "/"):
        assert secret not in html


def test_the_same_snapshot_gives_the_same_report_and_pictures(report: Path, lake: Lake, tmp_path: Path) -> None:
    again = write_report(lake, tmp_path, pictures=tmp_path / "pictures", look=SMALL, workers=1)
    assert again == tmp_path / "report.html"
    assert again.read_bytes() == report.read_bytes()
    made = sorted(path.name for path in (tmp_path / "pictures").iterdir())
    assert len(made) == 2 * CHARTS
    for name in made:
        assert (tmp_path / "pictures" / name).read_bytes() == (report.parent / "pictures" / name).read_bytes()


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_report(report: Path, lake: Lake, tmp_path: Path) -> None:
    told: list[str] = []
    again = write_report(lake, tmp_path / "a.html", look=SMALL, workers=2, advance=told.append)
    assert again.read_bytes() == report.read_bytes()
    assert sorted(told) == ["demo/room_0", "demo/room_1"]


def test_an_empty_lake_has_a_report(tmp_path: Path) -> None:
    page = Page(write_report(Lake.open(tmp_path / "none"), tmp_path / "report.html").read_text())
    assert "A lake without a snapshot" in page.text
    assert page.images == []
    assert not (tmp_path / "none").exists()


def test_more_scenes_than_are_pictured_are_counted(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.stats.PICTURED_SCENES", 1)
    page = Page(write_report(lake, tmp_path / "report.html", look=SMALL, workers=1).read_text())
    assert "The first 1 of 2 scenes are pictured" in page.text
    assert not any("demo/room_1" in str(image["alt"]) and str(image["src"]).startswith("data:image/jpeg") for image in page.images)


def test_a_snapshot_that_is_not_there_is_refused(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no snapshot 99"):
        write_report(lake, tmp_path / "report.html", 99)
    assert not (tmp_path / "report.html").exists()


def test_a_scene_that_cannot_be_pictured_costs_its_pictures_only(tmp_path: Path) -> None:
    lake = furnished_lake(tmp_path / "lake", scenes=2, objects=2)
    blob = lake.snapshot().arrow("scenes", "demo/room_0")["mesh_blob"][0].as_py()
    found = next((tmp_path / "lake").rglob(blob))
    found.chmod(0o644)
    found.write_bytes(b"no GLB")
    page = Page(write_report(lake, tmp_path / "report.html", look=SMALL, workers=1).read_text())
    assert "No pictures:" in page.text
    assert sum("demo/room_0" in str(image["alt"]) and str(image["src"]).startswith("data:image/jpeg") for image in page.images) == 0
    assert sum("demo/room_1" in str(image["alt"]) and str(image["src"]).startswith("data:image/jpeg") for image in page.images) == 6


def test_a_scene_that_is_not_in_the_snapshot_is_refused(lake: Lake) -> None:
    with pytest.raises(InputError, match="is not in the snapshot"):
        picture_scene_of(lake, 1, "demo/nowhere", SMALL)


def test_the_table_of_stage_times_is_in_the_order_of_the_data_path(lake: Lake) -> None:
    lines = stage_table(lake.snapshot()).splitlines()
    assert lines[0].split() == ["stage", "scenes", "total", "s", "median", "s", "p95", "s", "s", "per", "object"]
    assert [line.split()[0] for line in lines[1:]] == [stage for stage in STAGES if stage not in ("annotation", "evaluation")] + ["all"]
    # two scenes of 6 objects: 0.5 and 1.5 s of capture
    assert lines[1].split() == ["capture", "2", "2.00", "1.00", "1.45", "0.167"]
    assert float(lines[-1].split()[1]) == pytest.approx(sum(float(line.split()[2]) for line in lines[1:-1]))


def test_loading_the_flow_loads_no_heavy_package() -> None:
    code = (
        "import sys, flows.stats; "
        "print(sorted({'prefect', 'matplotlib', 'open3d', 'trimesh', 'duckdb', 'deltalake', 'wordcloud', 'jinja2'} & sys.modules.keys()))"
    )
    root = Path(__file__).resolve().parent.parent
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, env=environment, check=True)
    assert done.stdout.strip() == "[]"
