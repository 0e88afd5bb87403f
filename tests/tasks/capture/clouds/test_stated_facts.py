"""Facts that files of points state are used, or a line says that they are not."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pye57
import pytest
from pye57 import libe57
from scipy.spatial import cKDTree

from schemas.errors import InputError
from tasks.capture.formats import find_scans
from tasks.capture.point_cloud import POINT_CLOUD, confined, file_points
from tasks.capture.point_cloud.confined import read_confined
from tasks.capture.point_cloud.normals import oriented_normals
from tasks.capture.point_cloud.pcd import read_pcd
from tasks.capture.point_cloud.points import Points
from tasks.capture.point_cloud.projections import units_of_keys, units_of_text
from tests.tasks.capture.formats.clouds import small_cloud, write_las

CLOUD = small_cloud()
FOOT = 1200 / 3937
DEGREES = 'GEOGCS["NAD83",DATUM["d",SPHEROID["s",6378137,298.25]],PRIMEM["G",0],UNIT["degree",0.0174532925199433]]'
COLORADO = f'PROJCS["Colorado Central (ftUS)",{DEGREES},PROJECTION["p"],PARAMETER["x",1],UNIT["US survey foot",0.304800609601219]]'
MODERN_PLANE = (
    'PROJCRS["a / UTM 10N",BASEGEOGCRS["a",DATUM["d",ELLIPSOID["e",6378137,298,LENGTHUNIT["metre",1]]]],'
    'CONVERSION["c",METHOD["m"],PARAMETER["x",0.9,SCALEUNIT["unity",1]],PARAMETER["y",5,LENGTHUNIT["metre",1]]],'
    'CS[Cartesian,2],AXIS["e",east,ORDER[1],LENGTHUNIT["foot",0.3048]],AXIS["n",north,ORDER[2],LENGTHUNIT["foot",0.3048]]]'
)


@pytest.mark.parametrize(
    ("text", "plane", "height"),
    [
        (COLORADO, 0.304800609601219, None),
        (f'COMPD_CS["c",{COLORADO},VERT_CS["NAVD88",VERT_DATUM["v",2005],UNIT["metre",1.0],AXIS["Up",UP]]]', 0.304800609601219, 1.0),
        (f'COMPD_CS["c",PROJCS["u",{DEGREES},UNIT["metre",1]],VERT_CS["v",UNIT["US survey foot",{FOOT}]]]', 1.0, FOOT),
        (MODERN_PLANE, 0.3048, None),
        (f'COMPOUNDCRS["c",{MODERN_PLANE},VERTCRS["v",CS[vertical,1],AXIS["h",up,LENGTHUNIT["metre",1]]]]', 0.3048, 1.0),
        (f"BOUNDCRS[SOURCECRS[{MODERN_PLANE}],TARGETCRS[{DEGREES}]]", 0.3048, None),
        ('LOCAL_CS["site",LOCAL_DATUM["l",0],UNIT["foot",0.3048],AXIS["x",EAST]]', 0.3048, None),
        ("", None, None),
        ("not WKT [", None, None),
        ("[" * 70_000, None, None),
    ],
)
def test_the_unit_is_that_of_the_plane(text: str, plane: float | None, height: float | None) -> None:
    units = units_of_text(text, "a.las")
    assert (units.plane_m, units.height_m) == (plane, height)


@pytest.mark.parametrize(
    "text",
    [
        DEGREES,
        f'COMPD_CS["c",{DEGREES},VERT_CS["v",UNIT["metre",1]]]',
        'COMPOUNDCRS["c",GEOGCRS["WGS 84",CS[ellipsoidal,2],ANGLEUNIT["degree",0.017]],VERTCRS["v",LENGTHUNIT["metre",1]]]',
        'GEODCRS["WGS 84",CS[ellipsoidal,3],AXIS["lat",north,ANGLEUNIT["degree",0.017]]]',
        'GEOCCS["e",UNIT["metre",1]]',
        'GEODCRS["e",CS[Cartesian,3],LENGTHUNIT["metre",1]]',
    ],
)
def test_coordinates_on_the_globe_are_refused_by_name(text: str) -> None:
    with pytest.raises(InputError, match=r"^a.las: coordinate system: '.+' is geo(graphic|centric): .+; project the points to meters"):
        units_of_text(text, "a.las")


def test_keys_of_geotiff_state_the_units_of_the_plane_and_of_heights() -> None:
    units = units_of_keys({1024: (0, 1), 2048: (0, 4269), 3076: (0, 9003), 4099: (0, 9001)}, [], "a.las")
    assert (units.plane_m, units.height_m) == (FOOT, 1.0)
    assert units.height_factor == pytest.approx(1 / FOOT)
    assert units_of_keys({1024: (0, 1), 3076: (0, 32767), 3077: (34736, 1)}, [9.0, 0.25], "a.las").plane_m == 0.25
    assert units_of_keys({1024: (0, 1), 3072: (0, 2232)}, [], "a.las").notes == ("the coordinate system EPSG:2232 states no known unit",)
    for keys in ({1024: (0, 2), 2048: (0, 4326), 4099: (0, 9001)}, {2048: (0, 4326)}):
        with pytest.raises(InputError, match="coordinate system: EPSG:4326 is geographic: x and y are degrees; project"):
            units_of_keys(keys, [], "a.las")
    with pytest.raises(InputError, match="geocentric"):
        units_of_keys({1024: (0, 3)}, [], "a.las")


def test_heights_in_another_unit_are_read_as_stated_and_lead_back(tmp_path: Path) -> None:
    plan = dataclasses.replace(CLOUD, points=CLOUD.points / [FOOT, FOOT, 1.0])
    write_las(tmp_path / "a.las", plan)
    las = laspy.read(tmp_path / "a.las")
    text = f'COMPD_CS["c",{COLORADO},VERT_CS["NAVD88",UNIT["metre",1.0]]]'
    las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
    las.write(tmp_path / "a.las")
    points = file_points(tmp_path / "a.las", "a.las")
    assert points.unit_m is not None
    assert np.allclose(points.positions * points.unit_m, CLOUD.points, rtol=0, atol=1e-3)
    assert "a.las: heights are in another unit, metre: read as stated" in points.notes
    (scan,), _ = find_scans(tmp_path)
    reading = POINT_CLOUD.read(scan)
    original = reading.surface.vertices @ reading.to_original[:3, :3].T + reading.to_original[:3, 3]
    low, high = plan.points.min(axis=0), plan.points.max(axis=0)
    assert ((original > low - 0.4) & (original < high + 0.4)).all()


def test_every_dimension_of_a_las_file_is_used_or_named(tmp_path: Path) -> None:
    head = laspy.LasHeader(point_format=8, version="1.4")
    head.scales = np.full(3, 0.001)
    extra = ("label", "Instance", "object_id", "tree")
    head.add_extra_dims([laspy.ExtraBytesParams(name=word, type=np.int32) for word in extra])
    las = laspy.LasData(head)
    las.x, las.y, las.z = CLOUD.points.T
    las.Instance, las.label = CLOUD.owner, CLOUD.owner + 10
    las.write(tmp_path / "a.las")
    points = file_points(tmp_path / "a.las", "a.las")
    assert points.objects is not None
    assert {label for _, label in points.objects.named} == {f"class {owner + 10}" for owner in np.unique(CLOUD.owner)}
    (line,) = [note for note in points.notes if note.endswith(": not used")]
    named = line.removeprefix("a.las: ").removesuffix(": not used").split(", ")
    taken = {"X", "Y", "Z", "red", "green", "blue", "withheld", "Instance", "label"}
    assert set(named) == set(head.point_format.dimension_names) - taken
    assert {"user_data", "nir", "object_id", "tree"} <= set(named)


@pytest.mark.parametrize(("version", "at"), [("1.2", 100), ("1.4", 100), ("1.4", 243)])
def test_more_records_than_a_las_file_holds_are_refused_at_once(version: str, at: int, tmp_path: Path) -> None:
    las = laspy.LasData(laspy.LasHeader(point_format=2 if version == "1.2" else 7, version=version))
    las.x, las.y, las.z = CLOUD.points.T
    las.write(tmp_path / "a.las")
    data = bytearray((tmp_path / "a.las").read_bytes())
    data[at : at + 4] = bytes([255] * 4)
    (tmp_path / "a.las").write_bytes(data)
    with pytest.raises(InputError, match=r"^a.las: header: states 4294967295 records, more than its \d+ bytes hold; "):
        file_points(tmp_path / "a.las", "a.las")


def test_a_class_without_an_object_is_named(tmp_path: Path) -> None:
    head = laspy.LasHeader(point_format=2, version="1.2")
    head.scales = np.full(3, 0.001)
    head.add_extra_dims([laspy.ExtraBytesParams(name="label", type=np.int32)])
    las = laspy.LasData(head)
    las.x, las.y, las.z = CLOUD.points.T
    las.write(tmp_path / "a.las")
    points = file_points(tmp_path / "a.las", "a.las")
    assert points.objects is None
    assert any("label" in note and note.endswith(": not used") for note in points.notes)


def write_e57(path: Path, scans: Sequence[tuple[Mapping[str, np.ndarray], Sequence[float] | None]]) -> None:
    """An E57 of scans with any fields, and the place of each sensor, None without a pose."""
    with pye57.E57(str(path), mode="w") as file:
        image = file.image_file
        image.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
        for fields, place in scans:
            node = libe57.StructureNode(image)
            node.set("guid", libe57.StringNode(image, "{0}"))
            if place is not None:
                pose, turn, move = (libe57.StructureNode(image) for _ in range(3))
                node.set("pose", pose)
                pose.set("rotation", turn)
                pose.set("translation", move)
                for word, value in zip("wxyz", (1.0, 0.0, 0.0, 0.0), strict=True):
                    turn.set(word, libe57.FloatNode(image, value))
                for word, value in zip("xyz", place, strict=True):
                    move.set(word, libe57.FloatNode(image, value))
            prototype = libe57.StructureNode(image)
            buffers = libe57.VectorSourceDestBuffer()
            count = len(next(iter(fields.values())))
            arrays = []
            for word, values in fields.items():
                is_whole = values.dtype.kind in "iu"
                kind: Any = libe57.IntegerNode(image, 0, 0, 255) if is_whole else libe57.FloatNode(image, 0.0)
                prototype.set(word, kind)
                arrays.append(np.ascontiguousarray(values.astype("u1" if is_whole else "f8")))
                buffers.append(libe57.SourceDestBuffer(image, word, arrays[-1], count, True, True))
            points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
            node.set("points", points)
            file.data3d.append(node)
            writer = points.writer(buffers)
            writer.write(count)
            writer.close()


def e57_fields(local: np.ndarray, is_spherical: bool) -> dict[str, np.ndarray]:
    if not is_spherical:
        return {f"cartesian{axis}": local[:, i] for i, axis in enumerate("XYZ")}
    distance = np.linalg.norm(local, axis=1)
    angles = np.arctan2(local[:, 1], local[:, 0]), np.arcsin(local[:, 2] / distance)
    return dict(zip(("sphericalRange", "sphericalAzimuth", "sphericalElevation"), (distance, *angles), strict=True))


@pytest.mark.parametrize("is_spherical", [False, True])
def test_invalid_points_of_an_e57_file_are_left_out_and_counted(is_spherical: bool, tmp_path: Path) -> None:
    sensor = np.array([0.5, 0.2, 1.4])
    fields = e57_fields(CLOUD.points - sensor, is_spherical)
    state = np.zeros(len(CLOUD.points), "i8")
    state[3:7], state[9] = 1, 2
    kind = "spherical" if is_spherical else "cartesian"
    further = {word: np.ones(len(state)) for word in ("intensity", "nor:normalX", "nor:normalY", "nor:normalZ")}
    fields |= {f"{kind}InvalidState": state, "isColorInvalid": state, **further}
    write_e57(tmp_path / "a.e57", [(fields, sensor)])
    points = file_points(tmp_path / "a.e57", "a.e57")
    assert np.allclose(points.positions, CLOUD.points[state == 0], rtol=0, atol=1e-9)
    assert points.notes == (
        "a.e57: 5 points are marked as invalid: left out",
        "a.e57: isColorInvalid, intensity, nor:normalX, nor:normalY, nor:normalZ: not used",
    )


def test_a_scan_without_a_pose_leaves_the_sensors_of_others(tmp_path: Path) -> None:
    sensor = np.array([0.5, 0.2, 1.4])
    half = len(CLOUD.points) // 2
    scans = [(e57_fields(CLOUD.points[:half] - sensor, False), sensor), (e57_fields(CLOUD.points[half:], False), None)]
    write_e57(tmp_path / "a.e57", scans)
    points = file_points(tmp_path / "a.e57", "a.e57")
    assert points.sensors is not None
    assert points.sensor_of is not None
    assert points.sensors.tolist() == [sensor.tolist()]
    assert np.array_equal(points.sensor_of, np.repeat([0, -1], [half, len(CLOUD.points) - half]))
    assert points.notes == ("a.e57: no pose in scan 1: the place of the sensor is not known there",)
    # A sensor behind the surface, where no open space is, decides alone.
    behind = dataclasses.replace(points, sensors=np.array([[-50.0, -40.0, -30.0]]))
    normals = oriented_normals(behind, cKDTree(points.positions), 0.02, 1.0)
    toward = behind.sensors[0] - points.positions[:half]
    assert (np.einsum("ni,ni->n", normals.values[:half], toward) >= 0).all()
    assert normals.note.startswith("normals point to the sensors, which the file states for 50.0% of points; of the others, ")


ANSWER: dict[str, Any] = {
    "columns": {"positions": ["<f8", 3, 0], "colors": ["|u1", 3, 48], "sensor_of": ["<i4", 1, 54]},
    "unit_m": 1.0, "height_factor": 1.0, "notes": ["a\nb"], "sensors": [[0.0, 0.0, 0.0]],
}  # fmt: skip


def answered(facts: Mapping[str, Any], data: bytes, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Points:
    """Points of an answer that a child gave."""
    monkeypatch.setattr(confined, "run_child", lambda code, arguments, place, limits, name: facts)
    monkeypatch.setattr(confined, "read_file", lambda path, name, most: data)
    (folder / "a.las").write_bytes(b"LASF")
    return read_confined(folder / "a.las", "a.las", "las")


def test_an_answer_of_a_child_is_read_with_notes_of_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = answered(ANSWER, bytes(62), tmp_path, monkeypatch)
    assert (points.positions.shape, points.notes) == ((2, 3), ("a b",))


@pytest.mark.parametrize(
    "wrong",
    [
        {"columns": {"positions": ["O", 3, 0]}},
        {"columns": {"positions": ["V0", 3, 0]}},
        {"columns": {"positions": ["<f8", 0, 0]}},
        {"columns": {"positions": ["<f8", -3, 0]}},
        {"columns": {"positions": ["<f8", 3, -8]}},
        {"columns": {"positions": ["<f8", 3, 0], "colors": ["|u1", 3, 47], "sensor_of": ["<i4", 1, 54]}},
        {"columns": {"positions": ["<f8", 3, 0], "more": ["<f8", 1, 48]}},
        {"columns": {"positions": "<f8"}},
        {"columns": {"colors": ["|u1", 3, 0]}},
        {"columns": []},
        {"columns": {"positions": ["<f8", 3, 0]}},
        {"unit_m": -1.0},
        {"unit_m": float("nan")},
        {"height_factor": float("inf")},
        {"notes": [5]},
        {"notes": "line"},
        {"sensors": [[0.0, float("nan"), 0.0]]},
        {"sensors": [[0.0, 0.0]]},
        {"unit_m": "1"},
    ],
)
def test_a_wrong_answer_of_a_child_is_refused(wrong: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"^a.las: content: its reader gave a wrong answer \([^\n]+\); export it again$"):
        answered(ANSWER | wrong, bytes(62), tmp_path, monkeypatch)


def test_a_sensor_that_is_not_listed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"wrong answer \(sensors\)"):
        answered(ANSWER, bytes(54) + np.array([0, 1], "<i4").tobytes(), tmp_path, monkeypatch)


def test_a_file_without_points_is_refused_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"^a.las: points: the file has none that can be used; export"):
        answered(ANSWER | {"columns": {}}, b"", tmp_path, monkeypatch)


WIDTH, HEIGHT, FOCAL = 120, 90, 100.0


def grid_points() -> np.ndarray:
    """A wavy wall as a depth camera sees it, in the frame of the camera [m]."""
    v, u = np.indices((HEIGHT, WIDTH)).astype(float)
    depth = 2.0 + 0.3 * np.sin(u / 9) * np.cos(v / 7)
    return np.stack([(u - 60) / FOCAL * depth, (v - 45) / FOCAL * depth, depth], axis=2).reshape(-1, 3)


def write_pcd(path: Path, columns: Mapping[str, np.ndarray], viewpoint: str, is_grid: bool) -> None:
    """A binary PCD of floats; a column of shape (n, k) has COUNT k."""
    arrays = [values.reshape(len(values), -1) for values in columns.values()]
    count = len(arrays[0])
    widths = " ".join(str(values.shape[1]) for values in arrays)
    size = (WIDTH, HEIGHT) if is_grid else (count, 1)
    head = f"VERSION 0.7\nFIELDS {' '.join(columns)}\nSIZE {' 4' * len(arrays)}\nTYPE {' F' * len(arrays)}\nCOUNT {widths}\n"
    head += f"WIDTH {size[0]}\nHEIGHT {size[1]}\nVIEWPOINT {viewpoint}\nPOINTS {count}\nDATA binary\n"
    path.write_bytes(head.encode() + np.concatenate(arrays, axis=1).astype("<f4").tobytes())


TURNED = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""A camera that looks along +x, with +z up: quaternion 0.5 -0.5 0.5 -0.5."""


@pytest.mark.parametrize("is_in_camera", [False, True])
@pytest.mark.parametrize("unit_m", [1.0, 0.001])
def test_the_viewpoint_of_a_grid_is_the_pose_of_its_frame(is_in_camera: bool, unit_m: float, tmp_path: Path) -> None:
    seen, place = grid_points(), np.array([4.0, -2.0, 1.5])
    stored = (seen if is_in_camera else seen @ TURNED.T + place) / unit_m
    ones = np.ones(len(stored))
    columns = {word: stored[:, i] for i, word in enumerate("xyz")}
    columns |= dict.fromkeys(("normal_x", "normal_y", "normal_z", "instance", "label", "curvature"), ones)
    columns["fpfh"] = np.ones((len(stored), 33))
    viewpoint = " ".join(str(v) for v in [*(place / unit_m).tolist(), 0.5, -0.5, 0.5, -0.5])
    write_pcd(tmp_path / "a.pcd", columns, viewpoint, is_grid=True)
    (scan,), _ = find_scans(tmp_path)
    reading = POINT_CLOUD.read(scan)
    (frame,) = reading.frames
    assert frame.pose is not None
    assert np.allclose(frame.pose[:3, :3], TURNED, rtol=0, atol=1e-9)
    assert np.allclose(frame.pose[:3, 3], place, rtol=0, atol=1e-9)
    assert frame.intrinsics == pytest.approx((FOCAL, FOCAL, 60, 45), abs=0.05)
    # Depth and pose lead to the scan frame, and from there to the coordinates of the file.
    world = seen @ frame.pose[:3, :3].T + frame.pose[:3, 3]
    assert np.allclose(world @ reading.to_original[:3, :3].T + reading.to_original[:3, 3], stored, rtol=0, atol=1e-6 / unit_m)
    assert frame.depth is not None
    assert np.allclose(frame.depth().ravel(), seen[:, 2], rtol=0, atol=1e-4)
    expected = ["fpfh (33 values): not used", "curvature: not used", "has no colors: drawn in gray", "the camera's pose is the VIEWPOINT"]
    expected += ["normal_x, normal_y, normal_z, instance, label: not used, a frame has color and depth alone"]
    expected += ["is read as millimeters"] if unit_m == 0.001 else []
    assert [part for part in expected if not any(part in note for note in reading.degradations)] == []


def test_a_grid_in_millimeters_without_a_viewpoint_leads_back(tmp_path: Path) -> None:
    seen = grid_points() * [1, -1, -1]
    write_pcd(tmp_path / "a.pcd", {word: 1000 * seen[:, i] for i, word in enumerate("xyz")}, "0 0 0 1 0 0 0", is_grid=True)
    (scan,), _ = find_scans(tmp_path)
    reading = POINT_CLOUD.read(scan)
    assert reading.frames[0].pose is None
    to_original = reading.to_original
    assert np.allclose(grid_points() @ to_original[:3, :3].T + to_original[:3, 3], 1000 * seen, rtol=0, atol=1e-9)


def test_the_viewpoint_of_rows_is_the_sensor_of_all_points(tmp_path: Path) -> None:
    columns = {word: CLOUD.points[:, i] for i, word in enumerate("xyz")}
    write_pcd(tmp_path / "a.pcd", columns, "0.5 0.25 1.5 1 0 0 0", is_grid=False)
    points = read_pcd(tmp_path / "a.pcd", "a.pcd").points
    assert points.sensors is not None
    assert points.sensors.tolist() == [[0.5, 0.25, 1.5]]
    assert points.sensor_of is not None
    assert (points.sensor_of == 0).all()
    write_pcd(tmp_path / "a.pcd", columns, "0 0 0 1 0 0 0", is_grid=False)
    assert read_pcd(tmp_path / "a.pcd", "a.pcd").points.sensors is None


def test_a_field_that_is_listed_twice_is_refused(tmp_path: Path) -> None:
    columns = {word: CLOUD.points[:, i] for i, word in enumerate("xyz")}
    write_pcd(tmp_path / "a.pcd", {**columns, "w": columns["x"]}, "0 0 0 1 0 0 0", is_grid=False)
    data = (tmp_path / "a.pcd").read_bytes()
    (tmp_path / "a.pcd").write_bytes(data.replace(b"FIELDS x y z w", b"FIELDS x y z x"))
    with pytest.raises(InputError, match=r"^a.pcd: FIELDS: list 'x' twice; "):
        read_pcd(tmp_path / "a.pcd", "a.pcd")
