"""RoomPlan: structures of several rooms and storeys, and facts that are unused or contradict each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.formats import find_scans
from tasks.capture.reading import Reading
from tasks.capture.storeys.splitting import divided, write_divided
from tasks.geometry.triangles import face_areas
from tasks.stage import Context
from tests.tasks.capture.formats.written import only_scan, read
from tests.tasks.capture.phones.captured_rooms import (
    DEPTH,
    HEIGHT,
    WIDTH,
    captured,
    element,
    floor_lying,
    placed,
    surface,
    table,
    walls,
    write,
)


def labels_of(reading: Reading) -> list[str]:
    return sorted(group.raw_label for group in reading.groups or ())


def notes_of(folder: Path, **lists: Any) -> str:
    write(folder / "home", captured(**{"walls": walls(), "floors": [floor_lying()], **lists}))
    return "\n".join(read(folder).degradations)


def house() -> dict[str, Any]:
    """A structure of two storeys and three rooms, each of which it lists again."""
    rooms = [
        captured(walls=walls(), floors=[floor_lying()], objects=[table()], sections=[{"label": "kitchen", "story": 0}]),
        captured(walls=walls(x=4.1), floors=[floor_lying(x=4.1)], objects=[table(x=4.1)], sections=[{"label": "livingRoom", "story": 0}]),
        captured(walls=walls(2.8, 1), floors=[floor_lying(2.8, story=1)], objects=[table(2.8, story=1)]),
    ]
    kinds = ("walls", "floors", "objects", "doors", "windows", "openings", "sections")
    merged = {kind: [entry for room in rooms for entry in room[kind]] for kind in kinds}
    return {"identifier": "house", "version": 2, "rooms": rooms, **merged}


def test_a_structure_is_not_read_twice(tmp_path: Path) -> None:
    write(tmp_path / "home", house(), "CapturedStructure.json")
    reading = read(tmp_path)
    assert labels_of(reading) == sorted(["wall"] * 12 + ["floor"] * 3 + ["table"] * 3)
    assert any("sections: name several kinds of rooms (kitchen, living room)" in note for note in reading.degradations)


def test_rooms_alone_are_the_structure(tmp_path: Path) -> None:
    write(tmp_path / "home", {"identifier": "house", "version": 2, "rooms": house()["rooms"]}, "CapturedStructure.json")
    reading = read(tmp_path)
    assert labels_of(reading) == sorted(["wall"] * 12 + ["floor"] * 3 + ["table"] * 3)
    assert any("walls: the structure lists none, its rooms list 12: those are used" in note for note in reading.degradations)


def test_objects_that_a_structure_lost_are_named(tmp_path: Path) -> None:
    document = house()
    document["objects"] = document["objects"][:1]
    write(tmp_path / "home", document, "CapturedStructure.json")
    assert any("objects: the structure lists 1, its rooms 3" in note for note in read(tmp_path).degradations)


@pytest.mark.whole
def test_a_scene_of_two_storeys_says_so(tmp_path: Path) -> None:
    """Stated numbers count also where a storey is smaller than one that its geometry would tell."""
    write(tmp_path / "home", house(), "CapturedStructure.json")
    scan = only_scan(tmp_path)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
    assert any(note.startswith("2 storeys, floors at 0.00 and 2.80 m, but a scene is of one") for note in outcome.degradations)
    assert sum(row.category == "table" for row in outcome.rows["instances"]) == 3


@pytest.mark.whole
def test_each_storey_becomes_a_scan(tmp_path: Path) -> None:
    """`metascenes storeys` cuts a structure between the stated floors; tables, walls and floors stay whole."""
    write(tmp_path / "scans" / "home", house(), "CapturedStructure.json")
    parted = divided(only_scan(tmp_path / "scans"), CaptureConfig())
    assert parted.levels.floors == pytest.approx((0.0, 2.8))
    assert HEIGHT <= parted.levels.cuts[0] < 2.8
    write_divided(tmp_path / "storeys", parted)
    scans, errors = find_scans(tmp_path / "storeys")
    assert errors == []
    counts = []
    for scan in scans:
        outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
        (shell,) = outcome.rows["shells"]
        categories = [row.category for row in outcome.rows["instances"]]
        counts.append((scan.scene_id, categories.count("table"), categories.count("wall"), shell.height_m))
    assert counts == [
        ("glb/home_floor0", 2, 8, pytest.approx(HEIGHT, abs=0.05)),
        ("glb/home_floor1", 1, 4, pytest.approx(HEIGHT, abs=0.05)),
    ]


def test_small_storeys_count_as_stated(tmp_path: Path) -> None:
    """A storey with less floor than the geometry asks for is one if the file says so."""
    corners = [[-0.9, -0.9, 0], [0.9, -0.9, 0], [0.9, 0.9, 0], [-0.9, 0.9, 0]]
    attic = floor_lying(2.8, story=1) | {"polygonCorners": corners, "dimensions": [1.8, 1.8, 0]}
    upper = [wall | {"dimensions": [1.8, HEIGHT, 0]} for wall in walls(2.8, 1)]
    write(tmp_path / "home", captured(walls=[*walls(), *upper], floors=[floor_lying(), attic]))
    reading = read(tmp_path)
    assert reading.levels is not None
    assert reading.levels.floors == pytest.approx((0.0, 2.8))


def test_storeys_without_numbers_go_by_height(tmp_path: Path) -> None:
    listed = [wall | {"story": None} for wall in [*walls(), *walls(2.8)]]
    write(tmp_path / "home", captured(walls=listed, floors=[]))
    reading = read(tmp_path)
    assert reading.levels is not None
    assert reading.levels.floors == pytest.approx((0.0, 2.8))


@pytest.mark.parametrize("lost", [0, 5, 7])
def test_a_wall_without_a_story_costs_no_other_its_own(lost: int, tmp_path: Path) -> None:
    """Storeys of walls that start at one height are told by their numbers alone."""
    listed = [*walls(), *walls(1.6, 1)]
    listed[lost] = listed[lost] | {"story": None}
    write(tmp_path / "home", captured(walls=listed, floors=[floor_lying(), floor_lying(1.6, story=1)]))
    reading = read(tmp_path)
    assert reading.levels is not None
    assert reading.levels.floors == pytest.approx((0.0, 1.6))
    assert any("walls: 1 of 8 state no story: their lower edges decide" in note for note in reading.degradations)


def test_partial_numbers_of_small_rises_contradict_heights(tmp_path: Path) -> None:
    listed = [*walls(), *walls(1.2, 1)]
    listed[7] = listed[7] | {"story": None}
    notes = notes_of(tmp_path, walls=listed)
    assert "storey 0 at 0.00 m, storey 1 at 1.20 m: numbers and heights disagree" in notes


def test_a_rise_without_any_number_is_named(tmp_path: Path) -> None:
    notes = notes_of(tmp_path, walls=[wall | {"story": None} for wall in [*walls(), *walls(1.2)]])
    assert "lower edges rise by 1.20 m without a story: read as one storey" in notes


@pytest.mark.parametrize(("stated", "floors"), [(1, (0.0, 2.8, 5.6)), (0, (0.0, 2.8, 5.6)), (2, (0.0, 2.8, 5.6))])
def test_walls_far_from_all_stated_ones_are_storeys_of_their_own(stated: int, floors: tuple[float, ...], tmp_path: Path) -> None:
    levels = [[wall | {"story": 3 if k == stated else None} for wall in walls(2.8 * k)] for k in range(3)]
    write(tmp_path / "home", captured(walls=[wall for level in levels for wall in level], floors=[]))
    reading = read(tmp_path)
    assert reading.levels is not None
    assert reading.levels.floors == pytest.approx(floors)


def test_fields_of_rooms_are_listed(tmp_path: Path) -> None:
    document = house()
    document["rooms"][0] |= {"ceilingHeight": 2.5}
    document["rooms"][1] |= {"story": 7}
    write(tmp_path / "home", document, "CapturedStructure.json")
    (line,) = (note for note in read(tmp_path).degradations if "not used: " in note)
    assert "rooms.ceilingHeight, rooms.story" in line


@pytest.mark.parametrize("kind", ["door", "window"])
def test_a_door_that_is_not_a_rectangle_is_named(kind: str, tmp_path: Path) -> None:
    angles = np.linspace(0, np.pi, 9)
    arch = [[-0.45, -1, 0], [0.45, -1, 0], *([0.45 * np.cos(a), 0.55 + 0.45 * np.sin(a), 0] for a in angles)]
    arched = surface(kind, placed(0, 1.0, -1.5), [0.9, 2.0, 0], polygonCorners=arch)
    assert f"{kind}s[0].polygonCorners: not a rectangle: its rectangle is taken" in notes_of(tmp_path / "a", **{f"{kind}s": [arched]})
    square = surface(kind, placed(0, 1.0, -1.5), [0.9, 2.0, 0], polygonCorners=[[-0.45, -1, 0], [0.45, -1, 0], [0.45, 1, 0], [-0.45, 1, 0]])
    assert "polygonCorners" not in notes_of(tmp_path / "b", **{f"{kind}s": [square]})
    curved = surface(kind, placed(0, 1.0, -1.5), [0.9, 2.0, 0], curve={"radius": 2.0})
    assert f"{kind}s.curve" in notes_of(tmp_path / "c", **{f"{kind}s": [curved]})


def test_numbers_that_contradict_heights_are_named(tmp_path: Path) -> None:
    write(tmp_path / "home", captured(walls=[*walls(), *walls(0.1, 1, x=5.0)], floors=[]))
    reading = read(tmp_path)
    assert reading.levels is None
    assert any("story: storey 0 at 0.00 m, storey 1 at 0.10 m: numbers and heights disagree" in note for note in reading.degradations)


def test_unused_facts_are_listed(tmp_path: Path) -> None:
    chair = element("chair", placed(1, 0.45, 0), [0.5, 0.9, 0.5], parentIdentifier="table", attributes=[{"identifier": "ChairType"}])
    notes = notes_of(tmp_path, objects=[chair], coreModel="AAAA", referenceOriginTransform=[1.0] * 16)
    expected = (
        "coreModel, floors.confidence, objects.attributes, objects.confidence, objects.parentIdentifier, "
        "referenceOriginTransform, walls.confidence"
    )
    assert f"not used: {expected}" in notes


def test_an_open_door_is_shown_shut(tmp_path: Path) -> None:
    door = surface("door", placed(0, 1.0, -1.5), [0.9, 2.0, 0]) | {"category": {"door": {"isOpen": True}}}
    assert "doors: 1 open door, shown shut" in notes_of(tmp_path, doors=[door])


@pytest.mark.parametrize(
    ("parent", "z", "lost", "expected"),
    [
        (0, -1.5, 0, ""),
        (None, -1.5, 0, ""),
        (1, -1.5, 0, "doors[0].parentIdentifier: names a wall that it does not lie in"),
        ("gone", -1.5, 0, "doors[0].parentIdentifier: names a wall that is not listed"),
        (None, -0.5, None, "doors[0]: lies in no wall"),
    ],
)
def test_a_door_is_in_the_wall_where_it_lies(parent: Any, z: float, lost: int | None, expected: str, tmp_path: Path) -> None:
    named = walls()[parent]["identifier"] if isinstance(parent, int) else parent
    door = surface("door", placed(0, 1.0, z), [0.9, 2.0, 0], parentIdentifier=named)
    notes = notes_of(tmp_path, doors=[door])
    reading = read(tmp_path)
    assert reading.surface is not None
    areas = face_areas(reading.surface.vertices, reading.surface.faces)
    own = [float(areas[group.faces].sum()) for group in reading.groups or () if group.raw_label == "wall"]
    full = [WIDTH * HEIGHT, WIDTH * HEIGHT, DEPTH * HEIGHT, DEPTH * HEIGHT]
    assert own == pytest.approx([area - (0.9 * 2.0 if index == lost else 0.0) for index, area in enumerate(full)])
    assert expected in notes
    assert bool(expected) == ("doors[0]" in notes)


def test_a_wrong_story_costs_the_number_alone(tmp_path: Path) -> None:
    listed = [wall | {"story": "upstairs"} for wall in walls()]
    notes = notes_of(tmp_path, walls=listed)
    assert "walls[0].story: must be a whole number: not used" in notes
    assert labels_of(read(tmp_path)) == ["floor", "wall", "wall", "wall", "wall"]


def test_the_reason_for_walls_that_are_all_wrong(tmp_path: Path) -> None:
    write(tmp_path / "home", captured(walls=[{"dimensions": [1]}]))
    with pytest.raises(InputError, match=r"^home/CapturedRoom.json: walls: none is usable \(walls\[0\].dimensions: must be 3 numbers"):
        read(tmp_path)


@pytest.mark.parametrize("rooms", ["kitchen", [1], {"a": 1}])
def test_rooms_that_are_no_list_are_refused(rooms: Any, tmp_path: Path) -> None:
    write(tmp_path / "home", captured(walls=walls(), rooms=rooms))
    with pytest.raises(InputError, match=r"^home/CapturedRoom.json: rooms: must be a list of objects"):
        read(tmp_path)
