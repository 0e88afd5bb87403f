"""Scans of rooms of boxes: laid onto each other whatever their frames, and exactly the changes that were made."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tasks.geometry.transforms import inverse, yaw_of, yaw_pose
from tasks.rescans.configuration import MatchingConfig, RegistrationConfig
from tasks.rescans.matching import MatchedObject, matched, placed
from tasks.rescans.registration import Registration, registration
from tasks.rescans.surfaces import RoomScan, thinned
from tests.tasks.rescans.rooms import FIXED, SIZE, Thing, box, chair, scanned

LAMP = box("lamp", "lamp", (4.1, 2.8, 0.0), (0.3, 0.3, 1.5))
BOX = box("box", "box", (3.0, 0.5, 0.0), (0.4, 0.5, 0.3))
BEFORE = (*FIXED, chair("moved", (1.2, 2.4, 0.0), 0.0), LAMP)
AFTER = (*FIXED, chair("moved", (3.2, 1.6, 0.0), 2.0), BOX)


def held(later: RoomScan, earlier: RoomScan) -> tuple[Registration, list[MatchedObject]]:
    """How one scan lies in another, and what became of their objects."""
    found = registration(later, earlier, RegistrationConfig())
    return found, [] if found.problem else matched(placed(later, found.pose), earlier, MatchingConfig())


def check_known_changes(frame: NDArray[np.float64], back: NDArray[np.float64]) -> None:
    """The scans of `BEFORE` and `AFTER` in two frames give the true pose, and exactly what was changed."""
    found, changes = held(scanned("demo/b", AFTER, frame=frame), scanned("demo/a", BEFORE, frame=back))
    assert not found.problem
    off = inverse(back @ inverse(frame)) @ found.pose
    middle = frame @ [*(0.5 * np.array(SIZE)), 0.0, 1.0]
    assert abs(yaw_of(off)) < 0.01
    assert np.linalg.norm((off @ middle - middle)[:3]) < 0.02
    assert [(each.change, (each.later or each.reference).category) for each in changes if each.change != "unchanged"] == [  # type: ignore[union-attr]
        ("moved", "chair"),
        ("removed", "lamp"),
        ("added", "box"),
    ]
    assert sum(each.change == "unchanged" for each in changes) == len(FIXED)
    motion = next(each.motion for each in changes if each.change == "moved")
    assert motion is not None
    turned = back[:3, :3] @ [2.0, -0.8, 0.0]
    # the middle of the chair's box lies 1 mm behind that of its seat
    np.testing.assert_allclose(motion.shift[:2], turned[:2], atol=0.05)
    assert abs(motion.shift[2]) < 0.08, "each scan saw other parts of its legs"
    assert abs(motion.turn_radians - 2.0) < 0.06


def test_known_changes_are_found_between_frames_a_quarter_turn_apart() -> None:
    check_known_changes(yaw_pose(math.pi / 2 + 0.03, [1.0, -2.0, 0.0]), yaw_pose(0.0, [-2.2, -1.6, 0.0]))


@pytest.mark.whole
@settings(max_examples=5, deadline=None)
@given(
    quarter=st.integers(0, 3),
    little=st.floats(-0.05, 0.05),
    shift=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    back=st.floats(-math.pi, math.pi),
)
def test_known_changes_are_found_whatever_the_frames(quarter: int, little: float, shift: tuple[float, float], back: float) -> None:
    check_known_changes(yaw_pose(quarter * math.pi / 2 + little, [*shift, 0.0]), yaw_pose(back))


@pytest.mark.parametrize("size", [(4.4, 4.0), (3.6, 3.2), (6.0, 5.0)])
def test_another_room_is_refused(size: tuple[float, float]) -> None:
    things = (
        box("sofa", "sofa", (2.2, 0.5, 0.0), (1.9, 0.9, 0.8)),
        box("table", "table", (1.4, 2.0, 0.0), (1.2, 0.8, 0.74)),
        box("tv stand", "tv stand", (2.9, 2.9, 0.0), (1.1, 0.4, 0.5)),
    )
    found, _ = held(scanned("demo/b", things, size=size), scanned("demo/a", BEFORE))
    assert found.problem


def test_the_same_walls_with_other_furniture_are_refused() -> None:
    things = (
        box("sofa", "sofa", (2.2, 1.9, 0.0), (1.9, 0.9, 0.8)),
        box("table", "table", (3.3, 0.7, 0.0), (0.8, 0.5, 0.74)),
    )
    found, _ = held(scanned("demo/b", things), scanned("demo/a", BEFORE))
    assert "objects" in found.problem
    assert found.wall_share > 0.9


def test_a_scan_of_itself_has_no_changes_and_fits_all_over() -> None:
    room = scanned("demo/a", BEFORE)
    found, changes = held(room, room)
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-3)
    assert (found.wall_share, found.object_share, found.conflict_share) == (1.0, 1.0, 0.0)
    assert {each.change for each in changes} == {"unchanged"}
    assert all(each.reference is not None and each.later is not None for each in changes)
    assert [each.reference.instance_id for each in changes] == [each.later.instance_id for each in changes]  # type: ignore[union-attr]


def test_what_the_other_scan_never_saw_is_no_change() -> None:
    half = scanned("demo/b", FIXED[:1] + FIXED[2:], walls=(0, 2, 3), floor=(3.4, SIZE[1]))
    _, changes = held(half, scanned("demo/a", FIXED))
    assert {each.change for each in changes if each.reference and each.reference.category == "cabinet"} == {"not_seen"}
    assert {each.change for each in changes if each.reference and each.reference.category != "cabinet"} == {"unchanged"}


def test_what_the_other_scan_shows_without_a_name_is_no_change() -> None:
    nameless = tuple(dataclasses.replace(thing, is_named=thing.category != "cabinet") for thing in FIXED)
    _, changes = held(scanned("demo/b", nameless), scanned("demo/a", FIXED))
    assert {each.reference.category: each.change for each in changes if each.reference} == {
        "bed": "unchanged", "cabinet": "unnamed", "desk": "unchanged", "chair": "unchanged",
    }  # fmt: skip


def test_of_a_row_of_chairs_the_one_that_went_to_the_end_was_moved() -> None:
    row = [chair(str(number), (0.5 + 0.6 * number, 2.7, 0.0), -1.57) for number in range(4)]
    bed = FIXED[0]
    last: Thing = dataclasses.replace(row[0], place=(0.5 + 0.6 * 4, 2.7, 0.0))
    _, changes = held(scanned("demo/b", (bed, *row[1:], last)), scanned("demo/a", (bed, *row)))
    assert [each.change for each in changes] == ["unchanged", "moved", "unchanged", "unchanged", "unchanged"]
    assert changes[1].motion is not None
    assert abs(changes[1].motion.distance_m - 2.4) < 0.05
    assert abs(changes[1].motion.turn_radians) < 0.06


def test_what_looks_the_same_from_all_sides_turns_by_the_least() -> None:
    table = box("table", "table", (2.0, 1.2, 0.0), (0.8, 0.8, 0.7))
    turned = dataclasses.replace(table, place=(2.6, 1.2, 0.0), yaw=math.pi / 2 + 0.2)
    _, changes = held(scanned("demo/b", (*FIXED, turned)), scanned("demo/a", (*FIXED, table)))
    motion = changes[len(FIXED)].motion
    assert motion is not None
    assert abs(motion.turn_radians - 0.2) < 0.06


def test_thinned_points_are_means_of_their_voxels() -> None:
    rng = np.random.default_rng(0)
    points, normals = rng.uniform(-1, 1, (500, 3)), rng.normal(size=(500, 3))
    means, directions = thinned(points, normals, 0.5)
    cells = np.floor(points / 0.5)
    for mean, direction in zip(means, directions, strict=True):
        chosen = (cells == np.floor(mean / 0.5)).all(axis=1)
        np.testing.assert_allclose(mean, points[chosen].mean(axis=0))
        total = normals[chosen].sum(axis=0)
        np.testing.assert_allclose(direction, total / np.linalg.norm(total))
    assert len(means) == len(np.unique(cells, axis=0))
