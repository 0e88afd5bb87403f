"""Point clouds: each kind of file against an independent reader, and refusals that name the cause."""

from __future__ import annotations

import io
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.files.ply_elements import PlyColumn
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.point_cloud import POINT_CLOUD, file_points
from tasks.capture.point_cloud.pcd import read_pcd
from tasks.capture.point_cloud.points import Points, points_of_columns
from tasks.capture.point_cloud.rows import read_rows
from tasks.geometry.rendering import RayScene
from tasks.stage import Context
from tests.capture_scans import box_room, well_formed
from tests.conftest import REPOSITORY
from tests.tasks.capture.formats.clouds import WRITERS, Cloud, pcd_bytes, ply_bytes, sampled, small_cloud, text_rows, write_e57, write_las

CLOUD = small_cloud()


def write_sample(folder: Path) -> None:
    """A corner of a room as a compressed PCD."""
    write_as("room.pcd", folder)


def write_as(name: str, folder: Path) -> None:
    """A corner of a room, as a file of that name."""
    folder.mkdir(parents=True, exist_ok=True)
    WRITERS[name](folder / name, CLOUD)


def _further(name: str):
    return lambda folder: write_as(name, folder)


FURTHER_SAMPLES = tuple(_further(name) for name in WRITERS if name != "room.pcd")


def read(folder: Path, name: str) -> Points:
    return file_points(folder / name, name)


@pytest.mark.parametrize("name", WRITERS)
def test_every_kind_of_file_states_the_same_points(name: str, tmp_path: Path) -> None:
    write_as(name, tmp_path)
    points = read(tmp_path, name)
    tolerance = 1e-6 if name.endswith(("pcd", "e57")) else 1e-9
    assert np.abs(points.positions - CLOUD.points).max() < tolerance
    assert points.colors is not None
    assert np.array_equal(points.colors, CLOUD.colors)


@pytest.mark.parametrize("name", WRITERS)
def test_every_kind_of_file_is_a_scan(name: str, tmp_path: Path) -> None:
    write_as(name, tmp_path / "office")
    (scan,), errors = find_scans(tmp_path)
    assert (scan.scan, errors) == ("office", [])
    assert scan_files(scan) == [(tmp_path / "office" / name).resolve()]
    assert find_scans(tmp_path / "office" / name, "point_cloud")[0][0].format == "point_cloud"


@pytest.mark.parametrize("name", ["room.las", "room.laz"])
@pytest.mark.parametrize("wide", [True, False])
def test_las_files_are_read_as_laspy_reads_them(name: str, wide: bool, tmp_path: Path) -> None:
    write_las(tmp_path / name, CLOUD, (441547.5, 5121946.5, 345.0), wide)
    judge = laspy.read(tmp_path / name)
    points = read(tmp_path, name)
    assert np.array_equal(points.positions, judge.xyz)
    assert points.colors is not None
    assert np.array_equal(points.colors, CLOUD.colors)


def test_withheld_points_and_noise_are_left_out(tmp_path: Path) -> None:
    write_las(tmp_path / "room.las", CLOUD)
    las = laspy.read(tmp_path / "room.las")
    las.classification[:5], las.withheld[5:7] = 7, True
    las.write(tmp_path / "room.las")
    points = read(tmp_path, "room.las")
    assert np.abs(points.positions - CLOUD.points[7:]).max() < 1e-9
    assert points.notes[:2] == (
        "room.las: 2 points are marked as withheld: left out",
        "room.las: 5 points are classified as noise: left out",
    )


def test_feet_of_a_las_file_are_taken_from_its_coordinate_system(tmp_path: Path) -> None:
    write_las(tmp_path / "room.las", CLOUD)
    las = laspy.read(tmp_path / "room.las")
    text = 'PROJCS["x",GEOGCS["y",UNIT["degree",0.0174532925199433]],PROJECTION["z"],UNIT["US survey foot",0.304800609601219]]'
    las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
    las.write(tmp_path / "room.las")
    assert read(tmp_path, "room.las").unit_m == 0.304800609601219


def test_e57_files_are_read_as_pye57_reads_them(tmp_path: Path) -> None:
    write_e57(tmp_path / "room.e57", CLOUD, (100.25, -20.5, 3.0))
    with pye57.E57(str(tmp_path / "room.e57")) as file:
        judge = file.read_scan(0, colors=True, ignore_missing_fields=True)
    points = read(tmp_path, "room.e57")
    assert np.allclose(points.positions, np.stack([judge[f"cartesian{axis}"] for axis in "XYZ"], axis=1), rtol=0, atol=1e-9)
    assert np.array_equal(points.colors, np.stack([judge[f"color{word}"] for word in ("Red", "Green", "Blue")], axis=1))
    assert points.sensors is not None
    assert points.sensors.tolist() == [[100.25, -20.5, 3.0]]
    assert points.unit_m == 1.0


@pytest.mark.parametrize("is_text", [True, False])
def test_ply_files_are_read_as_trimesh_reads_them(is_text: bool, tmp_path: Path) -> None:
    (tmp_path / "room.ply").write_bytes(ply_bytes(CLOUD, is_text))
    judge = trimesh.load(tmp_path / "room.ply")
    points = read(tmp_path, "room.ply")
    assert np.allclose(points.positions, judge.vertices, rtol=0, atol=1e-6)
    assert np.array_equal(points.colors, judge.colors[:, :3])


@pytest.mark.parametrize(
    ("text", "rows", "colors", "normals"),
    [
        ("1 2 3\n4 5 6\n", 2, None, False),
        ("//X Y Z R G B\n1 2 3 10 20 30\n", 1, [10, 20, 30], False),
        ('"x","y","z","red","green","blue"\n1,2,3,10,20,30\n', 1, [10, 20, 30], False),
        ("1;2;3;10;20;30\r\n4;5;6;10;20;30\r\n", 2, [10, 20, 30], False),
        ("1,5 2,5 3,5\n4,5 5,5 6,5\n", 2, None, False),
        ("# a scan\n\n1\t2\t3\t0.1\t0.2\t0.3\n", 1, [26, 51, 76], False),
        ("1 2 3 0 0 1\n4 5 6 0 1 0\n", 2, None, True),
        ("1 2 3 10 20 30 0.6 0.8 0\n", 1, [10, 20, 30], True),
        ("1 2 3 0.6 0.8 0 10 20 30\n", 1, [10, 20, 30], True),
        ("2\n1 2 3 -900 10 20 30\n4 5 6 -90 10 20 30\n", 2, [10, 20, 30], False),
        ("1 2 3 10 20 30 0.25\n", 1, [10, 20, 30], False),
    ],
)
def test_text_is_read_by_its_header_or_its_values(text: str, rows: int, colors: list[int] | None, normals: bool, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text)
    points = read(tmp_path, "a.xyz")
    assert (len(points.positions), points.normals is not None) == (rows, normals)
    assert (None if points.colors is None else points.colors[0].tolist()) == colors
    assert points.positions[0].tolist() == ([1.5, 2.5, 3.5] if "1,5" in text else [1, 2, 3])


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("ID X Y Z R G B", "1 1.5 2.5 3.5 10 20 30"),
        ("//ID X Y Z R G B", "1 1.5 2.5 3.5 10 20 30"),
        ("# r g b x y z", "10 20 30 1.5 2.5 3.5"),
        ("# fields: r g b x y z", "10 20 30 1.5 2.5 3.5"),
        ("# a scan of a room\n\n# r, g, b, x [m], y [m], z [m]", "10,20,30,1.5,2.5,3.5"),
        ("a scan of a room\nscan id;z;y;x;R;G;B", "1;3.5;2.5;1.5;10;20;30"),
        ('"id","y","x","z","r","g","b"', "1,2.5,1.5,3.5,10,20,30"),
        ("1\nid y x z r g b", "1 2.5 1.5 3.5 10 20 30"),
        ("//X Y Z Rf Gf Bf\n1", "1.5 2.5 3.5 0.04 0.08 0.1176"),
        ("id;x;y;z;r;g;b", "1;1,5;2,5;3,5;10;20;30"),
    ],
)
def test_a_header_names_the_columns_in_any_order(header: str, row: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(f"{header}\n{row}\n")
    points = read(tmp_path, "a.xyz")
    assert points.positions.tolist() == [[1.5, 2.5, 3.5]]
    assert points.colors is not None
    assert points.colors.tolist() == [[10, 20, 30]]
    assert not any("does not say" in note for note in points.notes)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("easting northing height", "1 2 3"),
        ("R G B", "1 2 3"),
        ("x y z", "7 1 2 3"),
        ("id x y", "7 1 2"),
        ("x y z x", "7 1 2 3"),
        ("//ID X Y Z", "1 2 3 4 5 6 7"),
        ("a scan of a room", "1 2 3"),
    ],
)
def test_a_header_that_does_not_name_the_axes_is_refused(header: str, row: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(f"{header}\n{row}\n{row}\n")
    with pytest.raises(InputError, match=r"^a.xyz: header: '.*' does not name \d columns with x, y and z; write a name"):
        read(tmp_path, "a.xyz")


@pytest.mark.parametrize(
    "text",
    [
        "1,5 2,5 0\n1,5 2,5 4\n",
        "1,5\t2,5\t0\n1,5\t2,5\t4\n",
        "1,5;2,5;0\r\n1,5;2,5;4\r\n",
        "1,5 25e-1 0\n1,5 2,5 4\n",
        "2\n1,5 2,5 0\n1,5 2,5 4\n",
        "x y z\n1,5 2,5 0\n1,5 2,5 4\n",
        "1.5, 2.5, 0\n1.5, 2.5, 4\n",
        "1.5,2.5,  0\n1.5,2.5,  4\n",
        "1.5,2.5,0,\n1.5,2.5,4,\n",
    ],
)
def test_commas_are_decided_by_all_rows(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text)
    points = read(tmp_path, "a.xyz")
    assert points.positions.tolist() == [[1.5, 2.5, 0], [1.5, 2.5, 4]]
    assert points.colors is None


@given(
    rows=st.lists(st.tuples(*[st.integers(-99_999, 99_999)] * 6), min_size=1, max_size=20),
    separator=st.sampled_from([" ", "\t", ";", "; "]),
)
def test_decimal_commas_state_the_same_as_points(rows: list[tuple[int, ...]], separator: str) -> None:
    text = "\n".join(separator.join(f"{value / 1000:g}" for value in row) for row in rows)
    dotted, commas = (read_rows(io.BytesIO(each.encode()), "a.xyz").values for each in (text, text.replace(".", ",")))
    assert np.array_equal(dotted, commas)


@pytest.mark.parametrize("row", ["1,5, 2,5, 3,5", "1,2,3 4,5,6", "1.5,2.5,3.5 10 20 30", "1,5 2,5 3.5", "1,234.5 2,345.5 3.5"])
def test_ambiguous_commas_are_refused(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(f"{row}\n{row}\n")
    with pytest.raises(InputError, match=r"^a.xyz: content: has commas that may separate numbers or be decimals; export"):
        read(tmp_path, "a.xyz")


@pytest.mark.parametrize(
    ("row", "color"),
    [
        ("1 2 3 0 0.5 0.7", [0, 128, 178]),
        ("1 2 3 1 0.5 0", [255, 128, 0]),
        ("1 2 3 1.0 0 0", [255, 0, 0]),
        ("1 2 3 2 0 0", [2, 0, 0]),
        ("1 2 3 65535 0 0", [255, 0, 0]),
    ],
)
def test_colors_have_one_scale_in_all_channels(row: str, color: list[int], tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(f"x y z r g b\n{row}\n")
    colors = read(tmp_path, "a.xyz").colors
    assert colors is not None
    assert colors.tolist() == [color]


def test_channels_of_different_types_have_one_scale() -> None:
    values = dict(zip(["x", "y", "z", "red", "green", "blue"], np.array([[1.0], [2.0], [3.0], [0.0], [0.5], [1.0]]), strict=True))
    columns = {word: PlyColumn(value, "u1" if word == "red" else "f4") for word, value in values.items()}
    colors = points_of_columns(columns, "a.ply").colors
    assert colors is not None
    assert colors.tolist() == [[0, 128, 255]]


def test_a_damaged_row_costs_the_row(tmp_path: Path) -> None:
    lines = text_rows(CLOUD).splitlines()
    lines[7] = lines[7].replace(" ", "\x10", 1)
    lines[9] += " 5"
    (tmp_path / "a.xyz").write_text("\n".join(lines))
    points = read(tmp_path, "a.xyz")
    assert np.array_equal(points.positions, np.delete(CLOUD.points, [7, 9], axis=0))
    assert points.notes[0] == "a.xyz: 2 rows are not 6 numbers: left out"


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_further_elements_of_a_ply_are_noted(form: str, tmp_path: Path) -> None:
    camera = "".join(f"property float {word}\n" for word in ("view_px", "view_py", "view_pz", "scalex", "scaley"))
    head = f"ply\nformat {form} 1.0\nelement vertex 200\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element edge 100\nproperty int vertex1\nproperty int vertex2\nelement camera 1\n{camera}element face 0\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    rows = np.arange(600, dtype="<f4").reshape(200, 3)
    edges, view = np.arange(200, dtype="<i4").reshape(100, 2), np.arange(5, dtype="<f4")[None]
    text = "\n".join(" ".join(map(str, row)) for part in (rows, edges, view) for row in part.tolist())
    body = text.encode() if form == "ascii" else rows.tobytes() + edges.tobytes() + view.tobytes()
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    points = read(tmp_path, "a.ply")
    assert np.array_equal(points.positions, rows)
    assert points.notes == ("a.ply: element edge, element camera: not used",)


def test_a_pts_file_may_have_several_parts(tmp_path: Path) -> None:
    part = text_rows(CLOUD, intensity=True)
    (tmp_path / "a.pts").write_text(f"3000\n{part}3000\n{part}")
    assert np.array_equal(read(tmp_path, "a.pts").positions, np.concatenate([CLOUD.points] * 2))
    (tmp_path / "a.pts").write_text(f"3001\n{part}")
    with pytest.raises(InputError, match=r"a.pts: points: are 3000, the file states 3001; copy"):
        read(tmp_path, "a.pts")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xyz", b"2\nwater\nO 0 0 0\nH 0 0 1\n", "has no rows of numbers"),
        ("a.xyz", b"", "has no rows of numbers"),
        ("a.xyz", b"1 2\n3 4\n", "a point needs 3"),
        ("a.xyz", b"1 2 3\0", "is not text"),
        ("a.las", b"1 2 3", "does not begin with 'LASF'"),
        ("a.laz", b"LASF" + bytes(300), "cannot be read"),
        ("a.e57", b"ASTM-E57" + bytes(300), "cannot be read"),
        ("a.pcd", b"no cloud\n", "is not that of a PCD"),
        ("a.pcd", pcd_bytes(CLOUD, "binary")[:-9], "ends after 2999 of 3000 points"),
        ("a.pcd", pcd_bytes(CLOUD, "ascii")[:-40], "ends after 299"),
        ("a.pcd", pcd_bytes(CLOUD, "binary_compressed")[:-9], "packed bytes"),
        ("a.pcd", pcd_bytes(CLOUD, "binary").replace(b"POINTS 3000", b"POINTS 3001"), "but WIDTH x HEIGHT is 3000 x 1"),
        ("a.pcd", pcd_bytes(CLOUD, "binary").replace(b"POINTS 3000", b"POINTS 99999999999"), "more than"),
        ("a.ply", ply_bytes(CLOUD)[:-5], "ends before"),
        ("a.ply", ply_bytes(CLOUD).replace(b"double x", b"double f_dc_0"), "Gaussian splats"),
        ("a.ply", ply_bytes(CLOUD).replace(b"double x", b"double w"), "lack x"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_name(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"^{name}: .*{message}.*; "):
        read(tmp_path, name)


def grid(viewpoint: np.ndarray | None = None) -> tuple[Cloud, tuple[float, ...]]:
    """The points that a depth camera in a room sees, and its lens. viewpoint: turns and moves the points."""
    room = box_room()
    camera = room.cameras[0]
    view = RayScene([room.surface.to_trimesh()]).render(camera)
    v, u = np.indices(view.depth.shape)
    depth = np.where(np.isfinite(view.depth), view.depth, np.nan)
    points = np.stack([(u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth], axis=2).reshape(-1, 3)
    points[::97] = np.nan
    points = points if viewpoint is None else points @ viewpoint.T
    return Cloud(points, view.color.reshape(-1, 3), np.zeros(len(points), np.int64)), (camera.fx, camera.fy, camera.cx, camera.cy)


@pytest.mark.parametrize("viewpoint", [None, np.diag([1.0, -1.0, -1.0])])
def test_a_grid_of_points_is_the_frame_of_a_camera(viewpoint: np.ndarray | None, tmp_path: Path) -> None:
    cloud, lens = grid(viewpoint)
    stated = "0 0 0 1 0 0 0" if viewpoint is None else "0 0 0 0 1 0 0"
    (tmp_path / "a.pcd").write_bytes(pcd_bytes(cloud, "binary_compressed", (160, 120), stated))
    (scan,), _ = find_scans(tmp_path)
    reading = POINT_CLOUD.read(scan)
    (frame,) = reading.frames
    assert reading.surface is None
    assert frame.intrinsics == pytest.approx(lens, abs=1e-3)
    assert (frame.pose is None) == (viewpoint is None)
    assert viewpoint is None or np.allclose(frame.pose[:3, :3], viewpoint, rtol=0, atol=1e-12)
    depth = np.abs(cloud.points[:, 2])
    assert frame.depth is not None
    assert np.allclose(frame.depth().ravel(), np.nan_to_num(depth), atol=1e-6)
    assert np.array_equal(frame.color().reshape(-1, 3), cloud.colors)
    outcome = well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))
    assert len(outcome.rows["frames"]) == 1


OFFICE = REPOSITORY.parent / "shared" / "realdata" / "rgbd_pcl_office"


@pytest.mark.skipif(not OFFICE.is_dir(), reason="real clouds lie beside the checkout where they are at hand")
@pytest.mark.parametrize(("name", "valid"), [("office1.pcd", 254_456), ("milk_cartoon_all_small_clorox.pcd", 241_407)])
def test_real_grids_have_the_camera_that_took_them(name: str, valid: int) -> None:
    pcd = read_pcd(OFFICE / name, name)
    assert int(np.isfinite(pcd.points.positions).all(axis=1).sum()) == valid
    (scan,), _ = find_scans(OFFICE / name)
    (frame,) = POINT_CLOUD.read(scan).frames
    assert frame.intrinsics[:2] == pytest.approx((525.0, 525.0), abs=0.01)
    assert int((frame.depth() > 0).sum()) == valid
    # A viewpoint that the file states is the pose, whichever way its camera looks.
    assert (frame.pose is not None) == pcd.header.states_viewpoint
    assert frame.pose is None or np.allclose(frame.pose, pcd.header.viewpoint, rtol=0, atol=1e-9)


def test_a_cloud_without_colors_claims_none(tmp_path: Path) -> None:
    cloud = sampled(box_room(()), 40_000)
    (tmp_path / "a.xyz").write_text("\n".join("{:.3f} {:.3f} {:.3f}".format(*row) for row in cloud.points))
    (scan,), _ = find_scans(tmp_path)
    reading = POINT_CLOUD.read(scan)
    assert any("has no colors: drawn in gray" in line for line in reading.degradations)
    assert reading.surface is not None
    assert len(np.unique(reading.surface.colors, axis=0)) == 1
