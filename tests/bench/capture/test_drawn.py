"""Masks that were drawn by hand: how polygons become labels, and what the drawings say of the real frames."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from shapely import MultiPoint, Polygon

from bench.capture.drawn import IGNORED, drawings, filled, read_drawing
from schemas.errors import InputError
from tasks.capture.labels import label_map

OBJECTS = {
    "rgbd_open3d_livingroom_synth_00000.json": 3,
    "rgbd_open3d_livingroom_synth_00064.json": 5,
    "rgbd_open3d_livingroom_synth_00128.json": 4,
    "rgbd_pcl_office_milk_cartoon_all_small_clorox.json": 4,
    "rgbd_pcl_office_office1.json": 15,
    "rgbd_slambook_dining_1.json": 13,
    "rgbd_slambook_dining_2.json": 8,
    "rgbd_slambook_dining_3.json": 9,
    "rgbd_slambook_dining_4.json": 8,
    "rgbd_slambook_dining_5.json": 7,
    "rgbd_tum_desk_pair_1.json": 19,
    "rgbd_tum_desk_pair_2.json": 19,
}
"""Drawings, and how many objects each one has: 114 in all."""

LEAST_PIXELS, LEAST_DEPTH = 150, 0.5
"""What is smaller, or has depth in a smaller share of its pixels, is ignored."""

SQUARE = [[2, 2], [6, 2], [6, 6], [2, 6]]
INNER = [[3, 3], [5, 3], [5, 5], [3, 5]]
RIGHT = [[4, 1], [8, 1], [8, 7], [4, 7]]

SIZE = (12, 9)
HALVES = st.tuples(st.integers(0, 2 * SIZE[0]), st.integers(0, 2 * SIZE[1])).map(lambda point: (point[0] / 2, point[1] / 2))


def middles(size: tuple[int, int] = SIZE) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    return x, y


def drawn(**changes: Any) -> dict[str, Any]:
    objects = [{"category": "box", "is_support": True, "polygons": [SQUARE], "holes": [INNER]}]
    structure = [{"category": "wall", "polygons": [[[0, 0], [10, 0], [10, 8], [0, 8]]]}]
    whole = {"frame": "room/color/1.png", "size": [10, 8], "drawn": "by hand", "attribution": "somebody, MIT"}
    return {**whole, "objects": objects, "structure": structure, "ignored": [], **changes}


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "room_1.json"
    path.write_text(json.dumps(drawn(**changes)))
    return path


def thing(category: str, *polygons: Any, **more: Any) -> dict[str, Any]:
    return {"category": category, "is_support": False, "polygons": list(polygons), **more}


def turning(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points by their direction from the middle: most polygons of them are simple."""
    return sorted(points, key=lambda point: math.atan2(*np.subtract(point, np.mean(points, axis=0))))


@settings(max_examples=60)
@given(st.lists(HALVES, min_size=3, max_size=9, unique=True).map(turning).filter(lambda points: Polygon(points).is_valid))
def test_a_pixel_is_within_when_its_middle_is(points: list[tuple[float, float]]) -> None:
    mask, polygon = filled(np.array(points), SIZE), Polygon(points)
    assert (shapely.contains_xy(polygon, *middles()) <= mask).all()
    assert (mask <= shapely.intersects_xy(polygon, *middles())).all()
    assert (filled(np.array(points[::-1]), SIZE) == mask).all()
    assert (filled(np.roll(points, 1, axis=0), SIZE) == mask).all()


@settings(max_examples=60)
@given(st.lists(HALVES, min_size=4, max_size=12, unique=True).filter(lambda points: MultiPoint(points).convex_hull.area > 0))
def test_polygons_that_share_edges_part_all_pixels_among_them(points: list[tuple[float, float]]) -> None:
    triangles = [np.array(each.exterior.coords[:-1]) for each in shapely.delaunay_triangles(MultiPoint(points)).geoms]
    hull = np.array(MultiPoint(points).convex_hull.exterior.coords[:-1])
    assert (np.sum([filled(triangle, SIZE) for triangle in triangles], axis=0) == filled(hull, SIZE)).all()


def test_a_middle_on_an_edge_belongs_to_what_is_right_of_it_or_below() -> None:
    mask = filled(np.array([[0.5, 0.5], [2.5, 0.5], [2.5, 2.5], [0.5, 2.5]]), (4, 4))
    assert mask.tolist() == [[True, True, False, False], [True, True, False, False], [False] * 4, [False] * 4]


def test_a_later_object_lies_in_front_and_a_hole_shows_what_is_behind(tmp_path: Path) -> None:
    behind, front = thing("box", RIGHT), thing("mug", SQUARE, holes=[INNER])
    drawing = read_drawing(written(tmp_path, objects=[behind, front], ignored=[[[0, 0], [3, 0], [3, 3], [0, 3]]]))
    labels = drawing.labels()
    assert drawing.categories == ("box", "mug")
    assert labels.dtype == np.int32
    assert labels.tolist() == [
        [-1, -1, -1, 0, 0, 0, 0, 0, 0, 0],
        [-1, -1, -1, 0, 1, 1, 1, 1, 0, 0],
        [-1, -1, -1, 2, 2, 2, 1, 1, 0, 0],
        [0, 0, 2, 0, 1, 2, 1, 1, 0, 0],
        [0, 0, 2, 0, 1, 2, 1, 1, 0, 0],
        [0, 0, 2, 2, 2, 2, 1, 1, 0, 0],
        [0, 0, 0, 0, 1, 1, 1, 1, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    ]
    structure = drawing.structure_labels()
    assert (structure == np.where(labels == 0, 1, np.where(labels == IGNORED, IGNORED, 0))).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame": None}, "frame: must be a text"),
        ({"frame": "../other/1.png"}, "frame: leaves the folder of real data"),
        ({"frame": "/etc/1.png"}, "frame: leaves the folder of real data"),
        ({"attribution": " "}, "attribution: must be a text"),
        ({"drawn": 1}, "drawn: must be a text"),
        ({"size": [10]}, r"size: must be \[w, h\]"),
        ({"size": [10, True]}, r"size: must be \[w, h\]"),
        ({"size": [0, 8]}, r"size: must be \[w, h\]"),
        ({"size": [10**6, 10**6]}, "size: is 1000000000000 pixels"),
        ({"depth": "1.pgm"}, "depth: is no field of a drawing"),
        ({"objects": None}, "objects: must be a list, is missing"),
        ({"objects": {}}, "objects: must be a list, is a dict"),
        ({"objects": [[]]}, r"objects\[0\]: must be an object, is a list"),
        ({"objects": [thing("box", SQUARE, hole=[INNER])]}, r"objects\[0\]\.hole: is no field of a drawing"),
        ({"objects": [thing("", SQUARE)]}, r"objects\[0\]\.category: must be a text"),
        ({"objects": [{"category": "box", "polygons": [SQUARE]}]}, r"objects\[0\]\.is_support: must be true or false"),
        ({"objects": [thing("box")]}, r"objects\[0\]\.polygons: is empty"),
        ({"objects": [thing("box", SQUARE, [[1, 1], [2, 2]])]}, r"objects\[0\]\.polygons\[1\]: must be a list of three points"),
        ({"objects": [thing("box", [[1, 1], [2, 2], [3]])]}, r"objects\[0\]\.polygons\[0\]: must be a list of three points"),
        (
            {"objects": [thing("box", [[1, 1], [2, 1], [2, 2.25]])]},
            r"objects\[0\]\.polygons\[0\]: has 2\.25, which is no whole or half number",
        ),
        ({"objects": [thing("box", [[1, 1], [2, 1], [2, float("nan")]])]}, r"objects\[0\]\.polygons\[0\]: has nan"),
        ({"objects": [thing("box", [[1, 1], [2, 1], [2, True]])]}, r"objects\[0\]\.polygons\[0\]: has True"),
        ({"objects": [thing("box", [[1, 1], [2, 1], [2, "2"]])]}, r"objects\[0\]\.polygons\[0\]: has '2'"),
        ({"objects": [thing("box", [[1, 1], [10.5, 1], [2, 2]])]}, r"objects\[0\]\.polygons\[0\]: leaves the frame of 10 x 8 pixels"),
        ({"objects": [thing("box", [[1, 1], [9, -0.5], [2, 2]])]}, r"objects\[0\]\.polygons\[0\]: leaves the frame of 10 x 8 pixels"),
        ({"objects": [thing("box", [[1, 1], [5, 5], [5, 1], [1, 5]])]}, r"objects\[0\]\.polygons\[0\]: crosses or touches itself"),
        ({"objects": [thing("box", [[1, 1], [5, 5], [3, 3]])]}, r"objects\[0\]\.polygons\[0\]: crosses or touches itself, or has no area"),
        ({"objects": [thing("box", SQUARE, holes=[INNER, RIGHT[:1]])]}, r"objects\[0\]\.holes\[1\]: must be a list of three points"),
        ({"objects": [thing("box", INNER, holes=[[[7, 1], [9, 1], [9, 7]]])]}, r"objects\[0\]\.holes\[0\]: lies outside of the object"),
        ({"objects": [thing("mug", INNER), thing("box", SQUARE)]}, r"objects\[0\]: mug is hidden whole; list it after"),
        ({"objects": [thing("mug", INNER)], "ignored": [SQUARE]}, r"objects\[0\]: mug is hidden whole"),
        ({"structure": [{"category": "chair", "polygons": [SQUARE]}]}, r"structure\[0\]\.category: is no structure: 'chair'"),
        ({"structure": [thing("wall", SQUARE)]}, r"structure\[0\]\.is_support: is no field of a drawing"),
        ({"ignored": [SQUARE, 1]}, r"ignored\[1\]: must be a list of three points"),
    ],
)
def test_what_is_broken_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^room_1\.json: {message}"):
        read_drawing(written(tmp_path, **changes))


def test_what_is_no_drawing_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[]")
    with pytest.raises(InputError, match=r"^a\.json: content: holds a list, not an object"):
        read_drawing(tmp_path / "a.json")
    with pytest.raises(InputError, match=r"^b\.json: "):
        read_drawing(tmp_path / "b.json")


def test_so_many_objects_are_drawn() -> None:
    read = {path.name: read_drawing(path) for path in drawings()}
    assert {name: len(drawing.objects) for name, drawing in read.items()} == OBJECTS
    assert sum(OBJECTS.values()) == 114
    assert sum(region.is_support for drawing in read.values() for region in drawing.objects) == 10


@pytest.mark.parametrize("name", OBJECTS)
def test_a_drawing_labels_what_shapely_says(name: str) -> None:
    """Pixels whose middles lie on an outline are left out: shapely gives them to nobody."""
    (path,) = (each for each in drawings() if each.name == name)
    drawing = read_drawing(path)
    x, y = middles(drawing.size)
    expected, outlined = np.zeros(x.shape, dtype=int), np.zeros(x.shape, dtype=bool)

    def within(polygons: Sequence[NDArray[np.float64]]) -> NDArray[np.bool_]:
        inside = np.zeros(x.shape, dtype=bool)
        for polygon in map(Polygon, polygons):
            left, top, right, bottom = map(int, polygon.bounds)
            at = np.s_[top : bottom + 1, left : right + 1]
            shapely.prepare(polygon)
            contained = shapely.contains_xy(polygon, x[at], y[at])
            inside[at] |= contained
            outlined[at] |= shapely.intersects_xy(polygon, x[at], y[at]) & ~contained
        return inside

    for number, region in enumerate(drawing.objects, 1):
        expected[within(region.polygons) & ~within(region.holes)] = number
    expected[within(drawing.ignored)] = IGNORED
    labels = drawing.labels()
    assert (labels == expected)[~outlined].all()
    assert outlined.mean() < 0.01


@pytest.mark.parametrize("name", OBJECTS)
def test_a_drawing_names_its_frame_and_what_is_in_it(name: str) -> None:
    (path,) = (each for each in drawings() if each.name == name)
    drawing = read_drawing(path)
    frame = PurePosixPath(drawing.frame)
    assert name == f"{frame.parts[0]}_{frame.stem}.json"
    assert json.loads(path.read_text())["drawn"] == "by hand over enlarged pictures"
    assert any(word in drawing.attribution for word in ("MIT", "BSD-3-Clause", "CC BY"))
    assert [label_map()[category].category for category in drawing.categories] == list(drawing.categories)
    assert not any(label_map()[category].is_structure for category in drawing.categories)
    labels = drawing.labels()
    assert all((labels == number).sum() >= LEAST_PIXELS for number in range(1, len(drawing.objects) + 1))
    assert (labels == IGNORED).mean() < 0.25


@pytest.mark.realdata
@pytest.mark.parametrize("name", OBJECTS)
def test_a_drawing_fits_its_frame_and_most_of_an_object_has_depth(name: str, realdata: Callable[[str], Path]) -> None:
    from PIL import Image

    (path,) = (each for each in drawings() if each.name == name)
    drawing = read_drawing(path)
    frame = realdata(drawing.frame)
    if frame.suffix == ".pcd":
        head = frame.read_bytes()[:400].decode("ascii", "replace").splitlines()
        assert [f"WIDTH {drawing.size[0]}", f"HEIGHT {drawing.size[1]}"] == [line for line in head if line.startswith(("WIDTH", "HEIGHT"))]
        return
    assert Image.open(frame).size == drawing.size
    (recorded,) = frame.parents[1].glob(f"depth/{frame.stem}.*")
    depth, labels = np.array(Image.open(recorded)), drawing.labels()
    shares = {number: (depth[labels == number] > 0).mean() for number in range(1, len(drawing.objects) + 1)}
    assert {number: share for number, share in shares.items() if share < LEAST_DEPTH} == {}
