"""RoomPlan: curved walls as chords, whichever way angles count, with the doors in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.capture.roomplan.curves import MAX_RADIUS_M, MAX_SAGITTA_M, Arc, Curve, arc_of
from tasks.capture.roomplan.elements import RoomElement
from tasks.capture.roomplan.surfaces import sheets_of
from tasks.geometry.transforms import transform_points
from tasks.geometry.triangles import face_areas
from tests.tasks.capture.formats.written import read
from tests.tasks.capture.phones.captured_rooms import (
    HEIGHT,
    WIDTH,
    Array,
    Element,
    arc,
    captured,
    floor_lying,
    placed,
    surface,
    walls,
    write,
)

RADIUS, SWEEP = 2.5, 2 * float(np.arcsin(0.8))
"""Of a bay with a chord of 4 m that is 1 m deep."""


def bay(curve: Any) -> list[Element]:
    """A room whose wall at +z, which looks back, is curved."""
    listed = walls()
    listed[1] = listed[1] | {"curve": curve}
    return listed


def curved_wall(folder: Path, curve: Any, **lists: Any) -> tuple[Array, float, tuple[str, ...]]:
    """Vertices of the second wall in the +Z-up frame, where it lies at y = -1.5 m, its area [m2], and the notes."""
    write(folder / "home", captured(walls=bay(curve), floors=[floor_lying()], **lists))
    reading = read(folder)
    assert reading.surface is not None
    group = [group for group in reading.groups or () if group.raw_label == "wall"][1]
    area = float(face_areas(reading.surface.vertices, reading.surface.faces[group.faces]).sum())
    return reading.surface.vertices[group.vertices], area, reading.degradations


@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize(("center", "sign", "depth"), [(-1.5, 1.0, -0.5), (1.5, -1.0, -2.5), (1.5, 1.0, -2.5)])
def test_a_bay_is_an_arc_between_its_neighbors(center: float, sign: float, depth: float, is_measured: bool, tmp_path: Path) -> None:
    """The arc ends at the wall's ends, lies on the stated circle, and bulges away from its center."""
    curve = arc(RADIUS, SWEEP, center, is_measured, sign)
    vertices, area, notes = curved_wall(tmp_path, curve)
    assert vertices[:, 0].min() == pytest.approx(-WIDTH / 2)
    assert vertices[:, 0].max() == pytest.approx(WIDTH / 2)
    middle = [0.0, -1.5 + center]
    np.testing.assert_allclose(np.linalg.norm(vertices[:, :2] - middle, axis=1), RADIUS, atol=1e-6)
    deepest = vertices[np.abs(vertices[:, 1] + 1.5).argmax(), 1]
    assert deepest == pytest.approx(depth, abs=MAX_SAGITTA_M)
    assert area == pytest.approx(RADIUS * SWEEP * HEIGHT, rel=0.005)
    assert any("walls[1].curve: an arc of 2.50 m radius becomes 11 flat pieces" in note for note in notes)


def test_a_door_in_a_curved_wall_leaves_a_hole(tmp_path: Path) -> None:
    plain = curved_wall(tmp_path / "plain", arc(RADIUS, SWEEP, 1.5, sign=-1.0))[1]
    door = surface("door", placed(0.0, 1.0, 2.5, np.pi), [0.9, 2.0, 0], parentIdentifier=None)
    cut = curved_wall(tmp_path / "cut", arc(RADIUS, SWEEP, 1.5, sign=-1.0), doors=[door])[1]
    assert plain - cut == pytest.approx(0.9 * 2.0, rel=0.02)


def test_a_center_on_the_other_side_of_no_circle_is_named(tmp_path: Path) -> None:
    """A curve whose ends are not the wall's is bent between these, and both are named."""
    vertices, _, notes = curved_wall(tmp_path, arc(RADIUS, SWEEP, -4.0))
    assert np.ptp(vertices[:, 0]) == pytest.approx(WIDTH)
    assert np.ptp(vertices[:, 1]) == pytest.approx(1.0, abs=MAX_SAGITTA_M)
    assert any("curve: " in note and "its ends lie 2.50 m from those of its wall" in note for note in notes)


WRONG = {
    "no radius": ({"center": [0, 1.5], "startAngle": 0.6, "endAngle": 2.5}, "curve.radius: must be 1 numbers"),
    "no circle": (arc(0.0, SWEEP, 1.5), "curve.radius: must be 0.05 to 200 m"),
    "no sweep": (arc(2.5, 0.0, 1.5), "curve.endAngle: must be 1 to 360 degrees"),
    "no unit": (arc(2.5, SWEEP, 1.5) | {"startAngle": {"value": 0.6}}, "curve.startAngle.unit: must be one of"),
    "a text": ("round", "curve: must be an object"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_curve_leaves_a_flat_wall(case: str, tmp_path: Path) -> None:
    curve, expected = WRONG[case]
    vertices, area, notes = curved_wall(tmp_path, curve)
    assert area == pytest.approx(WIDTH * HEIGHT)
    np.testing.assert_allclose(vertices[:, 1], -1.5, atol=1e-6)
    assert any(expected in note and note.endswith("the wall is flat") for note in notes), notes


@settings(deadline=None, max_examples=80)
@given(st.floats(0.2, 20.0), st.floats(0.1, 6.0), st.sampled_from([1.0, -1.0]))
def test_unrolling_undoes_rolling(radius: float, sweep: float, side: float) -> None:
    """Points on the chords keep their place along the wall; chords are within a centimeter of the circle."""
    shape = Arc(np.array([0.3, -0.2]), radius, 0.5 * np.pi + side * 0.5 * sweep, -side * sweep)
    along = np.linspace(-0.5, 0.5, 50) * shape.length
    rolled = shape.roll(np.column_stack([along, np.ones(50), np.zeros(50)]))
    back = shape.unroll(rolled)
    np.testing.assert_allclose(back[:, 0], along, atol=max(0.02, 0.01 * shape.length))
    assert np.abs(back[:, 2]).max() <= shape.sagitta + 1e-9 <= MAX_SAGITTA_M + 2e-9


@pytest.mark.parametrize("radius", [50.0, MAX_RADIUS_M])
def test_chords_of_the_largest_walls_are_within_the_sagitta(radius: float) -> None:
    for sweep in (np.pi, 2 * np.pi):
        assert Arc(np.zeros(2), radius, 0.0, sweep).sagitta <= MAX_SAGITTA_M + 1e-9


def test_ends_of_walls_are_looked_up_and_not_compared_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many curved walls that end elsewhere than stated, each transforms a few points, however many walls there are."""
    counts = []
    for walls_in_all in (10, 100):
        moved: list[int] = []

        def transformed(points: Any, pose: Any, moved: list[int] = moved) -> Any:
            moved.append(len(points))
            return transform_points(points, pose)

        monkeypatch.setattr("tasks.capture.roomplan.surfaces.transform_points", transformed)
        curve = Curve(np.array([0.0, -4.0]), RADIUS, ((0.6, 2.5),))
        poses = [placed(4.0 * k) for k in range(walls_in_all)]
        elements = [RoomElement("", "wall", pose, np.array([4.0, 2.5, 0.0]), np.zeros((0, 3)), "", "walls[0]", curve) for pose in poses]
        sheets_of(elements, "room")
        counts.append(sum(moved))
    assert counts[1] == 10 * counts[0]


@settings(deadline=None, max_examples=80)
@given(st.floats(0.5, 10.0), st.floats(0.2, 3.0), st.sampled_from([1.0, -1.0]), st.booleans())
def test_an_arc_that_fits_its_wall_is_found(radius: float, sweep: float, side: float, is_clockwise: bool) -> None:
    """Whatever the angles count from, the arc ends where the wall does and keeps the stated center."""
    width = 2 * radius * float(np.sin(sweep / 2))
    center = np.array([0.0, -side * radius * float(np.cos(sweep / 2))])
    middle = side * np.pi / 2
    angles = (middle - sweep / 2, middle + sweep / 2)
    stated = (-angles[1], -angles[0]) if is_clockwise else angles
    found, remark = arc_of(Curve(center, radius, (stated,)), width, None)
    assert remark == ""
    np.testing.assert_allclose(found.ends, [[-width / 2, 0], [width / 2, 0]], atol=0.05 * width + 0.05)
    assert found.center.tolist() == center.tolist()
