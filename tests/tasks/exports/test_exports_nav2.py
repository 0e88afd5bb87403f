"""Maps for nav2: read as map_server reads them, held against the room they are of, and a gate that catches damage."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from schemas.errors import InputError
from tasks import exports
from tasks.exports import write_folder
from tasks.exports.bodies import Replica
from tasks.exports.config import Nav2Config
from tasks.exports.nav2 import is_door, nav2_files
from tasks.exports.nav2.grid import FREE, OCCUPIED, UNKNOWN, Raster, occupancy
from tasks.exports.nav2.map_files import MapSettings, dump_map, read_cells, read_settings
from tasks.exports.nav2.rules import RULES, check_nav2
from tasks.geometry.transforms import transform_points, translation, yaw_pose
from tests.replicas import ROOM, cube, furnished, replica_of, room_of, rows_of, with_navigation
from tests.tasks.exports.test_exports_agreement import Read, posed

CLIMB_M = 0.2


def read_objects(root: Path) -> dict[str, Read]:
    """Objects beside the one map in a folder of exports, in the world frame; a map says nothing of masses."""
    (file,) = (root / "nav2").glob("*/objects.json")
    objects = {}
    for item in json.loads(file.read_text())["objects"]:
        w, x, y, z = item["rotation_wxyz"]
        pose = posed(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(item["position_m"]))
        objects[item["name"]] = Read(pose, None, None, None, np.array(item["box_m"]))
    return objects


@dataclasses.dataclass(frozen=True)
class ServedMap:
    """What map_server would publish: `data` as in `nav_msgs/OccupancyGrid`, one value after the other."""

    data: list[int]
    width: int
    height: int
    resolution: float
    origin: tuple[float, float, float]

    def at(self, x: float, y: float) -> int | None:
        """The cell at a place [m], as costmaps look it up; None beside the map."""
        column, row = (int(np.floor((value - low) / self.resolution)) for value, low in zip((x, y), self.origin[:2], strict=True))
        return self.data[row * self.width + column] if 0 <= column < self.width and 0 <= row < self.height else None


def served(path: Path) -> ServedMap:
    """A map by map_server's own steps, pixel by pixel: PyYAML for yaml-cpp, Pillow for GraphicsMagick."""
    document = yaml.safe_load(path.read_text())
    with Image.open(path.parent / document["image"]) as image:
        width, height = image.size
        pixels = np.asarray(image.convert("RGB")).tolist()
    data = [0] * (width * height)
    for y in range(height):
        for x in range(width):
            shade = sum(pixels[y][x]) / 3 / 255
            occupied = shade if document["negate"] else 1.0 - shade
            value = -1
            if document["occupied_thresh"] < occupied:
                value = 100
            elif occupied < document["free_thresh"]:
                value = 0
            data[width * (height - y - 1) + x] = value
    assert document["mode"] == "trinary"
    return ServedMap(data, width, height, document["resolution"], tuple(document["origin"]))


def written(root: Path, rows: dict[str, list[Any]], blobs: Any, config: Nav2Config | None = None) -> Path:
    """The map of rows with or without navigation, in a folder."""
    navmeshes = {row.agent: (row, CLIMB_M) for row in rows.get("navmeshes", ())}
    made = nav2_files(replica_of(rows, blobs), navmeshes, rows.get("episodes", ()), config or Nav2Config())
    write_folder(root, {file.path: file.data for file in made.files})
    (path,) = root.glob("*/map.yaml")
    return path


@pytest.fixture(scope="module")
def rows() -> tuple[dict[str, list[Any]], Any]:
    return with_navigation(*rows_of(furnished()), episodes=20)


@pytest.fixture(scope="module")
def replica(rows: tuple[dict[str, list[Any]], Any]) -> Replica:
    return replica_of(*rows)


@pytest.fixture(scope="module")
def office(rows: tuple[dict[str, list[Any]], Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("nav2"), *rows)


@pytest.fixture(scope="module")
def grid(office: Path) -> ServedMap:
    return served(office)


@pytest.fixture
def copy(office: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(office.parent, tmp_path / "moved" / "elsewhere")) / "map.yaml"


def test_a_sound_map_has_no_findings_wherever_it_lies(office: Path, copy: Path) -> None:
    assert check_nav2(office) == []
    assert check_nav2(copy) == []


def test_the_gates_reader_reads_as_map_server_does(office: Path, grid: ServedMap) -> None:
    found = read_settings(office)
    cells = read_cells(office.parent / found.image, found)
    assert cells.shape == (grid.height, grid.width)
    assert cells.reshape(-1).tolist() == grid.data
    assert (found.resolution_m, found.origin) == (grid.resolution, grid.origin)


def test_what_is_seen_between_the_heights_lies_on_occupied_cells(replica: Replica, grid: ServedMap) -> None:
    """Points of every object's triangles, drawn at random: none between the map's heights is in a cell that is not occupied."""
    rng = np.random.default_rng(0)
    seen = 0
    for body in replica.bodies:
        for part in body.shape.parts:
            corners = transform_points(part.vertices, body.pose)[part.faces]
            weights = rng.dirichlet((1, 1, 1), (40, len(corners)))
            points = np.concatenate([np.einsum("snk,nkd->snd", weights, corners).reshape(-1, 3), corners.reshape(-1, 3)])
            low = points[(points[:, 2] > 0.02) & (points[:, 2] < 0.5) & (points[:, 1] < 1.999)]  # the picture is in the wall
            seen += len(low)
            assert {grid.at(x, y) for x, y, _ in low} <= {100}, body.name
    assert seen > 1000


def test_free_cells_are_the_floor_less_what_stands_on_it(replica: Replica, grid: ServedMap) -> None:
    """Free cells are floor as a whole, and what is occupied is near a wall or an object that reaches down between the heights."""
    room = shapely.Polygon(ROOM)
    columns, rows = np.meshgrid(np.arange(grid.width), np.arange(grid.height))
    centers = np.column_stack([columns.reshape(-1), rows.reshape(-1)]) * grid.resolution + grid.origin[:2] + grid.resolution / 2
    value = np.array(grid.data)
    free = value == 0
    half = grid.resolution / 2
    cells = shapely.box(*(centers[free] - half).T, *(centers[free] + half).T)
    assert shapely.covers(room.buffer(1e-6), cells).all()
    obstacles = shapely.union_all(
        [
            shapely.MultiPoint(transform_points(hull.vertices, body.pose)[:, :2]).convex_hull
            for body in replica.bodies
            for hull in body.shape.hulls
            if transform_points(hull.vertices, body.pose)[:, 2].min() < 0.5
        ]
    )
    # nothing is occupied farther from an obstacle or a wall than a cell's diagonal and the seam of outlines
    near = shapely.union_all([obstacles, room.buffer(0.15).difference(room)]).buffer(np.sqrt(2) * grid.resolution + 0.01)
    assert shapely.covers(near, shapely.points(centers[value == 100])).all()
    assert 20.0 < free.sum() * grid.resolution**2 < room.area, "of 22 m2 of floor most is free"
    assert set(value[~shapely.intersects(room.buffer(0.16), shapely.points(centers))]) == {-1}


def test_every_place_on_the_floor_is_known(grid: ServedMap) -> None:
    rng = np.random.default_rng(1)
    room = shapely.Polygon(ROOM)
    points = rng.uniform([-3, -2], [3, 2], (5000, 2))
    inside = shapely.contains_xy(room, *points.T)
    assert {grid.at(x, y) for x, y in points[inside]} == {0, 100}
    assert {grid.at(x, y) for x, y in ((2.0, 1.5), (-3.3, 0.0), (0.0, 2.3))} == {-1}, (
        "the corner that the L leaves out, and beyond the walls"
    )


def test_rows_of_the_image_go_down_and_columns_along_x(tmp_path: Path) -> None:
    """A box near the greatest x and y of the room, the lowest corner of which has nothing: the classic mistakes each put it elsewhere."""
    square = [[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]]
    rows, blobs = rows_of([cube((0.3, 0.2, 0.3), translation([1.5, 0.7, 0.0]))])
    rows["shells"] = [room_of(polygon=square)]
    path = written(tmp_path, rows, blobs)
    assert check_nav2(path) == []
    grid = served(path)
    assert [grid.at(x, y) for x, y in ((1.5, 0.7), (-1.5, 0.7), (1.5, -0.7), (-1.5, -0.7))] == [100, 0, 0, 0]
    with Image.open(path.parent / "map.pgm") as image:
        pixels = np.asarray(image)
    rows_, columns = np.nonzero(pixels[10:-10, 10:-10] == 0)  # without the walls
    assert rows_.mean() < 0.3 * (len(pixels) - 20), "up in the picture"
    assert columns.mean() > 0.7 * (pixels.shape[1] - 20), "on its right"


def test_starts_of_episodes_are_free(rows: tuple[dict[str, list[Any]], Any], grid: ServedMap) -> None:
    starts = [episode.start_position[:2] for episode in rows[0]["episodes"]]
    assert len(starts) == 20
    assert {grid.at(x, y) for x, y in starts} == {0}


def test_what_the_agents_climb_may_lie_under_their_starts(tmp_path: Path) -> None:
    """A platform of 10 cm over most of the floor: Habitat's agent drives over it, a small robot does not."""
    rows, blobs = with_navigation(*rows_of([cube((5.0, 2.0, 0.1), translation([0.0, -0.7, 0.0]))]), episodes=20)
    path = written(tmp_path, rows, blobs)
    grid = served(path)
    assert 100 in {grid.at(*episode.start_position[:2]) for episode in rows["episodes"]}
    assert check_nav2(path) == []
    beside = json.loads((path.parent / "objects.json").read_text())
    beside["objects"][0]["driven_over_m"] = []
    (path.parent / "objects.json").write_text(json.dumps(beside))
    assert {finding.rule for finding in check_nav2(path) if finding.is_error} == {"starts"}


def test_what_the_agents_pass_under_may_hang_over_their_starts(tmp_path: Path) -> None:
    """A ceiling of boards at 1 m over most of the floor, on a map for a robot that is higher than the episodes' agent."""
    rows, blobs = with_navigation(*rows_of([cube((5.0, 2.0, 0.1), translation([0.0, -0.7, 1.0]))]), episodes=20)
    path = written(tmp_path, rows, blobs, Nav2Config(highest_m=1.5))
    grid = served(path)
    assert 100 in {grid.at(*episode.start_position[:2]) for episode in rows["episodes"]}
    assert check_nav2(path) == []


def test_a_map_that_would_be_too_large_is_a_finding_and_the_other_formats_are_written(rows: tuple[dict[str, list[Any]], Any]) -> None:
    from tests.tasks.exports.test_exports import export

    config = exports.ExportsConfig(formats=("glb", "nav2"), nav2=Nav2Config(resolution_m=0.001))
    outcome = export(*rows, config)
    assert {row.format for row in outcome.rows["export_files"]} == {"glb"}
    (failed,) = [row for row in outcome.rows["export_checks"] if not row.passed]
    assert (failed.format, failed.rule) == ("nav2", "resolution")
    assert "is larger than 4,000,000; set a coarser one" in str(failed.message)
    with pytest.raises(InputError, match="cells is larger"):
        Raster.around((0.0, 0.0, 5.0, 10_000.0), 0.05, 4)
    with pytest.raises(InputError, match="cells is larger"):
        Raster.around((0.0, 0.0, 5.0, 5.0), 0.05, 10**6)
    assert Raster.around((0.0, 0.0, 99.0, 99.0), 0.05, 4).rows == 1988


def test_a_map_of_half_the_country_and_somebody_elses_objects_are_told(copy: Path) -> None:
    (copy.parent / "objects.json").write_text('{"classes": ["chair"]}')
    assert check_nav2(copy) == []
    line("resolution", "500.0")(copy)
    assert {finding.rule for finding in check_nav2(copy)} == {"resolution"}


def test_what_hangs_higher_or_lies_lower_than_the_map_is_not_on_it(tmp_path: Path) -> None:
    shelf = cube((0.5, 0.3, 0.3), translation([0.0, 0.0, 1.0]))
    rug = cube((1.0, 1.0, 0.01), translation([-1.5, -1.0, 0.0]))
    step = cube((0.2, 0.2, 0.05), translation([2.0, -1.0, 0.0]))
    rows, blobs = rows_of([shelf, rug, step])
    grid = served(written(tmp_path / "low", rows, blobs))
    assert [grid.at(*place) for place in ((0.0, 0.0), (-1.5, -1.0), (2.0, -1.0))] == [0, 0, 100]
    tall = served(written(tmp_path / "high", rows, blobs, Nav2Config(lowest_m=0.0, highest_m=1.1)))
    assert [tall.at(*place) for place in ((0.0, 0.0), (-1.5, -1.0), (2.0, -1.0))] == [100, 100, 100]


def test_doors_are_open_unless_they_are_wanted_shut(tmp_path: Path) -> None:
    """A leaf in the doorway of a wall through the room."""
    leaf = cube((0.06, 0.9, 2.0), translation([0.0, 0.5, 0.0]))
    rows, blobs = rows_of([dataclasses.replace(leaf, category="door")])
    wall = ((0.0, -2.0, 0.0, 0.05, 0.1, 2.6), (0.0, 0.95, 0.0, 2.0, 0.1, 2.6))
    rows["shells"] = [dataclasses.replace(rows["shells"][0], interior_walls=wall)]
    open_, shut = (served(written(tmp_path / str(closed), rows, blobs, Nav2Config(closed_doors=closed))) for closed in (False, True))
    assert [grid.at(0.0, 0.5) for grid in (open_, shut)] == [0, 100]
    assert [grid.at(0.0, y) for grid in (open_, shut) for y in (-1.0, 1.5)] == [100] * 4
    (said,) = json.loads((tmp_path / "False" / "demo_room_01" / "objects.json").read_text())["objects"]
    assert (said["is_open"], said["outline_m"]) == (True, [])


@pytest.mark.parametrize(
    ("category", "expected"),
    [("door", True), ("Bathroom Door", True), ("closet_doors", True), ("window", False), ("doorframe", False), ("cabinet door", False)],
)
def test_leaves_that_open_a_way_are_doors(category: str, expected: bool) -> None:
    assert is_door(category) == expected


def test_a_doorway_in_an_outer_wall_is_free_as_deep_as_it_is(tmp_path: Path) -> None:
    rows, blobs = rows_of([])
    opening = (-1.0, -2.0, 0.0, -2.0, 0.0, 2.1, 0.06)
    rows["shells"] = [dataclasses.replace(rows["shells"][0], openings=(opening,))]
    path = written(tmp_path, rows, blobs, Nav2Config(resolution_m=0.025))
    grid = served(path)
    assert [grid.at(-0.5, y) for y in (-1.9, -2.01, -2.04, -2.09)] == [0, 0, 0, 100], "the panel behind the leaf closes it"
    assert grid.at(-2.0, -2.01) == 100
    assert check_nav2(path) == []


def test_a_wall_that_ends_where_cells_meet_leaves_the_cells_before_it_free(tmp_path: Path) -> None:
    rows, blobs = rows_of([])
    grid = served(written(tmp_path, rows, blobs))
    assert [grid.at(-2.999, 0.0), grid.at(-3.001, 0.0)] == [0, 100]


def test_what_stands_beyond_the_walls_is_said(tmp_path: Path) -> None:
    rows, blobs = rows_of([cube((0.3, 0.3, 0.3), translation([40.0, 0.0, 0.0]))])
    made = nav2_files(replica_of(rows, blobs), {}, [], Nav2Config())
    assert [line.split(":")[0] for line in made.missed] == ["0001"]
    assert len(next(file for file in made.files if file.path.endswith(".pgm")).data) < 20_000, "the map ends with the room"


@pytest.mark.parametrize("resolution", [0.025, 0.05, 0.1, 0.3])
def test_maps_of_any_resolution_pass_their_gate(resolution: float, rows: tuple[dict[str, list[Any]], Any], tmp_path: Path) -> None:
    path = written(tmp_path, *rows, Nav2Config(resolution_m=resolution))
    assert [finding for finding in check_nav2(path) if finding.is_error] == []
    grid = served(path)
    for low in grid.origin[:2]:
        assert low / resolution == pytest.approx(round(low / resolution), abs=1e-6)


def test_the_stage_writes_and_checks_maps(rows: tuple[dict[str, list[Any]], Any]) -> None:
    from tests.tasks.exports.test_exports import export

    outcome = export(*rows, exports.ExportsConfig(formats=("nav2",)))
    assert [row.rule for row in outcome.rows["export_checks"] if not row.passed] == []
    assert {row.rule for row in outcome.rows["export_checks"]} == {*RULES, "complete"}
    assert sorted(row.path for row in outcome.rows["export_files"]) == [
        f"demo_room_01/{name}" for name in ("map.pgm", "map.yaml", "objects.json")
    ]


# ---- cells


@settings(max_examples=60, deadline=None)
@given(
    places=st.lists(st.tuples(st.floats(-1.4, 1.4), st.floats(-0.9, 0.9), st.floats(0, 3), st.floats(0.002, 0.4)), max_size=4),
    resolution=st.sampled_from([0.05, 0.07, 0.1]),
)
def test_no_obstacle_however_small_is_in_a_free_cell(places: list[tuple[float, ...]], resolution: float) -> None:
    """Squares anywhere in a room, turned any way: corners and middles of each are in occupied cells, and what is free is floor."""
    floor, slab = shapely.box(-1.5, -1.0, 1.5, 1.0), shapely.box(-1.6, -1.1, 1.6, 1.1)
    walls = slab.difference(floor)
    unit = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    corners = [transform_points(half * unit, yaw_pose(yaw, [x, y, 0])) for x, y, yaw, half in places]
    squares = [shapely.Polygon(ring[:4, :2]) for ring in corners]
    raster = Raster.around(slab.bounds, resolution, 2)
    cells = occupancy(raster, floor, slab, [walls, *squares])
    for ring in corners:
        inward = 0.999 * (ring - ring[4]) + ring[4]
        for x, y, _ in inward:
            if max(abs(x) - 1.5, abs(y) - 1.0) < 0:
                column, row = int((x - raster.origin[0]) // resolution), int((y - raster.origin[1]) // resolution)
                assert cells[row, column] == OCCUPIED
    solid = shapely.union_all([walls, *squares])
    for row, column in np.argwhere(cells == FREE):
        x, y = raster.origin[0] + column * resolution, raster.origin[1] + row * resolution
        box = shapely.box(x, y, x + resolution, y + resolution)
        assert box.intersection(solid).area < 1e-5 * resolution
        assert box.difference(floor).area < 1e-5 * resolution


def test_a_pocket_that_nobody_can_reach_from_outside_of_the_room_is_unknown() -> None:
    """Slab that a wall does not cover, on its far side: it is no floor of the room."""
    floor, slab = shapely.box(0, 0, 1, 1), shapely.box(-0.5, 0, 1, 1)
    cells = occupancy(Raster.around(slab.bounds, 0.1, 1), floor, slab, [shapely.box(-0.1, 0, 0, 1)])
    assert cells[5].tolist() == [UNKNOWN] * 5 + [OCCUPIED] + [FREE] * 10 + [UNKNOWN]


def test_floor_that_nothing_carries_is_occupied() -> None:
    floor, slab = shapely.box(0, 0, 1, 1), shapely.box(0, 0, 0.75, 1)
    cells = occupancy(Raster.around(floor.bounds, 0.1, 0), floor, slab, [])
    assert cells[5].tolist() == [FREE] * 7 + [OCCUPIED] * 3


# ---- the reader


@settings(max_examples=60, deadline=None)
@given(
    cells=st.lists(st.lists(st.sampled_from([FREE, OCCUPIED, UNKNOWN]), min_size=3, max_size=3), min_size=1, max_size=5),
    low=st.tuples(st.integers(-100, 100), st.integers(-100, 100)),
    resolution=st.sampled_from([0.05, 0.025, 0.1, 0.3]),
)
def test_cells_come_back_as_they_were_written(
    cells: list[list[int]], low: tuple[int, int], resolution: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("map")
    wanted = np.array(cells, dtype=np.int8)
    raster = Raster((low[0] * resolution, low[1] * resolution), resolution, *wanted.shape)
    text, image = dump_map(wanted, raster, "map.pgm")
    (folder / "map.yaml").write_bytes(text)
    (folder / "map.pgm").write_bytes(image)
    found = read_settings(folder / "map.yaml")
    np.testing.assert_array_equal(read_cells(folder / "map.pgm", found), wanted)
    assert (found.origin[:2], found.resolution_m) == (raster.origin, resolution)
    assert served(folder / "map.yaml").data == wanted.reshape(-1).tolist()


SETTINGS = MapSettings("map.png", "trinary", 0.05, (0.0, 0.0, 0.0), False, 0.65, 0.196)


@pytest.mark.parametrize(
    ("kind", "grays", "expected"),
    [
        ({"mode": "trinary"}, [0, 89, 90, 205, 206, 255], [100, 100, -1, -1, 0, 0]),
        ({"mode": "trinary", "negate": True}, [0, 49, 50, 165, 166, 255], [0, 0, -1, -1, 100, 100]),
        ({"mode": "scale"}, [0, 255, 147], [100, 0, 50]),
        ({"mode": "raw"}, [0, 42, 100, 101, 255], [0, 42, 100, -1, -1]),
    ],
)
def test_grays_mean_what_map_server_says(kind: dict[str, Any], grays: list[int], expected: list[int], tmp_path: Path) -> None:
    Image.fromarray(np.array([grays], dtype=np.uint8)).save(tmp_path / "map.png")
    assert read_cells(tmp_path / "map.png", dataclasses.replace(SETTINGS, **kind))[0].tolist() == expected


def test_transparent_pixels_are_unknown_where_a_map_is_scaled(tmp_path: Path) -> None:
    Image.fromarray(np.array([[[0, 0, 0, 255], [0, 0, 0, 0], [255, 255, 255, 255]]], dtype=np.uint8)).save(tmp_path / "map.png")
    assert read_cells(tmp_path / "map.png", dataclasses.replace(SETTINGS, mode="scale"))[0].tolist() == [100, -1, 0]
    assert read_cells(tmp_path / "map.png", SETTINGS)[0].tolist() == [100, 100, 0], "alpha counts as a fourth color"


# ---- damage


def line(key: str, value: str | None) -> Callable[[Path], None]:
    """Change or drop a line of the YAML file."""

    def damage(file: Path) -> None:
        lines = [text for text in file.read_text().splitlines() if not text.startswith(f"{key}:")]
        file.write_text("\n".join([*lines, *([] if value is None else [f"{key}: {value}"])]) + "\n")

    return damage


def paint(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Change the image's pixels."""

    def damage(file: Path) -> None:
        with Image.open(file.parent / "map.pgm") as image:
            pixels = np.array(image)
        Image.fromarray(np.ascontiguousarray(change(pixels))).save(file.parent / "map.pgm")

    return damage


def beside(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    """Change what objects.json says."""

    def damage(file: Path) -> None:
        document = json.loads((file.parent / "objects.json").read_text())
        change(document)
        (file.parent / "objects.json").write_text(json.dumps(document))

    return damage


def blank(old: int, new: int) -> Callable[[Path], None]:
    return paint(lambda pixels: np.where(pixels == old, new, pixels).astype(np.uint8))


TRIANGLE = [[[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]]]
DAMAGES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "no yaml": ("yaml", lambda file: file.write_text("image: [map.pgm"), "no YAML"),
    "a list": ("yaml", lambda file: file.write_text("- a\n"), "no table"),
    "no resolution": ("yaml", line("resolution", None), "resolution: is missing"),
    "resolution in words": ("yaml", line("resolution", "fine"), "resolution"),
    "origin of two numbers": ("yaml", line("origin", "[0, 0]"), "x, y, yaw"),
    "origin that is not finite": ("yaml", line("origin", "[.nan, 0, 0]"), "no finite number"),
    "unknown mode": ("yaml", line("mode", "binary"), "trinary, scale, raw"),
    "negate in words": ("yaml", line("negate", "perhaps"), "negate"),
    "absolute path": ("closed_paths", line("image", "/srv/maps/map.pgm"), "leaves the folder"),
    "path out of the folder": ("closed_paths", line("image", "../map.pgm"), "leaves the folder"),
    "lost image": ("closed_paths", lambda file: (file.parent / "map.pgm").unlink(), "does not exist"),
    "cut image": ("image", lambda file: (file.parent / "map.pgm").write_bytes(b"P5\n100 100\n255\n1"), "cannot be decoded"),
    "no image": ("image", lambda file: (file.parent / "map.pgm").write_text("a map"), "no image"),
    "huge image": ("image", lambda file: (file.parent / "map.pgm").write_bytes(b"P5\n90000 90000\n255\n1"), "pixels"),
    "no size": ("resolution", line("resolution", "0"), "is 0"),
    "far away": ("resolution", line("origin", "[1e7, 0, 0]"), "km"),
    "thresholds the wrong way round": ("thresholds", line("free_thresh", "0.7"), "0.7"),
    "unknown reads as free": ("unknown", line("free_thresh", "0.25"), "reads as free"),
    "nothing is free": ("free", blank(254, 205), "no free cell"),
    "objects of nothing": ("objects_file", beside(lambda document: document.pop("floor_m")), "floor_m"),
    "objects that are no JSON": ("objects_file", lambda file: (file.parent / "objects.json").write_text("{"), "objects.json"),
    "outline of one number": ("objects_file", beside(lambda d: d["objects"][0].update(outline_m=[[[1]]])), "cannot be read"),
    "box the wrong way round": ("objects_file", beside(lambda d: d["objects"][0]["box_m"].reverse()), "box_m"),
    "turned map": ("upright", line("origin", "[-3.35, -2.35, 1.57]"), "1.57"),
    "origin a metre off": ("floor", line("origin", "[-2.35, -2.35, 0.0]"), "floor"),
    "map that ends in the room": ("floor", paint(lambda pixels: pixels[:, :60]), "beyond the map"),
    "hole in the floor": ("floor", paint(lambda pixels: _holed(pixels)), "unknown"),
    "rows upside down": ("footprints", paint(lambda pixels: pixels[::-1]), "not occupied"),
    "columns mirrored": ("footprints", paint(lambda pixels: pixels[:, ::-1]), "not occupied"),
    "free beyond the walls": ("outside", blank(205, 254), "beyond the room"),
    "table that is not there": ("footprints", beside(lambda d: d["objects"][0].update(outline_m=TRIANGLE)), "table_0001"),
    "start in a wall": ("starts", beside(lambda d: d["starts"][0].update(position_m=[-3.05, 0.0])), "occupied"),
    "start beyond the walls": ("starts", beside(lambda d: d["starts"][0].update(position_m=[2.0, 1.7])), "unknown"),
    "start beside the map": ("starts", beside(lambda d: d["starts"][0].update(position_m=[30.0, 1.7])), "beside the map"),
}  # fmt: skip


def _holed(pixels: np.ndarray) -> np.ndarray:
    """Some pixels of the middle of the floor unknown."""
    holed = pixels.copy()
    holed[50:52, 66:68] = 205
    return holed


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_refused_by_its_rule(kind: str, copy: Path) -> None:
    rule, damage, words = DAMAGES[kind]
    damage(copy)
    errors = [finding for finding in check_nav2(copy) if finding.is_error]
    named = [finding for finding in errors if finding.rule == rule]
    assert any(words in str(finding) for finding in named), errors
    assert all(finding.where.split()[0] in ("map.yaml", "map.pgm", "objects.json") for finding in named), "each names the file"
    assert all(len(str(finding).splitlines()) == 1 and str(copy.parent) not in str(finding) for finding in errors)


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _, _ in DAMAGES.values()} == set(RULES)


def test_maps_of_others_need_no_objects_and_may_be_png(copy: Path) -> None:
    (copy.parent / "objects.json").unlink()
    with Image.open(copy.parent / "map.pgm") as image:
        image.convert("RGBA").save(copy.parent / "map.png")
    line("image", "map.png")(copy)
    line("negate", "false")(copy)
    assert check_nav2(copy) == []
    line("free_thresh", "0.25")(copy)
    assert [(finding.rule, finding.is_error) for finding in check_nav2(copy)] == [("unknown", False)]


_JSON = st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=5), lambda inner: st.lists(inner, max_size=4), max_leaves=6)


@settings(max_examples=60, deadline=None)
@given(
    field=st.sampled_from(
        ["floor_m", "slab_reach_m", "objects", "starts", "outline_m", "driven_over_m", "box_m", "position_m", "radius_m"]
    ),
    value=_JSON,
)
def test_no_objects_make_the_gate_fall_over(field: str, value: Any, office: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    document = json.loads((office.parent / "objects.json").read_text())
    for holder in (document, document["objects"][0], document["starts"][0]):
        if field in holder:
            holder[field] = value
    place = tmp_path_factory.mktemp("objects")
    for name in ("map.yaml", "map.pgm"):
        (place / name).symlink_to(office.parent / name)
    (place / "objects.json").write_text(json.dumps(document))
    assert all(finding.rule in RULES for finding in check_nav2(place / "map.yaml"))


@settings(max_examples=60, deadline=None)
@given(
    key=st.sampled_from(["image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"]), value=st.text(max_size=12)
)
def test_no_settings_make_the_gate_fall_over(key: str, value: str, office: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.mktemp("settings")
    shutil.copy(office, place / "map.yaml")
    (place / "map.pgm").symlink_to(office.parent / "map.pgm")
    lines = [text for text in office.read_text().splitlines() if not text.startswith(f"{key}:")]
    (place / "map.yaml").write_text("\n".join([*lines, f"{key}: {value}"]), encoding="utf-8", errors="surrogatepass")
    assert all(finding.rule in RULES for finding in check_nav2(place / "map.yaml"))
